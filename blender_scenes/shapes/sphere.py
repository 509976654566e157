"""The sphere."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.lathe import arc, azimuths, lathe
from blender_scenes.shapes.mesh import Mesh, Range


def sphere(
    radius: Annotated[float, Range(1e-3, 1e5)] = 25.0,
    segments: Annotated[int, Range(8, 2048)] = 384,
) -> Mesh:
    """A sphere with its analytic normals; meridians from pole to pole along y.

    radius: mm. segments: meridians, with half as many parallels; no facet lies deeper than radius (pi / segments)^2, 7e-5 of the
    radius at 384. Normals are exactly radial at every point, since position and normal are interpolated alike.
    """
    return lathe([arc((0, 0), radius, -np.pi / 2, np.pi / 2, segments // 2)], azimuths(segments))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A sphere of 8 to 40 mm radius."""
    return {"radius": float(rng.uniform(8, 40))}
