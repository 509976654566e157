"""LIME's factors: they multiply back to the layers, and are the shading of the reference BRDF."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gen.capture import Capture, Truth
from gen.errors import InputError
from gen.faults import rng_of, with_faults
from gen.lime import exponent_of, lime_factors
from gen.spec_faults import Faults

Synthetic = Callable[..., Capture]


def with_ks(capture: Capture, ks: Any) -> Capture:
    layer = (np.broadcast_to(ks, 3) * capture.mask[..., None]).astype(np.float32)
    return replace(capture, truth=replace(capture.truth, specular_albedo=layer))


@pytest.fixture(scope="module")
def sphere(synthetic: Synthetic) -> Capture:
    """With the specular reflectance among its truth."""
    return with_ks(synthetic("sphere", 32, albedo=(0.6, 0.3, 0.15), specular=0.2, alpha=0.2), [0.2, 0.2, 0.2])


def test_they_multiply_back_to_the_layers(sphere: Capture) -> None:
    factors = lime_factors(sphere)
    assert sphere.truth.diffuse is not None
    assert sphere.truth.specular is not None
    assert factors.m_d * factors.D == pytest.approx(sphere.truth.diffuse, rel=1e-6)
    assert factors.m_s * factors.S == pytest.approx(sphere.truth.specular, rel=1e-6)
    assert np.array_equal(factors.valid, np.repeat(sphere.mask[..., None], 3, axis=2))
    assert factors.exponent[sphere.mask] == pytest.approx(48)
    assert not factors.exponent[~sphere.mask].any()
    assert factors.mirror is None


def test_the_shading_does_not_know_the_colour(sphere: Capture, synthetic: Synthetic) -> None:
    """The substrate's diffuse is Kd times something of Ks and the geometry alone, so D is grey, and the same for any Kd."""
    factors = lime_factors(sphere)
    assert factors.D[..., 1] == pytest.approx(factors.D[..., 0], abs=1e-6)
    other = lime_factors(with_ks(synthetic("sphere", 32, albedo=(0.1, 0.9, 0.5), specular=0.2, alpha=0.2), 0.2))
    np.testing.assert_allclose(factors.D, other.D, atol=1e-6)
    # Facing light and viewer: 28/23 (1 - Rs) (1 - 2^-5)^2, times the cosine 1 (PBR 3rd edition, Eq. 8.20).
    assert factors.D[0].max() == pytest.approx(28 / 23 * 0.8 * (31 / 32) ** 2, rel=2e-3)


def test_the_substrates_specular_shading_depends_on_ks(synthetic: Synthetic) -> None:
    """Through Schlick's term over Rs: Rs .05 and .2, light 120 degrees from the viewer, so 60 from the half vector, 1 - cos = .5."""
    light = np.array([[np.sqrt(0.75), 0, -0.5]])
    low, high = (lime_factors(with_ks(synthetic("sphere", 32, lights=light, specular=ks, alpha=0.5), ks)).S for ks in (0.05, 0.2))
    lit = high > 1e-3
    assert lit.any()
    assert low[lit] / high[lit] == pytest.approx(((0.05 + 0.95 / 32) / 0.05) / ((0.2 + 0.8 / 32) / 0.2), rel=1e-5)


def test_what_is_divided_by_nothing_is_masked_in_its_channel(sphere: Capture) -> None:
    assert sphere.truth.albedo is not None
    albedo = sphere.truth.albedo.copy()
    albedo[..., 2] = 0
    albedo[16, 16, 0] = 1e-42  # so small that the quotient is no float32
    red = with_ks(replace(sphere, truth=replace(sphere.truth, albedo=albedo)), [0, 0.3, 0.3])
    factors = lime_factors(red)
    inside = sphere.mask
    assert factors.D_valid[inside].all(axis=0).tolist() == [False, True, False]
    assert not factors.D_valid[16, 16, 0]
    assert factors.D_valid[..., 0].sum() == inside.sum() - 1
    assert factors.S_valid[inside].all(axis=0).tolist() == [False, True, True]
    assert np.array_equal(factors.valid, factors.D_valid & factors.S_valid)
    for layer, valid in ((factors.D, factors.D_valid), (factors.S, factors.S_valid)):
        assert np.isfinite(layer).all()
        assert not layer[:, ~valid].any()
        assert layer.dtype == np.float32


def test_faults_of_the_sensor_do_not_reach_them(sphere: Capture) -> None:
    mirror = np.full_like(sphere.images, 0.25)
    clean = replace(sphere, truth=replace(sphere.truth, mirror=mirror))
    noisy = lime_factors(with_faults(clean, Faults(noise={"read": 0.1}, black_level=0.1, ambient=0.3), rng_of(1)))
    assert np.array_equal(noisy.D, lime_factors(clean).D)
    assert noisy.mirror is mirror


def test_a_capture_without_the_layers_is_refused(sphere: Capture) -> None:
    with pytest.raises(InputError, match="need the truth's specular_albedo; render with lime: true"):
        lime_factors(replace(sphere, truth=replace(sphere.truth, specular_albedo=None)))
    with pytest.raises(InputError, match="diffuse, specular, albedo, specular_albedo, gloss"):
        lime_factors(replace(sphere, truth=Truth()))


@given(st.floats(0.5, 1e5))
def test_the_exponent_of_an_alpha(exponent: float) -> None:
    alpha = np.sqrt(2 / (exponent + 2))
    assert exponent_of(np.array([alpha]))[0] == pytest.approx(exponent, rel=1e-5)


def test_a_width_without_an_exponent_has_none() -> None:
    assert exponent_of(np.array([0.0, 1.0, 1.7, -0.5, np.nan])).tolist() == [0, 0, 0, 0, 0]
    assert exponent_of(np.array([0.9999]))[0] > 0


def test_the_exponents_lobe_is_as_wide_as_alphas() -> None:
    """(h.n)^s matches Beckmann's distribution of that width at its peak, to a few percent of the curvature (Walter et al. 2007)."""
    alpha = 0.1
    exponent = float(exponent_of(np.array([alpha]))[0])
    theta = np.linspace(0, 2 * alpha, 50)
    blinn = np.cos(theta) ** exponent
    beckmann = np.exp(-((np.tan(theta) / alpha) ** 2)) / np.cos(theta) ** 4
    assert blinn == pytest.approx(beckmann, abs=0.02)
