"""Radiance in 16 bits: within half a step, and 65535 means clipped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from gen.capture import Capture, Fault
from gen.convert.sixteen_bit import TOP, quantised, to_sixteen_bits, white_level
from gen.errors import InputError
from gen.images import srgb_to_linear


def of(images: np.ndarray, faults: np.ndarray | None = None) -> Capture:
    count, height, width, _ = images.shape
    return Capture(images=images, faults=faults, lights=np.tile((0, 0, 1.0), (count, 1)), mask=np.ones((height, width), bool))


@settings(max_examples=40, deadline=None)
@given(
    npst.arrays(np.float32, (2, 3, 4, 3), elements=st.floats(0, 1000, width=32)),
    npst.arrays(np.uint8, (2, 3, 4), elements=st.sampled_from([0, 0, int(Fault.CLIPPED), int(Fault.DARK)])),
)
def test_every_measured_sample_is_within_half_a_step_and_clipped_ones_stay_clipped(
    images: np.ndarray, faults: np.ndarray
) -> None:
    stored = to_sixteen_bits(of(images, faults), None)
    clipped = (faults & Fault.CLIPPED) > 0
    off = np.abs(stored.words.astype(np.float64) - images.astype(np.float64) / stored.white * TOP)
    assert (off[~clipped] <= 1.01).all()  # a step where the value is the white itself, which would read as clipped
    assert (off[~clipped & (images.max(axis=-1) < stored.white * (1 - 1 / TOP))] <= 0.51).all()
    np.testing.assert_array_equal((stored.words == TOP).any(axis=-1), clipped)
    assert images.max() <= stored.white
    assert images.max() == 0 or images.max() > stored.white / 2


@pytest.mark.parametrize(
    ("top", "white"), [(1.0, 1), (0.7, 1), (1.001, 2), (0.5, 0.5), (4, 4), (1e-30, 2.0**-99), (0, 1), (-3, 1)]
)
def test_white_is_the_least_power_of_two(top: float, white: float) -> None:
    assert white_level([np.full((2, 2), top), np.array([-1.0])]) == white


def test_numbers_of_16_and_8_bit_files_stay_exact() -> None:
    words = np.random.default_rng(0).integers(0, 20_000, (1, 40, 40, 3))
    stored = to_sixteen_bits(of((words / TOP).astype(np.float32)), None)
    assert stored.white == 0.5
    np.testing.assert_array_equal(stored.words, words * 2)
    eight = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
    assert len(set(quantised(eight, 1.0).tolist())) == 256


def test_what_16_bits_do_not_say_is_told(synthetic: Callable[..., Capture], faulty: Capture) -> None:
    assert to_sixteen_bits(synthetic(size=16, specular=np.full(3, 0.02), alpha=0.5), None).lost == ()
    told = "; ".join(to_sixteen_bits(faulty, 0.5).lost)
    for words in ("above --white", "below 0", "lost in the noise", "missing"):
        assert words in told
    assert "missing" not in "; ".join(to_sixteen_bits(faulty, 0.5, holes=True).lost)
    bright = faulty.images.copy()
    bright[0, 16, 16] = 4000
    assert "in more than 256 steps" in "; ".join(to_sixteen_bits(replace(faulty, images=bright), None).lost)


@pytest.mark.parametrize("white", [0, -1, np.nan, np.inf])
def test_a_white_that_is_none_is_refused(glossy: Capture, white: float) -> None:
    with pytest.raises(InputError, match=r"--white .*: must be a positive number"):
        to_sixteen_bits(glossy, white)
