"""Exposure brackets: several exposures of one picture merged to linear radiance, each sample by how well it is known."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Bools, Fault, Floats
from gen.errors import InputError

READ_NOISE = 1e-3
"""Standard deviation of the read noise in units of full scale: 12 electrons of 12,000, an ordinary sensor. Only its ratio to the shot
noise counts here, and that only shifts weight between exposures."""

FULL_WELL = 12_000.0
"""Electrons at full scale; shot noise has the variance value / FULL_WELL."""

STEPS = 8192
"""Values in [0, 1] for which the variance is worked out once."""

PIECE = 1 << 18
"""Pixels that are merged at a time: under 200 MB for ten exposures."""

CENTRE = 1024
"""Side of the middle of a picture in which a shift is looked for: the camera moves as a whole."""

ROUNDS = 2
"""Times that the weights are worked out again from the merged value."""


def noise_variance(values: NDArray[np.floating[Any]], bits: int, encoding: str) -> NDArray[np.floating[Any]]:
    """Variance of a linear sensor value in [0, 1]: read noise, shot noise, and the file's rounding.

    bits: of a sample in the file (32: no rounding). encoding: "srgb", or anything else for evenly spaced numbers; the steps of sRGB
    widen with the value. Source: S. Hasinoff, F. Durand, W. Freeman, "Noise-optimal capture for high dynamic range photography",
    CVPR 2010.
    """
    v = np.maximum(values, 0)
    step = 0.0 if bits >= 32 else 1 / ((1 << bits) - 1)
    slope = (
        np.where(v <= 0.0031308, 1 / 12.92, 2.4 / 1.055 * np.maximum(v, 0.0031308) ** (1 - 1 / 2.4))
        if encoding == "srgb"
        else 1.0
    )
    variance: NDArray[np.floating[Any]] = READ_NOISE**2 + v / FULL_WELL + (step * slope) ** 2 / 12
    return variance


def merge(
    values: Floats, faults: NDArray[np.uint8], exposures: NDArray[np.float64], bits: int = 16, encoding: str = "linear"
) -> tuple[Floats, NDArray[np.uint8]]:
    """Radiance from B exposures of the same light: the weighted mean of value / exposure.

    The weight of a sample is the inverse of its variance, exposure^2 / noise_variance(value); the value that the variance is asked for is
    the one that the merged radiance predicts, in a few rounds, because a sample's own noise would bias its weight. Clipped and missing
    samples weigh nothing, dark ones only where no longer exposure is at hand.

    values: (B, H, W, 3) linear in [0, 1], the black level subtracted. faults: (B, H, W) of `Fault`. exposures: (B,) in one unit.
    Returns radiance (H, W, 3) float32 per unit of exposure, and faults (H, W): CLIPPED where every exposure is clipped (the
    radiance is then a lower bound, from the shortest), DARK where the longest unclipped one is dark, MISSING where none holds a value.
    Raises InputError where shapes disagree or an exposure is not positive.
    Source: P. Debevec, J. Malik, "Recovering high dynamic range radiance maps from photographs", SIGGRAPH 1997 (the weighted mean);
    M. Granados et al., "Optimal HDR reconstruction with linear digital cameras", CVPR 2010 (weights of the predicted value).
    """
    t = np.asarray(exposures, dtype=np.float64)
    if values.ndim != 4 or t.shape != values.shape[:1] or faults.shape != values.shape[:3]:
        raise InputError(
            f"exposure bracket: {values.shape} values, {faults.shape} faults and {t.shape} exposures do not belong together"
        )
    if not np.isfinite(t).all() or (t <= 0).any():
        raise InputError("exposure bracket: exposures must be positive numbers")
    order = np.argsort(t)
    values, faults, t = values[order], faults[order], t[order]
    radiance = np.empty(values.shape[1:], np.float32)
    flags = np.empty(faults.shape[1:], np.uint8)
    step = max(1, PIECE // faults.shape[2])
    for start in range(0, len(flags), step):
        rows = slice(start, start + step)
        radiance[rows], flags[rows] = _merged(values[:, rows], faults[:, rows], t, bits, encoding)
    return radiance, flags


def _merged(
    values: Floats, faults: NDArray[np.uint8], t: NDArray[np.float64], bits: int, encoding: str
) -> tuple[NDArray[Any], NDArray[np.uint8]]:
    """`merge` of some rows, exposures in rising order."""
    times = t.astype(np.float32).reshape(len(t), 1, 1, 1)
    inverse = (1 / noise_variance(np.linspace(0, 1, STEPS), bits, encoding)).astype(np.float32)
    missing, clipped, dark = ((faults & flag) > 0 for flag in (Fault.MISSING, Fault.CLIPPED, Fault.DARK))
    usable = ~(missing | clipped)
    # Where something longer is usable, a dark sample says nothing that it does not say better.
    later = np.zeros_like(usable)
    later[:-1] = np.logical_or.accumulate(usable[:0:-1], axis=0)[::-1]
    used = usable & ~(dark & later)
    rate = values / times
    merged = _weighted(rate, used, times**2 * _looked_up(inverse, values))
    for _ in range(ROUNDS):
        merged = _weighted(rate, used, times**2 * _looked_up(inverse, merged[None] * times))
    flags, merged = _flags(rate, missing, clipped, dark, usable, merged)
    return merged, flags


def _looked_up(table: Floats, values: Floats) -> Floats:
    """The entries of a table over [0, 1] at values, which a weight may be off from by half a step."""
    return np.take(table, (np.clip(values, 0, 1) * np.float32(len(table) - 1)).astype(np.int32))


def _weighted(rate: NDArray[Any], used: Bools, weights: NDArray[Any]) -> NDArray[Any]:
    w = weights * used[..., None]
    total = w.sum(axis=0)
    mean: NDArray[Any] = (w * rate).sum(axis=0) / np.where(total > 0, total, 1)
    return mean


def _flags(
    rate: NDArray[Any], missing: Bools, clipped: Bools, dark: Bools, usable: Bools, merged: NDArray[Any]
) -> tuple[NDArray[np.uint8], NDArray[Any]]:
    """(faults (H, W), the radiance with a lower bound where all is clipped). Exposures in rising order."""
    some = usable.any(axis=0)
    lost = ~some & clipped.any(axis=0)
    flags = np.zeros(some.shape, np.uint8)
    flags[lost] = np.uint8(Fault.CLIPPED)
    flags[~some & ~lost] = np.uint8(Fault.MISSING)
    longest = len(usable) - 1 - np.argmax(usable[::-1], axis=0)
    flags[some & np.take_along_axis(dark, longest[None], axis=0)[0]] |= np.uint8(Fault.DARK)
    first = np.argmax(clipped, axis=0)
    bound = np.take_along_axis(rate, first[None, ..., None], axis=0)[0]
    return flags, np.where(lost[..., None], bound, merged)


def exposure_slope(values: Floats, faults: NDArray[np.uint8], exposures: NDArray[np.float64]) -> float | None:
    """d log(value) / d log(exposure) between exposures: 1 where values are linear and the exposures are as stated; None if not seen.

    values: (B, H, W, 3) as `merge` takes them. A gamma of 2.2 that was taken for linear shows as 1 / 2.2. The median over samples that are
    well exposed (0.02 to 0.9) in two neighbouring exposures.
    """
    order = np.argsort(exposures)
    y, t = values[order].mean(axis=-1), np.asarray(exposures)[order]
    good = (faults[order] == 0) & (y > 0.02) & (y < 0.9)
    slopes = [
        np.log(y[i + 1][both] / y[i][both]) / np.log(t[i + 1] / t[i])
        for i in range(len(t) - 1)
        if (both := good[i] & good[i + 1]).sum() >= 50 and t[i + 1] > 1.05 * t[i]
    ]
    return float(np.median(np.concatenate(slopes))) if slopes else None


def shift_between(first: Floats, second: Floats) -> tuple[float, float]:
    """How far (x, y in pixels, to a tenth) the second picture (H, W) is moved against the first: the peak of their correlation.

    The logarithms are correlated, so that one exposure is like another, under a Hann window. Source: M. Guizar-Sicairos, S. Thurman,
    J. Fienup, "Efficient subpixel image registration algorithms", Optics Letters 33(2), 2008, as scikit-image has it.
    """
    from skimage.registration import phase_cross_correlation

    top, left = (max(0, (side - CENTRE) // 2) for side in first.shape)
    first, second = (picture[top : top + CENTRE, left : left + CENTRE] for picture in (first, second))
    window = np.outer(np.hanning(first.shape[0]), np.hanning(first.shape[1]))
    logs = [np.log(np.maximum(picture, 1e-3)).astype(np.float64) for picture in (first, second)]
    one, two = ((part - part.mean()) * window for part in logs)
    if not one.any() or not two.any():
        return 0.0, 0.0
    (down, right), *_ = phase_cross_correlation(one, two, upsample_factor=10, normalization=None)
    return -float(right), -float(down)
