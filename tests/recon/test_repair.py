"""Repairs: what is inpainted from where and how finely, and what `drop` may leave out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skimage.restoration import inpaint_biharmonic

from gen.capture import Capture, Fault
from gen.errors import InputError
from recon.conditioning import MAX_CONDITION
from recon.registry import REPAIR
from recon.repair import inpainting
from recon.repair.stack import SHADING, edge_weights, membrane, neighbours

INPAINTING = ["telea", "navier-stokes", "biharmonic", "stack"]
LIGHTS = np.array([[0, 0, 1], [0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, 0.8], [0, -0.6, 0.8]])


def around(pictures: np.ndarray, mask: np.ndarray | None = None) -> Capture:
    """A capture of the pictures (K, H, W, 3) or of one (H, W), repeated."""
    if pictures.ndim == 2:
        pictures = np.repeat(np.repeat(pictures[None, ..., None], 5, axis=0), 3, axis=3)
    H, W = pictures.shape[1:3]
    return Capture(pictures, LIGHTS[: len(pictures)], np.ones((H, W), bool) if mask is None else mask)


def ramp(size: int = 64) -> np.ndarray:
    y, x = np.mgrid[:size, :size]
    return (0.2 + 0.004 * x + 0.006 * y).astype(np.float32)


def hole(shape: tuple[int, int], frame: int = 1) -> np.ndarray:
    found = np.zeros((5, *shape), bool)
    found[frame, 20:26, 30:37] = True
    return found


@pytest.mark.parametrize("name", REPAIR)
def test_every_repair_keeps_good_samples_bit_for_bit(synthetic, name: str) -> None:
    capture = synthetic(size=48)
    faults = np.zeros(capture.faults.shape, np.uint8)
    faults[2, 20:24, 20:24] = Fault.MISSING
    capture = replace(capture, faults=faults)
    defects = np.random.default_rng(0).random(faults.shape) < 0.05
    before = capture.images.copy()
    done = REPAIR.load(name)(capture.images, defects, capture)
    np.testing.assert_array_equal(capture.images, before)
    kept = ~defects | ~capture.mask
    np.testing.assert_array_equal(done.images[kept], before[kept])
    assert done.images.dtype == np.float32
    assert done.weights.dtype == np.float32
    assert np.isfinite(done.images).all()
    assert set(np.unique(done.weights)) <= {0.0, 1.0}
    assert not done.weights[(faults & Fault.MISSING) != 0].any()
    assert done.weights[kept & (faults == 0)].all()


@pytest.mark.parametrize("name", REPAIR)
def test_without_defects_nothing_changes(synthetic, name: str) -> None:
    capture = synthetic(size=32)
    done = REPAIR.load(name)(capture.images, np.zeros(capture.faults.shape, bool), capture)
    np.testing.assert_array_equal(done.images, capture.images)
    assert done.weights.all()


@pytest.mark.parametrize("name", INPAINTING)
@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_ramp_is_continued_at_any_scale(name: str, scale: float) -> None:
    picture = ramp() * np.float32(scale)
    defects = hole(picture.shape)
    capture = around(np.where(defects[..., None], np.float32(50 * scale), picture[..., None] * np.ones(3, np.float32)))
    done = REPAIR.load(name)(capture.images, defects, capture).images
    inside = defects[1]
    wrong = np.abs(done[1, ..., 0] - picture)[inside]
    reference = inpaint_biharmonic(np.where(inside, 0, picture / scale).astype(np.float64), inside) * scale
    assert np.abs(reference - picture)[inside].max() < 1e-4 * scale  # the independent method continues the ramp exactly
    assert np.abs(done[1, ..., 0] - reference)[inside].max() < 0.5 * np.ptp(picture[inside])
    assert wrong.mean() < 0.2 * np.ptp(picture[inside])


@pytest.mark.parametrize("name", INPAINTING)
def test_values_are_not_quantised(name: str) -> None:
    """A slope of 1e-7 a pixel on 1, far finer than 16 bits (1.5e-5) would show, comes through."""
    y, x = np.mgrid[:64, :64]
    picture = (1 + 4e-7 * (x + y)).astype(np.float32)
    capture = around(picture)
    defects = hole(picture.shape)
    done = REPAIR.load(name)(capture.images, defects, capture).images
    inside = defects[1]
    assert len(np.unique(done[1, ..., 0][inside])) > 5
    assert np.abs(done[1, ..., 0].astype(float) - picture)[inside].max() < 5e-6


@pytest.mark.parametrize("name", INPAINTING)
@pytest.mark.parametrize("background", [0.0, 1000.0])
def test_background_never_bleeds_in(name: str, background: float) -> None:
    y, x = np.mgrid[:64, :64]
    mask = (x + y > 50) & (x < 50)
    picture = np.where(mask, ramp(), background).astype(np.float32)
    defects = np.zeros((5, 64, 64), bool)
    defects[0] = (abs(x + y - 52) < 6) & (abs(x - y) < 10)  # across the rim
    defects[3, 30:36, 46:64] = True
    capture = around(picture, mask)
    done = REPAIR.load(name)(capture.images, defects, capture).images
    for k in (0, 3):
        inside = defects[k] & mask
        assert np.abs(done[k, ..., 1] - picture)[inside].max() < 0.08
    np.testing.assert_array_equal(done[:, ~mask], capture.images[:, ~mask])


@pytest.mark.parametrize("name", INPAINTING)
def test_missing_samples_are_no_source(name: str) -> None:
    picture = ramp()
    pictures = np.repeat(np.repeat(picture[None, ..., None], 5, axis=0), 3, axis=3)
    pictures[1, 18:20, 28:40] = np.nan
    capture = around(pictures)
    defects = hole(picture.shape)
    done = REPAIR.load(name)(capture.images, defects, capture)
    assert np.abs(done.images[1, ..., 0] - picture)[defects[1]].max() < 0.06
    assert not done.weights[1, 18:20, 28:40].any()


@pytest.mark.parametrize("name", INPAINTING)
def test_a_frame_of_defects_stays_as_it_is(name: str) -> None:
    capture = around(ramp(32))
    defects = np.zeros((5, 32, 32), bool)
    defects[2] = True
    done = REPAIR.load(name)(capture.images, defects, capture).images
    np.testing.assert_array_equal(done, capture.images)


def test_drop_leaves_out_what_the_lights_allow() -> None:
    """Every one of the 32 ways to lose some of five lights, against the singular values of what remains."""
    faults = np.zeros((5, 4, 8), np.uint8)
    capture = replace(around(np.ones((5, 4, 8, 3), np.float32)), faults=faults)
    lost = ((np.arange(32)[None] >> np.arange(5)[:, None]) & 1).astype(bool)
    weights = REPAIR.load("drop")(capture.images, lost.reshape(5, 4, 8), capture).weights.reshape(5, 32)
    kinds = set()
    for i in range(32):
        left = LIGHTS[~lost[:, i]]
        s = np.linalg.svd(left, compute_uv=False) if len(left) >= 3 else np.array([1.0, 1.0, 0.0])
        allowed = bool(s[2] * MAX_CONDITION >= s[0])
        np.testing.assert_array_equal(weights[:, i], np.where(lost[:, i] & allowed, 0, 1))
        kinds.add(allowed)
    assert kinds == {True, False}


def test_drop_does_not_count_shadows() -> None:
    """Four lights remain, but two of them are dark: the defect stays in."""
    faults = np.zeros((5, 1, 2), np.uint8)
    faults[[3, 4], 0, 1] = Fault.DARK
    defects = np.zeros((5, 1, 2), bool)
    defects[0] = True
    capture = replace(around(np.ones((5, 1, 2, 3), np.float32)), faults=faults)
    weights = REPAIR.load("drop")(capture.images, defects, capture).weights
    np.testing.assert_array_equal(weights[:, 0, 0], [0, 1, 1, 1, 1])
    np.testing.assert_array_equal(weights[:, 0, 1], [1, 1, 1, 1, 1])


def test_biharmonic_is_scikit_images(synthetic) -> None:
    capture = synthetic("cylinder", 48, layer="diffuse")
    capture = replace(capture, mask=np.ones((48, 48), bool))
    defects = np.zeros((5, 48, 48), bool)
    defects[2, 10:20, 12:30] = defects[2, 30:33, 5:40] = True
    done = REPAIR.load("biharmonic")(capture.images, defects, capture).images[2]
    reference = inpaint_biharmonic(capture.images[2].astype(np.float64), defects[2], channel_axis=-1)
    assert np.abs(done - reference).max() < 1e-6


def test_a_hole_too_large_for_the_biharmonic_is_solved_coarser(monkeypatch: pytest.MonkeyPatch) -> None:
    """Halved once, the solution stays within a few percent of the range of the one at full resolution, and without a seam."""
    y, x = np.mgrid[:121, :120] / 20.0
    picture = np.stack([np.sin(x) + y, np.cos(y), x * y / 10], axis=-1)
    unknown = (x - 3) ** 2 + (y - 3) ** 2 < 6
    picture[unknown] = 1e3
    whole = inpainting.smoothest(picture, unknown)
    monkeypatch.setattr(inpainting, "LARGEST", 2000)
    coarser = inpainting.smoothest(picture, unknown)
    np.testing.assert_array_equal(coarser[~unknown], picture[~unknown])
    wrong = np.abs(coarser - whole)[unknown] / np.ptp(whole[unknown], axis=0)
    assert 0 < wrong.max() < 0.03
    steps = [np.abs(np.diff(p, axis=0)).max(axis=(0, 1)) for p in (coarser, whole)]
    assert (steps[0] < 1.5 * steps[1]).all()


def test_stack_has_the_least_energy() -> None:
    """Against the normal equations of the module's energy, written out densely over the edges of a ragged region."""
    rng = np.random.default_rng(0)
    region = rng.random((9, 8)) < 0.85
    i, j = neighbours(region)
    P = int(region.sum())
    values, lost = rng.random((5, P, 2)), rng.random((5, P)) < 0.3
    weights = edge_weights(values, lost, i, j)
    across = np.zeros((len(i), P))
    across[np.arange(len(i)), i], across[np.arange(len(i)), j] = 1, -1
    projector = LIGHTS @ np.linalg.pinv(LIGHTS)
    whole = np.kron(np.eye(5) - (1 - SHADING) * projector, across.T @ (weights[:, None] * across))
    u = lost.ravel()
    done = membrane(values, lost, i, j, LIGHTS)
    for channel in range(2):
        known = np.where(u, 0, values[..., channel].ravel())
        best = np.linalg.lstsq(whole[u][:, u], -(whole @ known)[u], rcond=None)[0]
        np.testing.assert_allclose(done[..., channel].ravel()[u], best, atol=1e-3)
        np.testing.assert_array_equal(done[..., channel][~lost].round(12), values[..., channel][~lost].round(12))


