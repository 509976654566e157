"""The gloss removers: properties that every one of them must have, and what each gains or must not spoil, judged by plain least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gen.capture import Capture, Fault, Truth, grey
from gen.errors import InputError
from recon.gloss.chromaticity import split_by_colour
from recon.gloss.geometry import fit, gloss_from_geometry
from recon.gloss.low_rank import complete
from recon.registry import GLOSS

CLASSICAL = ["bilateral", "chromaticity", "low-rank", "explain"]
WHOLE_STACK = ["chromaticity", "low-rank", "explain"]
COLOURS = {"coloured": (0.6, 0.3, 0.15), "grey": (0.5, 0.5, 0.5)}
NEEDS_TORCH = {name for name in GLOSS if not GLOSS[name].startswith("recon.")}


def dome(count: int = 12) -> np.ndarray:
    """One frontal light and rings at 25 and 45 degrees, irregular enough to have no symmetry."""
    angle = 2.399963 * np.arange(count)
    tilt = np.radians(np.linspace(0, 45, count))
    return np.column_stack([np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), np.cos(tilt)])


def error(capture: Capture, images: np.ndarray) -> float:
    """Mean angular error in degrees of plain least squares on the pictures, against the true normals."""
    y = grey(capture.reflectance(images))[:, capture.mask].astype(float)
    b = np.linalg.lstsq(capture.lights, y, rcond=None)[0].T
    n = b / np.maximum(np.linalg.norm(b, axis=1, keepdims=True), 1e-12)
    assert capture.truth.normals is not None
    return float(np.degrees(np.arccos(np.clip((n * capture.truth.normals[capture.mask]).sum(axis=1), -1, 1))).mean())


def spoilt(capture: Capture, seed: int = 0) -> Capture:
    """Coloured and unequal light intensities, sensor noise, clipping, and missing samples."""
    rng = np.random.default_rng(seed)
    intensities = rng.uniform(0.5, 3, (capture.count, 3))
    images = capture.images * intensities[:, None, None, :] + rng.normal(0, 0.002, capture.images.shape)
    images = np.clip(images, 0, 1.5).astype(np.float32)
    faults = np.where((images >= 1.5).any(axis=3), int(Fault.CLIPPED), 0).astype(np.uint8)
    images[rng.random(faults.shape) < 0.01] = np.nan
    return replace(capture, images=images, intensities=intensities, faults=faults, truth=Truth(normals=capture.truth.normals))


@pytest.mark.parametrize("name", [name for name in GLOSS if not name.startswith("true-") and name not in NEEDS_TORCH])
@pytest.mark.parametrize("colour", COLOURS)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 12])
def test_layers_add_up_to_the_input(synthetic, name: str, colour: str, count: int) -> None:
    capture = spoilt(synthetic(size=40, lights=dome(count), albedo=COLOURS[colour], specular=0.4, alpha=0.1))
    before = capture.images.copy()
    layers = GLOSS.load(name)(capture)
    np.testing.assert_array_equal(capture.images, before)
    missing = (capture.faults & Fault.MISSING) != 0
    for part in (layers.diffuse, layers.specular):
        assert part.dtype == np.float32
        assert part.shape == capture.images.shape
        assert np.isfinite(part).all()
        assert part.min() >= 0
    np.testing.assert_allclose(layers.diffuse + layers.specular, capture.images, rtol=1e-6, atol=1e-7)
    assert not layers.specular[:, ~capture.mask].any()
    assert not layers.specular[missing].any()
    if layers.confidence is not None:
        assert layers.confidence.shape == capture.faults.shape
        assert layers.confidence.min() >= 0
        assert layers.confidence.max() <= 1
        assert not layers.confidence[missing].any()


@pytest.mark.parametrize("layer", ["diffuse", "matte"])
def test_true_layers_are_handed_back(synthetic, layer: str) -> None:
    capture = synthetic()
    layers = GLOSS.load(f"true-{layer}")(capture)
    np.testing.assert_array_equal(getattr(layers, layer), getattr(capture.truth, layer))
    np.testing.assert_allclose(layers.diffuse + layers.specular, capture.images, rtol=1e-6)
    assert layers.specular.shape == capture.images.shape
    with pytest.raises(InputError, match=f"true-{layer}"):
        GLOSS.load(f"true-{layer}")(replace(capture, truth=Truth()))


@pytest.mark.parametrize("name", CLASSICAL)
@pytest.mark.parametrize("colour", COLOURS)
def test_order_of_lights_does_not_matter(synthetic, name: str, colour: str) -> None:
    capture = spoilt(synthetic(size=40, lights=dome(6), albedo=COLOURS[colour], specular=0.4, alpha=0.1))
    order = [3, 0, 5, 1, 4, 2]
    one, other = GLOSS.load(name)(capture), GLOSS.load(name)(capture.select(order))
    np.testing.assert_allclose(other.diffuse, one.diffuse[order], rtol=1e-3, atol=2e-4)


@pytest.mark.parametrize("name", CLASSICAL)
def test_exposure_scales_through(synthetic, name: str) -> None:
    capture = synthetic(size=40, lights=dome(6), specular=0.3, alpha=0.15)
    brighter = replace(capture, images=capture.images * 8, intensities=capture.intensities * 4)
    one, other = GLOSS.load(name)(capture), GLOSS.load(name)(brighter)
    np.testing.assert_allclose(other.diffuse, one.diffuse * 8, rtol=1e-3, atol=2e-3)


@pytest.mark.parametrize("name", CLASSICAL)
@pytest.mark.parametrize("colour", COLOURS)
@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
@pytest.mark.parametrize("count", [5, 12])
@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_matte_things_are_left_alone(synthetic, name: str, colour: str, shape: str, count: int, noise: float) -> None:
    capture = synthetic(shape=shape, lights=None if count == 5 else dome(), albedo=COLOURS[colour], layer="matte")
    noisy = capture.images + np.random.default_rng(1).normal(0, noise, capture.images.shape) * capture.mask[..., None]
    capture = capture.with_images(np.maximum(noisy, 0).astype(np.float32))
    diffuse = GLOSS.load(name)(capture).diffuse
    assert error(capture, diffuse) < error(capture, capture.images) + 0.5


@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.4618])
@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
@pytest.mark.parametrize("count", [5, 12])
def test_colour_separates_perfectly(synthetic, shape: str, alpha: float, count: int) -> None:
    capture = synthetic(shape=shape, lights=None if count == 5 else dome(), specular=0.3, alpha=alpha)
    assert capture.truth.diffuse is not None
    ceiling = error(capture, capture.truth.diffuse)
    assert error(capture, GLOSS.load("chromaticity")(capture).diffuse) < ceiling + 0.3
    assert error(capture, capture.images) > ceiling + 1.5


@pytest.mark.parametrize("name", WHOLE_STACK)
@pytest.mark.parametrize("colour", COLOURS)
@pytest.mark.parametrize("count", [5, 12])
def test_whole_stack_beats_nothing(synthetic, name: str, colour: str, count: int) -> None:
    glossy, removed, best = [], [], []
    every = 2 if name == "explain" else 1  # it takes half a second a capture
    for shape in ("sphere", "cylinder"):
        for alpha in (0.05, 0.1, 0.2, 0.4618)[::every]:
            for specular in (0.05, 0.2, 0.5)[::every]:
                capture = synthetic(shape, 48, None if count == 5 else dome(), COLOURS[colour], specular, alpha)
                glossy.append(error(capture, capture.images))
                removed.append(error(capture, GLOSS.load(name)(capture).diffuse))
                best.append(error(capture, capture.truth.diffuse))
    assert max(np.subtract(removed, glossy)) < 0.25  # never worse
    assert sum(glossy) - sum(removed) > 0.45 * (sum(glossy) - sum(best))


def test_single_image_gains_on_colour_and_leaves_grey_alone(synthetic) -> None:
    coloured = synthetic(specular=0.3, alpha=0.1)
    assert error(coloured, GLOSS.load("bilateral")(coloured).diffuse) < 0.75 * error(coloured, coloured.images)
    plain = synthetic(albedo=(0.5, 0.5, 0.5), specular=0.3, alpha=0.1)
    np.testing.assert_array_equal(GLOSS.load("bilateral")(plain).diffuse, plain.images)


def test_single_image_sees_one_picture_at_a_time(synthetic) -> None:
    capture = synthetic(size=40, specular=0.3, alpha=0.1)
    alone = GLOSS.load("bilateral")(capture.select([2])).diffuse
    np.testing.assert_array_equal(alone[0], GLOSS.load("bilateral")(capture).diffuse[2])


def test_two_colours_keep_apart_in_one_picture(synthetic) -> None:
    red, blue = synthetic(specular=0.3, alpha=0.1), synthetic(albedo=(0.1, 0.25, 0.7), specular=0.3, alpha=0.1)
    left = np.arange(64)[None, None, :, None] < 32
    assert red.truth.diffuse is not None
    assert blue.truth.diffuse is not None
    capture = red.with_images(np.where(left, red.images, blue.images))
    truth = np.where(left, red.truth.diffuse, blue.truth.diffuse)
    for name in ("bilateral", "chromaticity"):
        diffuse = GLOSS.load(name)(capture).diffuse
        assert np.square(diffuse - truth).sum() < 0.1 * np.square(capture.images - truth).sum()


def test_split_by_colour_is_the_non_negative_fit() -> None:
    from scipy.optimize import nnls

    rng = np.random.default_rng(3)
    colour = np.array([0.7, 0.25, 0.1])
    samples = (rng.uniform(0.2, 1, (6, 40, 1)) * colour + rng.uniform(0, 2, (6, 40, 1)) * (rng.random((6, 40, 1)) < 0.5)).astype(
        np.float32
    )
    samples[0] = colour  # one sample without gloss shows the colour
    usable = np.ones((6, 40), bool)
    gloss, trust = split_by_colour(samples, usable, ~usable)
    assert (trust > 0.99).all()
    basis = np.column_stack([colour, np.ones(3)])
    expected = np.array([[nnls(basis, samples[k, p].astype(float))[0][1] for p in range(40)] for k in range(6)])
    np.testing.assert_allclose(gloss, expected, atol=1e-4)


def test_fit_agrees_with_lstsq() -> None:
    rng = np.random.default_rng(4)
    L = dome(7).astype(np.float32)
    y, w = rng.random((7, 30)).astype(np.float32), rng.uniform(0.3, 1, (7, 30)).astype(np.float32)
    expected = [np.linalg.lstsq(np.sqrt(w[:, [p]]) * L, np.sqrt(w[:, p]) * y[:, p], rcond=None)[0] for p in range(30)]
    np.testing.assert_allclose(fit(y, w, L).T, expected, rtol=0.05, atol=0.02)


def test_geometry_finds_the_one_highlight() -> None:
    L = dome(8)
    half = L[5] + np.array([0, 0, 1])
    n = half / np.linalg.norm(half)
    y = np.repeat(0.5 * (L @ n)[:, None], 3, axis=1).astype(np.float32)
    y[5] += np.array([0, 0.3, 3], np.float32)
    gloss = gloss_from_geometry(y, np.ones((8, 3), bool), L)
    expected = np.zeros((8, 3))
    expected[5] = [0, 0.3, 3]
    np.testing.assert_allclose(gloss, expected, atol=0.02)


def test_low_rank_completes_missing_entries() -> None:
    rng = np.random.default_rng(5)
    L = dome(12)
    n = rng.normal(size=(2000, 3)) + np.array([0, 0, 6])
    D = (L @ (n / np.linalg.norm(n, axis=1, keepdims=True)).T).astype(np.float32)
    spoilt = D + (rng.random(D.shape) < 0.08) * rng.uniform(0.5, 3, D.shape)
    known = rng.random(D.shape) > 0.1
    A = complete(np.where(known, spoilt, 77).astype(np.float32), known, L)
    assert np.linalg.matrix_rank(A.astype(float), tol=1e-3 * np.linalg.norm(A)) <= 3
    assert np.abs(A - D).mean() < 0.02
    assert np.abs(spoilt - D).mean() > 0.1


@pytest.mark.parametrize("name", CLASSICAL)
def test_black_pictures_are_no_trouble(synthetic, name: str) -> None:
    capture = synthetic(size=24)
    layers = GLOSS.load(name)(capture.with_images(np.zeros_like(capture.images)))
    assert not layers.diffuse.any()
    assert not layers.specular.any()


@pytest.mark.data
@pytest.mark.parametrize("thing", ["bear", "cat"])
def test_real_nearly_matte_photographs_come_to_no_harm(data_folder, thing: str) -> None:
    from gen.capture import read_capture

    whole = read_capture(data_folder / "diligent" / thing)
    frames = np.random.default_rng(0).permutation(np.arange(20, 96))[:10]
    capture = whole.select([int(k) for k in frames])
    before = error(capture, capture.images)
    for name in CLASSICAL:
        assert error(capture, GLOSS.load(name)(capture).diffuse) < before + 0.2
    for name in WHOLE_STACK:
        assert error(capture, GLOSS.load(name)(capture).diffuse) < before - 0.2
