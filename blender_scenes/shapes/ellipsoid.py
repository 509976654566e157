"""The ellipsoid with three different axes."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.sphere import sphere
from blender_scenes.shapes.surface import stretched


def ellipsoid(
    width: Annotated[float, Range(1e-3, 1e5)] = 44.0,
    height: Annotated[float, Range(1e-3, 1e5)] = 32.0,
    depth: Annotated[float, Range(1e-3, 1e5)] = 26.0,
    segments: Annotated[int, Range(8, 2048)] = 384,
) -> Mesh:
    """An ellipsoid with its analytic normals: a stretched sphere, poles along y.

    width, height, depth: whole axes along x, y, z, mm. segments: meridians, with half as many parallels. Raises ValueError where one
    axis is over 20 times another: facets would be too coarse at its tips.
    """
    axes = (width, height, depth)
    if max(axes) > 20 * min(axes):
        raise ValueError(f"shape ellipsoid: axes {width:g}, {height:g}, {depth:g} mm differ more than twentyfold")
    return stretched(sphere(1.0, segments), *(axis / 2 for axis in axes))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """An ellipsoid whose axes are 18 to 50 mm."""
    return {key: float(rng.uniform(18, 50)) for key in ("width", "height", "depth")}
