"""The sphere."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.mesh import Mesh, Range, grid_faces


def sphere(
    radius: Annotated[float, Range(1e-3, 1e5)] = 25.0,
    segments: Annotated[int, Range(8, 2048)] = 384,
) -> Mesh:
    """A sphere with its analytic normals; meridians from pole to pole along y.

    radius: mm. segments: meridians, with half as many parallels; no facet lies deeper than radius (pi / segments)^2, 7e-5 of the
    radius at 384. Normals are exactly radial at every point, since position and normal are interpolated alike.
    """
    parallels = segments // 2
    latitude = np.pi * (np.arange(1, parallels) / parallels - 0.5)[:, None]
    longitude = 2 * np.pi * np.arange(segments)[None] / segments
    ring = np.stack(
        [
            np.cos(latitude) * np.sin(longitude),
            np.broadcast_to(np.sin(latitude), (parallels - 1, segments)),
            np.cos(latitude) * np.cos(longitude),
        ],
        axis=-1,
    ).reshape(-1, 3)
    normals = np.concatenate([ring, [[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]])
    south, north = len(ring), len(ring) + 1
    j = np.arange(segments)
    after = (j + 1) % segments
    last = (parallels - 2) * segments
    below = np.stack([np.full(segments, south), after, j], axis=1)
    above = np.stack([np.full(segments, north), last + j, last + after], axis=1)
    return Mesh(radius * normals, np.concatenate([grid_faces(parallels - 1, segments), below, above]), normals)


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A sphere of 8 to 40 mm radius."""
    return {"radius": float(rng.uniform(8, 40))}
