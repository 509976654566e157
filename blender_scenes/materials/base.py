"""What every material is: values that a job names, and a node graph in Blender that is told where its light is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Vector = tuple[float, float, float]
Aim = tuple[Numbers, bool]
"""Where a light is: the unit direction (3,) to a sun and False, or the position (3,) in mm of a light that is near and True."""


@dataclass(frozen=True, eq=False)
class Stand:
    """How the object stands before the camera, as far as a graph must know.

    view: unit vector to an orthographic camera, None for a perspective one (each point then has its own). rotation: (3, 3) object to
    world, translation: (3,) mm, so that what is painted on the object turns with it.
    """

    view: Vector | None
    rotation: Numbers = field(default_factory=lambda: np.eye(3))
    translation: Numbers = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, eq=False)
class Placed:
    """A material in Blender.

    item: the Blender material. aim: tells the graph its one light; None where the graph needs no light. gain: closure weights are
    multiplied by it, so the light's strength must be divided by it. passes: the shader outputs that the graph writes, name and channels:
    "albedo" and "gloss" where they vary over the surface, and what `one_light` writes of each light.
    """

    item: Any
    aim: Callable[[Aim], None] | None = None
    gain: float = 1.0
    passes: Mapping[str, str] = field(default_factory=dict)


class Material:
    """A material of a job. Subclasses are frozen dataclasses, one a module, named in `MATERIALS` with `parse(entries)` beside them."""

    one_light: ClassVar[bool] = False
    """Whether the graph holds for a single light of known direction (sun or point) only, without light from elsewhere."""

    own_twin: ClassVar[bool] = False
    """Whether the matte twin must be rendered on its own, since the light on the diffuse closure is not that on a Lambertian surface."""

    @property
    def albedo(self) -> Any:
        """Reflectance of the matte twin: (3,) numbers, or a texture."""
        raise NotImplementedError

    @property
    def gloss(self) -> Any:
        """Alpha of the half-vector distribution: a number (0 where there is no gloss), or a texture."""
        raise NotImplementedError

    def put(self, stand: Stand) -> Placed:
        """The material as a Blender material; `studio.take_out` removes it with the object that wears it."""
        raise NotImplementedError

    def without_gloss(self) -> Material | None:
        """The same with Ks = 0, or None where that means nothing."""
        return None


@dataclass(frozen=True, eq=False)
class Coated(Material):
    """A diffuse base under gloss. diffuse, specular: (3,) reflectances Kd, Ks. alpha: width of the half-vector distribution. Each may be a
    texture, where the subclass does not say otherwise."""

    diffuse: Any
    specular: Any
    alpha: Any

    @property
    def albedo(self) -> Any:
        return self.diffuse

    @property
    def gloss(self) -> Any:
        return self.alpha

    def without_gloss(self) -> Coated:
        return replace(self, specular=np.zeros(3))
