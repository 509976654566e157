"""Sparse Bayesian learning: every sample has an error of its own variance, which the samples themselves teach."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.normals.compiled import in_parts, sparse_bayes
from recon.normals.least_squares import solve
from recon.normals.position_threshold import kept
from recon.normals.rows import Rows, rows
from recon.registry import Normals

NOISE = 1e-8
"""Variance of what is not an outlier, over the square of the pixel's brightest sample: next to nothing, as in the paper."""

MATTE_NOISE = 1e-3
"""The same for the thresholded form: real matte surfaces depart from Lambert's law by some 3 % of the brightest sample."""

PRIOR = 1e6
"""Variance of b's entries: none to speak of."""

ROUNDS = 500
TOLERANCE = 1e-5
"""Change of b, relative to its length, at which a pixel counts as solved."""

EFFICIENCY, MATTE_EFFICIENCY = 2.0, 1.25
"""Variance of the two forms over that of least squares on Gaussian noise, by simulation with 20 and 96 lights and noise of .3 and 3 % of
the brightest sample (the second form: 1.0 and 1.3)."""

FEW = 9
"""Samples kept in a pixel under which the thresholded form, whose noise then rules the fit, states the uncertainty of least squares."""


def sparse_bayesian(
    reflectance: NDArray[np.float32], lights: NDArray[np.float64], mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """Sparse Bayesian learning a pixel, on all samples: highlights and attached shadows alike are errors, few and of any size.

    r = L b + e + noise on luma, with e_k ~ N(0, gamma_k) and all gamma_k learned by expectation maximisation of the evidence: most go to
    0, and the samples whose gamma stays have no say. A weight divides the variances of its sample.

    reflectance: (K, H, W, 3) radiance over light intensity. lights: (K, 3) unit. mask: (H, W). weights: (K, H, W), not negative.
    Returns Normals; pixels whose weighted lights have a condition number above `recon.conditioning.MAX_CONDITION` are not measurable.
    Uncertainty: from the noise of the samples that agree (`recon.normals.compiled.robust_angles`), since the posterior takes it as known;
    NaN with three samples. Raises InputError for lights in one plane and unusable input.
    Source: S. Ikehata, D. Wipf, Y. Matsushita and K. Aizawa, "Robust photometric stereo using sparse regression" (CVPR 2012), section
    3.2.
    """
    r = rows(reflectance, lights, mask, weights, "--normals sparse-bayesian")
    return r.normals(learned(r, r.w, NOISE), EFFICIENCY)


def thresholded_sparse_bayesian(
    reflectance: NDArray[np.float32], lights: NDArray[np.float64], mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """Sparse Bayesian learning on the samples that position thresholding keeps, with noise that allows for a real matte surface.

    The rank of a sample tells shadows and highlights apart from the rest without a fit; what still disagrees is left to learning.
    Arguments, result and errors as for `sparse_bayesian`, and so is the uncertainty where at least `FEW` samples are kept, else that of
    least squares on them. The best of the classical solvers here where lights are many.
    Source: the two methods of `sparse_bayesian` and `recon.normals.position_threshold`; their combination is this project's own.
    """
    r = rows(reflectance, lights, mask, weights, "--normals thresholded-sparse-bayesian")
    w = kept(r)
    result = r.normals(learned(r, w, MATTE_NOISE), MATTE_EFFICIENCY, w)
    few = (w > 0).sum(axis=1) < FEW
    if few.any():
        uncertainty = result.uncertainty[mask]
        uncertainty[few] = solve(np.ascontiguousarray(r.y[few].T), lights, np.ascontiguousarray(w[few].T))[1]
        result.uncertainty[mask] = np.where(result.measurable[mask], uncertainty, np.nan)
    return result


def learned(r: Rows, w: NDArray[np.float32], noise: float) -> NDArray[np.float64]:
    """The posterior mean of b (P, 3), in the scale of r.y. w: (P, K). noise: variance."""
    b = np.zeros((len(r.y), 3))
    in_parts(sparse_bayes, (r.y, w, r.usable, b), r.L, noise, PRIOR, ROUNDS, TOLERANCE)
    return b
