"""Angles, heights and mean squared errors against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skimage.metrics import mean_squared_error

from gen.capture import Capture, Truth
from gen.errors import InputError
from recon.metrics import (
    angle_summary,
    angular_error,
    eroded,
    gap_closed,
    height_bytes,
    height_error,
    mse,
    normal_bytes,
    regions,
)


@pytest.mark.parametrize("degrees", [0.0, 1e-4, 0.5, 30.0, 90.0, 179.0])
def test_angle_between_rotated_normals(degrees: float) -> None:
    t = np.radians(degrees)
    a = np.zeros((2, 3, 3))
    b = np.zeros((2, 3, 3))
    a[..., 2] = 1
    b[..., 0], b[..., 2] = np.sin(t), np.cos(t)
    assert np.allclose(angular_error(a, b), degrees, rtol=1e-5, atol=1e-7)


def test_angle_is_unknown_where_a_normal_has_no_length() -> None:
    a = np.zeros((1, 2, 3), np.float32)
    a[0, 0, 2] = 1
    error = angular_error(a, a)
    assert error[0, 0] == 0
    assert np.isnan(error[0, 1])


def test_summary_shares() -> None:
    error = np.array([[0.5, 1.5, 3.0, np.nan]], np.float32)
    summary = angle_summary(error, np.ones((1, 4), bool))
    assert summary["mean"] == pytest.approx(5 / 3)
    assert summary["median"] == pytest.approx(1.5)
    assert summary["under 1"] == pytest.approx(100 / 3)
    assert summary["under 2"] == pytest.approx(200 / 3)
    assert summary["known"] == pytest.approx(75)


def test_erosion_takes_two_pixels_off_but_not_at_the_frame() -> None:
    mask = np.zeros((9, 9), bool)
    mask[0:7, 1:8] = True
    expected = np.zeros_like(mask)
    expected[0:5, 3:6] = True
    assert (eroded(mask, 2) == expected).all()


def test_region_lit_by_all_knows_attached_and_cast_shadows() -> None:
    normals = np.zeros((1, 3, 3), np.float32)
    normals[0, 0] = normals[0, 2] = [0, 0, 1]
    normals[0, 1] = [0.8, 0, 0.6]
    lights = np.array([[0, 0, 1], [-0.8, 0, 0.6], [0.6, 0, 0.8]])
    images = np.ones((3, 1, 3, 3), np.float32)
    capture = Capture(images, lights, np.ones((1, 3), bool), truth=Truth(normals=normals))
    assert regions(capture, normals)["lit by all"].tolist() == [[True, False, True]]
    cast = images.copy()
    cast[0, 0, 2] = 0
    assert regions(replace(capture, truth=Truth(matte=cast)), normals)["lit by all"].tolist() == [[True, False, False]]


def test_height_error_forgives_a_shift_and_only_where_asked_a_scale() -> None:
    z = np.random.default_rng(0).normal(size=(20, 20)).astype(np.float32)
    mask = np.ones_like(z, bool)
    assert height_error(z + 5, z, mask, scaled=False)["rmse"] < 1e-6
    assert height_error(3 * z + 5, z, mask, scaled=True)["rmse"] < 1e-6
    assert height_error(3 * z + 5, z, mask, scaled=True)["scale"] == pytest.approx(1 / 3)
    assert height_error(3 * z, z, mask, scaled=False)["rmse"] == pytest.approx(2 * z.std(), rel=1e-5)
    with pytest.raises(InputError, match="no pixel"):
        height_error(z, np.full_like(z, np.nan), mask, scaled=False)


def test_mse_is_scikit_images() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.integers(0, 256, (2, 12, 10, 3)).astype(np.uint8)
    assert mse(a, b) == pytest.approx(mean_squared_error(a, b))
    region = rng.random((12, 10)) < 0.5
    assert mse(a, b, region) == pytest.approx(((a[region].astype(float) - b[region]) ** 2).mean())


def test_eight_bit_forms() -> None:
    assert normal_bytes(np.array([-1.0, 0.0, 1.0], np.float32)).tolist() == [0, 128, 255]
    assert height_bytes(np.array([[0.0, 1.0, 0.5, 7.0, np.nan]], np.float32), 0, 1).tolist() == [[0, 255, 128, 255, 0]]


def test_gap_closed() -> None:
    assert gap_closed(15, 5, 1) == pytest.approx(10 / 14)
    assert gap_closed(15, 1, 1) == 1
    assert gap_closed(1.9, 1.5, 1) is None
