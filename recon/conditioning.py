"""How well the lights that a pixel keeps determine its normal, and leaving samples out no further than they allow."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]

MAX_CONDITION = 15.0
"""Largest condition number of a pixel's weighted light matrix (largest over smallest singular value) that is still measured.

One frontal light and two at 35 degrees to either side in perpendicular directions have 4.7; lights in one plane have infinity.
"""


def normal_matrices(lights: Doubles, weights: NDArray[np.floating[Any]]) -> Doubles:
    """Weighted normal matrices sum_k w_k l_k l_k^T.

    lights: (K, 3). weights: (K, P). Returns (P, 3, 3) float64.
    """
    products = (lights[:, :, None] * lights[:, None, :]).reshape(len(lights), 9)
    return (weights.T.astype(np.float64) @ products).reshape(-1, 3, 3)


def condition_numbers(lights: Doubles, weights: NDArray[np.floating[Any]]) -> Doubles:
    """Condition number of sqrt(w_k) l_k a pixel, infinite where fewer than three independent lights have weight.

    lights: (K, 3). weights: (K, P), not negative. Returns (P,) float64. Equal columns of weights are worked out once.
    """
    patterns, index = np.unique(weights.T, axis=0, return_inverse=True) if weights.shape[1] > 1 else (weights.T, np.zeros(1, int))
    values = np.linalg.eigvalsh(normal_matrices(lights, patterns.T))
    tiny = values[:, 2] * 1e-14
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.sqrt(values[:, 2] / values[:, 0])
    condition[~(values[:, 0] > tiny)] = np.inf
    result: Doubles = condition[index.reshape(-1)]
    return result


def leave_out(weights: NDArray[np.float32], unwanted: NDArray[np.bool_], lights: Doubles) -> NDArray[np.float32]:
    """Weights with the unwanted samples at 0, but only in pixels where the others still determine the normal.

    weights: (K, P) or (K, H, W). unwanted: the same shape. lights: (K, 3).
    A pixel whose remaining lights are fewer than three or worse conditioned than `MAX_CONDITION` keeps all its samples.
    """
    reduced = np.where(unwanted, 0, weights).astype(np.float32).reshape(len(lights), -1)
    touched = np.flatnonzero((unwanted & (weights > 0)).reshape(len(lights), -1).any(axis=0))
    if touched.size:
        bad = touched[condition_numbers(lights, reduced[:, touched]) > MAX_CONDITION]
        reduced[:, bad] = weights.reshape(len(lights), -1)[:, bad]
    return reduced.reshape(weights.shape)
