"""The parts of a capture's spec: frozen pydantic models of shape, pose, camera and exposure. Lights: `gen.spec_lights`; materials:
`gen.spec_materials`."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

Array = NDArray[np.float64]


def _three(value: Any, what: str) -> tuple[float, float, float]:
    ok = isinstance(value, list | tuple) and len(value) == 3
    if not ok or any(isinstance(v, bool) or not isinstance(v, int | float) or not math.isfinite(v) for v in value):
        raise ValueError(f"must be {what}")
    return float(value[0]), float(value[1]), float(value[2])


def _colour(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        value = [value] * 3
    return _three(value, "one number (grey) or three [r, g, b]")


def _reflectance(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if min(value) < 0 or max(value) > 1:
        raise ValueError("must lie between 0 and 1 in every channel")
    return value


def _irradiance(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if min(value) <= 0:
        raise ValueError("must be greater than 0 in every channel")
    return value


def has_length(value: tuple[float, float, float]) -> tuple[float, float, float]:
    """The vector; ValueError where it is nothing."""
    if math.hypot(*value) < 1e-9:
        raise ValueError("must not be [0, 0, 0]: a direction needs a length")
    return value


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Whole = Annotated[int, Field(strict=True)]
YesNo = Annotated[bool, Field(strict=True)]
Vector = Annotated[tuple[float, float, float], BeforeValidator(lambda v: _three(v, "three numbers [x, y, z]"))]
Colour = Annotated[
    tuple[float, float, float], BeforeValidator(_colour, json_schema_input_type=float | tuple[float, float, float])
]
Reflectance = Annotated[Colour, AfterValidator(_reflectance)]
Intensity = Annotated[Colour, AfterValidator(_irradiance)]


class Part(BaseModel):
    """A section of the spec."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Shape(BaseModel):
    """A shape by name, its parameters beside the name; what is left out takes the shape's default.

    The name mesh stands for a GLB, OBJ, STL or PLY file: `file` (a relative path starts from the spec's folder), size_mm, up and
    smooth_degrees, see `gen.meshes.MeshFile`. Its sha256 is filled in here, so that the spec names the content.
    """

    model_config = ConfigDict(frozen=True, extra="allow")
    __pydantic_extra__: dict[str, float | int | bool | str]

    name: str = Field(description="name of the shape, such as cylinder or sphere, or mesh for a file")
    detail: tuple[dict[str, float | int | str], ...] | None = Field(
        default=None, max_length=8, description="surface detail: {kind: grooves, pitch: 0.8, ...}; heights add up"
    )

    @model_validator(mode="before")
    @classmethod
    def _file_is_named_by_its_content(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict) or data.get("name") != "mesh":
            return data
        from dataclasses import asdict

        from gen.meshes import mesh_file

        given = {key: value for key, value in data.items() if key not in ("name", "detail")}
        found = asdict(mesh_file(given, (info.context or {}).get("folder")))
        return {**data, **{key: value for key, value in found.items() if value is not None}}

    @field_validator("detail", mode="before")
    @classmethod
    def _detail_is_known(cls, value: Any) -> Any:
        if value is None:
            return None
        from blender_scenes.shapes.detail import checked_details

        checked_details(value)
        return value

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters that were given."""
        return dict(self.model_extra or {})


class Pose(Part):
    """Where the object is: turned about the fixed x, then y, then z axis, then moved."""

    rotation_degrees: Vector = (0.0, 0.0, 0.0)
    translation_mm: Vector = (0.0, 0.0, 0.0)

    def matrix(self) -> Array:
        """The rotation from the object's frame to the camera's, (3, 3): Rz Ry Rx."""
        (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(self.rotation_degrees)), np.sin(np.radians(self.rotation_degrees))
        rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        product: Array = rz @ ry @ rx
        return product


class Orthographic(Part):
    """Parallel projection."""

    kind: Literal["orthographic"]
    width_mm: Number = Field(ge=0.001, le=1e6, description="millimetres across the whole picture's width")
    distance_mm: Number = Field(
        default=1000.0, gt=0, le=1e6, description="from the camera to the origin; only depth depends on it"
    )


class Perspective(Part):
    """Pinhole camera, centred unless K says otherwise."""

    kind: Literal["perspective"]
    distance_mm: Number = Field(gt=0, le=1e6, description="from the camera to the origin")
    focal_px: Number | None = Field(default=None, gt=0, description="focal length in pixels")
    fov_degrees: Number | None = Field(default=None, gt=0.1, lt=150, description="horizontal field of view")
    K: tuple[Vector, Vector, Vector] | None = Field(
        default=None, description="3x3 intrinsics, OpenCV's: y down, pixel centres at integers"
    )

    @model_validator(mode="after")
    def _one_focal_length(self) -> Perspective:
        if sum(v is not None for v in (self.focal_px, self.fov_degrees, self.K)) != 1:
            raise ValueError("needs exactly one of focal_px, fov_degrees and K")
        if self.K is not None:
            (fx, skew, _), (zero, fy, _), bottom = self.K
            if fx <= 0 or fy <= 0 or skew != 0 or zero != 0 or bottom != (0.0, 0.0, 1.0):
                raise ValueError("K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx and fy positive")
        return self

    def intrinsics(self, width: int, height: int) -> Array:
        """K, (3, 3), for a picture of that size."""
        if self.K is not None:
            return np.array(self.K)
        focal = self.focal_px or width / 2 / math.tan(math.radians(self.fov_degrees or 0.0) / 2)
        return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])


CAMERAS: dict[str, type[Part]] = {"orthographic": Orthographic, "perspective": Perspective}


class AutoExposure(Part):
    """One exposure for the whole capture: the percentile of luma inside the mask, over all pictures, is brought to the level."""

    percentile: Number = Field(default=90.0, gt=0, le=100)
    level: Number = Field(default=0.6, gt=0, le=1)


def _exposure(value: Any) -> Any:
    if value == "auto":
        return AutoExposure()
    if isinstance(value, bool) or not isinstance(value, int | float | dict | AutoExposure):
        raise ValueError("must be auto, a number, or {percentile: P, level: L}")
    if isinstance(value, int | float) and not (math.isfinite(value) and value > 0):
        raise ValueError("must be a finite number greater than 0")
    return value


_AutoOrNumber = Annotated[
    Annotated[AutoExposure, Tag("auto")] | Annotated[Number, Tag("number")],
    Discriminator(lambda v: "number" if isinstance(v, int | float) else "auto"),
]
Exposure = Annotated[_AutoOrNumber, BeforeValidator(_exposure, json_schema_input_type=Literal["auto"] | float | AutoExposure)]
Camera = Annotated[Orthographic | Perspective, Discriminator("kind")]
