"""Extrusions along z: walls and bevels over an outline of smooth pieces, and flat caps between two closed loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from blender_scenes.shapes.lathe import Piece
from blender_scenes.shapes.mesh import Mesh
from blender_scenes.shapes.surface import Array, flat, grid, join


def walls(outline: Sequence[Piece], low: Sequence[Array | float], high: Sequence[Array | float]) -> Mesh:
    """Walls along z over a counter-clockwise outline. low, high: heights of each piece, one number or one a point."""
    return join(
        *(_strip(p.points, lower, p.points, upper, p.normals, 0.0) for p, lower, upper in zip(outline, low, high, strict=True))
    )


def bevel(outline: Sequence[Piece], width: float, top: float) -> Mesh:
    """A chamfer at 45 degrees from the outline, `width` under `top`, to the outline set `width` inward, at `top`.

    Its normals are exact on curved pieces too: what lies at a constant distance from a curve has the curve's normals.
    """
    inner = inset(outline, width)
    return join(*(_strip(p.points, top - width, q, top, _unit(p.normals), 1.0) for p, q in zip(outline, inner, strict=True)))


def inset(outline: Sequence[Piece], width: float) -> list[Array]:
    """Each piece's points, (M, 2), moved inward by `width`; where pieces of a closed outline meet, the corner is mitred."""
    normals = [_unit(piece.normals) for piece in outline]
    moves = [normal.copy() for normal in normals]
    for i in range(len(outline)):
        a, b = normals[i - 1][-1], normals[i][0]
        moves[i - 1][-1] = moves[i][0] = (a + b) / (1 + a @ b)
    return [piece.points - width * move for piece, move in zip(outline, moves, strict=True)]


def cap(outer: Array, inner: Array, centre: Sequence[float] | Array, height: float) -> Mesh:
    """The flat region between two counter-clockwise loops (M, 2) and (N, 2) that go once around `centre`, facing z.

    Each edge is joined to that vertex of the other loop which lies nearest to the edge's middle in angle: no more triangles than edges
    and no slivers where the loops are alike.
    """
    a, b = _middles(outer, centre), _middles(inner, centre)
    m, n = len(outer), len(inner)
    out, into = np.arange(m), np.arange(n)
    # Where an edge of each loop turn up at the same angle, the outer one goes first.
    at_inner, at_outer = m + _after(b, a, "left"), _after(a, b, "right")
    faces = np.concatenate(
        [np.stack([out, (out + 1) % m, at_inner], axis=1), np.stack([m + (into + 1) % n, m + into, at_outer], axis=1)]
    )
    loops = np.concatenate([outer, inner])
    points = np.column_stack([loops, np.full(len(loops), height)])
    return flat(points, faces.astype(np.int32), (0.0, 0.0, 1.0))


def _middles(loop: Array, centre: Sequence[float] | Array) -> Array:
    x, y = (loop - np.asarray(centre)).T
    angle = np.arctan2(y, x)
    step = (np.roll(angle, -1) - angle + np.pi) % (2 * np.pi) - np.pi
    middles: Array = (angle + step / 2) % (2 * np.pi)
    return middles


def _after(edges: Array, angle: Array, side: Literal["left", "right"]) -> NDArray[np.intp]:
    """The vertex of a loop that has been reached at an angle: the one after the last edge whose middle lies before it."""
    order = np.argsort(edges, kind="stable")
    last = np.searchsorted(edges[order], angle, side=side) - 1
    found: NDArray[np.intp] = (order[last] + 1) % len(edges)
    return found


def _unit(normals: Array) -> Array:
    unit: Array = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return unit


def _strip(low: Array, z_low: Array | float, high: Array, z_high: Array | float, normals: Array, up: float) -> Mesh:
    rows = [np.column_stack([points, np.broadcast_to(z, len(points))]) for points, z in ((low, z_low), (high, z_high))]
    return grid(np.stack(rows), np.column_stack([normals, np.full(len(normals), up)]), around=False)
