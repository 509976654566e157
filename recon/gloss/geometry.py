"""Gloss from geometry alone: a robust Lambertian fit, and what exceeds it near the mirror direction. For surfaces without colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.capture import Floats

SHADOW = 0.03
"""Samples under this share of the pixel's brightest are in shadow and take no part in the fit."""

TOLERANCE = 0.03
"""Residuals above this share of the pixel's brightest sample lose their say (the scale of the Cauchy weights)."""

MIRROR = (0.80, 0.90)
"""n.h between which a positive residual turns into gloss whatever its size: the surface mirrors the light toward the camera."""

SIDE = (0.60, 0.70)
"""n.h between which a positive residual turns into gloss where it also stands out of the other samples' scatter."""

STANDING_OUT = (2.0, 5.0)
"""Positive residual over the scatter of the samples that agree, between which it turns into gloss."""

ROUNDS = 10
CHUNK = 32768


def gloss_from_geometry(samples: Floats, usable: NDArray[np.bool_], lights: NDArray[np.float64]) -> Floats:
    """The part of each sample above a robust Lambertian fit to its pixel, where the lights' directions make gloss plausible.

    samples: (K, P) reflectance. usable: (K, P), false where missing. lights: (K, 3) unit. Returns (K, P) gloss, 0 <= gloss <= sample.
    A Lambertian b = albedo * normal is fitted by iteratively reweighted least squares with Cauchy weights that are three times as
    wide below as above (gloss only adds), shadows left out. A positive residual counts as gloss as far as n.h, h the half vector
    of that light and the view along +z, is near 1, or is not far from it and the residual stands out of the scatter
    of the samples that agree. Fewer than four lit samples leave nothing to disagree with: only n.h speaks then.
    With fewer than four lights nothing is found.
    Source: the test of a normal against the mirror direction is that of S. Barsky and M. Petrou, "The 4-source photometric stereo
    technique for three-dimensional surfaces in the presence of highlights and shadows", PAMI 25(10), 2003; reweighting after P. Holland and
    R. Welsch, "Robust regression using iteratively reweighted least-squares" (1977). The windows are this project's own.
    """
    gloss = np.zeros_like(samples)
    if len(lights) < 4:
        return gloss
    L = lights.astype(np.float32)
    half = half_vectors(lights)
    for start in range(0, samples.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        gloss[:, part] = _gloss(samples[:, part], usable[:, part], L, half)
    return gloss


def _gloss(y: Floats, usable: NDArray[np.bool_], L: Floats, half: Floats) -> Floats:
    top = np.where(usable, y, 0).max(axis=0)
    scaled = y / np.where(top > 0, top, 1)
    lit = (usable & (scaled > SHADOW)).astype(np.float32)
    weight = lit
    for i in range(ROUNDS):
        b = fit(scaled, weight, L)
        residual = scaled - L @ b
        scale = np.float32(TOLERANCE * 2 ** max(ROUNDS // 2 - 1 - i, 0))
        weight = lit / (1 + np.square(residual / np.where(residual > 0, scale, 3 * scale)))
    length = np.sqrt(np.square(b).sum(axis=0))
    mirror = half @ (b / np.maximum(length, 1e-9))
    freedom = np.maximum(weight.sum(axis=0) - 3, 0.3)
    scatter = np.sqrt((weight * np.square(residual)).sum(axis=0) / freedom) + 0.01
    stands_out = smoothstep(residual / scatter, *STANDING_OUT) * ((weight > 0.3).sum(axis=0) >= 4)
    share = np.maximum(stands_out * smoothstep(mirror, *SIDE), smoothstep(mirror, *MIRROR))
    excess = np.clip(scaled - np.maximum(L @ b, 0), 0, None)
    result: Floats = np.where(usable, share * excess * top, 0).astype(np.float32)
    return result


def fit(y: Floats, w: Floats, L: Floats) -> Floats:
    """b (3, P) of weighted least squares, lightly damped, by the closed-form inverse of a symmetric 3x3 matrix. y, w: (K, P). L: (K, 3)."""
    products = np.stack([L[:, 0] ** 2, L[:, 1] ** 2, L[:, 2] ** 2, L[:, 0] * L[:, 1], L[:, 0] * L[:, 2], L[:, 1] * L[:, 2]])
    xx, yy, zz, xy, xz, yz = products @ w
    xx, yy, zz = xx + np.float32(1e-3), yy + np.float32(1e-3), zz + np.float32(1e-3)
    rx, ry, rz = L.T @ (w * y)
    cxx, cxy, cxz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * cxx + xy * cxy + xz * cxz
    cyy, cyz, czz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    b = np.stack([cxx * rx + cxy * ry + cxz * rz, cxy * rx + cyy * ry + cyz * rz, cxz * rx + cyz * ry + czz * rz])
    result: Floats = b / np.maximum(determinant, np.float32(1e-9))
    return result


def half_vectors(lights: NDArray[np.float64]) -> Floats:
    """Unit vectors halfway between each light and the view along +z. lights: (K, 3) unit. Returns (K, 3)."""
    half = lights + np.array([0.0, 0.0, 1.0])
    result: Floats = (half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)).astype(np.float32)
    return result


def smoothstep(x: Floats, low: float, high: float) -> Floats:
    """0 below `low`, 1 above `high`, 3t^2 - 2t^3 between."""
    t = np.clip((x - low) / (high - low), 0, 1).astype(np.float32)
    result: Floats = t * t * (3 - 2 * t)
    return result
