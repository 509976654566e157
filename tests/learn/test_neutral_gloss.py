"""The group network's layers get their colours from the dichromatic model: exact where it holds, and metal keeps what the network says."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gen import large
from gen.capture import LUMA, Capture, Floats
from learn.neutral_gloss import colour, colour_alone
from recon.registry import Layers

Synthetic = Callable[..., Capture]
PAINT = (0.6, 0.3, 0.15)


def painted(synthetic: Synthetic, tint: tuple[float, float, float] = (1, 1, 1)) -> tuple[Capture, Layers]:
    """A glossy sphere under lights of a colour, and what a network made of it that sees brightness rightly and colour greyly."""
    capture = synthetic(size=64, albedo=PAINT, specular=0.4, alpha=0.05)
    light = np.array(tint, np.float32)
    truth = capture.truth
    assert truth.matte is not None
    assert truth.specular is not None
    capture = capture.with_images(capture.images * light)
    capture.intensities[:] = light
    luma = (truth.matte @ LUMA.astype(np.float32))[..., None]
    matte = (0.5 * truth.matte + 0.5 * luma) * light
    specular = np.minimum(truth.specular * np.array([0.9, 1.05, 1.2], np.float32) * light, capture.images)
    return capture, Layers(capture.images - specular, specular, matte, np.ones(capture.images.shape[:3], np.float32))


def off(found: Floats, true: Floats, where: np.ndarray) -> float:
    """Mean angle between colours, degrees."""
    a, b = found[where], true[where]
    cosine = (a * b).sum(-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


@pytest.mark.parametrize("tint", [(1, 1, 1), (1.5, 1.0, 0.6)])
def test_coloured_paint_gets_its_own_colour_and_the_gloss_that_of_the_light(
    synthetic: Synthetic, tint: tuple[float, float, float]
) -> None:
    capture, layers = painted(synthetic, tint)
    truth, light = capture.truth, np.array(tint, np.float32)
    assert truth.matte is not None
    assert truth.diffuse is not None
    assert layers.matte is not None
    before = layers.matte.copy()
    wrong = float(np.square(layers.diffuse / light - truth.diffuse).mean())
    lit = (truth.matte.min(axis=3) > 0.02) & capture.mask
    assert off(before / light, truth.matte, lit) > 8
    colour(capture, layers)
    assert off(layers.matte / light, truth.matte, lit) < 0.5
    luma = LUMA.astype(np.float32)
    np.testing.assert_allclose((layers.matte / light) @ luma, (before / light) @ luma, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(layers.diffuse + layers.specular, capture.images, rtol=1e-6, atol=1e-6)
    assert layers.specular.min() >= 0
    assert layers.diffuse.min() >= 0
    gloss = layers.specular / light
    bright = gloss.max(axis=3) > 0.05
    assert bright.sum() > 100
    assert float((gloss.max(axis=3) - gloss.min(axis=3))[bright].mean() / gloss[bright].mean()) < 0.1
    assert float(np.square(layers.diffuse / light - truth.diffuse).mean()) < 0.5 * wrong


def test_metal_keeps_the_gloss_that_the_network_found(synthetic: Synthetic) -> None:
    """All of it has the metal's colour: colour alone sees no gloss there, and must not overrule the network."""
    capture = synthetic(size=64, specular=0.6, alpha=0.2)
    assert capture.truth.specular is not None
    capture = capture.with_images(capture.truth.specular * np.array([1.0, 0.8, 0.4], np.float32))
    found = 0.9 * capture.images
    layers = Layers(capture.images - found, found.copy(), capture.images.copy(), np.ones(capture.images.shape[:3], np.float32))
    colour(capture, layers)
    assert float(np.abs(layers.specular - found).mean()) < 0.02 * float(found.mean())


def test_grey_stays_grey_and_black_black(synthetic: Synthetic) -> None:
    capture = synthetic(size=48, albedo=(0.4, 0.4, 0.4), specular=0.4, alpha=0.1)
    capture.images[:, :24] = 0
    matte = 0.7 * capture.images
    layers = Layers(
        capture.images.copy(), np.zeros_like(capture.images), matte.copy(), np.ones(capture.images.shape[:3], np.float32)
    )
    colour(capture, layers)
    np.testing.assert_allclose(layers.matte, matte, rtol=1e-4, atol=1e-6)
    for layer in (layers.matte, layers.diffuse, layers.specular):
        assert np.isfinite(layer).all()


