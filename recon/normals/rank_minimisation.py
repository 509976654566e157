"""Rank minimisation: the pictures of a matte surface span three dimensions; shadows are missing entries, the rest sparse errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.completion import complete
from recon.conditioning import leave_out
from recon.normals.least_squares import solve
from recon.normals.rows import rows
from recon.registry import Normals

SHADOW = 0.03
"""Samples under this share of their pixel's brightest are in shadow: missing entries."""

SPARSITY = 1.0
"""lambda of the paper times the square root of the number of pixels: its theory's value."""

ENOUGH = 15
"""Lights under which lambda grows in proportion: the theory takes rank three for far less than the number of pictures, and with five errors
would swallow the shading. Three times the theory's value at five lights is best of 1, 3, 6 and 10 on rendered
substrates; on DiLiGenT's cat 3, 6 and 10 differ little."""

EFFICIENCY = 2.5
"""Variance over that of least squares where the noise is Gaussian: 2 to 3 by simulation with 20 and 96 lights."""


def rank_minimisation(
    reflectance: NDArray[np.float32], lights: NDArray[np.float64], mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """Low-rank matrix completion and recovery over all pixels at once, then least squares on the matte part that it finds.

    The luma over each pixel's brightest sample is a matrix D of one row a light and one column a pixel; D = A + E on the entries that are
    lit, A of rank three, E sparse and of either sign, by minimising |A|_* + lambda |E|_1 (`complete`). Beyond the paper: the rank is held
    at three, the known directions' subspace pulls the one that the samples span, and lambda grows where lights are few. With three
    lights every matrix has rank three, and this is least squares.

    reflectance: (K, H, W, 3) radiance over light intensity. lights: (K, 3) unit. mask: (H, W). weights: (K, H, W), not negative; entries of
    weight 0 are missing too, and weights count in the last fit. Returns Normals; pixels whose weighted lights have a condition number
    above `recon.conditioning.MAX_CONDITION` are not measurable. Uncertainty: from the noise of the samples that agree
    (`recon.normals.compiled.robust_angles`). Raises InputError for lights in one plane and unusable input.
    Source: L. Wu, A. Ganesh, B. Shi, Y. Matsushita, Y. Wang and Y. Ma, "Robust photometric stereo via low-rank matrix completion and
    recovery" (ACCV 2010); the solver is the inexact augmented Lagrangian of Z. Lin, M. Chen and Y. Ma (2010).
    """
    r = rows(reflectance, lights, mask, weights, "--normals rank-minimisation")
    D = np.ascontiguousarray(r.y.T)
    w = leave_out(r.weights, D <= SHADOW, lights)
    known = (w > 0) & r.usable
    there = known.any(axis=1)  # a picture that is missing everywhere cannot be completed
    shading = D.copy()
    if there.sum() > 3:
        sparsity = SPARSITY * max(1.0, ENOUGH / int(there.sum()))
        shading[there] = complete(D[there], known[there], lights[there], sparsity, both_signs=True)
    b, _, measurable = solve(shading, lights, w)
    return r.normals(np.where(measurable[:, None], b, 0), EFFICIENCY, np.ascontiguousarray(w.T))
