"""Uncertainty of heights from that of the normals, against the spectrum worked out on paper."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import trapezoid

from recon.inspection.measured import measured_from
from recon.inspection.uncertainty import height_errors, scale_free_noise
from recon.inspection.waviness import SECOND_ORDER, Regression


def test_every_octave_holds_the_same_share() -> None:
    rng = np.random.default_rng(0)
    power = np.zeros(4)
    for _ in range(12):
        field = scale_free_noise((128, 128), 128, rng)
        spectrum = np.abs(np.fft.fft2(field * np.outer(np.hanning(128), np.hanning(128)))) ** 2
        f = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.fftfreq(128))
        power += [spectrum[(f >= lo) & (f < 2 * lo)].sum() for lo in (1 / 32, 1 / 16, 1 / 8, 1 / 4)]
    assert power / power.mean() == pytest.approx(np.ones(4), abs=0.15)


def test_spread_on_a_plate_is_what_the_spectrum_gives() -> None:
    """A flat plate that faces the viewer: slopes of variance s^2 with a spectrum ~ 1/f^2 give heights with that over (2 pi f)^2, and the
    L-filter leaves (1 - H)^2 of it. With one degree, s = 1 deg / sqrt 2 for each axis."""
    size, step, cutoff = 128, 0.1, 20.0
    y, x = np.mgrid[:size, :size].astype(float)
    points = np.stack([(x - 63.5) * step, (63.5 - y) * step, 0 * x], -1) / 1000
    normal = np.zeros((size, size, 3))
    normal[..., 2] = 1
    measured = measured_from(points, normal, np.full((size, size), 1.0), "m")
    regression = Regression(np.ones((size, size)), SECOND_ORDER * cutoff)
    variance = np.zeros((size, size))
    for height in height_errors(measured, 8, seed=2):
        variance += (height - regression(height)) ** 2 / 8
    inner = np.sqrt(variance[24:-24, 24:-24].mean())

    f = np.exp(np.linspace(np.log(1 / size), np.log(0.5), 4000))
    t = (2 * np.pi * f * SECOND_ORDER * cutoff) ** 2 / 2
    kept = (1 - (1 + t) * np.exp(-t)) ** 2
    s = np.radians(1) / np.sqrt(2)
    share = 1 / np.log(f[-1] / f[0])
    expected = s * step * np.sqrt(trapezoid(share * kept / (2 * np.pi * f) ** 2, np.log(f)))
    assert inner == pytest.approx(expected, rel=0.2)
    assert inner < np.radians(1) * cutoff * step / (2 * np.pi)  # the bound by one wave of the cut-off's length


def test_spread_grows_with_the_angle_and_the_draws_repeat() -> None:
    y, x = np.mgrid[:40, :40].astype(float)
    points = np.stack([x - 19.5, 19.5 - y, 0 * x], -1)
    normal = np.zeros((40, 40, 3))
    normal[..., 2] = 1
    one, two, again = (
        np.stack(list(height_errors(measured_from(points, normal, np.full((40, 40), s), "px"), 3, seed=5)))
        for s in (0.5, 1.0, 0.5)
    )
    np.testing.assert_array_equal(one, again)
    assert two.std() / one.std() == pytest.approx(2, rel=0.01)
