"""The deviation of what was measured from the nominal, parted into form and features, each with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from recon.inspection.align import Alignment, normal_equations
from recon.inspection.measured import Measured
from recon.inspection.polish import along_view
from recon.inspection.registration import linearise, motion_rows, without_pistons
from recon.inspection.uncertainty import DRAWS, height_errors
from recon.inspection.view import Bools, Doubles
from recon.inspection.waviness import (
    PLAIN,
    SECOND_ORDER,
    SHORTEST_PIXELS,
    Regression,
    Window,
    mean_around,
    robust_regression,
    windows,
)
from recon.metrics import eroded

RIM_PIXELS = 2
"""Pixels along the edge of a region that are not judged: they see two surfaces at once."""

SERIES = (1.0, 2.0, 2.5, 5.0, 8.0)
"""Cut-offs within a decade, as ISO 25178-3 has them."""

SHARE_OF_SIDE = 0.25
"""The default cut-off, over the shorter side of what was measured: four waves of it fit, so that form can be told from them."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """Maps (H, W) in millimetres along the nominal's normal, positive where material is too much; NaN where there is nothing to compare.

    raw: as aligned. form: what is longer than the cut-off. features: what lies between the two cut-offs. judged: where features count.
    raw_uncertainty, uncertainty: one standard deviation of raw and of features, NaN where the normals' is unknown. cutoff, shortest: mm.
    region: (H, W). angle: (H, W) degrees between the measured normal and the nominal's, NaN outside.
    raised: by what factor the uncertainty of the features was raised, see `deviation`.
    """

    raw: Doubles
    form: Doubles
    features: Doubles
    raw_uncertainty: Doubles
    uncertainty: Doubles
    judged: Bools
    cutoff: float
    shortest: float
    region: NDArray[np.int64]
    angle: Doubles
    raised: float


def default_cutoff(measured: Measured, alignment: Alignment) -> float:
    """The largest cut-off of `SERIES`, in mm, that is at most `SHARE_OF_SIDE` of the shorter side of what was measured."""
    rows, columns = np.nonzero(alignment.region > 0)
    side = SHARE_OF_SIDE * min(np.ptp(rows) + 1, np.ptp(columns) + 1) * measured.view.step / alignment.pose.scale
    decade = 10.0 ** np.floor(np.log10(side))
    return float(decade * max(step for step in SERIES if step * decade <= side * (1 + 1e-9)))


def checked_cutoff(measured: Measured, alignment: Alignment, cutoff: float | None) -> float:
    """The cut-off in mm, by default `default_cutoff`. InputError where the pixels, or the size of what was measured, do not allow it."""
    chosen = default_cutoff(measured, alignment) if cutoff is None else cutoff
    pixel = measured.view.step / alignment.pose.scale
    low = 2 * SHORTEST_PIXELS * pixel
    high = max(np.ptp(v) + 1 for v in np.nonzero(alignment.region > 0)) * pixel
    if not low <= chosen <= high:
        raise InputError(
            f"--cutoff {chosen:g}: must be from {low:.3g} mm (six pixels) to {high:.3g} mm (the extent of what was measured)"
        )
    return chosen


def deviation(measured: Measured, alignment: Alignment, cutoff: float, draws: int = DRAWS, seed: int = 0) -> Deviation:
    """Compare an aligned measurement with the nominal.

    The difference is taken along the viewing ray, where the drift of the integrated height is smooth, and parted there by the robust
    second-order Gaussian regression with the cut-off (mm); then each part is turned into a distance along the
    nominal's normal. Every region (see `recon.inspection.regions`) is filtered by itself. The uncertainty is the spread of seeded errors of
    the normals (see `recon.inspection.uncertainty`) that go the same way: integrated, aligned, filtered. Where the
    normals miss the nominal's by more than their stated uncertainty explains (medians over the part, for the features without the form),
    it is raised by that ratio: the part may differ all over, but an uncertainty that the data contradict proves nothing.
    """
    pixel = measured.view.step / alignment.pose.scale
    nominal, region = alignment.nominal, alignment.region
    there = region > 0
    along = along_view(measured, alignment) / alignment.pose.scale
    found, sigma = windows(region), cutoff / pixel
    filters = []
    form, features = np.full(region.shape, np.nan), np.full(region.shape, np.nan)
    for window in found:
        weight = window.inside * nominal.cosine[window.box] ** 2
        heights = np.where(window.inside, along[window.box], 0)
        filters.append(robust_regression(heights, weight.astype(np.float64), SECOND_ORDER * sigma))
        wave, fine = _parted(heights, window, filters[-1])
        form[window.box][window.inside] = wave[window.inside]
        features[window.box][window.inside] = fine[window.inside]
    cosine = np.where(there, nominal.cosine, np.nan)
    judged = there & np.isfinite(features)
    for window in found:
        judged[window.box] &= ~window.inside | eroded(np.pad(window.inside, 1), RIM_PIXELS)[1:-1, 1:-1]
    raw_sigma, fine_sigma = _spread(measured, alignment, found, filters, sigma / 4, draws, seed)
    angle, fine_angle = _angles(measured, alignment, found, filters)
    stated = _median(measured.uncertainty[judged])
    raised = max(1.0, _median(fine_angle[judged]) / stated) if stated > 0 else 1.0
    raw_raised = max(1.0, _median(angle[judged]) / stated) if stated > 0 else 1.0
    return Deviation(
        raw=along * cosine,
        form=form * cosine,
        features=features * cosine,
        raw_uncertainty=raw_sigma * raw_raised,
        uncertainty=fine_sigma * raised,
        judged=judged,
        cutoff=cutoff,
        shortest=SHORTEST_PIXELS * pixel,
        region=region,
        angle=angle,
        raised=raised,
    )


def _angles(measured: Measured, alignment: Alignment, found: list[Window], filters: list[Regression]) -> tuple[Doubles, Doubles]:
    """(H, W) degrees between the measured normal and the nominal's: as it is, and without its form; NaN where nothing is compared."""
    there = alignment.region > 0
    apart = np.where(there[..., None], measured.normal - alignment.nominal.normal, 0)
    fine = np.full(there.shape, np.nan)
    for window, regression in zip(found, filters, strict=True):
        parts = [apart[window.box][..., k] for k in range(3)]
        left = np.linalg.norm(np.stack([part - regression(part) for part in parts]), axis=0)
        fine[window.box][window.inside] = left[window.inside]
    whole = np.where(there, np.linalg.norm(apart, axis=2), np.nan)
    plain, without = (np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1))) for chord in (whole, fine))
    return plain, without


