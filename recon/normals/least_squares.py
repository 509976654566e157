"""Weighted least squares: the plain Lambertian fit, on all samples that carry weight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.capture import grey
from recon.conditioning import MAX_CONDITION, condition_numbers, distinct, normal_matrices
from recon.registry import Normals

Doubles = NDArray[np.float64]

CHUNK = 1 << 18
"""Pixels that are solved at a time: what a solve needs beside its input stays under 100 MB."""

LARGE = 4_000_000
"""Samples above which the compiled pass is worth loading the compiler for."""


def least_squares(
    reflectance: NDArray[np.float32], lights: Doubles, mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """Weighted linear least squares on all samples (Woodham 1980).

    Minimises sum_k w_k (r_k - l_k . b)^2 a pixel for b = albedo * normal, on the luma of the reflectance; shadowed samples take
    part like all others unless their weight is 0. Albedo is then fitted in each channel to the lit samples with the normal held.

    reflectance: (K, H, W, 3) radiance over light intensity. lights: (K, 3) unit. mask: (H, W). weights: (K, H, W), not negative.
    Returns Normals; pixels whose weighted lights have a condition number above `MAX_CONDITION` are not measurable.
    Uncertainty is the root mean square tangential part of the fit's covariance, from the pixel's own residual; NaN with three
    samples.
    Source: R. J. Woodham, "Photometric method for determining surface orientation from multiple images", Optical Engineering
    19(1), 1980; the covariance is that of any linear regression.
    """
    if len(lights) * np.count_nonzero(mask) > LARGE:
        from recon.normals.large_stacks import large_least_squares

        return large_least_squares(reflectance, lights, mask, weights)
    samples = reflectance[:, mask]
    y = grey(samples)
    w = weights[:, mask]
    scaled, uncertainty, measurable = solve(y, lights, w)
    return assemble(scaled, samples, lights, w, uncertainty, measurable, mask)


def solve(y: NDArray[np.float32], lights: Doubles, w: NDArray[np.float32]) -> tuple[Doubles, Doubles, NDArray[np.bool_]]:
    """The fit itself. y, w: (K, P). Returns b (P, 3), the uncertainty in degrees (P,), and which pixels are measurable (P,)."""
    pixels = y.shape[1]
    b, uncertainty, measurable = np.zeros((pixels, 3)), np.zeros(pixels), np.zeros(pixels, dtype=bool)
    for start in range(0, pixels, CHUNK):
        part = slice(start, start + CHUNK)
        b[part], uncertainty[part], measurable[part] = _solve(y[:, part], lights, w[:, part])
    return b, uncertainty, measurable


def _solve(y: NDArray[np.float32], lights: Doubles, w: NDArray[np.float32]) -> tuple[Doubles, Doubles, NDArray[np.bool_]]:
    patterns, index = distinct(w)
    usable = condition_numbers(lights, patterns) <= MAX_CONDITION
    inverses = np.zeros((len(usable), 3, 3))
    inverses[usable] = np.linalg.inv(normal_matrices(lights, patterns[:, usable]))
    b = np.einsum("pij,pj->pi", inverses[index], (w * y).T.astype(np.float64) @ lights)
    residual = (w * (y - (lights @ b.T).astype(np.float32)) ** 2).sum(axis=0)
    freedom = (w > 0).sum(axis=0) - 3
    length = np.linalg.norm(b, axis=1)
    measurable = usable[index] & (length > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        n = b / length[:, None]
        along = np.einsum("pi,pij,pj->p", n, inverses[index], n, optimize=True)
        across = np.maximum(np.trace(inverses, axis1=1, axis2=2)[index] - along, 0)
        spread = np.sqrt(residual / freedom * across) / length
    return b, np.where(measurable & (freedom > 0), np.degrees(np.arctan(spread)), np.nan), measurable


def assemble(
    scaled: Doubles,
    samples: NDArray[np.float32],
    lights: Doubles,
    w: NDArray[np.float32],
    uncertainty: Doubles,
    measurable: NDArray[np.bool_],
    mask: NDArray[np.bool_],
) -> Normals:
    """Maps of the whole frame from a solver's b = albedo * normal (P, 3); each channel's albedo is fitted to the lit samples.

    samples: (K, P, 3) reflectance. w: (K, P). uncertainty, measurable: (P,). mask: (H, W) with P true pixels.
    """
    length = np.linalg.norm(scaled, axis=1)
    n = np.where(measurable[:, None], scaled / np.where(length > 0, length, 1)[:, None], 0)
    shading = np.maximum(lights @ n.T, 0).astype(np.float32)
    weight = w * shading
    power = (weight * shading).sum(axis=0)
    fitted = np.einsum("kp,kpc->pc", weight, samples) / np.where(power > 0, power, 1)[:, None]
    normal = np.zeros((*mask.shape, 3), np.float32)
    albedo = np.zeros((*mask.shape, 3), np.float32)
    sigma = np.full(mask.shape, np.nan, np.float32)
    found = np.zeros(mask.shape, dtype=bool)
    normal[mask] = n
    albedo[mask] = np.maximum(fitted, 0) * measurable[:, None]
    sigma[mask] = np.where(measurable, uncertainty, np.nan)
    found[mask] = measurable
    return Normals(normal=normal, albedo=albedo, uncertainty=sigma, measurable=found)
