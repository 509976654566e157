"""Form and features: the filter by its definition, on closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from recon.inspection.waviness import PLAIN, SECOND_ORDER, Regression, mean_around, robust_regression, windows

Y, X = np.mgrid[:120, :150].astype(float)


def ragged() -> np.ndarray:
    inside = (X - 70) ** 2 / 65**2 + (Y - 60) ** 2 / 55**2 < 1
    inside[40:60, 60:75] = False
    return inside


def test_a_wave_of_the_cutoffs_length_is_halved() -> None:
    """Both filters, from their transfer functions: 1/2 at the cut-off, nearly all or none an octave and a half away."""
    middle = np.s_[55:65, 60:90]
    for length, least, most in ((24.0, 0.49, 0.51), (72.0, 0.9, 1.0), (8.0, -0.02, 0.02)):
        wave = np.cos(2 * np.pi * (X - 75) / length)
        for passed in (
            Regression(np.ones(X.shape), SECOND_ORDER * 24)(wave),
            mean_around(wave, np.ones(X.shape, bool), PLAIN * 24),
        ):
            share = (passed[middle] * wave[middle]).sum() / (wave[middle] ** 2).sum()
            assert least <= share <= most, (length, share)


def test_quadrics_are_form_up_to_the_rim() -> None:
    inside = ragged()
    z = 3 + 0.02 * X - 0.01 * Y + 1e-4 * (X - 50) ** 2 - 2e-4 * X * Y + 3e-4 * Y**2
    for weight in (inside.astype(float), inside * (1 + X / 150)):
        assert np.abs(Regression(weight, 7.0)(z) - z)[inside].max() < 1e-3 * np.ptp(z[inside])


def test_least_squares_by_hand() -> None:
    """One pixel of a noisy patch, weights and all, against a plain weighted fit."""
    rng = np.random.default_rng(0)
    z, weight = rng.normal(size=(40, 40)), rng.uniform(0.1, 1, (40, 40)) * (rng.uniform(size=(40, 40)) > 0.3)
    row, column, sigma = 3, 37, 5.0
    y, x = np.mgrid[:40, :40] - np.array([row, column]).reshape(2, 1, 1)
    w = np.sqrt(weight * np.exp(-(x**2 + y**2) / (2 * sigma**2)) * (abs(x) <= 20) * (abs(y) <= 20)).ravel()
    A = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1).reshape(-1, 6)
    expected = np.linalg.lstsq(A * w[:, None], z.ravel() * w, rcond=None)[0][0]
    assert Regression(weight, sigma)(z)[row, column] == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_a_dent_does_not_pull_the_form() -> None:
    inside = ragged()
    dent = -0.3 * np.exp(-((X - 60) ** 2 + (Y - 80) ** 2) / (2 * 4.0**2))
    z = np.where(inside, 2e-4 * (X - 75) ** 2 + dent + 0.002 * np.random.default_rng(1).normal(size=X.shape), 0)
    left = z - robust_regression(z, inside.astype(float), SECOND_ORDER * 40)(z)
    assert left[78:83, 58:63].min() == pytest.approx(-0.3, rel=0.04)
    far = inside & ((X - 60) ** 2 + (Y - 80) ** 2 > 16**2)
    assert np.abs(left[far]).max() < 0.012
    plain = z - Regression(inside.astype(float), SECOND_ORDER * 40)(z)
    assert np.abs(plain[far]).max() > 1.5 * np.abs(left[far]).max()


def test_windows_leave_crumbs_out() -> None:
    region = np.zeros((30, 30), np.int64)
    region[2:15, 3:20], region[20:24, 20:25], region[16:29, 1:12] = 1, 2, 3
    found = windows(region)
    assert [int(w.inside.sum()) for w in found] == [13 * 17, 13 * 11]
