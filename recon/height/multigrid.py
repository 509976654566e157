"""The normal equations of the heights, solved on the grid of pixels: conjugate gradients under a multigrid cycle.

Weights may jump by a million from edge to edge and the mask may have any outline. Every other pixel of every other row makes the next
level; those between take its correction in the proportion of their own edges' weights, so that none comes across an edge of little
weight, and the next level's weights follow from theirs. A cycle costs some fifteen passes over the pixels, and a few cycles solve.
Source: J. E. Dendy, "Black box multigrid", Journal of Computational Physics 48, 1982; the sums by squares are worked out here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from recon.height.algebraic import hierarchy, settled
from recon.height.edges import Domain, Doubles, held, normal_equations
from recon.height.stencil import (
    ENDS,
    advance,
    coarsen,
    correct,
    gather,
    multiply,
    row_sums,
    shares,
    sweep_down,
    sweep_up,
    turn,
)

COARSEST = 200
"""Pixels of a level that is solved directly."""

PATIENCE = 30
"""Steps of conjugate gradients after which the grid counts as too ragged; four to twelve are usual."""

USUAL, USUAL_ALGEBRAIC = 4, 12
"""Steps above which it pays to make the multigrid for the present weights before the next solve."""


@dataclass(frozen=True, eq=False)
class Level:
    """One grid's arrays, as `recon.height.stencil` wants them. spread: on the next level's grid, empty on the last."""

    nine: bool
    weight: Doubles
    held: Doubles
    diagonal: Doubles
    inverse: Doubles
    spread: Doubles
    x: Doubles
    b: Doubles
    r: Doubles
    line: Doubles


def _level(h: int, w: int, nine: bool, kind: DTypeLike = np.float64) -> Level:
    grid = (h + 3, w + 3)
    last = h * w <= COARSEST
    spread = np.zeros((0, 0, 0) if last else (8, (h + 1) // 2 + 3, (w + 1) // 2 + 3), kind)
    held, diagonal, inverse, x, b, r = (np.zeros(grid, kind) for _ in range(6))
    return Level(nine, np.zeros((4, *grid), kind), held, diagonal, inverse, spread, x, b, r, np.zeros((2, w + 3), kind))


class Multigrid:
    """The levels for a grid of h x w pixels. `prepare` takes a matrix in, as often as it changes; `cycle` solves it roughly.

    finest: in what precision the first level, three quarters of all, is kept.
    """

    def __init__(self, h: int, w: int, finest: DTypeLike = np.float64) -> None:
        self.levels = [_level(h, w, nine=False, kind=finest)]
        while h * w > COARSEST:
            h, w = (h + 1) // 2, (w + 1) // 2
            self.levels.append(_level(h, w, nine=True))
        self.direct = np.zeros((h * w, h * w))

    def prepare(self, weight: Doubles, held: Doubles) -> None:
        """weight: (2, h + 3, w + 3), of the edges to the right and down. held: (h + 3, w + 3)."""
        first = self.levels[0]
        first.weight[:2] = weight
        first.held[:] = held
        self.renew()

    def renew(self) -> None:
        """Take in the matrix whose weights and held are in the first level's arrays already."""
        first = self.levels[0]
        row_sums(first.weight, first.diagonal)
        np.add(first.diagonal, first.held, out=first.diagonal)
        for fine, coarse in zip(self.levels[:-1], self.levels[1:], strict=True):
            shares(fine.weight, fine.spread)
            coarsen(fine.weight, fine.held, fine.nine, fine.spread, ENDS, coarse.weight, coarse.diagonal)
            row_sums(coarse.weight, coarse.held)
            np.subtract(coarse.diagonal, coarse.held, out=coarse.held)
        for level in self.levels:
            level.inverse[:] = 0
            np.divide(1, level.diagonal, out=level.inverse, where=level.diagonal > 0)
        self.direct[:] = np.linalg.inv(_dense(self.levels[-1]))

    def cycle(self, right: Doubles) -> Doubles:
        """About the solution for a right side (h + 3, w + 3): one V-cycle from zero, symmetric. The result is overwritten by the next."""
        b = right
        for fine, coarse in zip(self.levels[:-1], self.levels[1:], strict=True):
            sweep_down(fine.weight, fine.nine, fine.inverse, b, fine.line, fine.x, fine.r)
            gather(fine.r, fine.spread, coarse.b)
            b = coarse.b
        last = self.levels[-1]
        inner = last.x[1:-2, 1:-2]
        inner[:] = (self.direct @ b[1:-2, 1:-2].ravel()).reshape(inner.shape)
        for fine, coarse in zip(self.levels[-2::-1], self.levels[:0:-1], strict=True):
            correct(coarse.x, fine.spread, fine.x)
            sweep_up(fine.weight, fine.nine, fine.inverse, right if fine is self.levels[0] else fine.b, fine.line, fine.x)
        return self.levels[0].x


