"""What all integrators share: the pixels inside, the edges between neighbours with the rise the normals give them, and Height."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Scale
from gen.errors import InputError
from recon.registry import Height

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Indices = NDArray[np.int32]

STEEPEST = 0.05
"""Smallest cosine toward the viewer that a normal is given: a pixel cannot show a slope beyond some 20 pixels a pixel, and noisy rims
would hang down in spikes. Steeper normals, and those that face away, are read as this."""

REACH = 50.0
"""Pixels, by default: where a reference height is given, forms wider than this follow it and narrower ones follow the normals."""


@dataclass(frozen=True, eq=False)
class Domain:
    """The P pixels that have a normal, row by row, and the E edges between neighbours: first those to the right, then those down.

    inside: (H, W). rows, columns: (P,). normal: (P, 3). rays: (P, 3) of unit depth, or None where the view is orthographic.
    i, j: (E,) the pixels at an edge's two ends. right: how many edges run to the right.
    The unknowns are heights in pixels (orthographic) or the logarithms of depths (perspective).
    """

    inside: NDArray[np.bool_]
    rows: Indices
    columns: Indices
    normal: Doubles
    rays: Doubles | None
    i: Indices
    j: Indices
    right: int
    scale: Scale

    @property
    def count(self) -> int:
        """How many unknowns there are."""
        return len(self.rows)

    @property
    def middle(self) -> float:
        """Perspective: the depth of the object's middle, in the unit of the heights."""
        assert self.scale.camera is not None
        return self.scale.distance_mm / 1000 if self.scale.distance_mm is not None else float(self.scale.camera[0, 0])

    def cosines(self) -> Doubles:
        """(P,) cosine of each normal toward the viewer, at least `STEEPEST`."""
        if self.rays is None:
            return np.maximum(self.normal[:, 2], STEEPEST)
        return np.maximum(-np.einsum("pk,pk->p", self.normal, self.rays) / np.linalg.norm(self.rays, axis=1), STEEPEST)

    def chords(self) -> Doubles:
        """(E,) rise along each edge: the chord is taken perpendicular to the sum of the two normals (see `quadratic`)."""
        i, j = self.i, self.j
        if self.rays is None:
            across = np.empty(len(i))
            r = self.right
            across[:r] = self.normal[i[:r], 0] + self.normal[j[:r], 0]
            across[r:] = -(self.normal[i[r:], 1] + self.normal[j[r:], 1])
            toward = self.cosines()
            return -across / (toward[i] + toward[j])
        mean = self.normal[i] + self.normal[j]
        at_i, at_j = (np.maximum(-(mean * self.rays[k]).sum(axis=1), 2 * STEEPEST) for k in (i, j))
        return np.log(at_i / at_j)


def domain_of(normal: Floats, mask: NDArray[np.bool_], scale: Scale) -> Domain:
    """The pixels of the mask that have a finite normal of length above a half, and their edges. InputError where there is none."""
    if normal.shape != (*mask.shape, 3):
        raise InputError(f"normals {normal.shape} and mask {mask.shape} differ in size; give both for the same frame")
    with np.errstate(over="ignore"):
        length = np.einsum("hwk,hwk->hw", normal, normal)
    inside = mask & np.isfinite(length) & (length > 0.25)
    if not inside.any():
        raise InputError("there is no pixel with a normal to integrate; check the mask and the pictures")
    rows, columns = (v.astype(np.int32) for v in np.nonzero(inside))
    index = np.full(mask.shape, -1, np.int32)
    index[inside] = np.arange(len(rows), dtype=np.int32)
    pairs = [_neighbours(index[:, :-1], index[:, 1:]), _neighbours(index[:-1], index[1:])]
    i, j = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    return Domain(
        inside, rows, columns, normal[inside].astype(np.float64), _rays(rows, columns, scale), i, j, len(pairs[0][0]), scale
    )


def _neighbours(a: Indices, b: Indices) -> tuple[Indices, Indices]:
    both = (a >= 0) & (b >= 0)
    return a[both], b[both]


def _rays(rows: Indices, columns: Indices, scale: Scale) -> Doubles | None:
    """(P, 3) viewing rays of unit depth in our frame (OpenCV's K has y down): the point at depth d is d times the ray."""
    if scale.camera is None:
        return None
    x = np.linalg.inv(scale.camera) @ np.stack([columns, rows, np.ones(len(rows))]).astype(np.float64)
    return np.stack([x[0], -x[1], -np.ones(len(rows))], axis=1)


