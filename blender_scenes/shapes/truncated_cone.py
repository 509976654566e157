"""The truncated cone."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.lathe import azimuths, lathe, path
from blender_scenes.shapes.mesh import Mesh, Range


def truncated_cone(
    bottom_radius: Annotated[float, Range(1e-3, 1e5)] = 20.0,
    top_radius: Annotated[float, Range(1e-3, 1e5)] = 11.0,
    height: Annotated[float, Range(1e-3, 1e5)] = 40.0,
    segments: Annotated[int, Range(8, 8192)] = 512,
) -> Mesh:
    """A closed frustum of a circular cone, axis along y, with its analytic normals; both rims are sharp.

    radii, height: mm; either radius may be the larger. segments: facets around.
    """
    y = height / 2
    return lathe(path((0, -y), (bottom_radius, -y), (top_radius, y), (0, y)), azimuths(segments))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A frustum of 10 to 25 mm bottom radius, the top .3 to 1.3 times as wide, 1 to 2.5 radii high."""
    radius = float(rng.uniform(10, 25))
    return {
        "bottom_radius": radius,
        "top_radius": radius * float(rng.uniform(0.3, 1.3)),
        "height": radius * float(rng.uniform(1, 2.5)),
    }
