"""Discontinuity-preserving integration: each pixel trusts one of its two sides more, told by the surface itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Scale
from recon.height.edges import (
    REACH,
    STEEPEST,
    Anchor,
    Domain,
    Doubles,
    Floats,
    anchor_of,
    domain_of,
    height_of,
    normal_equations,
    right_side,
)
from recon.height.quadratic import hierarchy
from recon.registry import Height

STIFFNESS = 2.0
"""The sigmoid's slope, the paper's k: with 2, a side that differs by one pixel of depth more than the other counts .12 against .88."""

ROUNDS = 60
"""Most rounds of reweighting."""

SETTLED = 1e-4
"""Relative change of the energy from round to round at which the weights count as settled."""

FAINTEST = 1e-6
"""What an edge still counts that neither end trusts, so that a part that is cut off all around keeps its place."""

LOOSE, TIGHT = 1e-4, 1e-7
"""Residuals, relative to the right-hand side, of the linear solves: while the weights still change, and at the end."""


def bilateral(
    normal: Floats, mask: NDArray[np.bool_], scale: Scale, *, reference: Floats | None = None, reach: float = REACH
) -> Height:
    """Bilaterally weighted one-sided differences, which keep steps in depth; reweighted least squares, orthographic or perspective.

    Every pixel states the rise to each of its four neighbours from its own normal. Of the two to its left and right, and of the
    two above and below, the one across which the surface moves less counts more: a sigmoid of the difference of the two squared
    moves, each along the normal, in pixels. Solved by reweighting, from equal weights; each round is one linear system, solved by
    conjugate gradients under a multigrid cycle.

    Arguments, Height and errors as in `recon.height.quadratic.quadratic`.
    Source: Cao, Santo, Shi, Okura and Matsushita, "Bilateral Normal Integration" (ECCV 2022), the functional with its sigmoid of
    stiffness 2; the multigrid cycle is this project's choice.
    """
    domain = domain_of(normal, mask, scale)
    anchor = anchor_of(domain, reference, reach)
    return height_of(domain, reweighted(domain, anchor), anchor)


def reweighted(domain: Domain, anchor: Anchor | None, smooth: NDArray[np.bool_] | None = None) -> Doubles:
    """The unknowns (P,) by reweighting.

    smooth: (E,) edges that no step can cross: they keep their weight and take the chord of both normals. None: there is none such.
    """
    i, j = domain.i, domain.j
    a, b, own_i, own_j = _statements(domain)
    chords = None if smooth is None else domain.chords()
    trust_i = np.full(len(i), 0.5)
    trust_j = trust_i.copy()
    z = np.zeros(domain.count)
    solver, energy = None, np.inf
    for _ in range(ROUNDS):
        weight = trust_i * a**2 + trust_j * b**2
        flow = trust_i * a * own_i + trust_j * b * own_j
        if smooth is not None and chords is not None:
            flow = np.where(smooth, weight * chords, flow)
        right = right_side(domain, flow, anchor)
        if not right.any():
            return z
        A = normal_equations(domain, weight, None if anchor is None else anchor.pull)
        if solver is None:
            solver = hierarchy(A)
        z, steps = _conjugate_gradients(A, right, z, solver, LOOSE)
        if steps > 12:  # the weights have moved away from those that the cycle was made for
            solver = None
        move = z[j] - z[i]
        misfit_i, misfit_j = a * move - own_i, b * move - own_j
        last, energy = energy, float((trust_i * misfit_i**2 + trust_j * misfit_j**2).sum())
        if abs(last - energy) <= SETTLED * last and np.isfinite(last):
            break
        trust_i, trust_j = _trust(domain, (a * move) ** 2, (b * move) ** 2)
        if smooth is not None:
            trust_i[smooth] = trust_j[smooth] = 0.5
    return _conjugate_gradients(A, right, z, solver or hierarchy(A), TIGHT)[0]


def _statements(domain: Domain) -> tuple[Doubles, Doubles, Doubles, Doubles]:
    """a, b, own_i, own_j, each (E,): by the normal at i a (z_j - z_i) = own_i, by that at j b (z_j - z_i) = own_j, in pixels."""
    r, n = domain.right, domain.normal
    tilt = np.empty((2, len(domain.i)))
    for row, end in zip(tilt, (domain.i, domain.j), strict=True):
        row[:r], row[r:] = n[end[:r], 0], -n[end[r:], 1]
    if domain.rays is None:
        toward = np.maximum(n[:, 2], STEEPEST)
        return toward[domain.i], toward[domain.j], -tilt[0], -tilt[1]
    assert domain.scale.camera is not None
    toward = np.maximum(-np.einsum("pk,pk->p", n, domain.rays), STEEPEST)
    focal = np.empty(len(domain.i))
    focal[:r], focal[r:] = domain.scale.camera[0, 0], domain.scale.camera[1, 1]
    return toward[domain.i] * focal, toward[domain.j] * focal, tilt[0], tilt[1]


def _trust(domain: Domain, move_i: Doubles, move_j: Doubles) -> tuple[Doubles, Doubles]:
    """(E,) each: what the pixel at either end of an edge trusts this edge against the one at its other side, in [FAINTEST, 1].

    move_i, move_j: squared moves across the edge along the normal of either end. A side that leaves the mask moves by nothing.
    """
    trust_i, trust_j = np.empty_like(move_i), np.empty_like(move_j)
    for axis in (slice(None, domain.right), slice(domain.right, None)):
        i, j = domain.i[axis], domain.j[axis]
        behind, ahead = np.zeros(domain.count), np.zeros(domain.count)
        behind[j], ahead[i] = move_j[axis], move_i[axis]
        trust_i[axis] = _sigmoid(behind[i] - move_i[axis])
        trust_j[axis] = _sigmoid(ahead[j] - move_j[axis])
    return trust_i, trust_j


def _sigmoid(x: Doubles) -> Doubles:
    from scipy.special import expit

    return np.maximum(expit(STIFFNESS * x), FAINTEST)


def _conjugate_gradients(A: Any, right: Doubles, start: Doubles, solver: Any, tolerance: float) -> tuple[Doubles, int]:
    """The solution from a start, and how many steps it took; `solver` is a multigrid hierarchy, of this matrix or one like it."""
    from scipy.sparse.linalg import cg

    steps = 0

    def count(_: Doubles) -> None:
        nonlocal steps
        steps += 1

    preconditioner = solver.aspreconditioner(cycle="V")
    solution, _ = cg(A, right, x0=start, rtol=tolerance, maxiter=200, M=preconditioner, callback=count)
    return solution, steps
