"""The spec of a capture: what a person writes in YAML, checked, with every default filled in.

A spec says one shape, its pose, its material, lights, camera and exposure; `degloss gen render` makes a capture of it.
Frame: x right, y up, z to the viewer, origin where the camera looks; lengths in millimetres, angles in degrees.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, Field, ValidationError, model_validator

from gen.errors import InputError
from gen.spec_faults import Faults, Noise
from gen.spec_lights import LIGHT_KINDS, LIGHT_PATTERNS, Light, Lights, Ring, Several
from gen.spec_materials import Material, Substrate, complaint
from gen.spec_materials import known_keys as material_keys
from gen.spec_parts import (
    CAMERAS,
    Array,
    AutoExposure,
    Camera,
    Exposure,
    Part,
    Pose,
    Shape,
    Whole,
    YesNo,
)
from gen.strict_yaml import first_complaint, read_yaml

MAX_SAMPLES = 1 << 25
"""The most samples of a picture, supersampling included: what the studio renders at a time."""


class Spec(Part):
    """One capture to be rendered."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$", description="letters, digits, dots, dashes and underscores")
    seed: Whole = Field(default=0, ge=0, lt=2**63, description="of everything drawn at random")
    resolution: tuple[Whole, Whole] = Field(default=(256, 256), description="[width, height] in pixels")
    supersampling: Whole = Field(default=1, ge=1, le=8, description="n: every pixel is the mean of n x n exact samples")
    shape: Shape
    pose: Pose = Pose()
    material: Material = Substrate()
    lights: Lights = Ring(pattern="ring", count=4, tilt_degrees=35.0, frontal=True)
    camera: Camera
    exposure: Exposure = AutoExposure()
    samples: Whole | None = Field(
        default=None,
        ge=1,
        le=4096,
        description="drawn at every sub-sample where light comes from many directions (default 64); suns and points need one",
    )
    bounces: Whole = Field(default=0, ge=0, le=16, description="how often light may pass from surface to surface")
    ks0: YesNo = Field(default=False, description="also render the pictures with Ks = 0")
    lime: YesNo = Field(
        default=False,
        description="also keep Ks of every pixel, and under surroundings the mirror image: what LIME's nets learn from",
    )
    crop: YesNo = Field(default=True, description="render only the box of pixels that holds the object; the rest is empty anyway")
    half: YesNo = Field(default=False, description="store radiance in half precision: half the size, three digits")
    clip: YesNo = Field(
        default=False, description="cut the pictures at 1 as a sensor does, and mark what was cut; the truth stays whole"
    )
    faults: Faults | None = Field(
        default=None, description="what a real set-up and its sensor do to the pictures and the stated lights"
    )

    @model_validator(mode="before")
    @classmethod
    def _size_is_sane(cls, data: Any) -> Any:
        size = data.get("resolution") if isinstance(data, dict) else None
        if size is not None and not (
            isinstance(size, list | tuple) and len(size) == 2 and all(type(n) is int and 1 <= n <= 8192 for n in size)
        ):
            raise _At("resolution", "must be [width, height], whole numbers from 1 to 8192")
        return data

    @model_validator(mode="after")
    def _shape_can_be_built(self) -> Spec:
        if max(self.resolution) * self.supersampling > 16384:
            raise _At(
                "supersampling",
                f"{self.supersampling} x {max(self.resolution)} pixels is more than 16384; ask for less of either",
            )
        if math.prod(self.resolution) * self.supersampling**2 > MAX_SAMPLES:
            raise _At(
                "resolution", f"with supersampling is more than {MAX_SAMPLES / 1e6:.0f} million samples; ask for less of either"
            )
        _check_shape(self)
        self.light_directions()  # the pattern may not fit
        refused = complaint(self.material, self.pictures(), self.bounces, self.ks0, self.lime)
        if refused is not None:
            raise _At(*refused)
        return self

    def pictures(self) -> tuple[Light, ...]:
        """The light of each picture."""
        return self.lights if isinstance(self.lights, tuple) else self.lights.lights(self.seed)

    def light_directions(self) -> Array:
        """Unit vectors (K, 3) to the lights; toward the camera for light without a single direction."""
        return np.array([light.toward() for light in self.pictures()])

    def light_intensities(self) -> Array:
        """Irradiance / pi of each light, (K, 3), before exposure."""
        return np.array([light.intensity for light in self.pictures()])

    def light_kinds(self) -> tuple[str, ...]:
        """The kind of each picture's light, a name in `LIGHT_KINDS`."""
        return tuple(light.kind for light in self.pictures())

    def light_positions(self) -> Array | None:
        """(K, 3) mm of near lights, NaN where the light is distant; None where all are."""
        places = [getattr(light, "position_mm", None) for light in self.pictures()]
        return None if all(place is None for place in places) else np.array([place or (np.nan,) * 3 for place in places])

    def draws(self) -> int:
        """Samples drawn at every sub-sample."""
        lights = [one for light in self.pictures() for one in (light.lights if isinstance(light, Several) else (light,))]
        single = not self.bounces and all(light.kind in ("sun", "point") for light in lights)
        return self.samples or (1 if single else 64)

    def plain(self) -> dict[str, Any]:
        """The spec as plain values, defaults filled in; `Spec.model_validate` reads it back to an equal spec."""
        return self.model_dump(mode="json", exclude_none=True)

    def digest(self) -> str:
        """SHA-256 of the spec with its defaults, in hexadecimal: equal for specs that mean the same capture.

        A mesh counts by its content, wherever its file lies.
        """
        plain = self.plain()
        if self.shape.name == "mesh":
            del plain["shape"]["file"]
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()

    def yaml(self) -> str:
        """The spec as YAML that `read_spec` reads back."""
        from ruamel.yaml import YAML

        writer = YAML(typ="safe", pure=True)
        writer.default_flow_style = None
        writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
        text = io.StringIO()
        writer.dump(self.plain(), text)
        return text.getvalue()