def _median(values: Doubles) -> float:
    """The median of what is finite, NaN of nothing."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _parted(heights: Doubles, window: Window, regression: Regression) -> tuple[Doubles, Doubles]:
    """Waviness and the S-L surface of a window."""
    wave = regression(heights)
    return wave, mean_around(heights - wave, window.inside, PLAIN * SHORTEST_PIXELS)


def _spread(
    measured: Measured,
    alignment: Alignment,
    found: list[Window],
    filters: list[Regression],
    pooled: float,
    draws: int,
    seed: int,
) -> tuple[Doubles, Doubles]:
    """One standard deviation of raw and of features, mm, (H, W) each; over `pooled` pixels the variance is taken to be alike."""
    unknown = np.full(alignment.region.shape, np.nan)
    if not np.isfinite(measured.uncertainty).any():
        return unknown, unknown.copy()
    nominal, region, level = alignment.nominal, alignment.region, alignment.level
    there = region > 0
    system = linearise(level, alignment.surface, alignment.pose, alignment.free_scale, 3.0)
    H, _ = normal_equations(system, level)
    inverse = np.linalg.pinv(H, rcond=1e-6, hermitian=True)
    cosine, of = nominal.cosine[there], region[there]
    rows = without_pistons(motion_rows(nominal.points[there], nominal.normal[there], level, alignment.free_scale), cosine, of)
    used = system.used[there]
    spread = max(1.4826 * float(np.median(np.abs(system.surface_gap))), 1e-3 * level.view.step)
    raw, fine = np.zeros(region.shape), np.zeros(region.shape)
    for height in height_errors(measured, draws, seed):
        gap = without_pistons((height[there] * cosine)[:, None], cosine, of)[:, 0]
        # The pose follows the error as far as it can: what it takes up is no deviation.
        motion = inverse @ (rows[used].T @ gap[used]) / (int(used.sum()) * spread**2)
        raw[there] += (gap - rows @ motion) ** 2
        for window, regression in zip(found, filters, strict=True):
            features = _parted(np.where(window.inside, height[window.box], 0), window, regression)[1]
            fine[window.box] += np.where(window.inside, features * nominal.cosine[window.box], 0) ** 2
    result = []
    for total in (raw, fine):
        sigma = unknown.copy()
        for window in found:
            variance = mean_around(total[window.box] / draws, window.inside, pooled)
            sigma[window.box][window.inside] = np.sqrt(variance[window.inside]) / alignment.pose.scale
        result.append(sigma)
    return result[0], result[1]
