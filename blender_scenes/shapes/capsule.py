"""The capsule."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.lathe import arc, azimuths, lathe, line
from blender_scenes.shapes.mesh import Mesh, Range


def capsule(
    radius: Annotated[float, Range(1e-3, 1e5)] = 12.0,
    length: Annotated[float, Range(1e-3, 1e5)] = 46.0,
    segments: Annotated[int, Range(8, 2048)] = 384,
) -> Mesh:
    """A cylinder with a hemisphere on either end, axis along y, with its analytic normals.

    radius, length over all: mm. segments: facets around. Raises ValueError where the length is not over two radii.
    """
    y = length / 2 - radius
    if not y > 0:
        raise ValueError(f"shape capsule: length {length:g} mm must be over two radii, {2 * radius:g} mm")
    quarter = max(2, segments // 4)
    south, north = arc((0, -y), radius, -np.pi / 2, 0, quarter), arc((0, y), radius, 0, np.pi / 2, quarter)
    return lathe([south, line((radius, -y), (radius, y)), north], azimuths(segments))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A capsule of 6 to 16 mm radius, 2.5 to 5 radii long."""
    radius = float(rng.uniform(6, 16))
    return {"radius": radius, "length": radius * float(rng.uniform(2.5, 5))}
