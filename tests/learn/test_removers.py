"""The learned removers keep the promises of the registry: layers add up, exposure and order do not matter, tiles leave no seam."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gen.capture import Capture, Fault, Truth
from gen.errors import InputError
from learn import removers
from learn.method import METHODS
from learn.removers import exposure_factor, remove_by, remover, separate, tiles
from learn.weights import Loaded, load_weights
from recon.registry import GLOSS
from tests.learn.small_weights import weights_file

Synthetic = Callable[..., Capture]


def spoilt(capture: Capture) -> Capture:
    """Coloured and unequal intensities, noise, clipping, missing samples."""
    rng = np.random.default_rng(3)
    intensities = rng.uniform(0.5, 3, (capture.count, 3))
    images = capture.images * intensities[:, None, None, :] + rng.normal(0, 0.002, capture.images.shape)
    images = np.clip(images, 0, 1.5).astype(np.float32)
    faults = np.where((images >= 1.5).any(axis=3), int(Fault.CLIPPED), 0).astype(np.uint8)
    images[rng.random(faults.shape) < 0.01] = np.nan
    return replace(capture, images=images, intensities=intensities, faults=faults, truth=Truth())


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("count", "size"), [(1, 40), (2, 33), (5, 37)])
def test_layers_add_up_to_the_input(
    networks: dict[str, Loaded], synthetic: Synthetic, method: str, count: int, size: int
) -> None:
    capture = spoilt(synthetic(size=size, specular=0.4, alpha=0.1).select(range(count)))
    before = capture.images.copy()
    layers = remove_by(networks[method], capture)
    np.testing.assert_array_equal(capture.images, before)
    missing = (capture.faults & Fault.MISSING) != 0
    for part in (layers.diffuse, layers.specular):
        assert part.dtype == np.float32
        assert np.isfinite(part).all()
        assert part.min() >= 0
    np.testing.assert_allclose(layers.diffuse + layers.specular, capture.images, rtol=1e-6, atol=1e-6)
    assert layers.specular[:, capture.mask].any()
    assert not layers.specular[:, ~capture.mask].any()
    assert not layers.specular[missing].any()
    assert (layers.matte is not None) == (layers.confidence is not None) == (method == "group")
    if layers.matte is not None and layers.confidence is not None:
        assert layers.matte.shape == capture.images.shape
        assert layers.matte.min() >= 0
        assert 0 <= layers.confidence.min() <= layers.confidence.max() <= 1
        assert not layers.confidence[missing].any()
        assert not layers.confidence[:, ~capture.mask].any()


@pytest.mark.parametrize("method", METHODS)
def test_exposure_and_intensity_scale_through(networks: dict[str, Loaded], synthetic: Synthetic, method: str) -> None:
    capture = synthetic(size=40, specular=0.3, alpha=0.15)
    brighter = replace(capture, images=capture.images * 8, intensities=capture.intensities * 4)
    one, other = (remove_by(networks[method], c) for c in (capture, brighter))
    # The group network's floors are absolute; the networks of single pictures are exposed alike.
    np.testing.assert_allclose(other.diffuse, one.diffuse * 8, rtol=2e-2 if method == "group" else 1e-3, atol=2e-3)


@pytest.mark.parametrize("method", METHODS)
def test_order_of_the_pictures_does_not_matter(networks: dict[str, Loaded], synthetic: Synthetic, method: str) -> None:
    capture = synthetic(size=40, specular=0.4, alpha=0.1)
    order = [3, 0, 4, 1, 2]
    one, other = remove_by(networks[method], capture), remove_by(networks[method], capture.select(order))
    np.testing.assert_allclose(other.diffuse, one.diffuse[order], rtol=1e-3, atol=2e-4)


@pytest.mark.parametrize("method", METHODS)
def test_networks_of_single_pictures_see_one_only(networks: dict[str, Loaded], synthetic: Synthetic, method: str) -> None:
    capture = synthetic(size=40, specular=0.4, alpha=0.1)
    one, all_five = remove_by(networks[method], capture.select([2])), remove_by(networks[method], capture)
    assert np.allclose(one.diffuse[0], all_five.diffuse[2], atol=1e-6) == (method != "group")


def test_tiles_leave_no_seam(networks: dict[str, Loaded], synthetic: Synthetic, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of single pictures: in tiles and whole, the same but for what a network sees further away than the overlap."""
    capture = synthetic("cylinder", 200, specular=0.4, alpha=0.1).select([0, 1, 3])
    whole = remove_by(networks["specular"], capture)
    monkeypatch.setattr(removers, "MAX_PIXELS", 130 * 130)
    calls = []
    model = networks["specular"].model
    handle = next(m for m in model.modules() if isinstance(m, torch.nn.Conv2d)).register_forward_hook(lambda *_: calls.append(1))
    tiled = remove_by(networks["specular"], capture)
    handle.remove()
    assert len(calls) > 3
    assert np.abs(tiled.diffuse - whole.diffuse).mean() < 0.02 * np.abs(whole.diffuse).mean()
    np.testing.assert_allclose(tiled.diffuse + tiled.specular, capture.images, rtol=1e-6, atol=1e-6)


