"""The lights of a capture's spec: one entry a picture, or a pattern that makes them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from gen import lights as patterns
from gen.spec_parts import Array, Intensity, Number, Part, Vector, Whole, YesNo, has_length

FROM_THE_CAMERA = (0.0, 0.0, 1.0)
"""What a capture says of light that has no single direction; its kind says so."""


class Sun(Part):
    """One distant light. A bare [x, y, z] is one of intensity 1."""

    kind: Literal["sun"] = "sun"
    direction: Annotated[Vector, AfterValidator(has_length)] = Field(description="towards the light; any length")
    intensity: Intensity = Field(default=(1.0, 1.0, 1.0), description="irradiance / pi, grey or [r, g, b]")

    def toward(self) -> Array:
        return _unit(self.direction)

    def job(self) -> dict[str, Any]:
        return {"kind": "sun", "direction": self.toward().tolist(), "intensity": list(self.intensity)}


class Point(Part):
    """A near light without size, falling with the square of the distance."""

    kind: Literal["point"]
    position_mm: Annotated[Vector, AfterValidator(has_length)] = Field(description="from where the camera looks")
    intensity: Intensity = Field(default=(1.0, 1.0, 1.0), description="irradiance / pi where the camera looks, facing the light")

    def toward(self) -> Array:
        return _unit(self.position_mm)

    def job(self) -> dict[str, Any]:
        return {"kind": "point", "position": list(self.position_mm), "intensity": list(self.intensity)}


class Area(Part):
    """A disc of even radiance that faces where the camera looks."""

    kind: Literal["area"]
    position_mm: Annotated[Vector, AfterValidator(has_length)] = Field(description="from where the camera looks")
    diameter_mm: Number = Field(ge=0.001, le=1e6)
    intensity: Intensity = Field(default=(1.0, 1.0, 1.0), description="irradiance / pi where the camera looks, facing the light")

    def toward(self) -> Array:
        return _unit(self.position_mm)

    def job(self) -> dict[str, Any]:
        return {
            "kind": "area",
            "position": list(self.position_mm),
            "diameter": self.diameter_mm,
            "intensity": list(self.intensity),
        }


class Environment(Part):
    """Surroundings: a panorama with y up and, in its middle, what lies behind the camera."""

    kind: Literal["environment"]
    map: str = Field(
        description="a panorama that Blender brings (city, courtyard, forest, interior, night, studio, ...) or a file"
    )
    rotation_degrees: Number = Field(default=0.0, ge=-360, le=360, description="about the y axis, from +z to +x")
    intensity: Intensity = Field(default=(1.0, 1.0, 1.0), description="factor on the panorama's radiance")

    def toward(self) -> Array:
        return np.array(FROM_THE_CAMERA)

    def job(self) -> dict[str, Any]:
        return {
            "kind": "environment",
            "map": self.map,
            "rotation": self.rotation_degrees,
            "intensity": list(self.intensity),
        }


class Ambient(Part):
    """The same radiance from everywhere."""

    kind: Literal["ambient"]
    intensity: Intensity = Field(default=(1.0, 1.0, 1.0), description="the radiance, grey or [r, g, b]")

    def toward(self) -> Array:
        return np.array(FROM_THE_CAMERA)

    def job(self) -> dict[str, Any]:
        return {"kind": "ambient", "intensity": list(self.intensity)}


def _single(value: Any) -> Any:
    """A bare direction is a sun; a kind that is left out is a sun's."""
    if isinstance(value, list | tuple):
        return {"kind": "sun", "direction": value}
    return {"kind": "sun", **value} if isinstance(value, dict) and "kind" not in value else value


_Single = Annotated[
    Annotated[Sun | Point | Area | Environment | Ambient, Discriminator("kind")],
    BeforeValidator(_single, json_schema_input_type=Vector | Sun | Point | Area | Environment | Ambient),
]


class Several(Part):
    """A picture under several lights at once."""

    kind: Literal["several"]
    lights: tuple[_Single, ...] = Field(min_length=1, max_length=64)

    @property
    def intensity(self) -> tuple[float, float, float]:
        """The sum of all."""
        red, green, blue = np.sum([light.intensity for light in self.lights], axis=0)
        return float(red), float(green), float(blue)

    def toward(self) -> Array:
        return np.array(FROM_THE_CAMERA)

    def job(self) -> list[dict[str, Any]]:
        return [light.job() for light in self.lights]


Light = Sun | Point | Area | Environment | Ambient | Several
LIGHT_KINDS: dict[str, type[Part]] = {
    "sun": Sun,
    "point": Point,
    "area": Area,
    "environment": Environment,
    "ambient": Ambient,
    "several": Several,
}


