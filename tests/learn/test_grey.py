"""The group network on pictures that colour says nothing of, as of monochrome cameras, and on masks larger than the object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gen.capture import LUMA, Capture, read_capture
from learn.models.evidence import GREY, evidence, luminance, saturations, without_cast
from learn.real import errors
from learn.removers import Shown, lit_pixels, remover
from recon.light_draws import CONDITION
from recon.metrics import angular_error
from recon.reconstruct import Settings, reconstruct
from recon.registry import GLOSS, Remover

Synthetic = Callable[..., Capture]
WHITE = (0.5, 0.5, 0.5)


def cone(count: int, width: float, tilt: float, seed: int) -> np.ndarray:
    """Lights anywhere within `width` degrees of a direction that is `tilt` degrees from the view, as well spread as draws of lights are."""
    rng = np.random.default_rng(seed)
    s, c = np.sin(np.radians(tilt)), np.cos(np.radians(tilt))
    while True:
        z = 1 - (1 - np.cos(np.radians(width))) * rng.random(count)
        turns = 2 * np.pi * rng.random(count)
        around = np.stack([np.sqrt(1 - z**2) * np.cos(turns), np.sqrt(1 - z**2) * np.sin(turns), z], 1)
        lights: np.ndarray = around @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        if np.linalg.cond(lights) < CONDITION:
            return lights


def in_eight_bits(capture: Capture, noise: float, monochrome: bool = True) -> Capture:
    """The capture as an 8-bit camera with linear numbers sees it; a monochrome one has one noise for all channels."""
    rng = np.random.default_rng(0)
    shape = (*capture.images.shape[:3], 1 if monochrome else 3)
    seen = capture.images + rng.normal(0, noise, shape)
    return replace(capture, images=(np.round(np.clip(seen, 0, 1) * 255) / 255).astype(np.float32))


def error(capture: Capture, remove: Remover, truth: np.ndarray, where: np.ndarray) -> float:
    """Mean angular error of least squares in degrees where the mask may be another, which `errors` would measure in."""
    shape = reconstruct(capture, remove(capture), Settings(gloss="group", repair="none", height="quadratic"))
    return float(np.nanmean(angular_error(shape.normals.normal, truth)[where]))


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
@pytest.mark.parametrize(("count", "width", "tilt", "seed"), [(5, 45, 0, 0), (5, 35, 30, 0), (12, 35, 30, 2)])
def test_matte_monochrome_pictures_get_better(
    synthetic: Synthetic, shape: str, count: int, width: float, tilt: float, seed: int
) -> None:
    lights = cone(count, width, tilt, seed)
    capture = in_eight_bits(synthetic(shape, size=96, lights=lights, albedo=WHITE, layer="matte"), 0.002)
    assert errors(capture, remover("group")) < 0.75 * errors(capture, None)


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_gloss_is_found_in_monochrome_pictures(synthetic: Synthetic, shape: str) -> None:
    capture = in_eight_bits(synthetic(shape, size=96, albedo=WHITE), 0.002)
    assert errors(capture, remover("group")) < 0.4 * errors(capture, None)


@pytest.mark.parametrize("cast", [0.01, 0.02])
def test_lamps_of_slightly_different_colours_do_no_harm(synthetic: Synthetic, cast: float) -> None:
    """To grey matte things, where a cast is all the colour that there is."""
    capture = synthetic("sphere", size=96, lights=cone(5, 35, 30, 0), albedo=WHITE, layer="matte")
    tints = 1 + cast * np.random.default_rng(3).standard_normal((capture.count, 1, 1, 3))
    capture = in_eight_bits(replace(capture, images=(capture.images * tints).astype(np.float32)), 0.002, monochrome=False)
    assert errors(capture, remover("group")) < errors(capture, None)


@pytest.mark.parametrize("around", [1.15, 1.5])
@pytest.mark.parametrize("layer", ["matte", "combined"])
def test_a_mask_with_black_background_hardly_matters(synthetic: Synthetic, around: float, layer: str) -> None:
    exact = in_eight_bits(synthetic("sphere", size=96, layer=layer), 0.003, monochrome=False)
    y, x = np.mgrid[:96, :96] - 47.5
    loose = replace(exact, mask=np.hypot(x, y) < around * 0.45 * 96)
    truth = exact.truth.normals
    assert truth is not None
    assert loose.mask.sum() > 1.2 * exact.mask.sum()
    with_exact, with_loose = (error(c, remover("group"), truth, exact.mask) for c in (exact, loose))
    assert with_loose < with_exact + 0.3


def test_what_is_black_in_all_pictures_is_not_lit(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", size=64)
    every = np.ones(capture.mask.shape, bool)
    shown = Shown(capture.images, capture.intensities.astype(np.float32), every, None, capture.lights)
    found = lit_pixels(shown)
    bright = (capture.images @ LUMA).mean(0)
    assert not found[~capture.mask].any()
    assert found[bright > 0.05 * bright.max()].all()
    black = replace(shown, images=np.zeros_like(capture.images))
    assert lit_pixels(black).all(), "nothing is lit: all is looked at"
    assert not lit_pixels(replace(shown, mask=np.zeros_like(every))).any()


def test_dark_sparkle_is_not_taken_for_noise(synthetic: Synthetic) -> None:
    """As of metal that mirrors little: dark in most pixels, and rough."""
    capture = synthetic("sphere", size=64)
    rng = np.random.default_rng(0)
    sparkle = (0.06 * rng.exponential(1, (*capture.images.shape[:3], 1))).astype(np.float32)
    left = (np.arange(64) < 32)[None, None, :, None] & capture.mask[None, ..., None]
    images = np.where(left, capture.images.max() * sparkle, capture.images)
    shown = Shown(images, capture.intensities.astype(np.float32), capture.mask, None, capture.lights)
    assert lit_pixels(shown)[capture.mask].mean() > 0.95


def test_pictures_outside_what_is_lit_stay_and_count_alike(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", size=64)
    layers = GLOSS.load("group")(replace(capture, mask=np.ones_like(capture.mask)))
    outside = ~capture.mask
    assert layers.matte is not None
    assert layers.confidence is not None
    np.testing.assert_array_equal(layers.specular[:, outside], 0)
    np.testing.assert_array_equal(layers.matte[:, outside], capture.images[:, outside])
    np.testing.assert_array_equal(layers.confidence[:, outside], 1)


def test_only_what_is_nearly_grey_loses_its_colour() -> None:
    generator = torch.Generator().manual_seed(0)
    y = 0.3 + torch.rand(1, 5, 8, 8, generator=generator)

    def tinted(saturation: float) -> torch.Tensor:
        return y[:, :, None] * torch.tensor([1.0, 1 - saturation / 2, 1 - saturation]).reshape(1, 1, 3, 1, 1)

    own, pale = tinted(2 * GREY[1]), tinted(GREY[0] / 2)
    assert torch.equal(without_cast(own, y), own)
    assert float(saturations(without_cast(pale, y)).max()) < 1e-6
    between = tinted((GREY[0] + GREY[1]) / 2)
    for images in (pale, between):
        assert torch.allclose(
            luminance(without_cast(images, y)), luminance(images), rtol=2e-4
        )  # as the weights of luma do not add up to 1
    assert bool((saturations(without_cast(between, y)) < saturations(between)).all())
    # A highlight, and samples in shadow, do not make a pixel grey or colourful.
    highlight = own.clone()
    highlight[:, 0] += 5
    highlight[:, 1] = 0
    assert torch.equal(without_cast(highlight, luminance(highlight)), highlight)
    shadowed = pale.clone()
    shadowed[:, :3] = 0
    assert float(saturations(without_cast(shadowed, luminance(shadowed)))[:, 3:].max()) < 1e-6


def test_a_grey_picture_has_the_same_evidence_whatever_its_slight_cast() -> None:
    generator = torch.Generator().manual_seed(1)
    grey = torch.rand(1, 5, 1, 12, 12, generator=generator).expand(-1, -1, 3, -1, -1) + 0.2
    cast = grey * torch.tensor([1.015, 0.999, 0.98]).reshape(1, 1, 3, 1, 1)
    cast = cast * (luminance(grey) / luminance(cast)).unsqueeze(2)
    valid, mask = torch.ones(1, 5, 12, 12, dtype=torch.bool), torch.ones(1, 12, 12, dtype=torch.bool)
    once, again = (evidence(images, None, valid, mask).features for images in (grey, cast))
    assert torch.allclose(once, again, atol=1e-5)


@pytest.mark.data
def test_a_photographed_matte_ball_keeps_its_shape(data_folder: Path) -> None:
    """Nearly grey, lit from above, in 8 bits with linear numbers; its truth is the sphere of its outline."""
    folder = data_folder / "uw_psm"
    lights = np.loadtxt(folder / "lights_zakmatt.txt", delimiter=",")
    capture = read_capture(folder / "gray", "linear")
    capture = replace(capture, lights=lights / np.linalg.norm(lights, axis=1, keepdims=True))
    rows, columns = np.nonzero(capture.mask)
    radius = np.sqrt(capture.mask.sum() / np.pi)
    y, x = np.mgrid[: capture.size[0], : capture.size[1]]
    x, y = (x - columns.mean()) / radius, (rows.mean() - y) / radius
    inside = capture.mask & (x**2 + y**2 < 0.9)
    truth = np.dstack([x, y, np.sqrt(np.clip(1 - x**2 - y**2, 0.01, None))])
    raw = error(capture, GLOSS.load("none"), truth, inside)
    assert error(capture, remover("group"), truth, inside) < raw
