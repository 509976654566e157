"""The group network in tiles sees what it sees at one look: where its trunk looks at the whole, and where at each tile's surroundings."""

from __future__ import annotations

import pytest
import torch

from learn.group_tiles import Given, layers_in_tiles
from learn.models import create_model
from learn.models.group import GroupNet, shrink_of
from learn.removers import tiles


@pytest.fixture(scope="module")
def shaken() -> GroupNet:
    """A network of little reach with every weight drawn at random, the last layers included, which looks again twice."""
    torch.manual_seed(0)
    network = create_model("group", widths=[6, 8], head=6, rounds=2)
    assert isinstance(network, GroupNet)
    for layer in (network.out, network.change):
        torch.nn.init.normal_(layer.weight, std=0.3)
    return network.eval().double()


def looks(network: GroupNet, mask: torch.Tensor, most: int, known: bool) -> tuple[float, int]:
    """The largest difference of any layer in tiles from the one look, and how often the trunk looked. Pictures of noise, three of them."""
    noise = torch.Generator().manual_seed(1)
    h, w = mask.shape
    images = torch.rand(1, 3, 3, h, w, generator=noise, dtype=torch.float64) + 0.1
    valid = torch.rand(1, 3, h, w, generator=noise) > 0.1
    lights = torch.nn.functional.normalize(torch.tensor([[0, 0, 1.0], [0.5, 0, 1], [-0.4, 0.3, 1]]).double(), dim=1)[None]
    toward = lights if known else None
    times = []
    handle = network.coarse.register_forward_hook(lambda *_: times.append(1))
    apart = 0.0
    with torch.inference_mode():
        whole = network(images, toward, valid, mask[None], shrink=shrink_of(mask))
        times.clear()
        given = Given(lambda part: images[(..., *part)], lambda part: valid[(..., *part)], mask, toward)
        for part, layers in layers_in_tiles(network, given, tiles(h, w, 128 * 128), most):
            for name in ("matte", "diffuse", "specular", "confidence", "normals"):
                inside = mask[part].expand(getattr(layers, name).shape)
                difference = (getattr(layers, name) - getattr(whole, name)[(..., *part)]).abs()
                apart = max(apart, float((difference * inside).max()))
    handle.remove()
    return apart, len(times)


@pytest.mark.parametrize("known", [True, False])
def test_one_look_of_the_trunk_serves_all_tiles(shaken: GroupNet, known: bool) -> None:
    y, x = torch.meshgrid(torch.arange(101), torch.arange(231), indexing="ij")
    mask = ((x - 110) / 110) ** 2 + ((y - 50) / 50) ** 2 < 1
    assert shrink_of(mask) == 2
    apart, times = looks(shaken, mask, 10**6, known)
    assert times == 1
    assert apart < 1e-9


def test_a_thin_object_is_looked_at_around_each_tile(shaken: GroupNet) -> None:
    """Too large for one look even of the trunk, which then sees as far around a tile as it can."""
    y, x = torch.meshgrid(torch.arange(90), torch.arange(331), indexing="ij")
    mask = (x - 3 * y).abs() < 20
    assert shrink_of(mask) == 1
    apart, times = looks(shaken, mask, 1000, True)
    assert times >= 2
    assert apart < 1e-9
