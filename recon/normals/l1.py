"""L1: the fit that a minority of highlights and shadows cannot pull away."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.normals.compiled import in_parts, reweighted_l1
from recon.normals.rows import rows
from recon.registry import Normals

ROUNDS = 200
TOLERANCE = 1e-5
"""Change of b, relative to its length, at which a pixel counts as solved: well under a thousandth of a degree on exact samples."""

SMALLEST = 1e-6
"""Residual, over the pixel's brightest sample, below which a sample weighs no more: a tenth of a 16-bit step."""

EFFICIENCY = np.pi / 2
"""Variance of least absolute deviations over that of least squares, Gaussian noise."""


def l1(
    reflectance: NDArray[np.float32], lights: NDArray[np.float64], mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """Least absolute deviations, by iteratively reweighted least squares: highlights and shadows as sparse errors.

    Minimises sum_k w_k |r_k - l_k . b| a pixel, on luma; each round is weighted least squares with w_k / |residual_k|. Samples that a
    majority contradicts end without a say. With five lights there is hardly a majority, and little is gained over least squares.

    reflectance: (K, H, W, 3) radiance over light intensity. lights: (K, 3) unit. mask: (H, W). weights: (K, H, W), not negative.
    Returns Normals; pixels whose weighted lights have a condition number above `recon.conditioning.MAX_CONDITION` are not measurable.
    Uncertainty: the covariance of least absolute deviations under the noise of the samples that agree
    (`recon.normals.compiled.robust_angles`); NaN with three samples. Raises InputError for lights in one plane and unusable input.
    Source: S. Ikehata, D. Wipf, Y. Matsushita and K. Aizawa, "Robust photometric stereo using sparse regression" (CVPR 2012), section
    3.1, the convex relaxation; the reweighting after P. Holland and R. Welsch (1977).
    """
    r = rows(reflectance, lights, mask, weights, "--normals l1")
    b = np.zeros((len(r.y), 3))
    in_parts(reweighted_l1, (r.y, r.w, r.usable, b), r.L, ROUNDS, TOLERANCE, SMALLEST)
    return r.normals(b, EFFICIENCY)
