"""Integration of large maps: the equations of `quadratic`, `bilateral` and `adaptive` on the grid of pixels, without a list of its edges.

What the normals say of an edge is worked out anew whenever it is needed. Weights, and with them the multigrid's finest level, are in single
precision; heights and residuals are in double.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen import large
from gen.capture import Scale
from gen.errors import InputError
from recon.height.edges import STEEPEST, Doubles, Floats
from recon.height.multigrid import Multigrid, conjugate_gradients
from recon.normals.compiled import compiled
from recon.registry import Height

Bools = NDArray[np.bool_]

MANY = 4_000_000
"""Pixels inside from which maps are integrated here."""

STEPS = 300
"""Most steps of conjugate gradients for one solve."""

ENOUGH = 100
"""Multiples of the residual that is asked for at which a solve that stops at `STEPS` still counts, as in `recon.height.algebraic`."""


class Ragged(Exception):
    """The mask or the weights are too ragged for the grid's multigrid: integrate by the list of edges, which is slow and sure."""


def is_large(mask: Bools, reference: Floats | None) -> bool:
    """Whether a map is integrated here: one of many pixels (mask (H, W)) that follows no reference."""
    return reference is None and int(np.count_nonzero(mask)) > MANY


class Sheet:
    """The box of the pixels that have a normal, and the system of its heights.

    normal: (h, w, 3). inside: (h, w). view: (2, 3), which times (column, row, 1) is the first two parts of the viewing ray, y down; zeros
    where the view is orthographic. focal: (2,), pixels of depth of one unknown, along rows and along columns. weight, held, right, x: the
    matrix, right side and unknowns as `recon.height.stencil` wants them, with its margins.
    """

    def __init__(self, normal: Floats, mask: Bools, scale: Scale) -> None:
        """normal: (H, W, 3). mask: (H, W). Raises InputError where no pixel has a normal."""
        if normal.shape != (*mask.shape, 3):
            raise InputError(f"normals {normal.shape} and mask {mask.shape} differ in size; give both for the same frame")
        every = np.zeros(mask.shape, bool)
        for rows in large.strips((1, *mask.shape)):
            with np.errstate(over="ignore"):
                length = np.einsum("hwk,hwk->hw", normal[rows], normal[rows])
            every[rows] = mask[rows] & np.isfinite(length) & (length > 0.25)
        if not every.any():
            raise InputError("there is no pixel with a normal to integrate; check the mask and the pictures")
        rows_in, columns_in = np.flatnonzero(every.any(axis=1)), np.flatnonzero(every.any(axis=0))
        self.box = slice(int(rows_in[0]), int(rows_in[-1]) + 1), slice(int(columns_in[0]), int(columns_in[-1]) + 1)
        self.size, self.scale = mask.shape, scale
        self.normal, self.inside = normal[self.box], every[self.box]
        self.view, self.focal = np.zeros((2, 3)), np.ones(2)
        if scale.camera is not None:
            shift = np.array([[1.0, 0, self.box[1].start], [0, 1, self.box[0].start], [0, 0, 1]])
            self.view = (np.linalg.inv(scale.camera) @ shift)[:2]
            self.focal = np.array([scale.camera[0, 0], scale.camera[1, 1]])
        h, w = self.inside.shape
        self.multigrid = Multigrid(h, w, np.float32)
        self.weight, self.held = self.multigrid.levels[0].weight, self.multigrid.levels[0].held
        self.right, self.x, self.r, self.direction, self.image = (np.zeros((h + 3, w + 3)) for _ in range(5))
        self.count = int(np.count_nonzero(self.inside))

    @property
    def facts(self) -> tuple[Any, ...]:
        """What the compiled passes need of the normals."""
        return self.normal, self.inside, self.view, self.scale.camera is not None, STEEPEST

    def torn(self, least: float, outlying: float) -> Bools:
        """(h, w) the pixels of squares whose chords do not close, and of those next to them; see `recon.height.adaptive.torn`."""
        from scipy.ndimage import maximum_filter

        gap = np.full(self.inside.shape, np.nan, np.float32)
        gaps(self.facts, self.focal[0], gap)
        whole = np.isfinite(gap)
        if not whole.any():
            return whole
        wide: Bools = maximum_filter(whole & (gap > max(least, outlying * float(np.median(gap[whole])))), size=4)
        return wide & self.inside

    def chords(self) -> None:
        """Write weights and right side as `recon.height.quadratic.least_squares` has them."""
        self.right[:] = 0
        for axis in range(2):
            chord_edges(self.facts, axis, self.weight[axis], self.right)

    def solve(self, tolerance: float) -> None:
        """Bring `x` to a residual of `tolerance` relative to the right side. Raises Ragged where that takes too long."""
        mean = 2 * float(self.weight[:2].sum(dtype=np.float64)) / self.count
        self.held[1:-2, 1:-2] = np.where(self.inside, np.float32(1e-10 * mean + 1e-30), np.float32(0))
        self.multigrid.renew()
        self.direction[:], self.r[:] = self.x, self.right
        grids = self.x, self.r, self.direction, self.image
        _, left = conjugate_gradients(self.multigrid, self.weight, self.held, grids, tolerance, STEPS)
        if left > ENOUGH * tolerance:
            raise Ragged

    def height(self) -> Height:
        """Height and points of the unknowns: every connected part at mean zero, as `recon.height.edges.height_of` places them."""
        from scipy.ndimage import label

        parts, count = label(self.inside)
        number = np.maximum(np.bincount(parts.ravel(), minlength=count + 1), 1)

        def means(values: Doubles) -> Doubles:
            return (np.bincount(parts.ravel(), values.ravel(), count + 1) / number)[parts]

        z = self.x[1:-2, 1:-2]
        z = z - means(z)
        (H, W), (h, w) = self.size, z.shape
        x, y = np.arange(w), np.arange(h)[:, None]
        if self.scale.camera is None:
            step = self.scale.metres_per_pixel or 1.0
            z *= step
            across, up = (x + self.box[1].start - (W - 1) / 2) * step, ((H - 1) / 2 - y - self.box[0].start) * step
        else:
            far = self.scale.distance_mm
            middle = float(self.scale.camera[0, 0]) if far is None else far / 1000
            depth = np.exp(z)
            depth *= middle / np.where(self.inside, means(depth), 1)
            across, up = ((v[0] * x + v[1] * y + v[2]) * depth for v in (self.view[0], -self.view[1]))
            z = middle - depth
        height, points = np.full(self.size, np.nan, np.float32), large.empty((*self.size, 3), np.float32)
        height[self.box] = np.where(self.inside, z, np.nan)
        points[:] = np.nan
        for axis, values in enumerate((across, up, z)):
            points[(*self.box, axis)] = np.where(self.inside, values, np.nan)
        large.release(points)
        return Height(height=height, points=points, unit=self.scale.unit)


