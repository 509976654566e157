"""Semi-calibrated photometric stereo: the lights' directions are known, their strengths are not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.capture import grey
from gen.errors import InputError
from gen.photos.intensities import estimate_intensities
from recon.conditioning import require_spanning_lights
from recon.normals.least_squares import least_squares, solve
from recon.registry import Normals

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

OPTION = "--normals semi-calibrated"

WORK = 1 << 23
"""Pixels times squared number of lights that the strengths are estimated from: their cost, in time and memory."""

COUNTS = 0.5
"""Share of its pixel's largest weight from which a sample says something of the strengths."""

DETERMINED = 1e-4
"""`determinacy` from which strengths are told from pictures. Five lights at 35 degrees have 0.1 over a sphere, 8e-4 over a relief whose
slopes stay under 6 degrees, 9e-5 under 2 degrees, and 0 over a plane or, along or across two of the lights, a cylinder."""


def semi_calibrated(reflectance: Floats, lights: Doubles, mask: Bools, weights: Floats) -> Normals:
    """Least squares under lights of unknown strength: each picture's factor is estimated first, then divided out.

    The factors are those of `light_gains`; what the stated intensities are off by does not matter. What comes before the solver, such
    as the removal of gloss, still takes the stated ones. With three lights every choice of factors explains the pictures: then the
    stated intensities hold, and this is least squares.

    reflectance: (K, H, W, 3) radiance over stated light intensity. lights: (K, 3) unit. mask: (H, W). weights: (K, H, W), not negative.
    Returns Normals as `least_squares` does; the albedo is relative to the mean light. Raises InputError as `light_gains` does.
    Source: D. Cho, Y. Matsushita, Y.-W. Tai and I. S. Kweon, "Semi-calibrated photometric stereo" (TPAMI 2020), the linear joint
    estimation of section 3 with outliers left out.
    """
    require_spanning_lights(lights, OPTION)
    gains = light_gains(reflectance, lights, mask, weights) if len(lights) > 3 else np.ones((len(lights), 3))
    return least_squares(reflectance / gains[:, None, None].astype(np.float32), lights, mask, weights)


def light_gains(reflectance: Floats, lights: Doubles, mask: Bools, weights: Floats) -> Doubles:
    """What each picture's light is stronger than stated, (K, 3), mean 1 in each channel: only ratios can be told from pictures.

    Estimated on up to some thousand pixels by `gen.photos.intensities.estimate_intensities`: the part of the samples that no surface
    explains is linear in the inverse strengths. Shadows, outliers and samples under half of their pixel's largest weight are left out.
    A picture without a sample of weight gets 1. Arguments as for `semi_calibrated`, with four lights or more.
    Raises InputError for fewer, where too few pixels are lit by four well-spread lights, or where the surface has too few directions
    for the strengths to show (over a plane, any would do).
    """
    require_spanning_lights(lights, OPTION)
    if len(lights) < 4:
        raise InputError(f"{OPTION}: the strengths of {len(lights)} lights cannot be told from pictures; four lights are needed")
    counts = (weights > 0) & (weights >= COUNTS * weights.max(axis=0)) & mask
    there = np.flatnonzero(counts.any(axis=(1, 2)))
    some = _thinned(mask, WORK // len(there) ** 2)
    pictures = np.where(counts[there, ..., None], reflectance[there], np.float32(0))
    # Pictures of like brightness first: whether a sample is lit is told by its pixel's brightest, whatever the lights' strengths.
    level = grey(pictures)[:, mask].sum(axis=1, dtype=np.float64) / counts[there][:, mask].sum(axis=1)
    if not (level > 0).all():
        raise InputError(f"{OPTION}: a picture is black inside the mask, so its light's strength cannot be told; leave it out")
    pictures /= level[:, None, None, None].astype(np.float32)
    faults = (~counts[there]).astype(np.uint8)
    try:
        with np.errstate(divide="ignore", invalid="ignore"):  # over a plane nothing is left to divide by; that is refused below
            found, _ = estimate_intensities(pictures, lights[there], some, faults, OPTION)
    except InputError as error:
        raise InputError(f"{str(error).split(';')[0]}; give them, and take another solver") from None
    finite = np.where(np.isfinite(found), found, 1)
    y = grey(pictures[:, some] / finite[:, None].astype(np.float32))
    b, _, measurable = solve(y, lights[there], counts[there][:, some].astype(np.float32))
    if determinacy(b[measurable], lights[there]) < DETERMINED:
        raise InputError(
            f"{OPTION}: the surface faces too few ways for the lights' strengths to show; give them, and take another solver"
        )
    gains = np.ones((len(lights), 3))
    gains[there] = finite * level[:, None]
    gains[there] /= gains[there].mean(axis=0)
    return gains


def determinacy(b: Doubles, lights: Doubles) -> float:
    """How well surface vectors b = albedo * normal (P, 3) determine the strengths of lights (K, 3): 0 is not at all.

    With I - L L^+ the part of K samples that no surface explains, inverse strengths f leave sum_p |(I - L L^+) diag(L b_p) f|^2, whose
    matrix is (L M L^T) o (I - L L^+) with M = sum_p b_p b_p^T. Equal factors leave nothing; this is the second smallest eigenvalue over
    the largest.
    """
    form = (lights @ (b.T @ b) @ lights.T) * (np.eye(len(lights)) - lights @ np.linalg.pinv(lights))
    values = np.linalg.eigvalsh(form)
    return float(values[1] / values[-1]) if values[-1] > 0 else 0.0


def _thinned(mask: Bools, most: int) -> Bools:
    """The mask with about `most` of its pixels at most, evenly through its rows."""
    chosen = np.flatnonzero(mask)
    result = np.zeros(mask.size, bool)
    result[chosen[:: max(1, -(-len(chosen) // max(most, 1)))]] = True
    return result.reshape(mask.shape)
