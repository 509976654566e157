"""The cone."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.lathe import azimuths, lathe, path
from blender_scenes.shapes.mesh import Mesh, Range


def cone(
    radius: Annotated[float, Range(1e-3, 1e5)] = 19.0,
    height: Annotated[float, Range(1e-3, 1e5)] = 42.0,
    segments: Annotated[int, Range(8, 8192)] = 512,
) -> Mesh:
    """A closed circular cone, tip up along y, with its analytic normals; the rim and the tip are sharp.

    radius of the base, height: mm. segments: facets around.
    """
    y = height / 2
    return lathe(path((0, -y), (radius, -y), (0, y)), azimuths(segments))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A cone of 8 to 25 mm radius, 1 to 2.5 radii high."""
    radius = float(rng.uniform(8, 25))
    return {"radius": radius, "height": radius * float(rng.uniform(1, 2.5))}
