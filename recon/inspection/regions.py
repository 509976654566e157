"""The regions of a view across which a height map can be continuous, and the outline of what is seen."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon.inspection.view import Doubles, Seen

Bools = NDArray[np.bool_]

GRAZING = 0.2
"""Cosine to the viewer under which a height says little, and integration does not carry one across: such pixels are in no region."""

STEP_PIXELS = 1.0
"""Pixels of depth by which the nominal surface must jump from one pixel to the next for the two to count as not connected."""


def regions(nominal: Seen, known: Bools, step: float) -> NDArray[np.int64]:
    """(H, W) the number of each pixel's region, 1 the largest, 0 where nominal or measurement (`known`) is missing or
    the nominal is seen under less than `GRAZING`.

    Normals say nothing of the height of a step that is hidden from the view, so heights on its two sides have no common zero. Two
    neighbours belong together unless the plane of each passes the other's point on opposite sides by more than `STEP_PIXELS`: a crease,
    however sharp, has both points on one side. step: length a pixel.
    """
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    both = nominal.inside & known & (nominal.cosine > GRAZING)
    index = np.full(both.shape, -1)
    index[both] = np.arange(int(both.sum()))
    pairs = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        joined = both[a] & both[b]
        over, back = _overshoot(nominal, a, b, joined), _overshoot(nominal, b, a, joined)
        torn = (over * back < 0) & (np.minimum(np.abs(over), np.abs(back)) > STEP_PIXELS * step)
        pairs.append(np.stack([index[a][joined][~torn], index[b][joined][~torn]]))
    i, j = np.concatenate(pairs, axis=1)
    count = int(both.sum())
    graph = sparse.coo_array((np.ones(len(i), np.int8), (i, j)), shape=(count, count))
    parts, part = connected_components(graph, directed=False)
    order = np.argsort(-np.bincount(part, minlength=parts), kind="stable")
    rank = np.empty(parts, np.int64)
    rank[order] = np.arange(1, parts + 1)
    label = np.zeros(both.shape, np.int64)
    label[both] = rank[part]
    return label


def _overshoot(nominal: Seen, a: Any, b: Any, where: Bools) -> Doubles:
    """Along the ray of pixel b, from its point to the plane of pixel a's."""
    n, toward = nominal.normal[a][where], nominal.toward[b][where]
    slope = np.maximum(np.einsum("nk,nk->n", n, toward), 1e-3)
    result: Doubles = np.einsum("nk,nk->n", nominal.points[a][where] - nominal.points[b][where], n) / slope
    return result


def outline(mask: Bools) -> tuple[NDArray[np.int64], Doubles, Doubles]:
    """Where a mask (H, W) ends inside the frame: the pixels (N, 2) just inside as row and column, the points (N, 2) half a pixel
    further, and the outward unit directions (N, 2) as column and row. The frame's own edge is no outline."""
    from scipy.ndimage import gaussian_filter

    down, right = np.gradient(gaussian_filter(mask.astype(np.float64), 3.0, mode="nearest"))
    inner, points, outward = [], [], []
    for axis in (0, 1):
        low = np.moveaxis(mask, axis, 0)[:-1]
        high = np.moveaxis(mask, axis, 0)[1:]
        for inside, outside, ahead in ((low, high, 1), (high, low, -1)):
            at = np.argwhere(inside & ~outside)
            if axis == 1:
                at = at[:, ::-1]
            pixel = at.copy()
            if ahead < 0:
                pixel[:, axis] += 1
            other = pixel.copy()
            other[:, axis] += ahead
            inner.append(pixel)
            points.append((pixel + other) / 2)
            slope = np.stack([m[tuple(pixel.T)] + m[tuple(other.T)] for m in (right, down)], axis=1)
            outward.append(-slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12))
    return np.concatenate(inner), np.concatenate(points), np.concatenate(outward)
