"""What a detail is to a surface: a height at every point of space, and how finely a mesh must follow it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from blender_scenes.shapes.mesh import Range
from blender_scenes.shapes.surface import Array

Degrees = Annotated[float, Range(-360, 360)]
Seed = Annotated[int, Range(0, 1e8)]

STEEPEST = 0.25
"""The greatest depth as a share of the width of a groove, scratch or dent: steeper ones would hide their own floor."""


@dataclass(frozen=True, eq=False)
class Field:
    """A solid scalar field in the object's frame, millimetres.

    height: from points (N, 3) to heights (N,) and their gradient (N, 3). spans: from the ends and the middle of N edges, each (N, 3), to
    how many times too long each edge is, (N,): edges over 1 are split. bound: the largest |height|; of noise, four times its rms. finest:
    the parameter that decides how fine the mesh gets, in words. centres, reach: (M, 3), (M,) of marks with nothing beyond their reach;
    `spans` judges the edges within it.
    """

    height: Callable[[Array], tuple[Array, Array]]
    spans: Callable[[Array, Array, Array], Array]
    bound: float
    finest: str
    centres: Array = field(default_factory=lambda: np.empty((0, 3)))
    reach: Array = field(default_factory=lambda: np.empty(0))


class Asking:
    """Who asks for a finer mesh. name: for the error. spans, centres, reach: see `Field`."""

    def __init__(
        self,
        name: str,
        spans: Callable[[Array, Array, Array], Array],
        centres: Array | None = None,
        reach: Array | None = None,
    ) -> None:
        self.name, self.spans = name, spans
        self.centres = np.empty((0, 3)) if centres is None else centres
        self.reach = np.empty(0) if reach is None else reach

    def times(self, points: Array, ends: NDArray[np.int64], middles: Array) -> Array:
        """How many times too long edges are, (E,). points: of the mesh so far. ends: (E, 2) of these. middles: (E, 3)."""
        return self.spans(points[ends[:, 0]], middles, points[ends[:, 1]])

    def holds(self, triangles: Array) -> NDArray[np.bool_]:
        """Which triangles (N, 3, 3) have a mark so far inside that no edge shows it, (N,)."""
        found = np.zeros(len(triangles), bool)
        if not len(self.centres) or not len(triangles):
            return found
        middle = triangles.mean(axis=1)
        radius = np.sqrt(((triangles - middle[:, None]) ** 2).sum(axis=2).max(axis=1))
        large = np.flatnonzero(radius > self.reach.min() / 2)
        middle, radius, corners = middle[large], radius[large], triangles[large]
        for centre, reach in zip(self.centres, self.reach, strict=True):
            near = np.flatnonzero(
                (np.einsum("ij,ij->i", middle - centre, middle - centre) < (radius + reach) ** 2) & (radius > reach / 2)
            )
            a, b, c = corners[near].transpose(1, 0, 2)
            normal = np.cross(b - a, c - a)
            inside = np.abs(np.einsum("ij,ij->i", centre - a, normal)) < reach * np.sqrt(np.einsum("ij,ij->i", normal, normal))
            for p, q in ((a, b), (b, c), (c, a)):
                inside &= (np.cross(q - p, centre - p) * normal).sum(axis=1) >= 0
            found[large[near[inside]]] = True
        return found


def direction(turn_degrees: float, tilt_degrees: float) -> Array:
    """A unit vector: x turned toward y by the first angle, then tilted toward z by the second."""
    a, t = np.radians([turn_degrees, tilt_degrees])
    return np.array([np.cos(t) * np.cos(a), np.cos(t) * np.sin(a), np.sin(t)])


def not_steep(kind: str, depth: float, width: float, of: str) -> None:
    """ValueError where a depth exceeds `STEEPEST` of a width."""
    if depth > STEEPEST * width:
        raise ValueError(f"detail {kind}: depth {depth:g} mm must be {STEEPEST * width:g} mm, a quarter of the {of}, or less")