class Pattern(Part):
    """Lights in directions that follow from a few numbers: suns, near ones at a distance, or discs there."""

    count: Whole = Field(ge=1, le=1000)
    intensity: Intensity = Field(default=(1.0, 1.0, 1.0), description="irradiance / pi of every light, grey or [r, g, b]")
    intensities: tuple[Intensity, ...] | None = Field(default=None, description="one a light, in place of intensity")
    distance_mm: Number | None = Field(default=None, gt=0, le=1e6, description="near lights: from where the camera looks")
    diameter_mm: Number | None = Field(default=None, ge=0.001, le=1e6, description="discs of this size at distance_mm")

    @model_validator(mode="after")
    def _what_fits(self) -> Pattern:
        if self.diameter_mm is not None and self.distance_mm is None:
            raise ValueError("diameter_mm needs distance_mm: a light with a size is near")
        number = self.count + bool(getattr(self, "frontal", False))
        if self.intensities is not None and len(self.intensities) != number:
            raise ValueError(f"intensities must hold one a light ({number}), it holds {len(self.intensities)}")
        return self

    def directions(self, seed: int) -> Array:
        """(K, 3) unit vectors to the lights."""
        raise NotImplementedError

    def lights(self, seed: int) -> tuple[Light, ...]:
        """The pattern's lights, one a picture."""
        found: list[Light] = []
        for k, direction in enumerate(self.directions(seed).tolist()):
            intensity = self.intensity if self.intensities is None else self.intensities[k]
            if self.distance_mm is None:
                found.append(Sun(direction=tuple(direction), intensity=intensity))
                continue
            x, y, z = (self.distance_mm * c for c in direction)
            if self.diameter_mm is None:
                found.append(Point(kind="point", position_mm=(x, y, z), intensity=intensity))
            else:
                found.append(Area(kind="area", position_mm=(x, y, z), diameter_mm=self.diameter_mm, intensity=intensity))
        return tuple(found)


class Ring(Pattern):
    """Lights evenly around the optical axis, all at one tilt from it; with `frontal`, one more on the axis, first."""

    pattern: Literal["ring"]
    tilt_degrees: Number = Field(gt=0, lt=90)
    start_degrees: Number = Field(default=0.0, ge=-360, le=360, description="azimuth of the first, counter-clockwise from +x")
    frontal: YesNo = False

    def directions(self, seed: int) -> Array:
        return patterns.ring(self.count, self.tilt_degrees, self.frontal, self.start_degrees)


class Hemisphere(Pattern):
    """Lights spread evenly over the cap up to a tilt (Fibonacci spiral)."""

    pattern: Literal["hemisphere"]
    max_tilt_degrees: Number = Field(default=60.0, gt=0, lt=90)

    def directions(self, seed: int) -> Array:
        return patterns.hemisphere(self.count, self.max_tilt_degrees)


class Scattered(Pattern):
    """Lights drawn at random (by the spec's seed) over the cap up to a tilt, none closer to another than a minimum."""

    pattern: Literal["random"]
    max_tilt_degrees: Number = Field(default=60.0, gt=0, lt=90)
    min_spread_degrees: Number = Field(default=15.0, ge=0, lt=90)

    def directions(self, seed: int) -> Array:
        return patterns.scattered(self.count, self.max_tilt_degrees, self.min_spread_degrees, np.random.default_rng(seed))


LIGHT_PATTERNS: dict[str, type[Pattern]] = {"ring": Ring, "hemisphere": Hemisphere, "random": Scattered}


def _lights_kind(value: Any) -> str | None:
    if isinstance(value, list | tuple):
        return "explicit"
    pattern = value.get("pattern") if isinstance(value, dict) else getattr(value, "pattern", None)
    return pattern if isinstance(pattern, str) else None


Explicit = Annotated[
    tuple[
        Annotated[
            Annotated[Light, Discriminator("kind")],
            BeforeValidator(_single, json_schema_input_type=Vector | Light),
        ],
        ...,
    ],
    Field(min_length=1, max_length=1000),
]
Lights = Annotated[
    Annotated[Explicit, Tag("explicit")]
    | Annotated[Ring, Tag("ring")]
    | Annotated[Hemisphere, Tag("hemisphere")]
    | Annotated[Scattered, Tag("random")],
    Discriminator(
        _lights_kind,
        custom_error_type="lights_kind",
        custom_error_message=f"must be a list of directions, or hold 'pattern:' with one of {', '.join(LIGHT_PATTERNS)}",
    ),
]


def _unit(vector: tuple[float, float, float]) -> Array:
    unit: Array = np.array(vector) / np.linalg.norm(vector)
    return unit
