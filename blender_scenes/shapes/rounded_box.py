"""The box with rounded edges."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import divisions, flat, grid, join


def rounded_box(
    width: Annotated[float, Range(1e-3, 1e5)] = 38.0,
    height: Annotated[float, Range(1e-3, 1e5)] = 30.0,
    depth: Annotated[float, Range(1e-3, 1e5)] = 24.0,
    radius: Annotated[float, Range(1e-3, 1e5)] = 4.0,
) -> Mesh:
    """A box whose edges are quarter cylinders and whose corners are eighths of a sphere, with its analytic normals.

    width, height, depth: along x, y, z, mm. radius of the edges: mm. Raises ValueError where it is not under half the least side.
    """
    core = np.array([width, height, depth]) / 2 - radius
    if not core.min() > 0:
        raise ValueError(
            f"shape rounded_box: radius {radius:g} mm must be under half the least side, {min(width, height, depth):g} mm"
        )
    n = divisions(radius, max(width, height, depth), np.pi / 2)
    # A sphere cut at its three planes of symmetry and pulled apart: between the eighths lie the edges and the flat sides.
    quarter = np.linspace(0, np.pi / 2, n + 1)
    latitude = np.concatenate([quarter - np.pi / 2, quarter])[:, None]
    longitude = np.concatenate([quarter + k * np.pi / 2 for k in range(4)])[None]
    normals = np.stack(
        [np.cos(latitude) * np.sin(longitude), np.sin(latitude) + 0 * longitude, np.cos(latitude) * np.cos(longitude)], axis=-1
    )
    eighth = np.repeat([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]], n + 1, axis=0)
    signs = np.empty_like(normals)
    signs[..., 0], signs[..., 2] = eighth[:, 0], eighth[:, 1]
    signs[..., 1] = np.repeat([-1.0, 1.0], n + 1)[:, None]
    points = signs * core + radius * normals
    corners = np.arange(4) * (n + 1)
    square = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    top = flat(points[-1, corners], square, (0.0, 1.0, 0.0))
    bottom = flat(points[0, corners], square[:, ::-1], (0.0, -1.0, 0.0))
    return join(grid(points, normals), top, bottom)


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A box with sides of 18 to 45 mm, rounded by .05 to .45 of the least."""
    sides = {key: float(rng.uniform(18, 45)) for key in ("width", "height", "depth")}
    return {**sides, "radius": min(sides.values()) * float(rng.uniform(0.05, 0.45))}