class _At(ValueError):
    """A complaint of a whole-spec check about one key."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__(f"{key}: {message}")


def _check_shape(spec: Spec) -> None:
    """Build the shape once, coarsely: what it refuses is refused here, and so is an object that reaches the camera."""
    from blender_scenes import shapes
    from gen.shape_extent import box, reach

    mesh = spec.shape.name == "mesh"
    if not mesh and spec.shape.name not in shapes.SHAPES:
        raise _At("shape.name", f"unknown shape '{spec.shape.name}'; there are {', '.join(shapes.SHAPES)}, mesh")
    known = () if mesh else tuple(shapes.parameters(spec.shape.name))
    for key in spec.shape.parameters:
        if not mesh and key not in known:
            raise _At(f"shape.{key}", f"unknown parameter of {spec.shape.name}; there are {', '.join(known)}")
    room = spec.camera.distance_mm - spec.pose.translation_mm[2]
    forward = spec.pose.matrix()[2]
    try:
        nearest = float((box(spec.shape.name, spec.shape.parameters) @ forward).max())
        if nearest >= room:  # the box is a little larger than the shape
            nearest = reach(spec.shape.name, spec.shape.parameters, forward)
    except ValueError as error:
        raise _At("shape", str(error).removeprefix(f"shape {spec.shape.name}: ")) from None
    if nearest >= room:
        nearest += spec.pose.translation_mm[2]
        raise _At("camera.distance_mm", f"the object reaches {nearest:g} mm toward the camera; put the camera farther than that")


_SYNONYMS = {
    "Kd": "albedo", "kd": "albedo", "diffuse": "albedo", "color": "albedo", "colour": "albedo",
    "Ks": "specular", "ks": "specular", "remaproughness": "remap", "uroughness": "roughness",
    "shininess": "exponent", "scale": "scale_mm", "sigma": "sigma_degrees",
    "width": "width_mm", "distance": "distance_mm", "focal": "focal_px", "fov": "fov_degrees", "tilt": "tilt_degrees",
    "rotation": "rotation_degrees", "translation": "translation_mm", "position": "position_mm",
    "diameter": "diameter_mm", "size": "resolution",
}  # fmt: skip
"""What other programs call our keys, for the hint in an error."""


def spec_from(data: Any, where: str, folder: Path | None = None) -> Spec:
    """A Spec from plain values. where: named in the error. folder: from which relative paths start, by default the working folder.

    Raises InputError with the key path and what is allowed.
    """
    try:
        return Spec.model_validate(data, context={"folder": folder})
    except ValidationError as error:
        raise first_complaint(error, data, where, _known_keys(data), _SYNONYMS) from None


def read_spec(path_or_preset: str | Path) -> Spec:
    """The spec in a YAML file, or the shipped preset of that name.

    Raises InputError, one line, where there is no such file or preset or where a key is missing, unknown or out of range.
    """
    from gen.presets import find_spec

    path = find_spec(path_or_preset)
    data = read_yaml(path, "a capture spec")
    if "set" in data:
        raise InputError(
            f"{path_or_preset}: is the spec of a set of captures, one capture is wanted here; "
            f"`degloss gen plan {path_or_preset}` shows its captures, `degloss gen render {path_or_preset} -o FOLDER` renders them all"
        )
    return spec_from(data, str(path_or_preset), path.parent)


def with_seed(spec: Spec, seed: int) -> Spec:
    """The same spec with another seed. Raises InputError where it is out of range."""
    return spec_from({**spec.plain(), "seed": seed}, "--seed")


def schema() -> dict[str, Any]:
    """The JSON schema of a spec file, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Spec.model_json_schema(mode="validation")}


def _known_keys(data: Any) -> dict[str, tuple[str, ...]]:
    """Allowed keys of each section, as the kinds that the data chose have them."""
    models: dict[str, type[BaseModel]] = {
        "": Spec,
        "pose": Pose,
        "exposure": AutoExposure,
        "faults": Faults,
        "faults.noise": Noise,
    }
    for section, tag, table in (("camera", "kind", CAMERAS), ("lights", "pattern", LIGHT_PATTERNS)):
        part = data.get(section) if isinstance(data, dict) else None
        chosen = table.get(str(part.get(tag))) if isinstance(part, dict) else None
        if chosen is not None:
            models[section] = chosen
    known = {section: tuple(model.model_fields) for section, model in models.items()}
    known |= material_keys(data.get("material") if isinstance(data, dict) else None)
    given = data.get("lights") if isinstance(data, dict) else None
    kinds = {light.get("kind", "sun") for light in given if isinstance(light, dict)} if isinstance(given, list) else {"sun"}
    fields = [field for kind in sorted(map(str, kinds)) if kind in LIGHT_KINDS for field in LIGHT_KINDS[kind].model_fields]
    return known | {"lights[]": tuple(dict.fromkeys(fields))}
