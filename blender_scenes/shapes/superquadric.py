"""The superquadric: from a box with round edges over the ellipsoid to a double cone."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import Array, grid


def superquadric(
    width: Annotated[float, Range(1e-3, 1e5)] = 40.0,
    height: Annotated[float, Range(1e-3, 1e5)] = 40.0,
    depth: Annotated[float, Range(1e-3, 1e5)] = 40.0,
    vertical: Annotated[float, Range(0.35, 1.3)] = 0.6,
    horizontal: Annotated[float, Range(0.35, 1.3)] = 0.6,
) -> Mesh:
    """A superellipsoid (Barr 1981), poles along y, with its analytic normals.

    width, height, depth: whole axes along x, y, z, mm. vertical, horizontal: exponents e1 and e2 of
    (|2x/w|^(2/e2) + |2z/d|^(2/e2))^(e2/e1) + |2y/h|^(2/e1) = 1; 1 is round, less is square, more is pinched.
    """
    columns = 512
    profile, slope = _superellipse(np.pi * np.linspace(-0.5, 0.5, columns // 2 + 1), vertical)
    section, turn = _superellipse(2 * np.pi * np.arange(columns) / columns, horizontal)
    radius, rise = profile[:, None, 0], slope[:, None, 0]
    unit = np.stack([radius * section[:, 1], profile[:, None, 1] + 0 * section[:, 0], radius * section[:, 0]], axis=-1)
    gradient = np.stack([rise * turn[:, 1], slope[:, None, 1] + 0 * turn[:, 0], rise * turn[:, 0]], axis=-1)
    axes = np.array([width, height, depth]) / 2
    return grid(unit * axes, gradient / axes)


def _superellipse(angle: Array, exponent: float) -> tuple[Array, Array]:
    """Points of |x|^p + |y|^p = 1, p = 2 / exponent, in these directions, and the gradient there over p; both (N, 2)."""
    p = 2 / exponent
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    direction[np.abs(direction) < 1e-12] = 0
    points = direction / (np.abs(direction) ** p).sum(axis=1, keepdims=True) ** (1 / p)
    return points, np.sign(points) * np.abs(points) ** (p - 1)


def sample(rng: np.random.Generator) -> dict[str, float]:
    """Axes of 25 to 45 mm, exponents of .35 to 1.3."""
    axes = {key: float(rng.uniform(25, 45)) for key in ("width", "height", "depth")}
    return {**axes, **{key: float(rng.uniform(0.35, 1.3)) for key in ("vertical", "horizontal")}}
