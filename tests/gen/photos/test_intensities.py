"""Light intensities from the pictures alone, against those that the pictures were made with, and the calibrated ones of real ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Capture
from gen.errors import InputError
from gen.images import read_frames, read_mask
from gen.photos.intensities import estimate_intensities
from tests.gen.photos.photo_scenes import ring

Synthetic = Callable[..., Capture]
STRENGTHS = np.array([1, 0.4, 1.7, 0.8, 1.2, 0.6])[:, None] * [[1, 0.9, 0.7]] * (1 + 0.1 * np.arange(6)[:, None] * [[0, 1, -0.5]])


def under(capture: Capture, strengths: np.ndarray, noise: float = 0.0) -> Capture:
    images = capture.images * strengths[:, None, None].astype(np.float32)
    return replace(capture, images=images + np.random.default_rng(0).normal(0, noise, images.shape).astype(np.float32))


def estimate(capture: Capture) -> tuple[np.ndarray, float]:
    return estimate_intensities(capture.images, capture.lights, capture.mask, capture.faults, "here")


def test_a_matte_object_gives_the_intensities_exactly(synthetic: Synthetic) -> None:
    """Attached shadows all over the sphere, so hardly a pixel is lit by all six."""
    found, residual = estimate(under(synthetic(lights=ring(45, 5), layer="matte"), STRENGTHS))
    np.testing.assert_allclose(found, STRENGTHS / STRENGTHS.mean(axis=0), rtol=1e-4)
    assert residual < 1e-4


def test_exposure_and_albedo_do_not_matter_noise_hardly(synthetic: Synthetic) -> None:
    scene = under(synthetic(lights=ring(45, 5), layer="matte", albedo=(0.1, 0.5, 0.3)), 3 * STRENGTHS, 0.003)
    found, _ = estimate(scene)
    np.testing.assert_allclose(found, STRENGTHS / STRENGTHS.mean(axis=0), rtol=0.02)


def test_highlights_are_left_out(synthetic: Synthetic) -> None:
    scene = synthetic(lights=ring(45, 5), specular=0.1, alpha=0.1)
    assert scene.truth.matte is not None
    assert scene.truth.specular is not None
    found, residual = estimate(under(scene.with_images(scene.truth.matte + scene.truth.specular), STRENGTHS))
    error = found * STRENGTHS.mean(axis=0) / STRENGTHS - 1
    assert np.abs(error).max() < 0.08
    assert residual > 0.005, "and the residual tells that there were some"


def test_near_lights_by_their_own_directions(synthetic: Synthetic) -> None:
    """A matte sphere under point lights, the fall-off in the vectors: in closed form, pixel by pixel."""
    base = synthetic(size=64, lights=ring(45, 5), layer="matte")
    assert base.truth.normals is not None
    y, x = np.mgrid[:64, :64].astype(float)
    points = np.stack([x - 31.5, 31.5 - y, 28.8 * base.truth.normals[..., 2]], -1)
    places = base.lights * 120
    toward = places[:, None, None] - points
    vectors = toward * 120**2 / np.linalg.norm(toward, axis=-1, keepdims=True) ** 3
    shading = np.maximum((vectors * base.truth.normals).sum(-1), 0)[..., None] * STRENGTHS[:, None, None]
    images = (shading * base.mask[..., None]).astype(np.float32)
    found, _ = estimate_intensities(images, lambda rows, columns: vectors[:, rows, columns], base.mask, base.faults, "here")
    np.testing.assert_allclose(found, STRENGTHS / STRENGTHS.mean(axis=0), rtol=1e-3)
    distant, _ = estimate_intensities(images, base.lights, base.mask, base.faults, "here")
    assert np.abs(distant / found - 1).max() > 0.02


def test_what_cannot_be_estimated_is_refused(synthetic: Synthetic) -> None:
    with pytest.raises(InputError, match="from 3 lights, four are needed"):
        estimate(synthetic(lights=ring(30, 3, frontal=False), layer="matte"))
    with pytest.raises(InputError, match="well-spread"):
        estimate(synthetic(lights=ring(0.5, 5), layer="matte"))
    dark = synthetic(lights=ring(45, 5), layer="matte")
    with pytest.raises(InputError, match="only 0 pixels"):
        estimate(replace(dark, faults=np.full(dark.faults.shape, 1, np.uint8)))


@pytest.mark.data
def test_real_intensities_that_were_calibrated(data_folder: Path) -> None:
    """Ten lights of a nearly matte thing: within 5 percent of the calibration, where equal ones would be off by 40 and more."""
    folder, chosen = data_folder / "diligent" / "cat", list(range(3, 96, 10))
    directions, strengths = (np.loadtxt(folder / f"light_{name}.txt")[chosen] for name in ("directions", "intensities"))
    frames = read_frames([folder / (folder / "filenames.txt").read_text().split()[k] for k in chosen])
    mask = read_mask(folder / "mask.png")
    found, _ = estimate_intensities(frames.images, directions, mask, frames.faults, "cat")
    true = strengths / strengths.mean(axis=0)
    ratio = found / true
    assert np.sqrt(((ratio / ratio.mean(axis=0) - 1) ** 2).mean()) < 0.06
    assert np.sqrt(((1 / true - 1) ** 2).mean()) > 0.3
