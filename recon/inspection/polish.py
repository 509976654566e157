"""The pose once more, within the wavelengths that are measured: drift of the form must not misplace the edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.inspection.align import OUTLINE_PIXELS, Alignment, aligned_at, moved, normal_equations
from recon.inspection.measured import Measured
from recon.inspection.registration import TRIMMED, System, linearise, motion_rows
from recon.inspection.view import Doubles
from recon.inspection.waviness import SECOND_ORDER, robust_regression, windows

ROUNDS = 3

HEIGHTS = 0.01
"""What the unfiltered heights still count: they hold what nothing else determines, such as the tilt of a flat plate."""

WORSE = 1.2
"""Times by which the outlines may miss by more than before; under half a pixel it is not asked."""


def along_view(measured: Measured, alignment: Alignment) -> Doubles:
    """(H, W) by how much the measurement lies nearer to the viewer than the nominal, along the ray, in the measurement's unit; each region
    but the largest at median zero, since the height of a hidden step is not measured. Zero outside."""
    nominal, region = alignment.nominal, alignment.region
    there = region > 0
    along = np.einsum("hwk,hwk->hw", np.where(there[..., None], measured.points - nominal.points, 0), nominal.toward)
    for number in np.unique(region[region > 1]):
        inside = region == number
        along[inside] -= np.median(along[inside])
    return np.where(there, along, 0)


def polished(measured: Measured, alignment: Alignment, cutoff: float) -> Alignment:
    """The alignment that makes the features least, not the raw heights. cutoff: pixels.

    Residuals and their derivatives go through the L-filter of `recon.inspection.waviness` before the least squares, the outlines stay as
    they are. A slow drift thus moves nothing; a motion that changes slow form alone is left as it was found, and so is the size. A step
    that leaves the outlines behind is not taken: then something else than the pose is wrong.
    """
    for _ in range(ROUNDS):
        level = alignment.level
        plain = linearise(level, alignment.surface, alignment.pose, False, 3.0)
        sharp = _filtered(measured, alignment, plain, cutoff)
        if len(sharp.surface_gap) < 100:
            return alignment
        H, g = normal_equations(sharp, level)
        more, pull = normal_equations(replace(plain, edge=plain.edge[:0], edge_gap=plain.edge_gap[:0]), level)
        pose, length = moved(alignment.pose, H + HEIGHTS * more, g + HEIGHTS * pull, level)
        found = aligned_at(measured, alignment.surface, level, pose, alignment.free_scale)
        if not found.outline <= max(WORSE * alignment.outline, OUTLINE_PIXELS[1]):
            return alignment
        alignment = replace(found, free=alignment.free, alternatives=alignment.alternatives)
        if length < 0.01:
            break
    return alignment


def _filtered(measured: Measured, alignment: Alignment, plain: System, cutoff: float) -> System:
    """The system with its heights, and what motions do to them, without their form."""
    nominal, level = alignment.nominal, alignment.level
    along = along_view(measured, alignment)
    rows, gaps = [], []
    for window in windows(alignment.region):
        cosine = nominal.cosine[window.box]
        heights = np.where(window.inside, along[window.box], 0)
        regression = robust_regression(heights, window.inside * cosine**2, SECOND_ORDER * cutoff)
        motion = motion_rows(nominal.points[window.box][window.inside], nominal.normal[window.box][window.inside], level, False)
        columns: list[Doubles] = []
        for values in (*motion.T, heights[window.inside]):
            rise = np.zeros(heights.shape)
            rise[window.inside] = values
            if len(columns) < motion.shape[1]:  # derivatives are along the normal
                rise = rise / np.where(window.inside, cosine, 1)
            columns.append(((rise - regression(rise)) * cosine)[window.inside])
        rows.append(np.stack(columns[:-1], axis=1))
        gaps.append(columns[-1])
    if not rows:
        return replace(plain, surface=plain.surface[:0], surface_gap=plain.surface_gap[:0])
    every, gap = np.concatenate(rows), np.concatenate(gaps)
    kept = np.abs(gap) <= np.quantile(np.abs(gap), TRIMMED)
    return replace(plain, surface=every[kept], surface_gap=gap[kept])
