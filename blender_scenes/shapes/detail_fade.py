"""Where detail ends: it fades out toward sharp edges, at which displaced sides would part, and toward bends narrower than it is deep."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from blender_scenes.shapes.detail_field import Asking
from blender_scenes.shapes.detail_surface import Indices, Surface, edges_of, shape_operator, sharpest, spread
from blender_scenes.shapes.surface import Array

SHARP_DEGREES = 2.0
"""Normals of one point that differ by more make it sharp."""

BEND = 0.25
"""The greatest height as a share of a bend's radius."""

SLOPE = 6.0
"""The way over which detail fades, as a multiple of its height."""

PARTS = 5
"""The least number of edges over that way."""

LEVELS = 3
CHUNK = 1 << 20


class Fade:
    """The weight of detail, 0 at sharp edges and tips and 1 from `reach` mm on, a smooth step between."""

    def __init__(self, surface: Surface, bound: float) -> None:
        """bound: the greatest height of all detail together, mm."""
        size = float(np.ptp(surface.points, axis=0).max())
        self.reach = max(SLOPE * bound, size / 500)
        self.segments = _subdivided(np.concatenate([_sharp(surface), _narrow(surface, bound, self.reach / 8)]), self.reach)

    def weight(self, points: Array) -> tuple[Array, Array]:
        """The weight (N,) and its gradient (N, 3)."""
        distance, nearest = self.nearest(points)
        t = distance / self.reach
        slope = 6 * t * (1 - t) / self.reach / np.maximum(distance, 1e-30)
        return t * t * (3 - 2 * t), slope[:, None] * np.where((t < 1)[:, None], points - nearest, 0.0)

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Distance (N,) of points from the nearest sharp place, at most `reach`, and that place (N, 3)."""
        distance2, nearest = np.full(len(points), self.reach**2), points.copy()
        if not len(self.segments) or not len(points):
            return np.sqrt(distance2), nearest
        # From large cubes to small ones and then points, each takes over the candidates of the one around it, and keeps those segments
        # that may be the nearest to some place in it.
        cube = max(self.reach / 2**LEVELS, float(np.ptp(points, axis=0).max()) / 2**20)
        low = points.min(axis=0)
        at = np.floor((points - low) / cube).astype(np.int64)
        corners, of_point = _distinct(at)
        parents: Indices | None = None
        pairs: tuple[Indices, Indices] | None = None
        for level in range(LEVELS, -1, -1):
            cells, of_corner = _distinct(corners >> level)
            centres, half = (cells + 0.5) * (cube * 2**level) + low, cube * 2**level * np.sqrt(3) / 2
            if parents is None or pairs is None:
                which, segment, distance = _within(centres, self.segments, self.reach + half, self.reach)
            else:
                outer = np.empty(len(cells), np.int64)
                outer[of_corner] = parents
                which, segment, distance = _inherited(centres, self.segments, outer, pairs)
            least = np.full(len(centres), np.inf)
            np.minimum.at(least, which, distance)
            kept = np.flatnonzero(distance <= np.minimum(least[which] + 2 * half, self.reach + half))
            kept = kept[np.argsort(which[kept], kind="stable")]
            parents, pairs = of_corner, (which[kept], segment[kept])
        assert pairs is not None
        which, segment = pairs
        order = np.argsort(of_point, kind="stable")
        first = np.searchsorted(of_point[order], np.arange(len(corners) + 1))
        for pair, rank in _ranges(first[which], first[which + 1]):
            _update(points, order[rank], self.segments[segment[pair]], distance2, nearest)
        return np.sqrt(distance2), nearest


class FadeAsking(Asking):
    """What the fade asks of the mesh: that the distance from sharp places be followed where there is any height."""

    def __init__(self, name: str, fade: Fade, height: Callable[[Array], Array]) -> None:
        """height: of all detail, from points (N, 3), without the fade."""
        super().__init__(name, lambda a, middle, b: np.zeros(len(a)))
        self.fade, self.height = fade, height
        self.known, self.tall = np.empty(0), np.empty(0, bool)

    def times(self, points: Array, ends: Indices, middles: Array) -> Array:
        """See `Asking.times`. Distances of points are kept, since points only ever become more."""
        more = points[len(self.known) :]
        self.known = np.concatenate([self.known, np.full(len(more), np.nan)])
        self.tall = np.concatenate([self.tall, self.height(more) != 0])
        # Along an edge the distance changes by no more than its length.
        a, b = points[ends[:, 0]], points[ends[:, 1]]
        long = np.sqrt(((a - middles) ** 2).sum(axis=1)) + np.sqrt(((b - middles) ** 2).sum(axis=1)) > self.fade.reach / PARTS
        used = np.flatnonzero(long)
        used = used[(self.height(middles[used]) != 0) | self.tall[ends[used]].any(axis=1)]
        missing = np.unique(ends[used])
        missing = missing[~np.isfinite(self.known[missing])]
        self.known[missing] = self.fade.nearest(points[missing])[0]
        between = self.fade.nearest(middles[used])[0]
        times = np.zeros(len(ends))
        times[used] = np.abs(self.known[ends[used]] - between[:, None]).sum(axis=1) * (PARTS / self.fade.reach)
        return times


def _distinct(at: Indices) -> tuple[Indices, Indices]:
    """The distinct rows of whole numbers (N, 3) from 0 to 2^21, and the number of each row among them, in ascending order."""
    keys, number = np.unique((at[:, 0] << 42) + (at[:, 1] << 21) + at[:, 2], return_inverse=True)
    mask = (1 << 21) - 1
    return np.stack([keys >> 42, keys >> 21 & mask, keys & mask], axis=1), number


def _inherited(centres: Array, segments: Array, outer: Indices, pairs: tuple[Indices, Indices]) -> tuple[Indices, Indices, Array]:
    """Pairs of a centre and each segment that belongs to its outer cell, and their distances. pairs: cells, ascending, and segments."""
    first = np.searchsorted(pairs[0], outer, side="left")
    last = np.searchsorted(pairs[0], outer, side="right")
    found = [
        (which, pairs[1][rank], np.sqrt(_closest(centres[which], segments[pairs[1][rank]])[0]))
        for which, rank in _ranges(first, last)
    ]
    return _together(found)


def _together(found: list[tuple[Indices, Indices, Array]]) -> tuple[Indices, Indices, Array]:
    if not found:
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    which, segment, distance = (np.concatenate(rows) for rows in zip(*found, strict=True))
    return which, segment, distance


def _within(points: Array, segments: Array, reach: float, longest: float) -> tuple[Indices, Indices, Array]:
    """All pairs of a point and a segment at most `reach` apart, as numbers (N,), and their distances (N,). longest: of the segments."""
    middles = segments.mean(axis=1)
    low = np.minimum(points.min(axis=0), middles.min(axis=0))
    extent = float((np.maximum(points.max(axis=0), middles.max(axis=0)) - low).max())
    cell, rows = max(reach + longest / 2, extent / (1 << 19)), 1 << 20

    def key(at: Array) -> Indices:
        x, y, z = (np.floor((at - low) / cell).astype(np.int64) + 1).T
        keys: Indices = (x * rows + y) * rows + z
        return keys

    keys = key(points)
    order = np.argsort(keys, kind="stable")
    keys, centre = keys[order], key(middles)
    found = []
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            start = centre + (dx * rows + dy) * rows
            first, last = np.searchsorted(keys, start - 1, side="left"), np.searchsorted(keys, start + 1, side="right")
            for segment, at in _ranges(first, last):
                point = order[at]
                square = _closest(points[point], segments[segment])[0]
                near = square <= reach**2
                found.append((point[near], segment[near], np.sqrt(square[near])))
    return _together(found)


def _sharp(surface: Surface) -> Array:
    """Segments (S, 2, 3) along all sharp edges, and one without length at each sharp point."""
    spare = np.cos(np.radians(SHARP_DEGREES / 2))
    P = len(surface.points)
    copies = np.bincount(surface.place, minlength=P)
    point = np.linalg.norm(spread(surface.normals, surface.place, P), axis=1) < spare * copies
    edges = edges_of(surface, surface.triangles, surface.quads)
    E = len(edges.ends)
    copies = np.bincount(edges.edge, minlength=E)
    along = np.zeros(E, bool)
    for end in (0, 1):
        along |= np.linalg.norm(spread(surface.normals[edges.sides[:, end]], edges.edge, E), axis=1) < spare * copies
    single = point.copy()
    single[edges.ends[along]] = False
    ends = np.concatenate([edges.ends[along], np.flatnonzero(single)[:, None].repeat(2, axis=1)])
    return surface.points[ends]


def _narrow(surface: Surface, bound: float, apart: float) -> Array:
    """Segments (S, 2, 3) without length where the surface bends too narrowly, thinned to about one a cube of side `apart`."""
    points = surface.points[np.unique(surface.place[sharpest(shape_operator(surface)) * bound > BEND])]
    _, first = np.unique(np.floor(points / apart).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first), None].repeat(2, axis=1)


def _subdivided(segments: Array, longest: float) -> Array:
    """The segments in equal pieces no longer than `longest`."""
    count = np.maximum(np.ceil(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1) / longest), 1).astype(np.int64)
    which = np.repeat(np.arange(len(count)), count)
    i = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count))[:, None]
    n, (a, b) = count[which, None], segments[which].transpose(1, 0, 2)
    return np.stack([a + (b - a) * i / n, a + (b - a) * (i + 1) / n], axis=1)


def _ranges(first: NDArray[np.intp], last: NDArray[np.intp]) -> list[tuple[Indices, Indices]]:
    """All pairs of a row and a number in [first, last) of it, in portions that memory holds."""
    count = last - first
    rows = np.flatnonzero(count)
    portions = []
    ends = np.cumsum(count[rows])
    start = 0
    while start < len(rows):
        stop = max(start + 1, int(np.searchsorted(ends, (ends[start - 1] if start else 0) + CHUNK)))
        part = rows[start:stop]
        which = np.repeat(part, count[part])
        before = np.cumsum(count[part]) - count[part]
        portions.append((which, first[which] + np.arange(len(which)) - np.repeat(before, count[part])))
        start = stop
    return portions


def _update(points: Array, at: Indices, segments: Array, distance2: Array, nearest: Array) -> None:
    """Take the place on each segment nearest to its point into account. at: (N,) points of the segments (N, 2, 3)."""
    square, place = _closest(points[at], segments)
    better = np.flatnonzero(square < distance2[at])
    # The last of several values for one point is the one that stays: the least.
    better = better[np.argsort(-square[better], kind="stable")]
    distance2[at[better]], nearest[at[better]] = square[better], place[better]


def _closest(points: Array, segments: Array) -> tuple[Array, Array]:
    """The squared distance (N,) of each point from its segment (N, 2, 3), and the place there (N, 3)."""
    a, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    off = points - a
    t = (np.einsum("ij,ij->i", off, along) / np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)).clip(0, 1)
    off -= t[:, None] * along
    return np.einsum("ij,ij->i", off, off), points - off
