"""The defects: samples where so much gloss lay that what is left under it is not to be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen import large
from gen.capture import Bools, Capture, Fault, Floats, grey
from gen.errors import InputError

FLOOR = 0.02
"""The least threshold that `auto` sets, in reflectance: below it there is practically no gloss."""

SEPARATION = 0.75
"""Share of the variance that the two classes must explain: that of a flat histogram, the most of any symmetric one with one peak."""

OUTLYING = 3.0
"""Robust standard deviations (1.4826 median absolute deviations) above the median; a cut beyond them splits off a tail, not half a bulk."""

MAJORITY = 0.5
"""Share of the object that the defects of one picture, dilated, may never exceed when the threshold is `auto`."""

FEWEST = 5
"""Fewer samples than this above the floor are noise, not a highlight, when the threshold is `auto`."""

AGREEMENT = 0.05
"""Residual of a pixel's Lambertian fit, relative to its albedo, up to which its samples agree when the threshold is `auto`. A perfectly
separated substrate diffuse layer, which is not Lambertian, leaves .03; gloss left behind leaves .08 and more."""

USUAL = 2.5
"""Times the lower quartile of that residual that still counts as agreement: two in three pixels of mere noise pass."""

BINS = 256

CHOICES = ("auto", "otsu")
"""The thresholds that are no number."""


@dataclass(frozen=True, eq=False)
class Defects:
    """mask: (K, H, W) bool. threshold: (K,) in reflectance luma, infinite where no sample counts as glossy.

    method: "auto", "otsu" or "manual".
    """

    mask: Bools
    threshold: NDArray[np.float64]
    method: str


def find_defects(
    specular: Floats,
    capture: Capture,
    threshold: float | str = "auto",
    dilate: int = 1,
    pictures: Floats | None = None,
    clipped_too: bool = True,
) -> Defects:
    """Samples whose estimated specular luma exceeds a threshold, and clipped ones, each picture's set dilated inside the mask.

    specular: (K, H, W, 3) radiance, as a gloss remover gives it; its unit here is specular radiance / light intensity, where 1 is a
    white Lambertian surface facing the light. threshold: that value, the same for all pictures; "otsu", Otsu's of each picture as it comes,
    which cuts whatever it is given in two; or "auto", which asks the capture whether there is anything to cut: `guarded_otsu`, each picture
    alone, raised until the dilated defects cover at most `MAJORITY` of the object (clipped samples count nevertheless).
    dilate: radius in pixels of the disk that the defects grow by, 0 for none; missing samples are never defects, they are missing.
    pictures: (K, H, W, 3) radiance, what the remover left: with "auto", only samples of `contradicted` pixels are defects.
    clipped_too: whether clipped samples are defects whatever lies on them.
    Raises InputError where shapes disagree, the threshold is not a positive number, or `dilate` is negative.
    Source: thresholding the estimated specular picture is the paper's; automatic choice after N. Otsu, "A threshold selection method
    from gray-level histograms" (1979).
    """
    if specular.shape != capture.images.shape:
        raise InputError(f"{capture.source}: the specular pictures are {specular.shape}, the capture's {capture.images.shape}")
    if dilate < 0:
        raise InputError(f"dilate must be 0 or more pixels, got {dilate}")
    require_threshold(threshold)
    luma = _luma(specular, capture)
    there = capture.mask & ((capture.faults & Fault.MISSING) == 0)
    clipped = ((capture.faults & Fault.CLIPPED) != 0) & there
    doubtful = there
    if threshold == "auto" and pictures is not None:
        doubtful = there & contradicted(pictures, capture)
    used = np.full(capture.count, np.inf)
    glossy = np.zeros(luma.shape, dtype=bool)
    for k in range(capture.count):
        values = luma[k][there[k] & ~clipped[k]]
        if threshold == "auto":
            used[k] = guarded_otsu(values)
            while (
                np.isfinite(used[k])
                and _grown(luma[k] > used[k], doubtful[k], there[k], dilate).sum() > MAJORITY * there[k].sum()
            ):
                used[k] *= 1.25
        else:
            used[k] = plain_otsu(values) if threshold == "otsu" else float(threshold)
        glossy[k] = (luma[k] > used[k]) & doubtful[k]
    if clipped_too:
        glossy |= clipped
    mask = np.stack([_grown(found, there[k], there[k], dilate) for k, found in enumerate(glossy)])
    return Defects(mask=mask, threshold=used, method=threshold if isinstance(threshold, str) else "manual")


def require_threshold(threshold: float | str) -> None:
    """InputError unless it is a positive number or one of `CHOICES`."""
    number = not isinstance(threshold, str) and np.isfinite(threshold) and threshold > 0
    if not number and threshold not in CHOICES:
        raise InputError(
            f"--threshold {threshold}: must be a positive number (1 is a white surface facing the light), {' or '.join(CHOICES)}"
        )


def contradicted(pictures: Floats, capture: Capture) -> Bools:
    """Pixels where the pictures without gloss contradict one matte surface, so that what lay under the gloss was not found.

    Where at least four lit samples are there and their lights are well-conditioned, the root mean square residual of the Lambertian fit to
    them, over the albedo, is compared with `AGREEMENT`, or with `USUAL` times its lower quartile over the object, whichever is larger:
    so noise, or a surface that is not quite Lambertian, does not pass for gloss left behind. A pixel with fewer samples contradicts
    nothing: in shadow, a repair loses more than it mends. Only where no pixel of the object can be judged, as under three lights, are all
    of them open to doubt.
    pictures: (K, H, W, 3) radiance. Returns (H, W) bool, false outside the mask.
    Source: the residual test is that of any overdetermined fit, used so by Coleman and Jain, "Obtaining 3-dimensional shape of textured
    and specular surfaces using four-source photometry" (1982).
    """
    from recon.conditioning import LIT
    from recon.normals.least_squares import CHUNK, solve

    y = _luma(pictures, capture)[:, capture.mask]
    usable = ((capture.faults & int(Fault.MISSING | Fault.CLIPPED)) == 0)[:, capture.mask]
    # Beside a highlight that was left behind everything looks dark: no sample counts as brighter than most pixels' brightest.
    brightest = (y * usable).max(axis=0)
    lit = y > LIT * np.minimum(brightest, np.median(brightest))
    weights = (usable & lit).astype(np.float32)
    b, _, measurable = solve(y, capture.lights, weights)
    spare = weights.sum(axis=0) - 3
    length = np.linalg.norm(b, axis=1)
    judged = measurable & (spare > 0) & (length > 0)
    if not judged.any():
        return capture.mask
    square = np.zeros(len(b), np.float32)
    for start in range(0, len(b), CHUNK):
        part = slice(start, start + CHUNK)
        square[part] = (weights[:, part] * (y[:, part] - (capture.lights @ b[part].T).astype(np.float32)) ** 2).sum(axis=0)
    residual = np.zeros(len(b))
    residual[judged] = np.sqrt(square[judged] / spare[judged]) / length[judged]
    usual = USUAL * float(np.percentile(residual[judged], 25))
    doubt = np.zeros(capture.mask.shape, dtype=bool)
    doubt[capture.mask] = residual > max(AGREEMENT, usual)
    return doubt


def plain_otsu(values: NDArray[np.floating[Any]]) -> float:
    """Otsu's threshold of the values (N,) as they are (skimage.filters.threshold_otsu), or infinity where all are alike."""
    from skimage.filters import threshold_otsu

    return float(threshold_otsu(values)) if values.size and np.ptp(values) > 0 else float("inf")


