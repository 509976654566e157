"""The camera chain: lights that err as far as stated, near lights by the inverse square, storage as `gen.faults` has it, what is cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gen.faults import quantised
from learn.camera_chain import BITS, NARROW, WIDE, Faults, misdirected, near_lights, stored, take_pictures
from learn.random_fields import Draws, unit

CPU = torch.device("cpu")
CLEAN = Faults(
    misstated=0, near=0, ambient=0, bounce=0, noise=0, black_level=0, clipped=0, quantised=0
)  # nothing between the surface and the picture


def scene(B: int = 6, K: int = 4, size: int = 24) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Radiance 0.1 to 1.3 with a few highlights, albedo, and a mask without its top rows."""
    rng = np.random.default_rng(0)
    radiance = torch.from_numpy(rng.uniform(0.1, 1.3, (B, K, 3, size, size)).astype(np.float32))
    radiance[..., 5, 5] = 6.0
    mask = torch.ones(B, size, size, dtype=torch.bool)
    mask[:, :3] = False
    return radiance * mask[:, None, None], torch.full((B, 3, 1, 1), 0.6), mask


def pictures(faults: Faults, step: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    radiance, albedo, mask = scene()
    images, valid = take_pictures(Draws(1, step, CPU), radiance, radiance, albedo, mask, faults)
    return radiance, images, valid, mask


def test_without_faults_the_pictures_are_the_radiance() -> None:
    radiance, images, valid, mask = pictures(CLEAN)
    assert torch.allclose(images, radiance, rtol=1e-5)
    assert torch.equal(valid, mask[:, None].expand_as(valid))


def test_clipped_samples_are_invalid_and_the_others_right() -> None:
    cut = 0
    for step in range(8):
        radiance, images, valid, mask = pictures(replace(CLEAN, clipped=1.0), step)
        assert torch.allclose(images.where(valid[:, :, None], 0.0), radiance.where(valid[:, :, None], 0.0), rtol=1e-5)
        lost = mask[:, None] & ~valid
        assert (images <= radiance * (1 + 1e-5)).all()
        assert ((images < radiance * (1 - 1e-5)).any(2) <= lost).all()
        cut += int(lost.sum())
    assert cut > 100


@pytest.mark.parametrize("kind", BITS)
def test_storage_is_that_of_the_factory(kind: str) -> None:
    linear = torch.cat([torch.linspace(0, 1e-3, 4001), torch.linspace(0, 1.2, 4001)])[None]
    bits, *encoding = kind.split()
    found, step = stored(linear, np.array([kind]))
    expected = quantised(linear[0].numpy(), int(bits), "srgb" if encoding else "linear")
    apart = np.abs(found[0].numpy() - expected)
    assert (apart > 2e-6).mean() < 0.005, "values half way between two steps may go either way"
    assert apart.max() < 3 / (1 << int(bits))
    assert len(found.unique()) <= 1 << int(bits)
    assert float(found[found > 0].min()) == pytest.approx(float(step), rel=1e-3)
    untouched, none = stored(linear, np.array([""]))
    assert torch.equal(untouched, linear)
    assert float(none) == 0


def test_each_fault_is_as_large_as_said() -> None:
    radiance, clean, _, mask = pictures(CLEAN)
    inside = mask[:, None, None].expand_as(radiance)

    def change(fault: str) -> torch.Tensor:
        """Of the picture over its level, (B, samples)."""
        faults = replace(CLEAN, **{fault: 1.0})
        changes = torch.cat([pictures(faults, step)[1] - clean for step in range(4)])
        return (changes / 0.7)[inside.repeat(4, 1, 1, 1, 1)]

    ambient = change("ambient")
    assert ambient.min() >= -1e-5
    assert ambient.max() <= 0.6 * 0.04 / 0.7 + 1e-5
    assert ambient.max() > 0.02
    bounce = change("bounce")
    assert bounce.min() >= -1e-5
    assert 0.01 < bounce.max() < 0.12
    intensity = change("misstated")
    assert intensity.min() < -0.01
    assert intensity.max() > 0.01
    assert (intensity.abs() <= 0.06 * 6 / 0.7).all()
    noise = change("noise")
    assert 1e-4 < noise.std() < 0.05
    assert abs(noise.mean()) < 3e-3


def test_dark_samples_are_invalid() -> None:
    radiance, albedo, mask = scene()
    radiance[:, :, :, 10:14] = 0
    for faults in (replace(CLEAN, clipped=1.0), replace(CLEAN, noise=1.0, clipped=1.0, quantised=1.0)):
        _, valid = take_pictures(Draws(2, 3, CPU), radiance, radiance, albedo, mask, faults)
        assert valid[:, :, 10:14].float().mean() < 0.05
        assert valid[:, :, 15:].float().mean() > 0.8


def test_stated_directions_err_by_up_to_three_degrees() -> None:
    lights = unit(torch.randn(400, 5, 3), -1)
    stated = misdirected(Draws(5, 0, CPU), lights, replace(WIDE, misstated=1.0))
    cross = torch.linalg.cross(lights, stated)
    angle = torch.rad2deg(torch.asin(cross.norm(dim=-1)))
    assert angle.max() <= 3.001
    assert angle.max() > 2.5
    assert 0.5 < angle.mean() < 1.5
    per_capture = angle.amax(1)
    assert per_capture.min() < 0.1, "some captures are well calibrated"
    assert torch.allclose(stated.norm(dim=-1), torch.ones(400, 5), atol=1e-6)
    assert torch.allclose(misdirected(Draws(5, 0, CPU), lights, NARROW), lights, atol=1e-6)
    # toward every side alike
    sideways = cross.sum((0, 1)).norm() / cross.norm(dim=-1).sum()
    assert sideways < 0.1


def test_near_lights_point_to_one_place_and_fall_off_by_the_square() -> None:
    size = 33
    lights = unit(torch.tensor([[[0.0, 0.0, 1.0], [3.0, 0.0, 4.0]]]), -1)
    height, mask = torch.zeros(1, size, size), torch.ones(1, size, size, dtype=torch.bool)
    direction, fall_off = near_lights(Draws(1, 4, CPU), lights, height, mask, replace(CLEAN, near=1.0))
    assert direction.shape == (1, 2, 3, size, size)
    assert torch.allclose(direction.norm(dim=2), torch.ones(1, 2, size, size), atol=1e-5)
    assert torch.allclose(direction[..., 16, 16], lights, atol=1e-6)
    assert torch.allclose(fall_off[..., 16, 16], torch.ones(1, 2, 1), atol=1e-6)
    # The frontal light stands over the middle at distance D: 16 pixels aside it is sqrt(D^2 + 16^2) away.
    d2 = 256 / float(direction[0, 0, 0, 16, 0] / direction[0, 0, 2, 16, 0]) ** 2
    assert 3 * size <= d2**0.5 <= 20 * size
    assert float(fall_off[0, 0, 0, 16, 0]) == pytest.approx(d2 / (d2 + 256), rel=1e-4)
    assert fall_off[0, 1, 0, 16, 32] > 1 > fall_off[0, 1, 0, 16, 0], "brighter toward the light"
    assert direction[0, 0, 1, 0, 16] < 0 < direction[0, 0, 1, 32, 16], "rows run downward"
    far, one = near_lights(Draws(1, 4, CPU), lights, height, mask, CLEAN)
    assert torch.equal(far[..., 0, 0], lights)
    assert one.max() == one.min() == 1
