"""Discontinuity-preserving integration: each pixel trusts one of its two sides more, told by the surface itself."""

from __future__ import annotations

from contextlib import suppress

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
    Indices,
    anchor_of,
    domain_of,
    height_of,
    right_side,
)
from recon.height.large import Ragged, Sheet, is_large, reweigh
from recon.height.multigrid import GridSystem
from recon.normals.compiled import compiled
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
    if is_large(mask, reference):
        with suppress(Ragged):
            sheet = Sheet(normal, mask, scale)
            return torn_height(sheet, sheet.inside)
    domain = domain_of(normal, mask, scale)
    anchor = anchor_of(domain, reference, reach)
    return height_of(domain, reweighted(domain, anchor), anchor)


def torn_height(sheet: Sheet, torn: NDArray[np.bool_]) -> Height:
    """Of a large map: only the edges that touch a pixel of `torn` (h, w) can be steps, the others take the chord of both normals."""
    reweigh(sheet, torn, STIFFNESS, FAINTEST, ROUNDS, SETTLED, LOOSE)
    sheet.solve(TIGHT)
    return sheet.height()


def reweighted(domain: Domain, anchor: Anchor | None, smooth: NDArray[np.bool_] | None = None) -> Doubles:
    """The unknowns (P,) by reweighting.

    smooth: (E,) edges that no step can cross: they keep their weight and take the chord of both normals. None: there is none such.
    """
    a, b, own_i, own_j = _statements(domain)
    if smooth is None:
        smooth = np.zeros(len(domain.i), bool)
    chords = domain.chords() if smooth.any() else np.zeros(len(domain.i))
    trust = np.full((2, len(domain.i)), 0.5)
    weight = 0.5 * (a**2 + b**2)
    flow = np.where(smooth, weight * chords, 0.5 * (a * own_i + b * own_j))
    system = GridSystem(domain, None if anchor is None else anchor.pull)
    z, energy = np.zeros(domain.count), np.inf
    for _ in range(ROUNDS):
        right = right_side(domain, flow, anchor)
        if not right.any():
            return z
        system.weigh(weight)
        z = system.solve(right, z, LOOSE)
        last = energy
        energy = _reweigh(domain.i, domain.j, domain.right, a, b, own_i, own_j, smooth, STIFFNESS, z, trust, weight, flow)
        if abs(last - energy) <= SETTLED * last and np.isfinite(last):
            break
    return system.solve(right, z, TIGHT)


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


@compiled
def _reweigh(
    i: Indices,
    j: Indices,
    right: int,
    a: Doubles,
    b: Doubles,
    own_i: Doubles,
    own_j: Doubles,
    smooth: NDArray[np.bool_],
    stiffness: float,
    z: Doubles,
    trust: Doubles,
    weight: Doubles,
    flow: Doubles,
) -> float:
    """The energy of the heights z (P,) under the present trust; then the trust that they give, and the weight and flow of each edge by it.

    trust: (2, E) what the pixel at either end of an edge trusts this edge against the one at its other side, in [`FAINTEST`, 1]: the
    sigmoid of the difference of the two squared moves along its normal. A side that leaves the mask moves by nothing. trust, weight (E,)
    and flow (E,) are written, but where `smooth`.
    """
    energy = 0.0
    behind, ahead = np.empty(len(z)), np.empty(len(z))
    for start, end in ((0, right), (right, len(i))):
        behind[:] = 0.0
        ahead[:] = 0.0
        for e in range(start, end):
            move = z[j[e]] - z[i[e]]
            by_i, by_j = a[e] * move, b[e] * move
            energy += trust[0, e] * (by_i - own_i[e]) ** 2 + trust[1, e] * (by_j - own_j[e]) ** 2
            ahead[i[e]], behind[j[e]] = by_i * by_i, by_j * by_j
        for e in range(start, end):
            if smooth[e]:
                continue
            at_i, at_j = ahead[i[e]] - behind[i[e]], behind[j[e]] - ahead[j[e]]
            trust[0, e] = max(1 / (1 + np.exp(stiffness * at_i)), FAINTEST)
            trust[1, e] = max(1 / (1 + np.exp(stiffness * at_j)), FAINTEST)
            weight[e] = trust[0, e] * a[e] * a[e] + trust[1, e] * b[e] * b[e]
            flow[e] = trust[0, e] * a[e] * own_i[e] + trust[1, e] * b[e] * own_j[e]
    return energy
