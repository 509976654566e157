"""The cylinder, the shape of the paper's experiment."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.lathe import azimuths, lathe, path
from blender_scenes.shapes.mesh import Mesh, Range


def cylinder(
    radius: Annotated[float, Range(1e-3, 1e5)] = 20.0,
    length: Annotated[float, Range(1e-3, 1e5)] = 50.0,
    segments: Annotated[int, Range(8, 8192)] = 512,
) -> Mesh:
    """A closed circular cylinder, axis along y, with its analytic normals: radial on the side, flat on the caps.

    radius, length: mm. segments: facets around the side; the chord error is radius (1 - cos(pi / segments)), 2e-5 of the radius
    at 512. Normals are exact at the vertices, and at every point of a facet they are exactly radial, since position and normal are
    interpolated alike. The rim's vertices come twice, once for the side and once for the cap.
    """
    y = length / 2
    return lathe(path((0, -y), (radius, -y), (radius, y), (0, y)), azimuths(segments))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A cylinder of 8 to 30 mm radius whose length is 1 to 3.5 radii."""
    radius = float(rng.uniform(8, 30))
    return {"radius": radius, "length": radius * float(rng.uniform(1, 3.5))}
