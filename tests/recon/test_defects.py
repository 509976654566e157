"""Defects: the threshold, its guards, dilation and clipped samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from skimage.filters import threshold_otsu
from skimage.morphology import dilation

from gen.capture import Capture, Fault
from gen.errors import InputError
from recon.defects import FLOOR, contradicted, find_defects, guarded_otsu
from recon.registry import GLOSS

Synthetic = Callable[..., Capture]


def plain(luma: np.ndarray, faults: np.ndarray | None = None) -> tuple[np.ndarray, Capture]:
    """Grey specular pictures (K, H, W, 3) under lights of intensity 2, and a capture around them."""
    K, H, W = luma.shape
    lights = np.array([[0, 0, 1], [0.5, 0, 0.8], [-0.5, 0.3, 0.8], [0, -0.6, 0.8]])[:K]
    specular = np.repeat(2 * luma[..., None], 3, axis=3).astype(np.float32)
    return specular, Capture(specular + 0.1, lights, np.ones((H, W), bool), np.full(K, 2.0), faults)


def blob(size: int = 64, radius: float = 10, peak: float = 1.0) -> np.ndarray:
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return peak * np.exp(-(x**2 + y**2) / (2 * (radius / 2) ** 2))


@pytest.mark.parametrize("threshold", [0.1, 0.5])
def test_manual_threshold_is_in_reflectance(threshold: float) -> None:
    luma = np.stack([blob(), blob(peak=0.3)])
    specular, capture = plain(luma)
    found = find_defects(specular, capture, threshold, dilate=0)
    np.testing.assert_array_equal(found.mask, luma * np.float32(0.9999) > threshold)
    assert (found.threshold == threshold).all()
    assert found.method == "manual"


def test_dilation_is_that_of_a_disk() -> None:
    luma = np.zeros((1, 40, 40))
    luma[0, 10, 12] = luma[0, 30:34, 20] = 1
    specular, capture = plain(luma)
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
    found = find_defects(specular, capture, 0.5, dilate=1)
    np.testing.assert_array_equal(found.mask[0], dilation((luma[0] > 0.5).astype(np.uint8), cross) > 0)


def test_defects_stay_in_the_mask_and_off_missing_samples() -> None:
    specular, capture = plain(np.ones((2, 20, 20)))
    faults = np.zeros((2, 20, 20), np.uint8)
    faults[0, 5, 5] = Fault.MISSING
    mask = np.arange(20) < 8
    capture = replace(capture, mask=np.broadcast_to(mask, (20, 20)), faults=faults)
    found = find_defects(specular, capture, 0.5, dilate=2).mask
    assert not found[:, :, 8:].any()
    assert not found[0, 5, 5]
    assert found.sum() == 2 * 20 * 8 - 1


def test_clipped_samples_are_defects() -> None:
    faults = np.zeros((2, 30, 30), np.uint8)
    faults[1, 10:13, 10:13] = Fault.CLIPPED
    specular, capture = plain(np.zeros((2, 30, 30)), faults)
    found = find_defects(specular, capture, "auto", dilate=0)
    np.testing.assert_array_equal(found.mask, faults > 0)
    assert np.isinf(found.threshold).all()


def test_two_classes_are_cut_where_skimage_cuts_them() -> None:
    rng = np.random.default_rng(0)
    roots = np.concatenate([rng.normal(0.1, 0.02, 4000), rng.normal(0.9, 0.05, 1000)]).clip(0)
    x = guarded_otsu(roots**2)
    cut = np.sqrt(x)
    assert 0.2 < cut < 0.75
    assert ((roots > cut) != (roots > threshold_otsu(roots))).mean() < 0.001  # an edge or the middle of a bin apart


@pytest.mark.parametrize("peak", [0.1, 1.0, 50.0])
@pytest.mark.parametrize("radius", [3, 10])
def test_a_highlight_is_found(peak: float, radius: float) -> None:
    luma = blob(radius=radius, peak=peak)
    x = guarded_otsu(luma.ravel())
    assert FLOOR <= x < 0.9 * peak
    assert 0 < (luma > x).mean() < 0.2


@pytest.mark.parametrize("kind", ["normal", "uniform", "exponential", "constant", "zero"])
def test_one_class_is_not_cut_in_half(kind: str) -> None:
    rng = np.random.default_rng(1)
    values = {
        "normal": rng.normal(0.3, 0.05, 5000).clip(0),
        "uniform": rng.uniform(0.1, 0.5, 5000),
        "exponential": rng.exponential(0.1, 5000),
        "constant": np.full(5000, 0.3),
        "zero": np.zeros(5000),
    }[kind]
    x = guarded_otsu(values)
    assert (values > x).mean() < 0.02


def test_never_the_majority() -> None:
    rng = np.random.default_rng(2)
    luma = np.where(rng.random((3, 50, 50)) < 0.8, 1.0, 0.0) * rng.uniform(0.9, 1.1, (3, 50, 50))
    specular, capture = plain(luma)
    assert find_defects(specular, capture, "auto", dilate=1).mask.mean(axis=(1, 2)).max() <= 0.5


@pytest.mark.parametrize("name", ["bilateral", "chromaticity", "low-rank"])
@pytest.mark.parametrize("albedo", [(0.6, 0.3, 0.15), (0.5, 0.5, 0.5)])
def test_matte_capture_has_almost_none(synthetic, name: str, albedo: tuple[float, float, float]) -> None:
    capture = synthetic(albedo=albedo, layer="matte")
    noisy = capture.images + np.random.default_rng(0).normal(0, 0.003, capture.images.shape) * capture.mask[..., None]
    capture = capture.with_images(np.maximum(noisy, 0).astype(np.float32))
    assert find_defects(GLOSS.load(name)(capture).specular, capture).mask[:, capture.mask].mean() < 0.002


@pytest.mark.parametrize("alpha", [0.05, 0.1, 0.2])
def test_synthetic_highlights_are_found_where_they_are(synthetic, alpha: float) -> None:
    capture = synthetic(specular=0.2, alpha=alpha)
    assert capture.truth.specular is not None
    found = find_defects(GLOSS.load("chromaticity")(capture).specular, capture).mask
    truth = capture.truth.specular[..., 0]
    strong = truth > 0.5 * truth.max(axis=(1, 2), keepdims=True)
    strong &= capture.mask
    assert found[strong].mean() > 0.95
    assert found[:, capture.mask].mean() < 0.2


def test_bad_arguments_are_refused() -> None:
    specular, capture = plain(np.zeros((1, 8, 8)))
    for bad in (0.0, -1.0, float("nan"), float("inf"), "cut"):
        with pytest.raises(InputError, match="--threshold"):
            find_defects(specular, capture, bad)
    with pytest.raises(InputError, match="dilate"):
        find_defects(specular, capture, 0.5, dilate=-1)
    with pytest.raises(InputError, match="specular pictures"):
        find_defects(specular[:, 1:], capture)


def test_what_the_samples_agree_on_needs_no_repair(synthetic: Synthetic) -> None:
    """The same gloss, found exactly or left in half: only the second is a defect, and of a manual threshold both are."""
    capture = synthetic("cylinder", 64, alpha=0.2, specular=0.3)
    truth = capture.truth
    exact = find_defects(truth.specular, capture, "auto", 1, truth.diffuse)
    half = find_defects(truth.specular, capture, "auto", 1, truth.diffuse + truth.specular / 2)
    plain = find_defects(truth.specular, capture, "auto", 1)
    assert plain.mask[:, capture.mask].mean() > 0.02
    assert exact.mask[:, capture.mask].mean() < 0.002
    assert half.mask[:, capture.mask].mean() > 0.5 * plain.mask[:, capture.mask].mean()
    by_hand = [find_defects(truth.specular, capture, 0.1, 1, p).mask for p in (None, truth.diffuse)]
    assert (by_hand[0] == by_hand[1]).all()


def test_noise_does_not_pass_for_gloss_left_behind(synthetic: Synthetic) -> None:
    """With noise of 10 %, twice the residual that passes without it, two in three pixels agree, and left-over gloss does not."""
    capture = synthetic("cylinder", 64, alpha=0.1, specular=0.3)
    truth = capture.truth
    noise = (1 + 0.1 * np.random.default_rng(0).normal(size=truth.matte.shape[:3])[..., None]).astype(np.float32)
    glossy = capture.mask & (truth.specular.max(axis=(0, 3)) > 0.3)
    assert contradicted(truth.matte * noise, capture)[capture.mask].mean() < 0.4
    assert contradicted((truth.matte + truth.specular) * noise, capture)[glossy].mean() > 0.8


def test_where_nothing_can_be_told_shadows_are_innocent_and_three_lights_are_not(synthetic: Synthetic) -> None:
    """Left in half, gloss is a defect where four lit samples contradict each other, and under three lights everywhere."""
    capture = synthetic("sphere", 64, alpha=0.2, specular=0.3)
    left = capture.truth.diffuse + capture.truth.specular / 2
    facing = (capture.truth.normals @ capture.lights.T > 0.1).sum(-1)
    doubt = contradicted(left, capture)
    assert doubt[facing == 5].any()
    assert not doubt[facing < 4].any()
    three = [0, 1, 3]
    assert (contradicted(left[three], capture.select(three)) == capture.mask).all()


def test_otsu_is_that_of_each_picture() -> None:
    """skimage's own cut of every picture's object, clipped and background samples apart, with none of the guards of auto."""
    rng = np.random.default_rng(3)
    specular, capture = plain(rng.uniform(0, 1, (3, 40, 40)) ** np.array([1, 2, 4])[:, None, None])
    capture = replace(capture, mask=np.arange(40) < np.full((40, 1), 25))
    found = find_defects(specular, capture, "otsu", dilate=0)
    luma = specular[..., 0] / 2
    cuts = np.array([threshold_otsu(picture[capture.mask]) for picture in luma])
    np.testing.assert_allclose(found.threshold, cuts, rtol=1e-3)
    assert ((luma > cuts[:, None, None]) & capture.mask != found.mask).mean() < 1e-3
    assert found.method == "otsu"
    assert not find_defects(np.zeros_like(specular), capture, "otsu").mask.any()
