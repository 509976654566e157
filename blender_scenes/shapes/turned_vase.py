"""The vase turned to a random profile."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np

from blender_scenes.shapes.lathe import Piece, arc, azimuths, lathe, line, path
from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import Array, centred, divisions


def turned_vase(
    radius: Annotated[float, Range(1e-3, 1e5)] = 16.0,
    neck_radius: Annotated[float, Range(1e-3, 1e5)] = 7.0,
    height: Annotated[float, Range(1e-3, 1e5)] = 44.0,
    wall: Annotated[float, Range(1e-3, 1e5)] = 1.5,
    seed: Annotated[int, Range(0, 1e8)] = 4,
) -> Mesh:
    """A hollow vase, axis along y, its smooth profile drawn by the seed; analytic normals.

    radius, neck_radius: the largest and the least outside, mm. height: of the outside without the lip, mm. wall: thickness, mm; the
    inside runs parallel to the outside, the lip is round and the floor flat. Raises ValueError where neck, wall and height do not
    fit together.
    """
    if not 2 * wall < neck_radius < radius or not 4 * wall < height:
        raise ValueError("shape turned_vase: needs 2 wall < neck_radius < radius and 4 wall < height")
    outside = _profile(radius, neck_radius, height, np.random.default_rng(seed))
    floor = 1.5 * wall
    # The inside starts where it leaves the floor: found by bisection, for outside's height there.
    low, high = 0.0, height
    for _ in range(60):
        middle = (low + high) / 2
        points, normals = outside(np.array([middle]))
        low, high = (middle, high) if (points - wall * normals)[0, 1] < floor else (low, middle)
    outer, inner = outside(np.linspace(0, height, 257)), outside(np.linspace(height, high, 257))
    inside = inner.points - wall * inner.normals
    inside[-1, 1] = floor
    if np.diff(inside[:, 1]).max() >= 0 or inside[:, 0].min() <= 0:
        raise ValueError(f"shape turned_vase: wall {wall:g} mm is too thick for the bends of the profile of seed {seed}")
    tilt = float(np.arctan2(outer.normals[-1, 1], outer.normals[-1, 0]))
    rim = outer.points[-1] - wall / 2 * outer.normals[-1]
    lip = arc(rim, wall / 2, tilt, tilt + np.pi, max(24, divisions(wall / 2, height, np.pi)))
    pieces = [*path((0, 0), outer.points[0]), outer, lip, Piece(inside, -inner.normals), line(inside[-1], (0, floor))]
    return centred(lathe(pieces, azimuths(max(256, divisions(radius, max(height, 2 * radius))))))


def _profile(radius: float, neck: float, height: float, rng: np.random.Generator) -> Callable[[Array], Piece]:
    """The outside as a function of the height: a random sum of four cosines that runs from `neck` to `radius`, with unit normals."""
    k = np.arange(1, 5) * np.pi / height
    size, phase = rng.normal(size=4) / np.arange(1, 5) ** 1.5, rng.uniform(0, 2 * np.pi, 4)
    waves = (size * np.cos(k * np.linspace(0, height, 2001)[:, None] + phase)).sum(axis=1)
    size *= (radius - neck) / (waves.max() - waves.min())
    middle = neck - waves.min() * (radius - neck) / (waves.max() - waves.min())

    def outside(y: Array) -> Piece:
        angle = k * y[:, None] + phase
        slope = -(size * k * np.sin(angle)).sum(axis=1)
        normals = np.stack([np.ones_like(y), -slope], axis=1) / np.hypot(1, slope)[:, None]
        return Piece(np.stack([middle + (size * np.cos(angle)).sum(axis=1), y], axis=1), normals)

    return outside


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A vase of 12 to 20 mm radius, 2 to 3 radii high, its neck .4 to .7 of the radius."""
    radius = float(rng.uniform(12, 20))
    return {
        "radius": radius,
        "neck_radius": radius * float(rng.uniform(0.4, 0.7)),
        "height": radius * float(rng.uniform(2, 3)),
        "wall": float(rng.uniform(0.8, 1.4)),
        "seed": int(rng.integers(10**8)),
    }
