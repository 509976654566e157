"""Weighted least squares where every pixel has lights of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.conditioning import MAX_CONDITION

Doubles = NDArray[np.float64]


def fit(y: Doubles, vectors: Doubles, w: Doubles) -> tuple[Doubles, Doubles]:
    """b = albedo * normal (P, 3) of min sum_k w_k (y_k - v_k . b)^2 a pixel, and the residual over the brightness, both root mean square.

    y, w: (K, P), weights not negative. vectors: (K, P, 3), each light's direction times its strength at the pixel. Returns b, NaN where
    the lights of weight do not determine it (condition number above `MAX_CONDITION`), and the residual (P,), NaN there too.
    """
    v = np.ascontiguousarray(vectors.transpose(1, 0, 2))
    weighted = w.T[..., None] * v
    matrix = weighted.transpose(0, 2, 1) @ v
    values = np.linalg.eigvalsh(matrix)
    good = (values[:, 0] * MAX_CONDITION**2 >= values[:, 2]) & (values[:, 0] > 0)
    b = np.full((len(v), 3), np.nan)
    b[good] = np.linalg.solve(matrix[good], np.einsum("pki,kp->pi", weighted[good], y[:, good])[..., None])[..., 0]
    off = y - np.einsum("pki,pi->kp", v, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        residual = np.sqrt((w * off**2).sum(axis=0) / (w * y**2).sum(axis=0))
    return b, residual
