"""The reference BRDFs: closed forms written otherwise, reciprocity, energy, and the same numbers from numpy and torch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gen.brdfs import BRDFS, shade_blinn_phong, shade_blinn_phong_lobe, shade_metal, shade_oren_nayar

UP = np.array([0.0, 0.0, 1.0])
RD, RS = np.array([0.8, 0.4, 0.0]), np.array([0.04, 0.5, 1.0])
VALUES: dict[str, dict[str, Any]] = {
    "blinn-phong": {"diffuse": RD, "specular": RS, "exponent": 30.0},
    "blinn-phong-lobe": {"diffuse": RD, "specular": RS, "alpha": 0.2, "normalised": True},
    "lambertian": {"diffuse": RD},
    "metal": {"specular": RS, "alpha": 0.3},
    "oren-nayar": {"diffuse": RD, "specular": RS, "alpha": 0.2, "sigma": 0.4},
    "substrate": {"diffuse": RD, "specular": RS, "alpha": 0.3},
    "two-lobe": {"diffuse": RD, "specular": RS, "alpha": 0.1, "alpha2": 0.5, "mix": 0.3},
}


def directions(count: int, seed: int = 0, below: bool = False) -> np.ndarray:
    """Unit vectors (count, 3), above the horizon unless said otherwise."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors[:, 2] = vectors[:, 2] if below else abs(vectors[:, 2]) + 0.02
    unit: np.ndarray = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def directional_albedo(kind: str, values: dict[str, Any], mo: float) -> np.ndarray:
    """(3,) share of light from everywhere that is seen at cosine mo, summed over half vectors."""
    u, phi = np.meshgrid((np.arange(800) + 0.5) / 800, (np.arange(128) + 0.5) / 128 * np.pi, indexing="ij")
    theta = np.pi / 2 * u**2
    h = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    view = np.array([np.sqrt(1 - mo**2), 0.0, mo])
    ld = h @ view
    # d h = sin(theta) dtheta dphi, d wi = 4 (l.h) d h; both halves of phi.
    measure = 4 * ld.clip(0) * np.sin(theta) * np.pi * u / 800 * 2 * np.pi / 128 / np.pi
    diffuse, specular, _ = BRDFS[kind](UP, 2 * ld[..., None] * h - view, view, **values)
    total: np.ndarray = ((diffuse + specular) * measure[..., None]).sum((0, 1))
    return total


@pytest.mark.parametrize("kind", BRDFS)
def test_nothing_is_negative_and_backs_are_black(kind: str) -> None:
    light, view = directions(500, 1, below=True), directions(500, 2, below=True)
    turned = (light[:, 2] <= 0) | (view[:, 2] <= 0)
    for part in BRDFS[kind](UP, light, view, **VALUES[kind]):
        assert part.shape == (500, 3)
        assert np.isfinite(part).all()
        assert part.min() >= 0
        assert (part[turned] == 0).all()
    matte = BRDFS[kind](UP, light, view, **VALUES[kind])[2]
    albedo = RS if kind == "metal" else RD
    np.testing.assert_allclose(matte[~turned], albedo * light[~turned, 2:], rtol=1e-12)


@pytest.mark.parametrize("kind", BRDFS)
def test_light_and_view_may_change_places(kind: str) -> None:
    """Of a BRDF, radiance over the cosine; Blinn-Phong's lobes, which are none, are themselves the same both ways."""
    light, view = directions(300, 3), directions(300, 4)
    one, two = BRDFS[kind](UP, light, view, **VALUES[kind]), BRDFS[kind](UP, view, light, **VALUES[kind])
    np.testing.assert_allclose(one[0] / light[:, 2:], two[0] / view[:, 2:], rtol=1e-9)
    shares = (1.0, 1.0) if kind.startswith("blinn") else (light[:, 2:], view[:, 2:])
    np.testing.assert_allclose(one[1] / shares[0], two[1] / shares[1], rtol=1e-9)