def reweigh(sheet: Sheet, torn: Bools, stiffness: float, faintest: float, rounds: int, settled: float, loose: float) -> None:
    """Solve `sheet` roughly by the rounds of `recon.height.bilateral.reweighted`, whose numbers these are.

    Only edges that touch a pixel of `torn` (h, w) lose trust; the others keep the chord. Weights and right side are left as they were at
    the last solve.
    """
    trust = np.full((2, 2, *sheet.inside.shape), 0.5, np.float32)  # by axis; in the edge ahead and in the one behind
    energy = np.inf
    for _ in range(rounds):
        sheet.right[:] = 0
        for axis in range(2):
            stated_edges(sheet.facts, torn, sheet.focal[axis], axis, trust[axis], sheet.weight[axis], sheet.right)
        if not sheet.right.any():
            return
        sheet.solve(loose)
        last, energy = energy, 0.0
        for axis in range(2):
            energy += distrust(sheet.facts, torn, sheet.focal[axis], axis, sheet.x, stiffness, faintest, trust[axis])
        if abs(last - energy) <= settled * last and np.isfinite(last):
            break


@compiled
def toward(n: Floats, i: int, j: int, y: int, x: int, view: Doubles) -> float:
    """Minus the product of the normal of the pixel (i, j) with the ray of unit depth through (y, x)."""
    across = view[0, 0] * x + view[0, 1] * y + view[0, 2]
    down = view[1, 0] * x + view[1, 1] * y + view[1, 2]
    return n[i, j, 2] - n[i, j, 0] * across + n[i, j, 1] * down


@compiled
def cosine(n: Floats, i: int, j: int, view: Doubles, steepest: float) -> float:
    """Cosine of a pixel's normal toward the viewer, at least `steepest`."""
    across = view[0, 0] * j + view[0, 1] * i + view[0, 2]
    down = view[1, 0] * j + view[1, 1] * i + view[1, 2]
    return max(toward(n, i, j, i, j, view) / np.sqrt(across * across + down * down + 1), steepest)


@compiled
def chord(n: Floats, i: int, j: int, axis: int, view: Doubles, perspective: bool, steepest: float) -> float:
    """The rise from a pixel to that on its right (axis 0) or below it (1); see `recon.height.edges.Domain.chords`."""
    k, m = (i, j + 1) if axis == 0 else (i + 1, j)
    if perspective:
        here = max(toward(n, i, j, i, j, view) + toward(n, k, m, i, j, view), 2 * steepest)
        there = max(toward(n, i, j, k, m, view) + toward(n, k, m, k, m, view), 2 * steepest)
        return np.log(here / there)
    tilt = n[i, j, 0] + n[k, m, 0] if axis == 0 else -(n[i, j, 1] + n[k, m, 1])
    return -tilt / (max(n[i, j, 2], steepest) + max(n[k, m, 2], steepest))


