"""capture.yaml: what is known of a folder of photographs, as frozen pydantic models. A key that is not known is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, Discriminator, Field, Tag, ValidationError, model_validator

from gen.errors import InputError
from gen.spec_parts import Intensity as AnyIntensity
from gen.spec_parts import Number, Part, YesNo, has_length
from gen.spec_parts import Vector as AnyVector
from gen.strict_yaml import first_complaint, read_yaml

NAME = "capture.yaml"
MOST = 1000
"""Pictures of a capture, and frames of a kind."""

LARGEST = 1e9
"""Numbers beyond this are slips, and their squares would leave single precision."""

File = Annotated[str, Field(strict=True, min_length=1, max_length=500)]
Exposure = Annotated[Number, Field(ge=1e-7, le=86_400)]
Millimetres = Annotated[Number, Field(gt=0, le=1e6)]


def _bounded(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if max(abs(v) for v in value) > LARGEST:
        raise ValueError(f"must lie within {LARGEST:g} either way")
    return value


Vector = Annotated[AnyVector, AfterValidator(_bounded)]
Intensity = Annotated[AnyIntensity, AfterValidator(_bounded)]


class Shot(Part):
    """One photograph. A bare file name is one whose exposure is not known."""

    file: File
    exposure_s: Exposure | None = Field(default=None, description="seconds")


def _shot(value: Any) -> Any:
    return {"file": value} if isinstance(value, str) else value


OneShot = Annotated[Shot, BeforeValidator(_shot)]


class Bracket(Part):
    """One picture taken with several exposures."""

    bracket: tuple[OneShot, ...] = Field(min_length=2, max_length=20)

    @model_validator(mode="after")
    def _exposures_are_known(self) -> Bracket:
        times = [shot.exposure_s for shot in self.bracket]
        if None in times:
            raise ValueError("every photograph of a bracket needs its exposure_s")
        if len(set(times)) != len(times):
            raise ValueError("two photographs of a bracket have the same exposure_s")
        return self


class Pattern(Part):
    """Files by a pattern of names, in natural order; with several exposures, each run of so many files is one bracket."""

    glob: File
    exposures_s: tuple[Exposure, ...] | None = Field(default=None, min_length=1, max_length=20)


def _glob(value: Any) -> Any:
    return {"glob": value} if isinstance(value, str) else value


def _entry_kind(value: Any) -> str:
    return "exposures" if isinstance(value, Bracket) or (isinstance(value, dict) and "bracket" in value) else "shot"


def _list_or(single: str) -> Discriminator:
    return Discriminator(lambda v: "list" if isinstance(v, list | tuple) else single)


Entry = Annotated[Annotated[OneShot, Tag("shot")] | Annotated[Bracket, Tag("exposures")], Discriminator(_entry_kind)]
Images = Annotated[
    Annotated[Annotated[tuple[Entry, ...], Field(min_length=1, max_length=MOST)], Tag("list")]
    | Annotated[Annotated[Pattern, BeforeValidator(_glob)], Tag("pattern")],
    _list_or("pattern"),
]


def _one_or_many(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


Shots = Annotated[tuple[OneShot, ...], Field(min_length=1, max_length=100), BeforeValidator(_one_or_many)]


class BallSpec(Part):
    """A ball in the pictures, or in pictures of its own under the same lights. Where it is not said where, it is looked for."""

    kind: Literal["chrome", "matte"]
    mask: File | None = Field(default=None, description="white on the ball")
    circle_px: Vector | None = Field(default=None, description="[x, y, radius], pixel centres at integers, y down")
    outline: File | None = Field(
        default=None, description="a picture in which the ball's outline shows, such as under the room's light"
    )
    diameter_mm: Millimetres | None = None
    height_mm: Annotated[Number, Field(ge=-1e6, le=1e6)] | None = Field(
        default=None, description="of the ball's middle over the plane of the object, to the camera"
    )
    images: Images | None = Field(default=None, description="pictures of the ball alone, in the order of the lights")

    @model_validator(mode="after")
    def _one_place(self) -> BallSpec:
        if sum(v is not None for v in (self.mask, self.circle_px, self.outline)) > 1:
            raise ValueError("needs at most one of mask, circle_px and outline")
        if self.circle_px is not None and self.circle_px[2] <= 0:
            raise ValueError("circle_px must be [x, y, radius] with a positive radius")
        return self


Direction = Annotated[Vector, AfterValidator(has_length)]


class LightSpec(Part):
    """Where the light of each picture comes from: exactly one of the four."""

    directions: tuple[Direction, ...] | None = Field(
        default=None, min_length=1, max_length=MOST, description="to the light; any length"
    )
    positions_mm: tuple[Direction, ...] | None = Field(
        default=None, min_length=1, max_length=MOST, description="near lights, from where the camera looks"
    )
    file: File | None = Field(default=None, description="rows of x y z, or of a file name and x y z")
    balls: tuple[BallSpec, ...] | None = Field(default=None, min_length=1, max_length=20)
    near: YesNo | None = Field(
        default=None,
        description="balls: whether to measure the lights' places; left out, where several balls and the scale allow it",
    )

    @model_validator(mode="after")
    def _one_source(self) -> LightSpec:
        given = (self.directions, self.positions_mm, self.file, self.balls)
        if sum(v is not None for v in given) != 1:
            raise ValueError("needs exactly one of directions, positions_mm, file and balls")
        if self.near is not None and self.balls is None:
            raise ValueError("near belongs to balls; give positions_mm for near lights that were measured")
        return self


class Camera(Part):
    """A pinhole camera with a lens, as OpenCV calibrates it."""

    K: tuple[Vector, Vector, Vector] = Field(description="3x3 intrinsics: y down, pixel centres at integers")
    distortion: tuple[Annotated[Number, Field(ge=-1e6, le=1e6)], ...] | None = Field(
        default=None, description="OpenCV's k1 k2 p1 p2 k3 ...: 4, 5, 8, 12 or 14 numbers"
    )
    distance_mm: Millimetres | None = Field(default=None, description="from the camera to the object's middle")

    @model_validator(mode="after")
    def _as_opencv_has_it(self) -> Camera:
        (fx, skew, _), (zero, fy, _), bottom = self.K
        if fx <= 0 or fy <= 0 or skew != 0 or zero != 0 or bottom != (0.0, 0.0, 1.0):
            raise ValueError("K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx and fy positive")
        if self.distortion is not None and len(self.distortion) not in (4, 5, 8, 12, 14):
            raise ValueError(f"distortion must hold 4, 5, 8, 12 or 14 numbers, it holds {len(self.distortion)}")
        return self

    def matrix(self) -> NDArray[np.float64]:
        """K, (3, 3)."""
        return np.array(self.K)


class GammaColour(Part):
    """Numbers that are linear radiance to the power 1 / gamma."""

    gamma: Number = Field(gt=0.2, le=5)


ColourSpec = Annotated[
    Annotated[Literal["srgb", "linear"], Tag("name")] | Annotated[GammaColour, Tag("power")],
    Discriminator(lambda v: "power" if isinstance(v, dict | GammaColour) else "name"),
]
Strengths = Annotated[
    Annotated[Literal["estimate", "equal"], Tag("word")]
    | Annotated[Annotated[tuple[Intensity, ...], Field(min_length=1, max_length=MOST)], Tag("list")],
    _list_or("word"),
]


class PhotoSpec(Part):
    """What capture.yaml says."""

    images: Images = Field(
        description="one a light: a pattern of file names, or a list of files, {file, exposure_s} or {bracket: [...]}"
    )
    lights: LightSpec | None = None
    intensities: Strengths | None = Field(
        default=None,
        description="estimate, equal, or one or three numbers a light; left out: measured on a matte ball, else estimated",
    )
    colour: ColourSpec | None = Field(
        default=None, description="srgb, linear or {gamma: 2.2}; left out: 8-bit is sRGB, all else linear"
    )
    dark: Shots | None = Field(default=None, description="pictures with the lens covered, averaged")
    ambient: Shots | None = Field(default=None, description="pictures with all lights off, averaged")
    flat: Shots | None = Field(default=None, description="pictures of an evenly lit card, averaged")
    camera: Camera | None = None
    mm_per_pixel: Millimetres | None = Field(default=None, description="orthographic views")
    mask: File | None = Field(default=None, description="white on the object")

    @model_validator(mode="after")
    def _one_scale(self) -> PhotoSpec:
        if self.camera is not None and self.mm_per_pixel is not None:
            same = self.mm_per_pixel * self.camera.K[0][0]
            raise ValueError(
                f"mm_per_pixel is for orthographic views; with a camera, say camera.distance_mm: {same:.6g}, which means the same"
            )
        return self


_SYNONYMS = {
    "pictures": "images", "photos": "images", "files": "images", "light": "lights", "intensity": "intensities",
    "color": "colour", "colorspace": "colour", "colour_space": "colour", "color_space": "colour", "encoding": "colour",
    "darks": "dark", "dark_frame": "dark", "flat_field": "flat", "flatfield": "flat", "scale": "mm_per_pixel",
    "exposure": "exposure_s", "time": "exposure_s", "exposures": "exposures_s", "positions": "positions_mm",
    "radius": "circle_px", "circle": "circle_px", "diameter": "diameter_mm", "distance": "distance_mm", "dist": "distortion",
    "intrinsics": "K", "type": "kind",
}  # fmt: skip
"""What other people call our keys, for the hint in an error."""


def photo_spec(data: Any, where: str) -> PhotoSpec:
    """A PhotoSpec from plain values. Raises InputError with the key path and what is allowed."""
    try:
        return PhotoSpec.model_validate(data)
    except ValidationError as error:
        raise first_complaint(error, data, where, _known_keys(), _SYNONYMS) from None


def read_photo_spec(folder: Path) -> PhotoSpec:
    """The PhotoSpec of a folder's capture.yaml. Raises InputError, one line, where it is missing or says something that is not known."""
    path = folder / NAME
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    if not path.is_file():
        raise InputError(f"{folder}: has no {NAME}; write one that names the images and their lights")
    return photo_spec(read_yaml(path, "what is known of the photographs"), str(path))


def _known_keys() -> dict[str, tuple[str, ...]]:
    """Allowed keys of each section."""

    def keys(*models: type[BaseModel]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for model in models for name in model.model_fields))

    known = {"": keys(PhotoSpec), "lights": keys(LightSpec), "camera": keys(Camera), "colour": keys(GammaColour)}
    known["lights.balls[]"] = keys(BallSpec)
    for images in ("images", "lights.balls[].images"):
        known |= {images: keys(Pattern), f"{images}[]": keys(Shot, Bracket), f"{images}[].bracket[]": keys(Shot)}
    for frames in ("dark", "ambient", "flat"):
        known |= {frames: keys(Shot), f"{frames}[]": keys(Shot)}
    return known
