"""The torus."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.lathe import arc, azimuths, lathe
from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import divisions, facing


def torus(
    radius: Annotated[float, Range(1e-3, 1e5)] = 15.0,
    tube_radius: Annotated[float, Range(1e-3, 1e5)] = 6.0,
    segments: Annotated[int, Range(8, 2048)] = 384,
) -> Mesh:
    """A ring torus, axis toward the viewer along z, with its analytic normals.

    radius of the tube's middle, tube_radius: mm. segments: facets around the axis. Raises ValueError where the tube is as wide as the
    ring, or under a hundredth of it.
    """
    if not 0.01 * radius <= tube_radius < radius:
        raise ValueError(
            f"shape torus: tube_radius {tube_radius:g} mm must be a hundredth of the radius, {radius:g} mm, or more, and under it"
        )
    profile = arc((radius, 0), tube_radius, 0, 2 * np.pi, divisions(tube_radius, 2 * (radius + tube_radius)))
    return facing(lathe([profile], azimuths(segments)))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A torus of 10 to 20 mm radius whose tube is .15 to .6 times as wide."""
    radius = float(rng.uniform(10, 20))
    return {"radius": radius, "tube_radius": radius * float(rng.uniform(0.15, 0.6))}