@compiled
def statement(
    n: Floats, i: int, j: int, axis: int, view: Doubles, perspective: bool, focal: float, steepest: float
) -> tuple[float, float]:
    """a, own: by the normal of a pixel a (z_next - z) = own along an axis; see `recon.height.bilateral`."""
    facing = max(toward(n, i, j, i, j, view), steepest)
    tilt = n[i, j, 0] if axis == 0 else -n[i, j, 1]
    return (facing * focal, tilt) if perspective else (facing, -tilt)


@compiled
def gaps(facts: Any, focal: float, gap: Floats) -> None:
    """gap: at the upper left pixel of every whole square, by how much its chords do not close, in pixels along the normal."""
    n, inside, view, perspective, steepest = facts
    for i in range(inside.shape[0] - 1):
        for j in range(inside.shape[1] - 1):
            if inside[i, j] and inside[i, j + 1] and inside[i + 1, j] and inside[i + 1, j + 1]:
                over = chord(n, i, j, 0, view, perspective, steepest) + chord(n, i, j + 1, 1, view, perspective, steepest)
                under = chord(n, i, j, 1, view, perspective, steepest) + chord(n, i + 1, j, 0, view, perspective, steepest)
                first = min(cosine(n, i, j, view, steepest), cosine(n, i, j + 1, view, steepest))
                second = min(cosine(n, i + 1, j, view, steepest), cosine(n, i + 1, j + 1, view, steepest))
                gap[i, j] = abs(over - under) * focal * min(first, second)


@compiled
def chord_edges(facts: Any, axis: int, weight: Floats, right: Doubles) -> None:
    """weight of all edges along an axis, and what they add to the right side, by the chords."""
    n, inside, view, perspective, steepest = facts
    down = axis
    for i in range(inside.shape[0] - down):
        for j in range(inside.shape[1] - 1 + down):
            k, m = i + down, j + 1 - down
            if inside[i, j] and inside[k, m]:
                w = (cosine(n, i, j, view, steepest) * cosine(n, k, m, view, steepest)) ** 2
                flow = w * chord(n, i, j, axis, view, perspective, steepest)
                weight[i + 1, j + 1] = w
                right[i + 1, j + 1] -= flow
                right[k + 1, m + 1] += flow


@compiled
def stated_edges(facts: Any, torn: Bools, focal: float, axis: int, trust: Floats, weight: Floats, right: Doubles) -> None:
    """weight of all edges along an axis, and what they add to the right side, by what the normals at their ends state and their trust.

    trust: (2, h, w) of each pixel in its edge ahead and in that behind. Edges without a torn pixel take the chord.
    """
    n, inside, view, perspective, steepest = facts
    down = axis
    for i in range(inside.shape[0] - down):
        for j in range(inside.shape[1] - 1 + down):
            k, m = i + down, j + 1 - down
            if inside[i, j] and inside[k, m]:
                a, own_a = statement(n, i, j, axis, view, perspective, focal, steepest)
                b, own_b = statement(n, k, m, axis, view, perspective, focal, steepest)
                s, t = trust[0, i, j], trust[1, k, m]
                w = s * a * a + t * b * b
                flow = s * a * own_a + t * b * own_b
                if not (torn[i, j] or torn[k, m]):
                    flow = w * chord(n, i, j, axis, view, perspective, steepest)
                weight[i + 1, j + 1] = w
                right[i + 1, j + 1] -= flow
                right[k + 1, m + 1] += flow


@compiled
def distrust(
    facts: Any, torn: Bools, focal: float, axis: int, z: Doubles, stiffness: float, faintest: float, trust: Floats
) -> float:
    """The energy of the heights z along an axis under the present trust, then the trust that they give; see `recon.height.bilateral`."""
    n, inside, view, perspective, steepest = facts
    down = axis
    across = 1 - down
    energy = 0.0
    for i in range(inside.shape[0]):
        for j in range(inside.shape[1]):
            if not inside[i, j]:
                continue
            a, own = statement(n, i, j, axis, view, perspective, focal, steepest)
            before = i >= down and j >= across and inside[i - down, j - across]
            after = i + down < inside.shape[0] and j + across < inside.shape[1] and inside[i + down, j + across]
            behind = ahead = 0.0
            here = z[i + 1, j + 1]
            if before:
                behind = a * (here - z[i + 1 - down, j + 1 - across])
                energy += trust[1, i, j] * (behind - own) ** 2
            if after:
                ahead = a * (z[i + 1 + down, j + 1 + across] - here)
                energy += trust[0, i, j] * (ahead - own) ** 2
            more = ahead * ahead - behind * behind
            if after and (torn[i, j] or torn[i + down, j + across]):
                trust[0, i, j] = max(1 / (1 + np.exp(stiffness * more)), faintest)
            if before and (torn[i, j] or torn[i - down, j - across]):
                trust[1, i, j] = max(1 / (1 + np.exp(-stiffness * more)), faintest)
    return energy