def conjugate_gradients(
    multigrid: Multigrid,
    weight: Doubles,
    held: Doubles,
    grids: tuple[Doubles, Doubles, Doubles, Doubles],
    tolerance: float,
    most: int,
) -> tuple[int, float]:
    """Solve a grid's system (see `recon.height.stencil`) by conjugate gradients under cycles of a multigrid, in at most so many steps.

    grids, each (h + 3, w + 3): x, which takes the solution; r, which holds the right side and is left with the residual; the direction,
    which holds where to start; and room for its image. Stops at a residual of `tolerance` relative to the right side. Returns the steps and
    the relative residual, 0 where the right side is.
    """
    x, r, direction, image = grids
    size = float(np.linalg.norm(r))
    x[:] = 0
    multiply(weight, held, direction, image)
    left = advance(1.0, direction, image, x, r)
    before, steps = np.inf, 0
    while left > (tolerance * size) ** 2 and steps < most:
        z = multigrid.cycle(r)
        now = float(np.einsum("ij,ij->", r, z))
        turn(now / before, z, direction)
        left = advance(now / multiply(weight, held, direction, image), direction, image, x, r)
        before, steps = now, steps + 1
    return steps, float(np.sqrt(left)) / size if size else 0.0


def _dense(level: Level) -> Doubles:
    """The matrix of a small level; pixels outside have a one on the diagonal."""
    h, w = (n - 3 for n in level.held.shape)
    at = np.arange(h * w).reshape(h, w)
    A = np.zeros((h * w, h * w))
    diagonal, (right, down, falling, rising) = level.diagonal[1:-2, 1:-2], level.weight[:, 1:-2, 1:-2]
    A[at, at] = np.where(diagonal > 0, diagonal, 1)
    for weight, i, j in (
        (right[:, :-1], at[:, :-1], at[:, 1:]),
        (down[:-1], at[:-1], at[1:]),
        (falling[:-1, :-1], at[:-1, :-1], at[1:, 1:]),
        (rising[:-1, 1:], at[:-1, 1:], at[1:, :-1]),
    ):
        A[i, j] = A[j, i] = -weight
    return A


class GridSystem:
    """The normal equations of a domain (see `recon.height.edges.normal_equations`), whose weights may change from solve to solve."""

    def __init__(self, domain: Domain, pull: Doubles | None = None) -> None:
        top, left = int(domain.rows.min()), int(domain.columns.min())
        h, w = int(domain.rows.max()) - top + 1, int(domain.columns.max()) - left + 1
        self.domain, self.pull = domain, pull
        self.pixels = (domain.rows - top + 1).astype(np.int64) * (w + 3) + (domain.columns - left + 1)
        self.across, self.down = self.pixels[domain.i[: domain.right]], self.pixels[domain.i[domain.right :]]
        self.weight = np.zeros((2, h + 3, w + 3))
        self.held, self.x, self.r, self.direction, self.image = (np.zeros((h + 3, w + 3)) for _ in range(5))
        self.multigrid, self.prepared = Multigrid(h, w), False
        self.algebraic: Any = None

    def weigh(self, weight: Doubles) -> None:
        """Take in the weights of the edges (E,)."""
        self.weight[0].ravel()[self.across] = weight[: len(self.across)]
        self.weight[1].ravel()[self.down] = weight[len(self.across) :]
        self.held.ravel()[self.pixels] = held(self.domain.count, weight, self.pull)

    def solve(self, right: Doubles, start: Doubles, tolerance: float) -> Doubles:
        """(P,) the solution for a right side (P,), to a residual of `tolerance` relative to it.

        The multigrid is made again only when the weights have moved away from those that it was made for. Masks of lace, and weights that
        jump from every pixel to the next, are too ragged for it: then, and from then on, an algebraic one is made.
        """
        if self.algebraic is None:
            if not self.prepared:
                self.multigrid.prepare(self.weight, self.held)
            self.r[:] = 0
            self.r.ravel()[self.pixels] = right
            self.direction.ravel()[self.pixels] = start
            grids = self.x, self.r, self.direction, self.image
            steps, _ = conjugate_gradients(self.multigrid, self.weight, self.held, grids, tolerance, PATIENCE)
            solution: Doubles = self.x.ravel()[self.pixels]
            self.prepared = steps <= USUAL
            if steps < PATIENCE:
                return solution
            start, self.prepared = solution, False
        weight = np.concatenate([self.weight[0].ravel()[self.across], self.weight[1].ravel()[self.down]])
        A = normal_equations(self.domain, weight, self.pull)
        if not self.prepared:
            self.algebraic = hierarchy(A)
        solution, steps = settled(A, right, start, self.algebraic, tolerance)
        self.prepared = steps <= USUAL_ALGEBRAIC
        return solution