@pytest.mark.parametrize("layer", ["matte", "diffuse"])
def test_stack_knows_what_one_picture_cannot(synthetic, layer: str) -> None:
    """Wide holes on a sphere whose albedo has a pattern, the same place lost in two pictures: less than half of any inpainting's error."""
    capture = synthetic("sphere", 96, layer=layer)
    y, x = np.mgrid[:96, :96]
    checks = np.where((x // 6 + y // 6) % 2, 1.0, 0.5).astype(np.float32)[..., None]
    capture = capture.with_images(capture.images * checks)
    defects = np.zeros((5, 96, 96), bool)
    defects[0] = (x - 45) ** 2 + (y - 40) ** 2 < 200
    defects[1] = (x - 55) ** 2 + (y - 48) ** 2 < 200
    spoilt = np.where(defects[..., None], np.float32(5), capture.images)
    error = {
        name: np.sqrt(((REPAIR.load(name)(spoilt, defects, capture).images - capture.images)[defects] ** 2).mean())
        for name in INPAINTING
    }
    assert error["stack"] < 0.5 * min(error[name] for name in INPAINTING if name != "stack")


def test_stack_falls_back_on_the_surroundings_where_too_few_lights_remain(synthetic) -> None:
    """One place lost in four of five pictures: what is filled in is no worse than Telea's."""
    capture = synthetic("sphere", 64, layer="matte")
    y, x = np.mgrid[:64, :64]
    defects = np.zeros((5, 64, 64), bool)
    defects[:4] = (x - 30) ** 2 + (y - 34) ** 2 < 60
    spoilt = np.where(defects[..., None], np.float32(5), capture.images)
    wrong = [
        np.abs(REPAIR.load(name)(spoilt, defects, capture).images - capture.images)[defects].mean() for name in ("stack", "telea")
    ]
    assert wrong[0] < wrong[1] < 0.1


def test_a_part_that_a_picture_lost_whole_stays_as_it_is(synthetic) -> None:
    capture = synthetic("sphere", 48)
    mask = capture.mask.copy()
    mask[:, 23:25] = False
    capture = replace(capture, mask=mask)
    defects = np.zeros((5, 48, 48), bool)
    defects[1, :, :23] = defects[2, 20:24, 30:34] = True
    done = REPAIR.load("stack")(capture.images, defects, capture).images
    np.testing.assert_array_equal(done[1], capture.images[1])
    assert (done[2] != capture.images[2])[defects[2] & mask].any()


@pytest.mark.parametrize("name", REPAIR)
def test_shapes_that_disagree_are_refused(name: str) -> None:
    capture = around(ramp(16))
    with pytest.raises(InputError, match="defects"):
        REPAIR.load(name)(capture.images, np.zeros((5, 8, 8), bool), capture)
