"""How well the lights that a pixel keeps determine its normal, and leaving samples out no further than they allow."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError

Doubles = NDArray[np.float64]

MAX_CONDITION = 30.0
"""Largest condition number of a light matrix (largest over smallest singular value), weighted a pixel, that is still measured.

A frontal light and two at 35 degrees, one to the side and one above, have 4.4; a frontal one and four at 3 degrees have 30.
"""


CHUNK = 1 << 20
"""Pixels whose condition is worked out at a time: a matrix each, in double precision, is 72 MB."""

LIT = 0.05
"""Share of a pixel's brightest sample above which a sample counts as lit."""


def lit(y: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which samples are not in shadow, told by their pixel's brightest. y: (K, ...) grey reflectance; so is the result's shape."""
    return y > LIT * y.max(axis=0)


def require_spanning_lights(lights: Doubles, where: str) -> None:
    """InputError unless the directions (K, 3) are at least three, and spread so that their condition number is at most `MAX_CONDITION`."""
    if len(lights) < 3:
        raise InputError(f"{where}: photometric stereo needs at least three lights, there are {len(lights)}")
    s = np.linalg.svd(lights, compute_uv=False)
    if s[2] * 1e4 < s[0]:
        raise InputError(
            f"{where}: the light directions lie in one plane; move a light out of it, or choose others with --lights"
        )
    if s[2] * MAX_CONDITION < s[0]:
        raise InputError(
            f"{where}: the lights are too much alike (condition number {s[0] / s[2]:.0f}, at most {MAX_CONDITION:g}); spread them"
        )


def normal_matrices(lights: Doubles, weights: NDArray[np.floating[Any]]) -> Doubles:
    """Weighted normal matrices sum_k w_k l_k l_k^T.

    lights: (K, 3). weights: (K, P). Returns (P, 3, 3) float64.
    """
    products = (lights[:, :, None] * lights[:, None, :]).reshape(len(lights), 9)
    return (weights.T.astype(np.float64) @ products).reshape(-1, 3, 3)


def distinct(weights: NDArray[np.floating[Any]]) -> tuple[NDArray[np.floating[Any]], NDArray[np.intp]]:
    """The different columns of weights, and which of them each pixel has: what follows from weights alone is worked out once for each.

    weights: (K, P). Returns patterns (K, Q) and index (P,), with patterns[:, index] == weights. Pixels that all
    weigh alike are one pattern; other weights than 0 and 1 (or more than 62 lights) hardly repeat and come back as they are.
    """
    count = len(weights)
    if (weights == weights[:, :1]).all():
        return weights[:, :1], np.zeros(weights.shape[1], dtype=np.intp)
    if count > 62 or not ((weights == 0) | (weights == 1)).all():
        return weights, np.arange(weights.shape[1])
    keys = (1 << np.arange(count, dtype=np.int64)) @ weights.astype(np.int64)
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    return weights[:, first], index


def condition_numbers(lights: Doubles, weights: NDArray[np.floating[Any]]) -> Doubles:
    """Condition number of sqrt(w_k) l_k a pixel, infinite where fewer than three independent lights have weight.

    lights: (K, 3). weights: (K, P), not negative. Returns (P,) float64.
    """
    patterns, index = distinct(weights)
    values = np.linalg.eigvalsh(normal_matrices(lights, patterns))
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.sqrt(values[:, 2] / values[:, 0])
    condition[~(values[:, 0] > values[:, 2] * 1e-14)] = np.inf
    result: Doubles = condition[index]
    return result


def leave_out(weights: NDArray[np.float32], unwanted: NDArray[np.bool_], lights: Doubles) -> NDArray[np.float32]:
    """Weights with the unwanted samples at 0, but only in pixels where the others still determine the normal (see `lowered`)."""
    return lowered(weights, np.where(unwanted, 0, weights).astype(np.float32), lights)


def lowered(weights: NDArray[np.float32], wanted: NDArray[np.float32], lights: Doubles) -> NDArray[np.float32]:
    """The wanted, lower weights, but only in pixels where they still determine the normal.

    weights, wanted: (K, P) or (K, H, W), wanted <= weights. lights: (K, 3). A pixel whose lights would be fewer than three, or worse
    conditioned than `MAX_CONDITION`, keeps all its weights as they are.
    """
    result = wanted.reshape(len(lights), -1).copy()
    kept = weights.reshape(len(lights), -1)
    touched = np.flatnonzero((result != kept).any(axis=0))
    for start in range(0, touched.size, CHUNK):
        part = touched[start : start + CHUNK]
        bad = part[condition_numbers(lights, result[:, part]) > MAX_CONDITION]
        result[:, bad] = kept[:, bad]
    return result.reshape(weights.shape)
