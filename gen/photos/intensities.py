"""The strengths of lights that nobody measured, from the pictures themselves: semi-calibrated photometric stereo."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gen.capture import grey
from gen.errors import InputError

Doubles = NDArray[np.float64]
Vectors = Doubles | Callable[[NDArray[np.intp], NDArray[np.intp]], Doubles]

SPREAD = 30.0
"""Largest condition number of the lights of a pixel's samples that say anything of intensities."""

PIXELS = 4000
"""Pixels that the estimate is made from: K unknowns of some thousands of equations a light."""

LIT = 0.1
"""Share of a pixel's brightest sample below which a sample is left out as shadowed."""

OUTLIER = 2.5
"""Robust standard deviations beyond which a sample is no Lambertian one."""

ROUNDS = 8


def estimate_intensities(
    images: NDArray[np.float32], vectors: Vectors, mask: NDArray[np.bool_], faults: NDArray[np.uint8], where: str
) -> tuple[Doubles, float]:
    """Relative light intensities (K, 3), mean 1 in each channel, of a mostly matte object under lights of known direction.

    For each pixel the samples over the unknown strengths, m_k / e_k, must be l_k . b. With f = 1 / e the part of diag(m) f that no b
    explains is linear in f: summed over pixels it is one quadratic form, whose smallest eigenvector is f. Shadowed and clipped samples are
    left out a pixel, which the form allows; then samples far from the fit, such as highlights, are left out, and it is solved again.
    The colour common to all lights is not determinable: it goes into the albedo.

    images: (K, H, W, 3) linear. vectors: (K, 3) unit directions; for near lights a function of rows (P,) and columns (P,)
    that gives direction times relative fall-off (K, P, 3).
    mask: (H, W). faults: (K, H, W). Returns the intensities and the residual over the brightness (root mean square).
    Raises InputError with fewer than four lights, or where too few pixels are lit by four lights that are well spread.
    Source: D. Cho, Y. Matsushita, Y.-W. Tai, I. S. Kweon, "Photometric stereo under non-uniform light intensities and exposures",
    ECCV 2016 (the linear joint estimation, the surface eliminated).
    """
    count = len(images)
    if count < 4:
        raise InputError(f"{where}: intensities cannot be estimated from {count} lights, four are needed; say intensities: equal")
    rows, columns = np.nonzero(mask)
    step = max(1, len(rows) // PIXELS)
    rows, columns = rows[::step], columns[::step]
    samples = images[:, rows, columns].astype(np.float64)
    L = vectors(rows, columns) if callable(vectors) else np.broadcast_to(vectors[:, None], (count, len(rows), 3))
    L = np.ascontiguousarray(L.transpose(1, 0, 2))
    y = grey(samples)
    top = y.max(axis=0)
    used = ((y > LIT * top) & (top > 0) & (faults[:, rows, columns] == 0)).T
    strength, residual, used = _solved(y.T / np.where(top > 0, top, 1)[:, None], L, used, where)
    colours = np.empty((count, 3))
    for channel in range(3):
        values = samples[..., channel].T
        size = np.abs(values).max(axis=1, keepdims=True)
        colours[:, channel] = _strengths(values / np.where(size > 0, size, 1), L, used) if (values > 0).any() else strength
    return np.asarray(colours / colours.mean(axis=0)), residual


def _solved(m: Doubles, L: Doubles, used: NDArray[np.bool_], where: str) -> tuple[Doubles, float, NDArray[np.bool_]]:
    """(strengths (K,), residual, samples that were kept) of m (P, K), outliers left out in rounds."""
    start = used
    for _ in range(ROUNDS):
        enough = _determined(L, used)
        if enough.sum() < 30:
            raise InputError(
                f"{where}: only {int(enough.sum())} pixels are lit by four well-spread lights, too few to estimate intensities; "
                "say intensities: equal, or measure them"
            )
        used = used & enough[:, None]
        e = _strengths(m, L, used)
        b = _surface(m / e, L, used)
        off = m / e - (L @ b[..., None])[..., 0]
        spread = 1.4826 * np.median(np.abs(off[used])) + 1e-9
        kept = start & (np.abs(off) <= OUTLIER * spread)
        if (kept == used).all():
            break
        used = kept
    used = used & _determined(L, used)[:, None]
    all_lit = start & used.any(axis=1, keepdims=True)  # outliers too: what is left out of the estimate speaks against it
    residual = float(np.sqrt((off[all_lit] ** 2).mean() / ((m / e)[all_lit] ** 2).mean()))
    return e, residual, used


def _determined(L: Doubles, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (P,) with four or more samples whose lights are spread well enough (`SPREAD`)."""
    w = used.astype(np.float64)
    values = np.linalg.eigvalsh(np.einsum("pk,pki,pkj->pij", w, L, L, optimize=True))
    return (used.sum(axis=1) >= 4) & (values[:, 0] * SPREAD**2 > values[:, 2])


def _strengths(m: Doubles, L: Doubles, used: NDArray[np.bool_]) -> Doubles:
    """The smallest eigenvector of sum_p diag(m) (I - L L^+) diag(m), inverted: strengths (K,), mean 1."""
    some = used.any(axis=1)
    A, pseudo = _inverse(L[some], used[some])
    v = (m * used)[some]
    # The pixels' matrices are never formed: A and its pseudo-inverse are three columns and three rows.
    seen = (v[..., None] * A).transpose(0, 2, 1).reshape(-1, v.shape[1])
    back = (pseudo * v[:, None]).reshape(-1, v.shape[1])
    form = np.diag((v**2).sum(axis=0)) - seen.T @ back
    # Scaled by each light's own power: a lamp that was weak in all pictures must not be the cheapest answer.
    scale = np.sqrt(np.maximum((v**2).sum(axis=0), 1e-30))
    _, vectors = np.linalg.eigh(form / np.outer(scale, scale))
    f = vectors[:, 0] / scale
    f = f * np.sign(f.sum())
    e = 1 / np.maximum(f, 1e-6 * np.abs(f).max())
    result: Doubles = e / e.mean()
    return result


def _surface(r: Doubles, L: Doubles, used: NDArray[np.bool_]) -> Doubles:
    """albedo * normal (P, 3) by least squares on the used samples (P, K)."""
    some = used.any(axis=1)
    b = np.zeros((len(r), 3))
    b[some] = np.einsum("pik,pk->pi", _inverse(L[some], used[some])[1], (r * used)[some])
    return b


def _inverse(L: Doubles, used: NDArray[np.bool_]) -> tuple[Doubles, Doubles]:
    """(L with the rows that are left out at 0, its pseudo-inverse), (P, K, 3) and (P, 3, K), of pixels that are `_determined`."""
    A = L * used[..., None]
    turned = A.transpose(0, 2, 1)
    return A, np.linalg.solve(turned @ A, turned)