def test_strips_make_no_difference(synthetic: Synthetic, monkeypatch: pytest.MonkeyPatch) -> None:
    capture, whole = painted(synthetic)
    colour(capture, whole)
    monkeypatch.setattr(large, "STRIP", 2000)
    _, parts = painted(synthetic)
    colour(capture, parts)
    for name in ("matte", "diffuse", "specular"):
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), rtol=1e-4, atol=1e-5, err_msg=name)


def test_layers_without_a_matte_twin_are_refused(synthetic: Synthetic) -> None:
    capture = synthetic(size=20)
    with pytest.raises(ValueError, match="matte"):
        colour(capture, Layers(capture.images, np.zeros_like(capture.images)))


@pytest.mark.parametrize("tint", [(1, 1, 1), (1, 0.8, 0.5)])
def test_of_one_picture_the_gloss_gets_the_lights_colour(synthetic: Synthetic, tint: tuple[float, float, float]) -> None:
    capture, layers = painted(synthetic, tint)
    truth = capture.truth.specular
    assert truth is not None
    before = layers.specular.copy()
    colour_alone(capture.images, capture.intensities, capture.mask, layers)
    light = np.array(tint, np.float32)
    seen = (layers.specular > 1e-4).all(axis=-1)
    assert seen.any()
    assert off(layers.specular, np.broadcast_to(light, layers.specular.shape), seen) < 0.1
    np.testing.assert_allclose(layers.diffuse + layers.specular, capture.images, atol=1e-6)
    assert (layers.specular <= capture.images + 1e-6).all()
    assert np.abs(layers.specular - truth * light).mean() < np.abs(before - truth * light).mean()


def test_of_one_picture_nothing_is_taken_from_a_saturated_surface() -> None:
    images = np.zeros((1, 8, 8, 3), np.float32)
    images[..., 0] = 0.7
    layers = Layers(0.5 * images, 0.5 * images)
    colour_alone(images, np.ones((1, 3)), np.ones((8, 8), bool), layers)
    assert not layers.specular.any()
    np.testing.assert_array_equal(layers.diffuse, images)


@pytest.mark.parametrize(("count", "chroma", "taken"), [(1, 0.0, 0), (1, 0.04, 0), (1, 0.3, 1), (2, 0.0, 1)])
def test_of_one_picture_of_a_grey_thing_nothing_is_taken(synthetic: Synthetic, count: int, chroma: float, taken: int) -> None:
    capture = synthetic(size=64, albedo=(0.5, 0.5 * (1 - chroma), 0.5 * (1 - chroma)), specular=0.3, alpha=0.2).select(
        list(range(count))
    )
    gloss = capture.truth.specular
    assert gloss is not None
    layers = Layers(capture.images - gloss, gloss.copy())
    colour_alone(capture.images, capture.intensities, capture.mask, layers)
    np.testing.assert_allclose(layers.specular, taken * gloss, rtol=2e-4, atol=1e-5)
    np.testing.assert_allclose(layers.diffuse + layers.specular, capture.images, atol=1e-6)


def test_what_has_no_value_in_a_picture_alone_leaves_the_rest_as_it_is(synthetic: Synthetic) -> None:
    capture = synthetic(size=64, albedo=PAINT, specular=0.3, alpha=0.2).select([0])
    gloss = capture.truth.specular
    assert gloss is not None
    images = capture.images.copy()
    images[0, 30, 30:33] = np.nan, np.inf, 1e30
    layers = Layers(images - gloss, gloss.copy())
    colour_alone(images, capture.intensities, capture.mask, layers)
    rest = np.ones(images.shape[:3], bool)
    rest[0, 30, 30:33] = False
    np.testing.assert_allclose(layers.specular[rest], gloss[rest], rtol=2e-4, atol=1e-5)


def test_a_black_picture_alone_stays_black() -> None:
    images = np.zeros((1, 8, 8, 3), np.float32)
    layers = Layers(images.copy(), images.copy())
    colour_alone(images, np.ones((1, 3)), np.zeros((8, 8), bool), layers)
    assert not layers.diffuse.any()
    assert not layers.specular.any()