@pytest.mark.parametrize("mo", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
def test_energy(mo: float, alpha: float) -> None:
    """A white metal gives back at most all, and nearly all where it is smooth; the rough base no more than a white Lambertian one."""
    white = np.ones(3)
    metal = directional_albedo("metal", {"specular": white, "alpha": alpha}, mo)
    assert (metal <= 1 + 2e-3).all()
    assert alpha > 0.1 or mo < 0.2 or (metal > 0.98).all()
    two = {"diffuse": 0 * white, "specular": white, "alpha": alpha, "alpha2": 0.5, "mix": 0.5}
    half = directional_albedo("metal", {"specular": white, "alpha": 0.5}, mo)
    np.testing.assert_allclose(directional_albedo("two-lobe", two, mo), (metal + half) / 2, rtol=1e-9)
    assert directional_albedo("lambertian", {"diffuse": white}, mo) == pytest.approx(1, abs=2e-3)
    rough = {"diffuse": white, "specular": 0 * white, "alpha": 1e-3, "sigma": alpha}
    light = directions(4000, 5)
    base = BRDFS["oren-nayar"](UP, light, np.array([np.sqrt(1 - mo**2), 0, mo]), **rough)[0].mean(0) * 2
    assert (base < 1.05).all()


def test_metal_is_the_microfacet_formula() -> None:
    """D F / (4 mi mo (1 + Lambda(wi) + Lambda(wo))), with tangents (Walter et al. 2007; Heitz 2014)."""
    light, view = directions(200, 6), directions(200, 7)
    h = (light + view) / np.linalg.norm(light + view, axis=1, keepdims=True)
    for alpha in (0.05, 0.4, 2.0):
        tan2 = (1 - h[:, 2] ** 2) / h[:, 2] ** 2
        d = 1 / (np.pi * alpha**2 * h[:, 2] ** 4 * (1 + tan2 / alpha**2) ** 2)
        hidden = [(np.sqrt(1 + alpha**2 * (1 - w[:, 2] ** 2) / w[:, 2] ** 2) - 1) / 2 for w in (light, view)]
        f = RS + (1 - RS) * (1 - (light * h).sum(1, keepdims=True)) ** 5
        expected = np.pi * (d / (1 + hidden[0] + hidden[1]) / (4 * view[:, 2]))[:, None] * f
        np.testing.assert_allclose(shade_metal(UP, light, view, RS, alpha)[1], expected, rtol=1e-7)


def test_the_rough_base_is_oren_and_nayars_formula_in_angles() -> None:
    light, view = directions(300, 8), directions(300, 9)
    sigma = 0.6
    ti, to = np.arccos(light[:, 2]), np.arccos(view[:, 2])
    azimuth = np.arctan2(light[:, 1], light[:, 0]) - np.arctan2(view[:, 1], view[:, 0])
    a, b = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33), 0.45 * sigma**2 / (sigma**2 + 0.09)
    back = np.maximum(0, np.cos(azimuth)) * np.sin(np.maximum(ti, to)) * np.tan(np.minimum(ti, to))
    expected = RD * (np.cos(ti) * (a + b * back))[:, None]
    np.testing.assert_allclose(shade_oren_nayar(UP, light, view, RD, RS, 0.3, sigma)[0], expected, rtol=1e-9, atol=1e-12)
    smooth = shade_oren_nayar(UP, light, view, RD, RS, 0.3, 0.0)
    np.testing.assert_array_equal(smooth[0], smooth[2])


def test_blinn_phong_is_a_power_of_the_half_vector() -> None:
    light, view = directions(200, 10), directions(200, 11)
    h = (light + view) / np.linalg.norm(light + view, axis=1, keepdims=True)
    plain = shade_blinn_phong(UP, light, view, RD, RS, exponent=18.0)[1]
    np.testing.assert_allclose(plain, RS * h[:, 2:] ** 18, rtol=1e-9)
    by_alpha = shade_blinn_phong(UP, light, view, RD, RS, alpha=np.sqrt(2 / 20), normalised=True)[1]
    np.testing.assert_allclose(by_alpha, plain * 26 / 8, rtol=1e-9)
    lobe = shade_blinn_phong_lobe(UP, light, view, RD, RS, exponent=18.0)[1]
    assert (lobe <= plain * (1 + 1e-9)).all()
    mirrored = view * [-1, -1, 1]
    np.testing.assert_allclose(shade_blinn_phong_lobe(UP, mirrored, view, RD, RS, exponent=18.0)[1], np.tile(RS, (200, 1)))


@pytest.mark.parametrize("kind", BRDFS)
def test_torch_gives_numpys_numbers(kind: str) -> None:
    torch = pytest.importorskip("torch")
    light, view = directions(50, 12, below=True), directions(50, 13, below=True)
    values = {key: torch.as_tensor(v) if isinstance(v, np.ndarray) else v for key, v in VALUES[kind].items()}
    found = BRDFS[kind](*(torch.as_tensor(v) for v in (UP, light, view)), **values)
    for one, two in zip(found, BRDFS[kind](UP, light, view, **VALUES[kind]), strict=True):
        np.testing.assert_allclose(one.numpy(), two, rtol=1e-9, atol=1e-12)