def guarded_otsu(values: NDArray[np.floating[Any]]) -> float:
    """Otsu's threshold on the square root of the values, or infinity where there is nothing to separate.

    values: (N,) specular luma in reflectance, not negative, of the whole object: the zeros of its matte parts belong to the histogram.
    The root keeps a narrow peak of many times white from hiding the rest. The threshold is believed only where at least `FEWEST`
    values exceed `FLOOR`, and either the two classes explain more than `SEPARATION` of the variance of the roots, which no flat
    histogram or single symmetric peak does, or the cut lies `OUTLYING` robust standard deviations above the median, beyond the bulk:
    so a veil over the whole object is not cut in half. Never below `FLOOR`.
    """
    if int((values > FLOOR).sum()) < FEWEST:
        return float("inf")
    roots = np.sqrt(np.maximum(values, 0).astype(np.float64))
    count, edges = np.histogram(roots, bins=BINS, range=(0.0, float(roots.max())))
    total = count.sum()
    centre = (edges[:-1] + edges[1:]) / 2
    below = np.cumsum(count)[:-1]
    above = total - below
    moment = np.cumsum(count * centre)
    overall = moment[-1] / total
    with np.errstate(divide="ignore", invalid="ignore"):
        between = np.where((below > 0) & (above > 0), (overall * below - moment[:-1]) ** 2 / (below * above), 0)
    variance = float((count * (centre - overall) ** 2).sum() / total)
    # Empty bins between two groups tie; the middle of the tie is the fairest cut.
    best = np.flatnonzero(between >= between.max() * (1 - 1e-9))
    cut = float(edges[1:-1][best].mean())
    middle = float(np.median(roots))
    bulk = middle + OUTLYING * 1.4826 * float(np.median(np.abs(roots - middle)))
    if variance > 0 and (between.max() > SEPARATION * variance or cut > bulk):
        return max(cut**2, FLOOR)
    return float("inf")


def _luma(pictures: Floats, capture: Capture) -> Floats:
    """(K, H, W) luma of pictures (K, H, W, 3) over the lights' intensities, worked out picture by picture."""
    luma = np.empty(pictures.shape[:3], np.float32)
    for k, picture in enumerate(pictures):
        luma[k] = grey(picture / capture.intensities[k].astype(np.float32))
        large.release(pictures)
    return luma


def _grown(found: Bools, among: Bools, there: Bools, dilate: int) -> Bools:
    return _dilated(found & among, dilate) & there


def _dilated(mask: Bools, radius: int) -> Bools:
    if radius == 0 or not mask.any():
        return mask
    import cv2

    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    grown: Bools = cv2.dilate(mask.astype(np.uint8), disk) > 0
    return grown
