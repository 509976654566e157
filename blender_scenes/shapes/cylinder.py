"""The cylinder, the shape of the paper's experiment."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.mesh import Mesh, Range, grid_faces


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
    angle = 2 * np.pi * np.arange(segments) / segments
    # Counter-clockwise seen from +y: x = sin, z = cos, so that the first facet faces the viewer.
    ring = np.stack([np.sin(angle), np.zeros(segments), np.cos(angle)], axis=1)
    up = np.array([0.0, 1.0, 0.0])
    half = up * length / 2
    bottom, top = radius * ring - half, radius * ring + half
    vertices = np.concatenate([bottom, top, bottom, top, [-half], [half]])
    normals = np.concatenate([ring, ring, np.tile(-up, (segments, 1)), np.tile(up, (segments, 1)), [-up], [up]])
    j = np.arange(segments)
    after = (j + 1) % segments
    below = np.stack([np.full(segments, 4 * segments), 2 * segments + after, 2 * segments + j], axis=1)
    above = np.stack([np.full(segments, 4 * segments + 1), 3 * segments + j, 3 * segments + after], axis=1)
    return Mesh(vertices, np.concatenate([grid_faces(2, segments), below, above]), normals)


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A cylinder of 8 to 30 mm radius whose length is 1 to 3.5 radii."""
    radius = float(rng.uniform(8, 30))
    return {"radius": radius, "length": radius * float(rng.uniform(1, 3.5))}