@dataclass(frozen=True, eq=False)
class Anchor:
    """A reference height as the unknowns see it: pull (P,), 0 where there is none, and target (P,)."""

    pull: Doubles
    target: Doubles


def anchor_of(domain: Domain, reference: Floats | None, reach: float) -> Anchor | None:
    """The reference (H, W) in the unit of the heights, NaN where unknown: a coarse depth, or a plane where the object touches it.

    reach: pixels; forms wider than it follow the reference. Raises InputError where nothing of it lies inside, for a reach that
    is not positive, and for a reference that lies behind the camera.
    """
    if reference is None:
        return None
    if reference.shape != domain.inside.shape:
        raise InputError(
            f"the reference height is {reference.shape} and the mask {domain.inside.shape}; give both for the same frame"
        )
    if not (np.isfinite(reach) and reach > 0):
        raise InputError(f"the reach of the reference height must be a positive number of pixels, got {reach!r}")
    values = reference[domain.inside].astype(np.float64)
    known = np.isfinite(values)
    if not known.any():
        raise InputError("the reference height has no value inside the mask; check its place and its unknown (NaN) pixels")
    values = np.where(known, values, 0)
    if domain.rays is None:
        target = values / (domain.scale.metres_per_pixel or 1.0)
    else:
        if (values >= domain.middle).any():
            raise InputError("the reference height reaches behind the camera; check its unit")
        target = np.log(domain.middle - values)
    return Anchor(known / reach**2, target)


def parts_of(domain: Domain) -> tuple[int, Indices]:
    """How many connected parts there are, and the number of each pixel's."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    edge = sparse.csr_array((np.ones(len(domain.i), np.int8), (domain.i, domain.j)), shape=(domain.count, domain.count))
    count, part = connected_components(edge, directed=False)
    return int(count), part


def height_of(domain: Domain, unknowns: Doubles, anchor: Anchor | None = None) -> Height:
    """Height and points from the unknowns: every connected part at mean zero, or where the reference has put it."""
    scale, inside = domain.scale, domain.inside
    count, part = parts_of(domain)
    free = np.ones(count, bool)
    if anchor is not None:
        free[part[anchor.pull > 0]] = False
    height = np.full(inside.shape, np.nan, np.float32)
    points = np.full((*inside.shape, 3), np.nan, np.float32)
    if domain.rays is None:
        step = scale.metres_per_pixel or 1.0
        z = (unknowns - np.where(free, _means(unknowns, part), 0)[part]) * step
        points[inside, 0] = (domain.columns - (inside.shape[1] - 1) / 2) * step
        points[inside, 1] = ((inside.shape[0] - 1) / 2 - domain.rows) * step
        points[inside, 2] = z
    else:
        depth = np.exp(unknowns - np.where(free, _means(unknowns, part), 0)[part])
        depth *= np.where(free, domain.middle / _means(depth, part), 1)[part]
        z = domain.middle - depth
        points[inside] = domain.rays * depth[:, None] + [0, 0, domain.middle]
    height[inside] = z
    return Height(height=height, points=points, unit=scale.unit)


def _means(values: Doubles, part: Indices) -> Doubles:
    return np.bincount(part, values) / np.bincount(part)


def held(count: int, weight: Doubles, pull: Doubles | None) -> Doubles:
    """(P,) what the diagonal of the normal equations has beyond the weights (E,) of the edges: the pull of a reference, and a grain.

    A height is known only up to a constant in each part: the grain makes the matrix definite.
    """
    mean = 2 * float(weight.sum()) / count
    return np.full(count, 1e-10 * mean + 1e-300) if pull is None else pull + 1e-12 * mean


def normal_equations(domain: Domain, weight: Doubles, pull: Doubles | None = None) -> Any:
    """The matrix of sum w (z_j - z_i - rise)^2 + sum pull (z - target)^2, sparse rows; see `right_side`."""
    from scipy import sparse

    count, i, j = domain.count, domain.i, domain.j
    diagonal = np.bincount(i, weight, count) + np.bincount(j, weight, count) + held(count, weight, pull)
    upper = sparse.csr_array((-weight, (i, j)), shape=(count, count))
    return (upper + upper.T + sparse.diags_array(diagonal)).tocsr()


def right_side(domain: Domain, flow: Doubles, anchor: Anchor | None = None) -> Doubles:
    """The right side of the normal equations: flow is weight times rise, (E,)."""
    right = np.bincount(domain.j, flow, domain.count) - np.bincount(domain.i, flow, domain.count)
    return right.astype(np.float64) if anchor is None else right + anchor.pull * anchor.target
