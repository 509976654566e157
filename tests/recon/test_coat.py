"""Least squares under a coat, against closed forms of the substrate's diffuse layer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gen.capture import Capture
from gen.errors import InputError
from gen.substrate import substrate_diffuse
from recon.metrics import angular_error
from recon.normals.coat import coat, dimming
from recon.normals.least_squares import least_squares
from recon.registry import Normals

Synthetic = Callable[..., Capture]


def solved(capture: Capture, weights: np.ndarray | None = None) -> Normals:
    w = np.ones(capture.images.shape[:3], np.float32) if weights is None else weights
    return coat(capture.reflectance(), capture.lights, capture.mask, w)


def lit_by_all(capture: Capture, least: float = 0.1) -> np.ndarray:
    assert capture.truth.normals is not None
    result: np.ndarray = capture.mask & (capture.truth.normals @ capture.lights.T > least).all(-1)
    return result


def test_the_factor_is_the_reference_layers() -> None:
    rng = np.random.default_rng(0)
    mi, mo = rng.uniform(0.05, 1, (2, 50))
    layer = substrate_diffuse(mi, mo, 0.7, 0.2)
    assert np.allclose(layer, 0.7 * 0.8 * mi * dimming(mi, mo), rtol=1e-12)


@pytest.mark.parametrize("shape", ["cylinder", "sphere"])
def test_the_dimming_is_undone(shape: str, synthetic: Synthetic) -> None:
    """Plain least squares errs by 5 degrees on this layer; without the dimming the normals and the albedo are exact."""
    capture = synthetic(shape, 96, layer="diffuse", specular=0.2)
    truth = capture.truth
    ones = np.ones(capture.images.shape[:3], np.float32)
    plain = angular_error(least_squares(capture.reflectance(), capture.lights, capture.mask, ones).normal, truth.normals)
    result = solved(capture)
    error = angular_error(result.normal, truth.normals)
    lit = lit_by_all(capture)
    assert np.median(plain[capture.mask]) > 4.5
    assert np.median(error[capture.mask]) < 0.01
    assert error[capture.mask].mean() < 0.1
    assert error[lit].max() < 0.05
    assert np.abs(result.albedo - 0.8 * truth.albedo)[lit].max() < 1e-3
    assert result.measurable[capture.mask].all()
    assert (result.normal[~capture.mask] == 0).all()


def test_noise_is_not_blown_up(synthetic: Synthetic) -> None:
    """One percent of noise costs less than a degree, and the uncertainty says how much."""
    capture = synthetic("sphere", 64, layer="diffuse")
    rng = np.random.default_rng(1)
    noisy = capture.with_images(capture.images + 0.003 * rng.normal(size=(*capture.images.shape[:3], 1)).astype(np.float32))
    result = solved(noisy)
    lit = lit_by_all(capture)
    error = angular_error(result.normal, capture.truth.normals)[lit]
    assert error.mean() < 1.0
    assert np.sqrt((result.uncertainty[lit] ** 2).mean()) == pytest.approx(np.sqrt((error**2).mean()), rel=0.1)


def test_attached_shadows_do_not_spread(synthetic: Synthetic) -> None:
    """Where a light does not reach, the four others decide: no pixel is made worse than plain least squares by more than a degree."""
    capture = synthetic("sphere", 64, layer="diffuse")
    ones = np.ones(capture.images.shape[:3], np.float32)
    plain = least_squares(capture.reflectance(), capture.lights, capture.mask, ones).normal
    shadowed = capture.mask & ~lit_by_all(capture, 0.0)
    worse = (angular_error(solved(capture).normal, capture.truth.normals) - angular_error(plain, capture.truth.normals))[shadowed]
    assert shadowed.sum() > 100
    assert worse.max() < 1


def test_turned_permuted_and_brighter_lights(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 48, layer="diffuse")
    normal = solved(capture).normal
    t = 0.4
    R = np.array([[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1]])
    ones = np.ones(capture.images.shape[:3], np.float32)
    turned = coat(capture.reflectance(), capture.lights @ R.T, capture.mask, ones).normal
    lit = lit_by_all(capture)
    assert np.abs(turned - normal @ R.T.astype(np.float32))[lit].max() < 1e-4
    assert np.abs(solved(capture.select([3, 1, 4, 0, 2])).normal - normal)[lit].max() < 1e-4
    assert np.abs(solved(capture.with_images(capture.images * 9)).normal - normal)[lit].max() < 1e-4


def test_what_cannot_be_solved_is_refused(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 24, layer="diffuse")
    with pytest.raises(InputError, match="--normals coat: photometric stereo needs at least three lights, there are 2"):
        solved(capture.select([0, 1]))
    with pytest.raises(InputError, match="--normals coat: the light directions lie in one plane"):
        solved(capture.select([0, 1, 2]))
    w = np.ones(capture.images.shape[:3], np.float32)
    w[2:, 10] = 0
    result = solved(capture, w)
    assert not result.measurable[10].any()
    assert result.measurable[12][capture.mask[12]].all()
