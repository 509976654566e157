"""Poisson integration by the cosine transform: one direct solve where the mask is the whole frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.capture import Scale
from gen.errors import InputError
from recon.height.edges import REACH, Anchor, Domain, Doubles, Floats, anchor_of, domain_of, height_of, right_side
from recon.registry import Height

TOLERANCE = 1e-7
"""Residual, relative to the right-hand side, at which the masked system counts as solved."""

STEPS = 500
"""Most steps of conjugate gradients; a mask with smooth outlines takes some twenty, ragged ones a hundred."""


GRAZING = 1e-3
"""Smallest cosine toward the viewer for `slopes`: the textbook's form has no bound, this one keeps it finite."""


def dct(
    normal: Floats,
    mask: NDArray[np.bool_],
    scale: Scale,
    *,
    reference: Floats | None = None,
    reach: float = REACH,
    slopes: bool = False,
) -> Height:
    """Unweighted least squares by the cosine transform: one direct solve on a full frame, conjugate gradients on a mask.

    The chords and unknowns are those of `quadratic`, every edge counts the same. Where the mask is the whole frame the normal
    equations are Poisson's with natural boundaries, which the cosine transform (DCT-II) makes diagonal. Where it is not, the same
    least squares over the mask alone is solved by conjugate gradients that have the full frame's direct solve as preconditioner.

    slopes: the textbook's rise, the mean of the slopes at both ends, instead of the chord. It is of second order only and follows
    noisy rims wherever they point; it is what published figures of "quadratic" or "Poisson" integration mean.
    Arguments, Height and errors as in `recon.height.quadratic.quadratic`; InputError also where the mask is so torn that the
    conjugate gradients do not settle.
    Source: Simchony, Chellappa and Shao, "Direct analytical methods for solving Poisson equations in computer vision problems"
    (PAMI 1990); fictitious-domain preconditioning for masks is worked out here.
    """
    domain = domain_of(normal, mask, scale)
    anchor = anchor_of(domain, reference, reach)
    return height_of(domain, _poisson(domain, _slopes(domain) if slopes else domain.chords(), anchor), anchor)


def _poisson(domain: Domain, rise: Doubles, anchor: Anchor | None) -> Doubles:
    """The unknowns (P,) that fit the rises, unweighted."""
    inside = domain.inside
    right = np.zeros(inside.shape)
    right[inside] = right_side(domain, rise, anchor)
    pull = 0.0 if anchor is None else float(anchor.pull.mean())
    if inside.all() and (anchor is None or np.ptp(anchor.pull) == 0):
        return _direct(right, pull)[inside]
    held = np.zeros(inside.shape)
    if anchor is not None:
        held[inside] = anchor.pull
    return _masked(inside, right, held, pull)[inside]


def _slopes(domain: Domain) -> Doubles:
    """(E,) rise along each edge: the mean of the slopes at its two ends."""
    n, r = domain.normal, domain.right
    if domain.rays is None:
        toward, across, down = np.maximum(n[:, 2], GRAZING), -n[:, 0], n[:, 1]
    else:
        assert domain.scale.camera is not None
        toward = np.maximum(-np.einsum("pk,pk->p", n, domain.rays), GRAZING)
        across, down = n[:, 0] / domain.scale.camera[0, 0], -n[:, 1] / domain.scale.camera[1, 1]
    across, down = across / toward, down / toward
    rise = np.empty(len(domain.i))
    rise[:r] = (across[domain.i[:r]] + across[domain.j[:r]]) / 2
    rise[r:] = (down[domain.i[r:]] + down[domain.j[r:]]) / 2
    return rise


def _direct(right: Doubles, pull: float) -> Doubles:
    """Solve (Laplacian + pull) z = right on the whole frame, natural boundaries; without a pull the mean of z is zero."""
    from scipy.fft import dctn, idctn

    H, W = right.shape
    spectrum = dctn(right, type=2, norm="ortho", overwrite_x=False)
    down, along = (2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in (H, W))
    for row in range(H):  # a row at a time: no second frame in memory
        eigen = down[row] + along + pull
        if row == 0 and pull == 0:
            eigen[0] = np.inf
        spectrum[row] /= eigen
    solution: Doubles = idctn(spectrum, type=2, norm="ortho", overwrite_x=True)
    return solution


def _masked(inside: NDArray[np.bool_], right: Doubles, held: Doubles, pull: float) -> Doubles:
    """Conjugate gradients on the frame for edges with both ends inside; the preconditioner is `_direct`."""
    across = (inside[:, 1:] & inside[:, :-1]).astype(np.float64)
    down = (inside[1:] & inside[:-1]).astype(np.float64)

    def laplacian(z: Doubles) -> Doubles:
        out = held * z
        for edge, low, high, axis in (
            (across, np.s_[:, :-1], np.s_[:, 1:], 1),
            (down, np.s_[:-1], np.s_[1:], 0),
        ):
            flow = np.diff(z, axis=axis)
            flow *= edge
            out[low] -= flow
            out[high] += flow
        return out

    z = np.zeros(right.shape)
    residual = right.copy()
    size = np.sqrt((right**2).sum())
    if size == 0:
        return z
    direction, before = np.zeros(right.shape), 1.0
    for _ in range(STEPS):
        smooth = _direct(residual, pull)
        now = float((residual * smooth).sum())
        direction *= now / before
        direction += smooth
        along = laplacian(direction)
        step = now / float((direction * along).sum())
        z += step * direction
        residual -= step * along
        if np.sqrt((residual**2).sum()) <= TOLERANCE * size:
            return z
        before = now
    raise InputError("the mask is too torn for the dct integrator, which did not settle; use quadratic")