def test_a_large_capture_in_files_and_tiles_has_the_same_layers(
    networks: dict[str, Loaded], synthetic: Synthetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The group network sees in tiles what it sees at one look, to rounding."""
    capture = spoilt(synthetic(size=150, specular=0.4, alpha=0.1).select([0, 1, 3]))
    whole = remove_by(networks["group"], capture)
    monkeypatch.setattr(removers, "MAX_SAMPLES", 3 * 128 * 128)
    monkeypatch.setattr("gen.large.LARGE", 1000)
    tiled = remove_by(networks["group"], capture)
    for name, layer in vars(whole).items():
        np.testing.assert_allclose(getattr(tiled, name), layer, rtol=1e-4, atol=2e-5, err_msg=name)


@pytest.mark.parametrize(("H", "W", "most"), [(8, 8, 10**6), (300, 200, 130 * 130), (1000, 37, 128 * 128), (517, 613, 256 * 256)])
def test_tiles_cover_every_pixel_once(H: int, W: int, most: int) -> None:
    seen_times = np.zeros((H, W), int)
    for seen, kept in tiles(H, W, most):
        seen_times[kept] += 1
        assert all(s.start <= k.start < k.stop <= s.stop for s, k in zip(seen, kept, strict=True))
        assert all(s.start % 32 == 0 for s in seen), "strides would fall otherwise than on the whole picture"
        rows, columns = (s.stop - s.start for s in seen)
        assert max(rows, columns) <= max(most**0.5, 128) + 64 or most >= H * W
        for k, s, length in zip(kept, seen, (H, W), strict=True):
            assert k.start - s.start >= 32 or s.start == 0
            assert s.stop - k.stop >= 32 or s.stop == length
    assert (seen_times == 1).all()


def test_exposure_is_that_of_the_training() -> None:
    rng = np.random.default_rng(0)
    picture = np.repeat(rng.uniform(0, 3, (50, 40, 1)), 3, axis=2).astype(np.float32)
    mask = rng.random((50, 40)) < 0.5
    factor = exposure_factor(picture, mask)
    assert np.percentile(picture[mask][:, 0] * factor, 95) == pytest.approx(0.8, rel=2e-3)  # the luma's weights add up to .9999
    assert exposure_factor(np.zeros((9, 9, 3), np.float32), None) == 1
    framed = np.pad(picture, ((100, 100), (100, 100), (0, 0)))
    inside = np.pad(picture[..., 0] > 0.06, 100)
    assert exposure_factor(framed, None) == pytest.approx(exposure_factor(framed, inside), rel=1e-3)


def test_lights_of_several_directions_are_not_told(networks: dict[str, Loaded], synthetic: Synthetic) -> None:
    capture = synthetic(size=40)
    ambient = replace(capture, light_kinds=("environment", *["sun"] * 4), lights=np.vstack([[0, 0, 1.0], capture.lights[1:]]))
    unknown = separate(networks["group"], capture.reflectance(), capture.mask, capture.valid, None)
    np.testing.assert_array_equal(remove_by(networks["group"], ambient).matte, unknown.matte)
    assert not np.array_equal(remove_by(networks["group"], capture).matte, unknown.matte)


def test_bare_pictures_with_lights_are_separated_as_a_capture_is(networks: dict[str, Loaded], synthetic: Synthetic) -> None:
    capture = synthetic(size=40, specular=0.4, alpha=0.1)
    bare = separate(networks["group"], capture.images, capture.mask, None, capture.lights)
    for name, layer in vars(remove_by(networks["group"], capture)).items():
        np.testing.assert_array_equal(getattr(bare, name), layer, err_msg=name)


def test_too_small_a_picture_is_refused(networks: dict[str, Loaded], synthetic: Synthetic) -> None:
    for method in METHODS:
        remove_by(networks[method], synthetic(size=8))
        with pytest.raises(InputError, match="8x8"):
            remove_by(networks[method], synthetic(size=7))


def test_the_registry_knows_them(tmp_path: Path, synthetic: Synthetic, monkeypatch: pytest.MonkeyPatch) -> None:
    """By their names with the shipped weights, here replaced by small ones, and by a path with any others."""
    for method in METHODS:
        weights_file(tmp_path, method)
    monkeypatch.setattr("learn.weights.SHIPPED", tmp_path)
    removers._shipped.cache_clear()
    capture = synthetic(size=32)
    for method in METHODS:
        assert method in GLOSS
        named, given = GLOSS.load(method)(capture), remover(method, tmp_path / f"{method}.safetensors")(capture)
        np.testing.assert_array_equal(named.diffuse, given.diffuse)
    removers._shipped.cache_clear()
    with pytest.raises(InputError, match="not of lime"):
        remover("lime", tmp_path / "group.safetensors")
    assert load_weights("group").method == "group"
