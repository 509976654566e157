"""The group network: what holds of it whatever its weights are, and what the shipped weights have to do."""

from __future__ import annotations

import copy
import dataclasses
from itertools import pairwise

import numpy as np
import pytest
import torch

from gen.errors import InputError
from learn.method import create_method
from learn.methods.group import judge
from learn.models import create_model
from learn.models.evidence import evidence, luminance
from learn.models.group import GroupLayers, GroupNet, shrink_of, shrunk_features
from learn.solve import angle, unit, weighted_least_squares
from learn.world import World
from tests.conftest import Synthetic


@pytest.fixture(scope="module")
def shaken() -> GroupNet:
    """A network with every weight drawn at random, the last layers included."""
    torch.manual_seed(0)
    network = create_model("group", widths=[8, 12, 16])
    assert isinstance(network, GroupNet)
    for layer in (network.out, network.change):
        torch.nn.init.normal_(layer.weight, std=0.3)
    return network.eval()


@pytest.fixture(scope="module")
def batch() -> World:
    return World({"reliefs": 1.0, "size": 32, "lights": 5, "large": 0.0}, 2, 5)


@torch.no_grad()
def test_untrained_it_is_least_squares() -> None:
    given = World({"reliefs": 1.0, "size": 32, "lights": 5, "large": 0.0}, 2, 5).batch(0)
    found = create_model("group").eval()(given.images, given.lights, given.valid, given.mask)
    assert torch.allclose(found.matte, given.images.clamp(min=0))
    assert torch.allclose(found.diffuse + found.specular, given.images, atol=1e-6)
    every = torch.ones_like(given.valid)
    found = create_model("group").eval()(given.images, given.lights, every, given.mask)
    luma = (given.images.clamp(min=0) * torch.tensor([0.2989, 0.5870, 0.1140])[:, None, None]).sum(2)
    plain = unit(weighted_least_squares(luma, given.lights, torch.ones_like(luma)))
    assert float(angle(found.normals, plain)[given.mask].max()) < 1e-3


@torch.no_grad()
def test_order_of_the_pictures_is_the_order_of_the_result(shaken: GroupNet) -> None:
    """In double precision: where hardly a light reaches a pixel, single precision lets the order of a sum be seen."""
    network = copy.deepcopy(shaken).double()
    for lights in (5, 8):
        given = World({"reliefs": 1.0, "size": 32, "lights": lights, "large": 0.0}, 2, 5).batch(1)
        order = torch.randperm(lights, generator=torch.Generator().manual_seed(2))
        images, directions = given.images.double(), given.lights.double()
        one = network(images, directions, given.valid, given.mask)
        two = network(images[:, order], directions[:, order], given.valid[:, order], given.mask)
        assert torch.allclose(one.matte[:, order], two.matte, rtol=1e-5, atol=1e-6)
        assert torch.allclose(one.confidence[:, order], two.confidence, atol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 16])
@pytest.mark.parametrize("known", [True, False])
@torch.no_grad()
def test_any_number_of_pictures_with_lights_or_without(shaken: GroupNet, count: int, known: bool) -> None:
    torch.manual_seed(count)
    images, valid = torch.rand(1, count, 3, 21, 30), torch.rand(1, count, 21, 30) > 0.1
    lights = unit(torch.rand(count, 3) + torch.tensor([-0.5, -0.5, 0.5]))[None]
    found = shaken(images, lights if known else None, valid, torch.ones(1, 21, 30, dtype=torch.bool))
    assert found.matte.shape == found.specular.shape == images.shape
    assert found.confidence.shape == valid.shape
    assert all(torch.isfinite(layer).all() for layer in (found.matte, found.diffuse, found.confidence, found.normals))
    assert torch.allclose(found.diffuse + found.specular, images, atol=1e-6)
    assert (found.confidence >= 0).all()
    assert (found.confidence <= 1).all()
    assert bool((found.normals == 0).all()) != known


@torch.no_grad()
def test_units_of_the_pictures_do_not_matter(shaken: GroupNet, batch: World) -> None:
    given = batch.batch(2)
    one = shaken(given.images, given.lights, given.valid, given.mask)
    two = shaken(64 * given.images, given.lights, given.valid, given.mask)
    assert torch.allclose(64 * one.matte, two.matte, rtol=0.03, atol=0.03)


@torch.no_grad()
def test_what_lies_far_away_does_not_matter(shaken: GroupNet) -> None:
    """A tile gives what the whole gives, where both are equally bright on average."""
    torch.manual_seed(4)
    images, lights = torch.rand(1, 5, 3, 48, 160), unit(torch.rand(5, 3) + torch.tensor([-0.5, -0.5, 0.5]))[None]
    mask = torch.ones(1, 48, 160, dtype=torch.bool)
    valid = torch.ones(1, 5, 48, 160, dtype=torch.bool)
    whole = shaken(images, lights, valid, mask)
    part = shaken(images[..., :112], lights, valid[..., :112], mask[..., :112])
    assert torch.allclose(whole.confidence[..., :32], part.confidence[..., :32], atol=0.02)


@pytest.mark.parametrize("shrink", [2, 3])
@torch.no_grad()
def test_a_picture_drawn_out_by_whole_pixels_looks_the_same_to_the_trunk(batch: World, shrink: int) -> None:
    given = batch.batch(3)

    def drawn_out(maps: torch.Tensor) -> torch.Tensor:
        return maps.repeat_interleave(shrink, -1).repeat_interleave(shrink, -2)

    images, lights = given.images.double(), given.lights.double()
    parts = (drawn_out(images), lights, drawn_out(given.valid), drawn_out(given.mask))
    once = evidence(images, lights, given.valid, given.mask).features.flatten(0, 1)
    assert torch.allclose(shrunk_features(*parts, shrink), once, atol=1e-5)


