"""Semi-calibrated photometric stereo: the lights' strengths are told from the pictures, and do not matter to the normals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gen.capture import Capture, read_capture
from gen.errors import InputError
from recon.metrics import angular_error
from recon.normals.least_squares import least_squares
from recon.normals.semi_calibrated import determinacy, light_gains, semi_calibrated

Synthetic = Callable[..., Capture]


def ones(capture: Capture) -> NDArray[np.float32]:
    return np.ones(capture.images.shape[:3], np.float32)


def dimmed(capture: Capture, gains: NDArray[np.float64]) -> NDArray[np.float32]:
    """The capture's pictures under lights that are stronger than stated by gains (K, 3)."""
    return capture.images * gains[:, None, None].astype(np.float32)


@pytest.mark.parametrize("seed", [0, 1])
def test_gains_of_the_pictures_leave_the_normals_alone(seed: int, synthetic: Synthetic) -> None:
    """Each lamp another strength and colour, a thirtyfold apart: the normals stay those of calibrated least squares."""
    capture = synthetic("sphere", 64, layer="matte")
    gains = np.random.default_rng(seed).uniform(0.1, 3, (5, 3))
    found = light_gains(dimmed(capture, gains), capture.lights, capture.mask, ones(capture))
    assert found == pytest.approx(gains / gains.mean(axis=0), rel=1e-5)
    result = semi_calibrated(dimmed(capture, gains), capture.lights, capture.mask, ones(capture))
    calibrated = least_squares(capture.images, capture.lights, capture.mask, ones(capture))
    assert np.nanmax(angular_error(result.normal, calibrated.normal)) < 0.01
    lit = capture.mask & (capture.truth.normals @ capture.lights.T > 0).all(axis=-1)
    assert np.nanmax(angular_error(result.normal, capture.truth.normals)[lit]) < 0.01
    # The stated intensities, which are wrong, would have cost this much.
    ignored = least_squares(dimmed(capture, gains), capture.lights, capture.mask, ones(capture))
    assert np.nanmean(angular_error(ignored.normal, capture.truth.normals)[lit]) > 5


def test_samples_without_weight_say_nothing(synthetic: Synthetic) -> None:
    """Spoiled samples of weight 0, a picture that is missing altogether, and highlights that nobody marked."""
    t, a = np.radians([20, 35, 50]), np.radians(np.arange(0, 360, 72))
    ring = np.stack([np.outer(np.sin(t), np.cos(a)), np.outer(np.sin(t), np.sin(a)), np.outer(np.cos(t), np.ones(5))], -1)
    capture = synthetic("sphere", 64, ring.reshape(-1, 3), layer="matte")
    gains = np.random.default_rng(2).uniform(0.3, 2, (15, 3))
    spoiled, weights = dimmed(capture, gains), ones(capture)
    spoiled[3], weights[3] = np.nan, 0
    spoiled[5, 20:40], weights[5, 20:40] = 7, 0
    spoiled[6, 30:36, 20:26] += 2
    found = light_gains(spoiled, capture.lights, capture.mask, weights)
    there = np.arange(15) != 3
    assert found[there] == pytest.approx(gains[there] / gains[there].mean(axis=0), rel=1e-3)
    assert (found[3] == 1).all()  # nothing is known of it


def test_the_surfaces_that_determine_strengths(synthetic: Synthetic) -> None:
    """The form of `determinacy` against the sum over pixels that it stands for, and the surfaces that are refused."""
    capture = synthetic("sphere", 32, layer="matte")
    b = capture.truth.normals[capture.mask].astype(np.float64)
    across = np.eye(5) - capture.lights @ np.linalg.pinv(capture.lights)
    samples = b @ capture.lights.T
    values = np.linalg.eigvalsh(sum(np.diag(m) @ across @ np.diag(m) for m in samples))
    assert determinacy(b, capture.lights) == pytest.approx(values[1] / values[-1], rel=1e-6)
    plate = Capture(
        images=np.repeat(capture.images[:, 16:17, 16:17], 40, 1).repeat(40, 2), lights=capture.lights, mask=np.ones((40, 40))
    )
    for flat in (plate, synthetic("cylinder", 48, layer="matte")):
        with pytest.raises(InputError, match=r"--normals semi-calibrated: .*; give them, and take another solver"):
            semi_calibrated(flat.images, flat.lights, flat.mask, ones(flat))


def test_what_cannot_be_told_is_refused_or_taken_as_stated(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 32, layer="matte").select([0, 1, 3])
    with pytest.raises(InputError, match="of 3 lights cannot be told"):
        light_gains(capture.images, capture.lights, capture.mask, ones(capture))
    same = semi_calibrated(capture.images, capture.lights, capture.mask, ones(capture)).normal
    assert (same == least_squares(capture.images, capture.lights, capture.mask, ones(capture)).normal).all()
    five = synthetic("sphere", 32, layer="matte")
    black = five.images.copy()
    black[2] = 0
    with pytest.raises(InputError, match="a picture is black"):
        semi_calibrated(black, five.lights, five.mask, ones(five))
    few = ones(five)
    few[2:] = 0
    with pytest.raises(InputError, match="give them, and take another solver"):
        semi_calibrated(five.images, five.lights, five.mask, few)


@pytest.mark.data
def test_a_real_object_whose_intensities_are_ignored(data_folder: Path) -> None:
    """DiLiGenT's cat, every sixth light: the lamps differ by a factor of two; normals are near those of calibrated least squares."""
    capture = read_capture(data_folder / "diligent" / "cat")
    capture = capture.select(range(0, capture.count, 6))
    found = light_gains(capture.images, capture.lights, capture.mask, ones(capture))
    ratio = found / capture.intensities
    assert (ratio.std(axis=0) / ratio.mean(axis=0)).max() < 0.06
    assert (capture.intensities.std(axis=0) / capture.intensities.mean(axis=0)).min() > 0.1
    solved = {
        "semi-calibrated": semi_calibrated(capture.images, capture.lights, capture.mask, ones(capture)),
        "calibrated": least_squares(capture.reflectance(), capture.lights, capture.mask, ones(capture)),
        "ignored": least_squares(capture.images, capture.lights, capture.mask, ones(capture)),
    }
    error = {name: np.nanmean(angular_error(n.normal, capture.truth.normals)[capture.mask]) for name, n in solved.items()}
    assert error["semi-calibrated"] < error["calibrated"] + 0.5
    assert error["ignored"] > error["calibrated"] + 3
