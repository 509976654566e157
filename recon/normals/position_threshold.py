"""Position thresholding: least squares on the samples between the darkest and the brightest of each pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.conditioning import condition_numbers
from recon.normals.compiled import between_ranks, in_parts
from recon.normals.least_squares import assemble, solve
from recon.normals.rows import Rows, rows
from recon.registry import Normals

DARKEST = 0.2
BRIGHTEST = 0.3
"""Shares of a pixel's samples that are left out at either end. Chosen on rendered substrates of four roughnesses under 10 to 96 lights
and on DiLiGenT's bear and cat, where .2 to .4 at the bright end differ little; the dark end is what attached shadows take under lights
up to 45 degrees from the view."""

KEPT_CONDITION = 8.0
"""Largest condition number of the lights of the samples that are kept: with few lights, leaving out must not cost more than it mends."""


def position_threshold(
    reflectance: NDArray[np.float32], lights: NDArray[np.float64], mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """Least squares without each pixel's darkest fifth (shadows) and brightest three tenths (highlights) of the samples.

    Where the lights of what remains have a condition number above `KEPT_CONDITION`, the darkest are taken back, since a shadow pulls
    less than a highlight; where that does not suffice, all samples are used.

    reflectance: (K, H, W, 3) radiance over light intensity. lights: (K, 3) unit. mask: (H, W). weights: (K, H, W), not negative; ranks
    are taken among samples of positive weight. Returns Normals; pixels whose weighted lights have a condition number above
    `recon.conditioning.MAX_CONDITION` are not measurable. Uncertainty: that of least squares on the samples kept; NaN with
    three. Raises InputError for lights in one plane and unusable input.
    Source: the baseline with position thresholds of B. Shi, Z. Mo, Z. Wu, D. Duan, S.-K. Yeung and P. Tan, "A benchmark dataset and
    evaluation for non-Lambertian and uncalibrated photometric stereo" (TPAMI 2019); taking samples back is this project's own.
    """
    r = rows(reflectance, lights, mask, weights, "--normals position-threshold")
    w = np.ascontiguousarray(kept(r).T)
    luma = np.ascontiguousarray(r.y.T)
    b, uncertainty, measurable = solve(luma, lights, w)
    return assemble(b * r.top[:, None], r.samples, lights, w, uncertainty, measurable & r.usable, mask)


def kept(r: Rows) -> NDArray[np.float32]:
    """The weights (P, K) of the samples that position thresholding keeps, the others 0; see `position_threshold`."""
    result = r.w.copy()
    waiting = np.flatnonzero(r.usable)
    for low, high in ((DARKEST, BRIGHTEST), (0.0, BRIGHTEST)):
        y, w = r.y[waiting], r.w[waiting]
        tried = np.zeros_like(w)
        in_parts(between_ranks, (y, w, tried), low, high)
        good = condition_numbers(r.lights, tried.T) <= KEPT_CONDITION if len(waiting) else np.zeros(0, bool)
        result[waiting[good]] = tried[good]
        waiting = waiting[~good]
    return result
