"""Smaller captures against block means by scikit-image, and against a scene rendered at the smaller size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from skimage.measure import block_reduce

from gen.capture import Capture, Fault, Scale
from gen.errors import InputError
from gen.sets.shrink import shrink

N = 4


@pytest.fixture
def pair(synthetic: Callable[..., Capture]) -> tuple[Capture, Capture]:
    """A sphere in 64x64 pixels and what it shrinks to in 16x16."""
    large = synthetic(size=64)
    return large, shrink(large, N)


def test_radiance_is_the_mean_over_the_block(pair: tuple[Capture, Capture]) -> None:
    large, small = pair
    for name in ("diffuse", "specular", "matte"):
        expected = block_reduce(getattr(large.truth, name).astype(np.float64), (1, N, N, 1), np.mean)
        assert getattr(small.truth, name) == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert small.images == pytest.approx(block_reduce(large.images.astype(np.float64), (1, N, N, 1), np.mean), rel=1e-6, abs=1e-9)
    assert small.images.sum(dtype=float) * N * N == pytest.approx(large.images.sum(dtype=float), rel=1e-6)


def test_what_belongs_to_the_view(pair: tuple[Capture, Capture]) -> None:
    large, small = pair
    assert np.array_equal(small.mask, block_reduce(large.mask.astype(float), (N, N), np.mean) >= 0.5)
    n = small.truth.normals.astype(float)
    assert np.linalg.norm(n[small.mask], axis=1) == pytest.approx(1, abs=1e-6)
    assert (n[~small.mask] == 0).all()
    assert np.isnan(small.truth.depth[~small.mask]).all()
    total = block_reduce(np.where(large.mask, large.truth.depth, 0).astype(float), (N, N), np.sum)
    count = block_reduce(large.mask.astype(float), (N, N), np.sum)
    assert small.truth.depth[small.mask] == pytest.approx((total / np.maximum(count, 1))[small.mask], rel=1e-6)
    assert np.array_equal(np.unique(small.truth.gloss), np.float32([0, 0.2]))
    assert small.truth.albedo[small.mask] == pytest.approx(np.float32([[0.6, 0.3, 0.15]] * int(small.mask.sum())))
    assert (small.truth.albedo[~small.mask] == 0).all()


def test_matte_stays_albedo_times_cosine_and_normals_those_of_the_sphere(
    pair: tuple[Capture, Capture], synthetic: Callable[..., Capture]
) -> None:
    _, small = pair
    direct = synthetic(size=16)
    inner = small.mask & (small.truth.normals[..., 2] > 0.6) & direct.mask
    cos = (small.truth.normals * direct.truth.normals).sum(axis=2)[inner]
    assert np.degrees(np.arccos(np.clip(cos, -1, 1))).max() < 1.0
    for k, light in enumerate(small.lights):
        expected = small.truth.albedo * np.maximum(small.truth.normals @ light, 0)[..., None]
        assert small.truth.matte[k][inner] == pytest.approx(expected[inner].astype(float), abs=0.006)


def test_faults_and_flags_of_a_block(synthetic: Callable[..., Capture]) -> None:
    large = synthetic(size=8)
    faults = np.zeros((5, 8, 8), np.uint8)
    faults[0, :2, :2] = Fault.DARK
    faults[0, 2:4, :2] = [[Fault.DARK, Fault.DARK], [Fault.DARK, 0]]
    faults[0, 4, 4] = Fault.CLIPPED
    faults[0, 5, 5] = Fault.MISSING
    shadow = np.zeros((5, 8, 8), np.uint8)
    shadow[1, :2, :2] = [[0, 1], [2, 2]]
    shadow[1, :2, 2:4] = [[0, 0], [1, 2]]
    shadow[1, :2, 4:6] = [[0, 0], [1, 1]]
    small = shrink(replace(large, faults=faults, truth=replace(large.truth, shadow=shadow)), 2)
    assert small.faults[0, 0, 0] == Fault.DARK
    assert small.faults[0, 1, 0] == 0
    assert small.faults[0, 2, 2] == Fault.CLIPPED | Fault.MISSING
    assert small.faults.astype(bool).sum() == 2
    assert small.truth.shadow[1, 0].tolist() == [2, 0, 1, 0]


def test_normals_that_cancel_leave_the_mask(synthetic: Callable[..., Capture]) -> None:
    large = synthetic(size=8)
    normals = large.truth.normals.copy()
    normals[4:6, 4:6] = [[[1, 0, 0], [-1, 0, 0]], [[0, 1, 0], [0, -1, 0]]]
    small = shrink(replace(large, truth=replace(large.truth, normals=normals)), 2)
    assert not small.mask[2, 2]
    assert np.isnan(small.truth.depth[2, 2])


@pytest.mark.parametrize("n", [2, 3])
def test_the_scale_sees_the_same_rays(synthetic: Callable[..., Capture], n: int) -> None:
    """A point at the corner of a block, in whole-pixel coordinates of OpenCV, lies at the corner of the pixel it becomes."""
    K = np.array([[80.0, 0, 10.25], [0, 90.0, 12.5], [0, 0, 1]])
    large = synthetic(size=24)
    small = shrink(replace(large, scale=Scale(camera=K, distance_mm=500)), n)
    ray = np.linalg.inv(K) @ [n * 5 - 0.5, n * 2 - 0.5, 1]
    assert (small.scale.camera @ ray)[:2] == pytest.approx([5 - 0.5, 2 - 0.5])
    assert shrink(replace(large, scale=Scale(mm_per_pixel=0.5)), n).scale.mm_per_pixel == 0.5 * n


def test_factors_that_do_not_fit_are_refused(synthetic: Callable[..., Capture]) -> None:
    large = synthetic(size=24)
    assert shrink(large, 1) is large
    for n in (0, 5, 48):
        with pytest.raises(InputError, match=f"24x24 pixels cannot be shrunk by {n}"):
            shrink(large, n)
    mask = np.zeros((24, 24), bool)
    mask[3, 3] = True
    with pytest.raises(InputError, match="nothing of the mask is left at 1/8"):
        shrink(replace(large, mask=mask), 8)
