"""Conformity with a tolerance under uncertainty: pass, fail, or cannot be decided."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from recon.inspection.deviation import Deviation
from recon.inspection.view import Doubles

PASS, UNDECIDED, FAIL = 1.0, 0.0, -1.0
"""The codes of a verdict map; NaN where nothing was judged."""

GUARD = 2.0
"""Standard deviations of the guard band."""

LEAST_JUDGED = 0.5
"""Share of the nominal's visible pixels under which a part is not passed, whatever was seen of it."""


@dataclass(frozen=True)
class Place:
    """A connected group of pixels that fail. row, column: of the largest deviation. deviation, uncertainty: there, mm. area: mm^2 in the
    picture plane. pixels: how many."""

    row: int
    column: int
    deviation: float
    uncertainty: float
    area: float
    pixels: int


@dataclass(frozen=True, eq=False)
class Verdict:
    """features: "pass", "fail" or "cannot be decided"; of the form nothing is ever said. reason: why, in a sentence. codes: (H, W).
    places: the failing ones, largest deviation first. shares: of the judged pixels, by word. judged: share of the visible pixels.
    tolerance: mm. guard: in standard deviations. provable: mm, the tolerance that the median pixel's guard band alone would fill.
    """

    features: str
    reason: str
    codes: Doubles
    places: tuple[Place, ...]
    shares: dict[str, float]
    judged: float
    tolerance: float
    guard: float
    provable: float


def pixel_codes(value: Doubles, uncertainty: Doubles, tolerance: float, guard: float = GUARD) -> Doubles:
    """`PASS`, `FAIL` or `UNDECIDED` of deviations against +-tolerance, shapes alike. NaN in value stays NaN, an unknown uncertainty decides
    nothing.

    The guard band g = guard * u narrows the tolerance for a pass and widens it for a fail; between the two neither is proven.
    Source: ISO 14253-1:2017.
    """
    size, band = np.abs(value), guard * uncertainty
    with np.errstate(invalid="ignore"):
        codes = np.where(size + band <= tolerance, PASS, np.where(size - band > tolerance, FAIL, UNDECIDED))
    return np.where(np.isfinite(value), codes, np.nan)


def verdict(found: Deviation, visible: int, pixel: float, tolerance: float, guard: float = GUARD) -> Verdict:
    """The verdict on the features of a part.

    It fails where a connected group of failing pixels, and passes only where no such group of undecided ones, is as large as the square
    of the shortest wavelength judged: a single pixel is no feature. visible: pixels of the nominal in view. pixel: its length, mm.
    Raises InputError for a tolerance or guard that is none.
    """
    require_tolerance(tolerance, guard)
    value = np.where(found.judged, found.features, np.nan)
    codes = pixel_codes(value, found.uncertainty, tolerance, guard)
    judged = np.isfinite(codes)
    least = max(1, round((found.shortest / pixel) ** 2))
    places = [_place(group, found, pixel) for group in _groups(codes == FAIL, least)]
    open_ = _groups(codes == UNDECIDED, least)
    share = float(judged.sum() / max(visible, 1))
    count = max(int(judged.sum()), 1)
    shares = {
        name: float((codes == code).sum() / count)
        for name, code in (("pass", PASS), ("cannot be decided", UNDECIDED), ("fail", FAIL))
    }
    places.sort(key=lambda place: -abs(place.deviation))
    sigma = found.uncertainty[judged]
    provable = guard * float(np.median(sigma)) if np.isfinite(sigma).all() and sigma.size else float("nan")
    if not judged.any():
        word, reason = "cannot be decided", "not one pixel could be judged"
    elif places:
        p = places[0]
        what = "place is" if len(places) == 1 else "places are"
        word, reason = (
            "fail",
            f"{len(places)} {what} out of tolerance beyond doubt, the worst by {abs(p.deviation) - tolerance:.3g} mm",
        )
    elif not np.isfinite(sigma).any():
        word, reason = "cannot be decided", "the uncertainty of the normals is not known; state it with --uncertainty"
    elif open_:
        area = sum(len(group) for group in open_) * pixel**2
        word, reason = "cannot be decided", f"on {area:.3g} mm² the deviation is nearer to the limit than the guard band"
    elif share < LEAST_JUDGED:
        word, reason = "cannot be decided", f"only {100 * share:.0f} % of what is in view could be judged"
    else:
        word, reason = "pass", "all that was judged lies within the tolerance less its guard band"
    return Verdict(word, reason, codes, tuple(places), shares, share, tolerance, guard, provable)


def require_tolerance(tolerance: float, guard: float) -> None:
    """InputError for a tolerance or a guard that is none."""
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise InputError(f"--tolerance {tolerance:g}: must be a positive number of millimetres")
    if not 0 <= guard <= 10:
        raise InputError(f"--guard {guard:g}: must be from 0 to 10 standard deviations")


def _groups(where: NDArray[np.bool_], least: int) -> list[NDArray[np.intp]]:
    """The connected groups of at least `least` pixels, each (N, 2) rows and columns."""
    from scipy.ndimage import find_objects, label

    numbers, _ = label(where)
    found = []
    for number, box in enumerate(find_objects(numbers), 1):
        group = np.argwhere(numbers[box] == number)
        if len(group) >= least:
            found.append(group + np.array([box[0].start, box[1].start]))
    return found


def _place(group: NDArray[np.intp], found: Deviation, pixel: float) -> Place:
    rows, columns = group.T
    worst = int(np.argmax(np.abs(found.features[rows, columns])))
    row, column = int(rows[worst]), int(columns[worst])
    return Place(
        row, column, float(found.features[row, column]), float(found.uncertainty[row, column]), len(group) * pixel**2, len(group)
    )
