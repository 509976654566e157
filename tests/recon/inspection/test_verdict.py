"""The decision rule, in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from gen.errors import InputError
from recon.inspection.deviation import Deviation
from recon.inspection.verdict import FAIL, PASS, UNDECIDED, pixel_codes, verdict


def found(features: np.ndarray, uncertainty: float = 0.01, judged: np.ndarray | None = None) -> Deviation:
    sigma = np.full(features.shape, uncertainty)
    there = np.isfinite(features) if judged is None else judged
    return Deviation(features, features, features, sigma, sigma, there, 5.0, 0.3, there.astype(np.int64), features, 1.0)


@pytest.mark.parametrize(
    ("value", "u", "code"),
    [
        (0.0, 0.01, PASS),
        (0.08, 0.01, PASS),
        (-0.08, 0.01, PASS),
        (0.0801, 0.01, UNDECIDED),
        (0.12, 0.01, UNDECIDED),
        (0.1201, 0.01, FAIL),
        (-0.1201, 0.01, FAIL),
        (0.0, 0.06, UNDECIDED),
        (0.1, 0.0, PASS),
        (0.1001, 0.0, FAIL),
        (0.0, np.nan, UNDECIDED),
        (9.0, np.nan, UNDECIDED),
        (np.nan, 0.01, np.nan),
    ],
)
def test_the_guard_band_narrows_a_pass_and_widens_a_fail(value: float, u: float, code: float) -> None:
    assert pixel_codes(np.array(value), np.array(u), 0.1, 2.0) == pytest.approx(code, nan_ok=True)


def test_a_part_fails_by_a_place_and_not_by_a_pixel() -> None:
    features = np.zeros((30, 30))
    features[4, 4] = 0.5
    assert verdict(found(features), 900, 0.1, 0.1).features == "pass"
    features[10:13, 10:13] = -0.2
    features[20:24, 20:24] = 0.3
    result = verdict(found(features), 900, 0.1, 0.1)
    assert result.features == "fail"
    assert [(p.pixels, p.deviation) for p in result.places] == [(16, 0.3), (9, -0.2)]
    assert result.places[0].area == pytest.approx(0.16)
    assert sum(result.shares.values()) == pytest.approx(1)
    assert result.provable == pytest.approx(0.02)


def test_what_cannot_be_decided() -> None:
    flat = np.zeros((30, 30))
    assert verdict(found(flat, 0.06), 900, 0.1, 0.1).features == "cannot be decided"
    assert "not known" in verdict(found(flat, np.nan), 900, 0.1, 0.1).reason
    assert "could be judged" in verdict(found(flat), 5000, 0.1, 0.1).reason
    assert verdict(found(flat, judged=np.zeros((30, 30), bool)), 900, 0.1, 0.1).features == "cannot be decided"
    near = flat.copy()
    near[5:10, 5:10] = 0.1
    assert verdict(found(near), 900, 0.1, 0.1).features == "cannot be decided"


@pytest.mark.parametrize(("tolerance", "guard"), [(0.0, 2), (-1.0, 2), (float("nan"), 2), (0.1, -1), (0.1, float("nan"))])
def test_impossible_limits_are_refused(tolerance: float, guard: float) -> None:
    with pytest.raises(InputError, match=r"--tolerance|--guard"):
        verdict(found(np.zeros((4, 4))), 16, 0.1, tolerance, guard)