def test_large_objects_are_shrunk_for_the_trunk() -> None:
    mask = torch.zeros(2, 300, 300, dtype=torch.bool)
    mask[:, :128, :128] = True
    assert shrink_of(mask) == shrink_of(mask[0]) == 2
    assert shrink_of(mask[:, :64, :64]) == shrink_of(torch.zeros(8, 8, dtype=torch.bool)) == 1
    assert shrink_of(torch.ones(4000, 4000, dtype=torch.bool)) == 16


@torch.no_grad()
def test_each_refinement_sees_the_one_before(batch: World) -> None:
    given = batch.batch(0)
    torch.manual_seed(3)
    network = create_model("group", widths=[8, 12], head=8, rounds=3).train()
    torch.nn.init.normal_(network.out.weight, std=0.3)
    torch.nn.init.normal_(network.change.weight, std=0.3)
    found = network(given.images, given.lights, given.valid, given.mask)
    matte = [*(layers.matte for layers in found.earlier), found.matte]
    assert len(matte) == 4
    assert all(not torch.allclose(one, two) for one, two in pairwise(matte))


@torch.no_grad()
def test_the_colour_of_the_matte_layer_is_judged_by_its_angle(batch: World) -> None:
    """Of the truth itself it is 0, and of grey ones it is that between each albedo and grey."""
    given = batch.batch(8)
    layers = GroupLayers(given.matte, given.diffuse, given.specular, given.valid.float(), given.normals)
    loss, exact = judge(layers, given)
    assert float(exact["degrees_colour"]) < 0.1
    grey = given.matte.mean(2, keepdim=True).expand_as(given.matte)
    worse, wrong = judge(dataclasses.replace(layers, matte=grey), given)
    total = (given.matte * given.valid.unsqueeze(2)).sum(1)
    cosine = total.sum(1) / (3**0.5 * total.norm(dim=1).clamp(min=1e-12))
    seen = given.mask & given.valid.any(1) & (total.sum(1) > 0)
    expected = torch.rad2deg(torch.arccos(cosine.clamp(max=1)))[seen].mean()
    assert float(expected) > 2
    assert float(wrong["degrees_colour"]) == pytest.approx(float(expected), rel=0.05)
    assert float(worse) > float(loss)


def test_learns_four_captures() -> None:
    method = create_method("group")
    torch.manual_seed(0)
    network = method.build({"widths": [8, 12, 16], "head": 16}).train()
    source = method.source({"reliefs": 1.0, "size": 24, "lights": 5, "large": 0.0}, 4, 3, torch.device("cpu"), "train")
    given = source.batch(0)
    optimiser = torch.optim.Adam(network.parameters(), 4e-3)
    figures = []
    for _ in range(60):
        loss, _ = method.loss(network, given, 0.0)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        figures.append(float(loss.detach()))
    assert figures[-1] < 0.75 * figures[0]
    assert method.samples(network.eval(), given).dtype == np.uint8


def test_under_bf16_it_says_nearly_the_same_and_solves_in_full(shaken: GroupNet, batch: World) -> None:
    given = batch.batch(0)
    with torch.no_grad():
        one = shaken(given.images, given.lights, given.valid, given.mask)
        with torch.autocast("cpu", torch.bfloat16):
            two = shaken(given.images, given.lights, given.valid, given.mask)
    assert two.normals.dtype == two.matte.dtype == torch.float32
    solved = unit(weighted_least_squares(luminance(two.matte), given.lights, two.confidence))
    assert torch.equal(solved, two.normals)
    assert float((one.confidence - two.confidence).abs().mean()) < 0.02


def test_size_is_bounded() -> None:
    assert sum(p.numel() for p in create_model("group").parameters()) < 3e6


@pytest.mark.parametrize(
    "options", [{"widths": [8]}, {"widths": [8, 2]}, {"head": 1}, {"depth": 3}, {"rounds": 9}, {"widths": "8"}]
)
def test_impossible_options_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(InputError):
        create_method("group").build(options)


def test_shipped_weights_do_matte_surfaces_no_harm(synthetic: Synthetic) -> None:
    """Matte pictures under five lights are measured better than by least squares alone, which takes shadows at their word."""
    from learn.real import errors
    from learn.removers import remover

    for shape in ("sphere", "cylinder"):
        capture = synthetic(shape, size=96, layer="matte")
        assert errors(capture, remover("group")) < errors(capture, None)


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_shipped_weights_close_most_of_the_gap(synthetic: Synthetic, shape: str) -> None:
    from learn.real import errors
    from learn.removers import remover

    capture = synthetic(shape, size=96)
    glossy, matte = errors(capture, None), errors(synthetic(shape, size=96, layer="matte"), None)
    assert errors(capture, remover("group")) < glossy - 0.6 * (glossy - matte)


@pytest.mark.data
def test_real_photographs_get_better(data_folder: object) -> None:
    from pathlib import Path

    from learn.real import photographs
    from learn.removers import remover

    figures = photographs(Path(str(data_folder)) / "diligent", remover("group"), count=2, whole=False)
    assert figures
    for row in figures.values():
        assert row["ratio"] < 1
