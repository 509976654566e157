"""Cast shadows of height fields against closed forms, and shadows of things outside the picture."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from learn.cast_shadows import thrown_in, visible
from learn.random_fields import Draws

CPU = torch.device("cpu")


def direction(elevation: float, azimuth: float) -> torch.Tensor:
    """(1, 1, 3), angles in degrees; azimuth from x toward y."""
    e, a = math.radians(elevation), math.radians(azimuth)
    return torch.tensor([[[math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)]]])


@pytest.mark.parametrize("elevation", [20.0, 35.0, 50.0, 70.0])
@pytest.mark.parametrize("rise", [4.0, 9.0])
@pytest.mark.parametrize("azimuth", [0, 90, 180, 270])
def test_the_shadow_of_a_step_is_height_over_tangent(elevation: float, rise: float, azimuth: int) -> None:
    """The step's high side is toward the light; quarter turns of the light and of the picture go together (rows run downward)."""
    ground = torch.zeros(48, 48)
    ground[:, 32:] = rise
    height = torch.rot90(ground, azimuth // 90)[None]
    seen = visible(height, torch.ones_like(height, dtype=torch.bool), direction(elevation, azimuth))
    row = torch.rot90(seen[0, 0], -(azimuth // 90))[24]
    assert set(row.tolist()) <= {0.0, 1.0}
    assert row[32:].min() == 1
    assert abs((row[:32] == 0).sum().item() - min(rise / math.tan(math.radians(elevation)), 32)) <= 1
    shaded = torch.nonzero(row == 0).flatten()
    assert shaded.tolist() == list(range(int(shaded[0]), 32)), "the shadow lies beside the step, in one piece"


def test_a_slanting_light_throws_a_slanting_shadow() -> None:
    """A post's shadow ends where its tip's does, 12 pixels away at 45 degrees of azimuth."""
    height = torch.zeros(1, 49, 49)
    height[0, 23:26, 23:26] = 12.0
    seen = visible(height, torch.ones(1, 49, 49, dtype=torch.bool), direction(45, 45))[0, 0]
    rows, columns = torch.nonzero(seen == 0, as_tuple=True)
    far = int((rows - columns).argmax())
    tip = 24 + 12 / math.sqrt(2)  # away from the light: left, and down
    assert rows[far].item() == pytest.approx(tip, abs=2)
    assert columns[far].item() == pytest.approx(48 - tip, abs=2)
    assert abs(rows + columns - 48).max() <= 3


@pytest.mark.parametrize("elevation", [5.0, 25.0, 60.0])
def test_a_convex_body_throws_no_shadow_on_itself(elevation: float) -> None:
    y, x = torch.meshgrid(torch.arange(64) - 31.5, torch.arange(64) - 31.5, indexing="ij")
    rest = 28.0**2 - x**2 - y**2
    mask = (rest > 0)[None]
    height = rest.clamp_min(0).sqrt()[None]
    normal = torch.stack([x, -y, height[0]]) / 28
    for azimuth in (0, 33, 135, 250):
        light = direction(elevation, azimuth)
        lit = torch.einsum("chw,c->hw", normal, light[0, 0]) > 1e-3
        assert visible(height, mask, light)[0, 0][lit & mask[0]].min() == 1


def test_heights_are_relative_and_soft_rims_lie_inside() -> None:
    torch.manual_seed(0)
    height = torch.nn.functional.interpolate(torch.rand(2, 1, 6, 6) * 20, size=(40, 40), mode="bilinear")[:, 0]
    mask = torch.ones(2, 40, 40, dtype=torch.bool)
    mask[:, :8] = False
    lights = torch.cat([direction(30, 10), direction(30, 10)]).expand(2, 3, 3)
    hard = visible(height, mask, lights)
    assert 0.05 < (hard == 0).float().mean() < 0.9
    assert torch.equal(hard, visible(height + 8, mask, lights))
    soft = visible(height, mask, lights, torch.tensor([0.1, 0.0]))
    assert torch.equal(soft[0] == 1, hard[0] == 1)
    assert ((soft[0] > 0) & (soft[0] < 1)).float().mean() > 0.02
    assert (soft[1] - hard[1]).abs().gt(0.01).float().mean() < 1e-3
    frontal = visible(height, mask, torch.tensor([0.0, 0.0, 1.0]).expand(2, 1, 3))
    assert frontal[mask[:, None]].min() == 1


def test_what_is_outside_the_mask_throws_no_shadow() -> None:
    height = torch.zeros(1, 32, 32)
    height[..., 20:] = 50.0
    mask = height < 1
    assert visible(height, mask, direction(20, 0))[mask[:, None]].min() == 1


def test_shadows_from_outside_come_as_often_as_asked() -> None:
    lit = thrown_in(Draws(3, 1, CPU), 400, 3, 32, share=0.5, each=0.6)
    assert lit.shape == (400, 3, 32, 32)
    assert set(np.unique(lit.numpy())) == {0.0, 1.0}
    touched = (lit == 0).flatten(2).any(2)
    assert touched.any(1).float().mean() == pytest.approx(0.5 * (1 - 0.4**3) * 0.9, abs=0.08)
    assert 0.1 < (1 - lit)[touched].mean() < 0.5
    assert thrown_in(Draws(3, 1, CPU), 50, 3, 32, share=0.0, each=1.0).min() == 1
