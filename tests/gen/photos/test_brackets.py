"""Exposure brackets against known radiance, with a sensor's noise, clipping and rounding."""

from __future__ import annotations

import numpy as np
import pytest

from gen.capture import Fault
from gen.errors import InputError
from gen.photos.brackets import FULL_WELL, READ_NOISE, exposure_slope, merge, noise_variance, shift_between
from gen.srgb import linear_to_srgb, srgb_to_linear

TIMES = np.array([1.0, 4.0, 16.0])


def expose(radiance: np.ndarray, times: np.ndarray, seed: int = 0, bits: int = 14) -> tuple[np.ndarray, np.ndarray]:
    """(values (B, H, W, 3), faults (B, H, W)) of a sensor with shot and read noise."""
    rng = np.random.default_rng(seed)
    electrons = rng.poisson(radiance[None] * times[:, None, None, None] * FULL_WELL)
    values = electrons / FULL_WELL + rng.normal(0, READ_NOISE, electrons.shape)
    top = (1 << bits) - 1
    values = np.round(np.clip(values, 0, 1) * top) / top
    faults = np.where((values >= 1).any(-1), int(Fault.CLIPPED), 0) | np.where((values <= 0).all(-1), int(Fault.DARK), 0)
    return values.astype(np.float32), faults.astype(np.uint8)


def radiances() -> np.ndarray:
    """(64, 64, 3), four decades, up to twice what the shortest exposure holds."""
    ramp = np.geomspace(2e-4, 2, 64)
    return np.broadcast_to(ramp[None, :, None], (64, 64, 3)) * [1.0, 0.9, 0.8]


def test_radiance_is_recovered_over_four_decades_and_what_is_clipped_everywhere_is_said() -> None:
    true = radiances()
    found, faults = merge(*expose(true, TIMES), TIMES, bits=14)
    clipped = (faults & Fault.CLIPPED) > 0
    assert clipped[:, true[0, :, 0] > 1.1].all()
    assert not clipped[:, true[0, :, 0] < 0.9].any()
    lit = ~clipped
    bias = (found / true)[lit].reshape(-1, 3)
    assert abs(bias.mean() - 1) < 0.005
    bright = lit & (true[..., 0] > 0.005)
    assert np.abs((found / true)[bright] - 1).max() < 0.2
    assert np.sqrt((((found / true)[bright] - 1) ** 2).mean()) < 0.03
    np.testing.assert_allclose(found[clipped].min(), 0.8, rtol=0.15)  # a lower bound, from the shortest exposure


def test_the_weights_are_those_of_least_noise() -> None:
    """The spread over many draws is that of the best unbiased combination, 1 / sum(1 / variance), column by column."""
    true = np.full((60, 60, 3), 0.03)
    values, faults = expose(true, TIMES, bits=16)
    assert not faults.any()
    found, _ = merge(values, faults, TIMES)
    each = noise_variance(0.03 * TIMES, 16, "linear") / TIMES**2
    np.testing.assert_allclose(found.var(), 1 / (1 / each).sum(), rtol=0.05)
    assert found.var() < each.min()


def test_steps_of_srgb_are_the_derivative_of_its_curve() -> None:
    v, h = np.array([1e-3, 0.01, 0.2, 0.9]), 1e-6
    slope = (srgb_to_linear(linear_to_srgb(v) + h) - srgb_to_linear(linear_to_srgb(v) - h)) / (2 * h)
    rounding = noise_variance(v, 8, "srgb") - READ_NOISE**2 - v / FULL_WELL
    np.testing.assert_allclose(np.sqrt(12 * rounding) * 255, slope, rtol=1e-4)


def test_eight_bit_srgb_brackets() -> None:
    true = radiances()
    values, faults = expose(true, TIMES, bits=16)
    coded = srgb_to_linear(np.round(linear_to_srgb(values) * 255) / 255).astype(np.float32)
    found, flags = merge(coded, faults, TIMES, bits=8, encoding="srgb")
    good = (flags == 0) & (true[..., 0] > 0.01)
    assert np.sqrt((((found / true)[good] - 1) ** 2).mean()) < 0.03


def test_the_faults_of_a_merged_sample() -> None:
    values = np.array([0.2, 0.8, 1.0], np.float32)[:, None, None, None] * np.ones((3, 1, 5, 3), np.float32)
    values[:, 0, 1] = 1
    values[:, 0, 2] = 0
    values[0, 0, 4] = 0
    D, C, M = int(Fault.DARK), int(Fault.CLIPPED), int(Fault.MISSING)
    faults = np.array([[0, C, D, M, D], [0, C, D, M, 0], [C, C, D, M, 0]], np.uint8)[:, None]
    found, flags = merge(values, faults, TIMES)
    assert flags[0].tolist() == [0, C, D, M, 0]
    np.testing.assert_allclose(found[0, :3, 0], [0.2, 1, 0], atol=1e-6)
    assert 1.0 / 16 < found[0, 4, 0] < 0.2, "the dark first exposure has no say where a longer one is good"
    order = [2, 0, 1]
    again, marks = merge(values[order], faults[order], TIMES[order])
    np.testing.assert_array_equal(again, found)
    np.testing.assert_array_equal(marks, flags)


def test_the_slope_tells_linear_numbers_from_others() -> None:
    values, faults = expose(radiances(), TIMES)
    slope = exposure_slope(values, faults, TIMES)
    assert slope is not None
    assert abs(slope - 1) < 0.02
    bent = exposure_slope(values ** np.float32(1 / 2.2), faults, TIMES)
    assert bent is not None
    assert abs(bent - 1 / 2.2) < 0.02
    wrong = exposure_slope(values, faults, np.array([1.0, 2.0, 4.0]))
    assert wrong is not None
    assert abs(wrong - 2) < 0.05
    assert exposure_slope(np.zeros_like(values), faults, TIMES) is None


def test_a_shift_is_measured_to_a_fraction_of_a_pixel() -> None:
    from scipy.ndimage import gaussian_filter, shift

    texture = np.exp(gaussian_filter(np.random.default_rng(0).normal(0, 8, (120, 160)), 2.5))
    moved = shift(texture, (-1.5, 3.25), order=3, mode="nearest")
    np.testing.assert_allclose(shift_between(texture.astype(np.float32), moved.astype(np.float32)), (3.25, -1.5), atol=0.15)


@pytest.mark.parametrize(
    ("times", "says"),
    [([1, 2], "do not belong"), ([1, 0, 2], "positive"), ([1, np.nan, 2], "positive"), ([1, np.inf, 2], "positive")],
)
def test_impossible_brackets_are_refused(times: list[float], says: str) -> None:
    values, faults = expose(radiances(), TIMES)
    with pytest.raises(InputError, match=says):
        merge(values, faults, np.array(times))
