"""The training world: reproducible, its truth consistent, its geometry right after every turn, its lights well spread."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gen.errors import InputError
from gen.sets.pack import header_bytes, read_pack
from learn.brdf_family import random_material
from learn.light_sets import FLATTEST, MAX_CONDITION, STEEPEST, condition_number, random_lights
from learn.random_fields import TEXTURES, Draws, octaves, textures
from learn.views import ViewBank, Views, height_in_pixels, moved, random_relief, with_detail
from learn.world import CaptureBatch, World, relight

CPU = torch.device("cpu")
SMALL = {"size": 32, "large": 0.0}


def bowl(size: int, m_per_pixel: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals, depth in metres and mask of a lopsided dome, unlike any of its own mirror images; the closed form."""
    y, x = np.meshgrid((size - 1) / 2 - np.arange(size), np.arange(size) - (size - 1) / 2, indexing="ij")
    half = 0.45 * size
    mask = (x - 3) ** 2 + y**2 < half**2
    height = 20 * np.exp(-((x - 5) ** 2 + 2 * (y + 4) ** 2) / (2 * 12.0**2))
    p, q = -(x - 5) / 144 * height, -2 * (y + 4) / 144 * height
    normals = np.stack([-p, -q, np.ones_like(p)], -1) / np.sqrt(1 + p**2 + q**2)[..., None]
    return (
        (normals * mask[..., None]).astype(np.float32),
        np.where(mask, 0.3 - height * m_per_pixel, np.nan).astype(np.float32),
        mask,
    )


@pytest.fixture(scope="module")
def pack_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pack of two views of 72 x 72 pixels, of the splits a and b."""
    normals, depth, mask = (np.stack(maps) for maps in zip(bowl(72, 0.5e-3), bowl(72, 2e-3), strict=True))
    arrays: dict[str, tuple[str, np.ndarray]] = {
        "normals": ("F32", normals),
        "depth": ("F32", depth),
        "mask": ("BOOL", mask),
        "valid": ("BOOL", mask),
        "lights": ("F32", np.tile(np.array([0, 0, 1], np.float32), (2, 1))),
        "intensities": ("F32", np.ones((2, 3), np.float32)),
        "item": ("I32", np.arange(2, dtype=np.int32)),
    }
    facts = {"items": [{"id": str(i), "frames": [i, i + 1], "split": "ab"[i]} for i in range(2)]}
    metadata = {"format": "degloss pack", "version": "1", "facts": json.dumps(facts)}
    opening, places = header_bytes({name: (kind, a.shape) for name, (kind, a) in arrays.items()}, metadata)
    path = tmp_path_factory.mktemp("world") / "views.pack"
    content = bytearray(opening + bytes(sum(a.nbytes for _, a in arrays.values())))
    for name, (_, a) in arrays.items():
        content[places[name] : places[name] + a.nbytes] = np.ascontiguousarray(a).tobytes()
    path.write_bytes(bytes(content))
    return path


def same(one: CaptureBatch, two: CaptureBatch) -> bool:
    pairs = [(getattr(one, f.name), getattr(two, f.name)) for f in fields(CaptureBatch)]
    return all(torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b for a, b in pairs)


@pytest.mark.parametrize("views", [False, True])
def test_a_batch_is_a_function_of_seed_and_step(views: bool, pack_path: Path) -> None:
    data = {**SMALL, "views": str(pack_path) if views else ""}
    world = World(data, 3, seed=7)
    first = world.batch(5)
    world.batch(6)
    assert same(first, world.batch(5))
    assert same(first, World(data, 3, seed=7).batch(5))
    for other in (world.batch(6), World(data, 3, seed=8).batch(5)):
        assert other.images.shape != first.images.shape or not torch.equal(other.images, first.images)


@pytest.mark.parametrize("kind", ["wide", "narrow"])
def test_a_batch_is_what_it_says(kind: str, pack_path: Path) -> None:
    world = World({**SMALL, "world": kind, "views": str(pack_path)}, 6, seed=1)
    for step in range(6):
        b = world.batch(step)
        B, K = b.images.shape[:2]
        assert B == 6
        assert 1 <= K <= 10
        for name in ("images", "matte", "diffuse", "specular"):
            layer = getattr(b, name)
            assert layer.shape == (B, K, 3, 32, 32)
            assert layer.dtype == torch.float32
            assert layer.isfinite().all()
            assert (layer[~b.mask[:, None, None].expand_as(layer)] == 0).all()
            assert name == "images" or layer.min() >= 0
        assert b.valid.dtype == b.mask.dtype == torch.bool
        assert b.valid.shape == (B, K, 32, 32)
        assert not (b.valid & ~b.mask[:, None]).any()
        assert torch.allclose(b.lights.norm(dim=-1), torch.ones(B, K), atol=1e-5)
        length = b.normals.norm(dim=1)
        assert torch.allclose(length, b.mask.float(), atol=1e-5)
        assert b.normals[:, 2].min() >= 0
        assert b.mask.float().mean((1, 2)).min() > 0.05
        # The matte twin is at most white, but for near lights, and dark where the surface turns from the stated light by more than it errs.
        assert b.matte.max() < 1.6
        away = torch.einsum("bchw,bkc->bkhw", b.normals, b.lights) < -0.35
        assert (b.matte.amax(2)[away] == 0).all()
        assert (b.diffuse.amax(2)[away] == 0).all()
        assert b.valid.float().mean() > 0.2


def test_a_share_of_the_batches_is_large_and_a_share_is_not_told_the_lights(pack_path: Path) -> None:
    world = World({"size": 24, "lights": 3, "large": 0.5, "dropped": 0.5, "views": str(pack_path)}, 8, seed=4)
    batches = [world.batch(step) for step in range(24)]
    shapes = {tuple(b.images.shape) for b in batches}
    assert shapes == {(8, 3, 3, 24, 24), (2, 3, 3, 48, 48)}
    assert 4 < sum(len(b.images) == 2 for b in batches) < 20
    assert 4 < sum(b.told for b in batches) < 20
    assert world.pictures == 15


def test_what_is_looked_at_from_nearer_keeps_its_slopes(pack_path: Path) -> None:
    bank = ViewBank(read_pack(pack_path), 24, CPU)
    views = bank.crops(Draws(3, 0, CPU), 6, 80)  # larger than the pack's pictures: all drawn out
    assert views.mask.shape == (6, 80, 80)
    slopes_agree(views, 1.0)


def test_the_narrow_world_is_lambertian_and_true_where_nothing_shines() -> None:
    """Its pictures are the layers' sum where valid, up to noise, and its matte twin is albedo * n.l of the stated lights: rank one."""
    b = World({**SMALL, "world": "narrow", "lights": 5}, 16, seed=3).batch(0)
    total = b.diffuse + b.specular
    seen = b.valid[:, :, None].expand_as(total)
    assert (b.images - total)[seen].abs().median() < 0.01
    shading = torch.einsum("bchw,bkc->bkhw", b.normals, b.lights).clamp_min(0)[:, :, None]
    lit = (shading > 0.05) & (b.matte > 0)
    albedo = torch.where(lit, b.matte / shading.clamp_min(0.05), 0.0)
    brightest = albedo.amax(1, keepdim=True).expand_as(albedo)
    assert torch.allclose(albedo[lit], brightest[lit], rtol=1e-3)
    assert brightest.max() <= 0.981


def test_the_wide_world_is_as_shiny_and_as_matte_as_promised() -> None:
    world = World({"size": 16, "lights": 2, "large": 0.0}, 64, seed=2)
    share = []
    for step in range(3):
        b = world.batch(step)
        share.append(b.specular.flatten(1).amax(1) / (b.matte.flatten(1).amax(1) + 1e-3))
    shares = torch.cat(share)
    assert (shares < 0.1).float().mean() > 0.2
    assert (shares > 1).float().mean() > 0.3
    assert (shares > 20).float().mean() > 0.03


def test_a_share_of_the_batches_is_clean() -> None:
    """In the wide world stated lights are off by what the camera did; where all batches are clean they are the true ones."""

    def misstated(clean: float) -> list[bool]:
        found = []
        for step in range(8):
            batch = World({**SMALL, "lights": 3, "clean": clean}, 4, 5).batch(step)
            shading = torch.einsum("bkc,bchw->bkhw", batch.lights, batch.normals).clamp(min=0)
            matte = batch.matte.sum(2)
            lit = (matte > 0).all(1, keepdim=True) & batch.mask[:, None]
            ratio = torch.where(lit, matte / shading.clamp(min=1e-6), 0.0)
            found.append(bool((ratio - ratio[:, :1]).abs().gt(1e-3 * ratio[:, :1] + 1e-4).any()))
        return found

    assert all(misstated(0.0))
    assert not any(misstated(1.0))
    assert 0 < sum(misstated(0.5)) < 8


def test_pictures_turn_with_their_lights_order() -> None:
    draws = Draws(1, 2, CPU)
    views = random_relief(draws, 3, 32)
    material = random_material(draws, 3, 32)
    lights = torch.from_numpy(np.stack([random_lights(draws.rng, 6) for _ in range(3)])).float()
    order = torch.tensor([3, 0, 5, 1, 4, 2])
    for one, two in zip(relight(views, lights, material), relight(views, lights[:, order], material), strict=True):
        assert torch.equal(one[:, order], two)


def slopes_agree(views: Views, tolerance: float) -> None:
    """Finite differences of the height are what the normals say, in most pixels well inside."""
    h, n, m = views.height, views.normals, views.mask
    inside = m[:, 1:-1, 1:-1] & m[:, 1:-1, 2:] & m[:, 1:-1, :-2] & m[:, 2:, 1:-1] & m[:, :-2, 1:-1]
    dx = 0.5 * (h[:, 1:-1, 2:] - h[:, 1:-1, :-2])
    dy = 0.5 * (h[:, :-2, 1:-1] - h[:, 2:, 1:-1])
    found = torch.stack([-dx, -dy, torch.ones_like(dx)], 1)
    cosine = (found * n[:, :, 1:-1, 1:-1]).sum(1) / found.norm(dim=1)
    angle = torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))
    for i in range(len(h)):
        if inside[i].sum() > 20:
            assert angle[i][inside[i]].median() < tolerance, i


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("mirrored", [False, True])
def test_normals_turn_with_the_height(quarters: int, mirrored: bool) -> None:
    normals, depth, mask = bowl(48, 1.0)
    height = np.where(mask, 0.3 - depth, 0).astype(np.float32)
    view = moved(
        torch.from_numpy(np.moveaxis(normals, 2, 0).copy()), torch.from_numpy(height), torch.from_numpy(mask), mirrored, quarters
    )
    slopes_agree(Views(view.normals[None], view.height[None], view.mask[None]), 0.5)
    kept = torch.equal(view.mask, torch.from_numpy(mask)) and torch.equal(view.height, torch.from_numpy(height))
    assert kept == (quarters == 0 and not mirrored)


@pytest.mark.parametrize("m_per_pixel", [1e-5, 1e-3, 1.0])
def test_heights_find_their_own_scale(m_per_pixel: float) -> None:
    normals, depth, mask = bowl(64, m_per_pixel)
    height = height_in_pixels(normals, depth, mask)
    expected = (0.3 - depth[mask].astype(np.float64)) / m_per_pixel
    assert height[mask] - height[mask].mean() == pytest.approx(expected - expected.mean(), abs=0.3)
    assert (height[~mask] == 0).all()
    flat = np.zeros_like(normals)
    flat[..., 2] = 1
    assert (height_in_pixels(flat, np.full(mask.shape, 2.0), mask) == 0).all()


def test_a_bank_gives_crops_of_its_views(pack_path: Path) -> None:
    bank = ViewBank(read_pack(pack_path), 32, CPU)
    assert len(bank) == 2
    views = bank.crops(Draws(1, 1, CPU), 24)
    assert views.normals.shape == (24, 3, 32, 32)
    assert views.mask.float().mean((1, 2)).min() >= 0.25
    assert torch.allclose(views.normals.norm(dim=1), views.mask.float(), atol=1e-5)
    slopes_agree(views, 1.5)
    assert len({tuple(view.flatten().tolist()) for view in views.height}) == 24


def test_reliefs_are_varied_and_their_normals_are_their_slopes() -> None:
    views = random_relief(Draws(1, 0, CPU), 60, 64)
    assert torch.allclose(views.normals.norm(dim=1), views.mask.float(), atol=1e-5)
    slopes_agree(views, 3.0)
    tilt = torch.rad2deg(torch.acos(views.normals[:, 2].clamp(0, 1))).where(views.mask, torch.nan).flatten(1).nanmean(1)
    assert tilt.min() < 12
    assert tilt.max() > 35
    assert (views.mask.flatten(1).all(1)).float().mean() > 0.2
    assert views.mask.float().mean((1, 2)).min() > 0.1
    steep = (views.normals[:, 2] < 0.25) & views.mask
    assert steep.flatten(1).any(1).float().mean() > 0.15, "some show their silhouettes"


def test_fine_detail_changes_normals_alone() -> None:
    views = random_relief(Draws(1, 0, CPU), 40, 32)
    detailed = with_detail(Draws(2, 0, CPU), views, 0.5)
    changed = (detailed.normals != views.normals).flatten(1).any(1)
    assert 0.25 < changed.float().mean() < 0.75
    assert torch.equal(detailed.mask, views.mask)
    assert torch.equal(detailed.height, views.height)
    assert torch.allclose(detailed.normals.norm(dim=1), views.mask.float(), atol=1e-5)
    assert with_detail(Draws(2, 0, CPU), views, 0.0) is views


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 10, 16])
def test_lights_are_spread_and_above_the_object(count: int) -> None:
    rng = np.random.default_rng(count)
    frontal = 0
    for _ in range(60):
        lights = random_lights(rng, count)
        assert lights.shape == (count, 3)
        assert np.linalg.norm(lights, axis=1) == pytest.approx(1)
        tilt = np.degrees(np.arccos(lights[:, 2].clip(-1, 1)))
        assert tilt.max() <= FLATTEST + 1e-6
        assert (tilt < STEEPEST - 1e-6).sum() <= 1, "only one may be frontal"
        frontal += int(tilt.min() < STEEPEST)
        assert count < 3 or condition_number(lights) < MAX_CONDITION
    assert 10 < frontal < 40


def test_textures_fill_their_range() -> None:
    for kind in TEXTURES:
        maps = textures(Draws(1, 1, CPU), 30, 24, {kind: 1.0})
        assert maps.shape == (30, 24, 24)
        assert maps.min() >= 0
        assert maps.max() <= 1
        assert kind == "constant" or (maps.flatten(1).std(1) > 0.02).float().mean() > 0.7, kind
    noise = octaves(Draws(1, 1, CPU), torch.ones(40, 1), 48)
    assert 0.3 < noise.std() < 1.5


def test_the_number_of_lights_is_as_asked() -> None:
    assert World({**SMALL, "lights": 4}, 2, 0).batch(0).images.shape[1] == 4
    assert World({**SMALL, "lights": 4}, 2, 0).pictures == 8
    two_or_three = World({**SMALL, "lights": [0, 1, 1]}, 2, 0)
    assert {two_or_three.batch(step).images.shape[1] for step in range(12)} == {2, 3}
    mixed = World(SMALL, 1, 0)
    counts = [mixed.batch(step).images.shape[1] for step in range(40)]
    assert max(set(counts), key=counts.count) == 5
    assert len(set(counts)) > 4
    assert mixed.steps_per_epoch is None


@pytest.mark.parametrize(
    ("data", "batch", "message"),
    [
        ({"sise": 3}, 2, "unknown option 'sise'"),
        ({"size": 8}, 2, "size = 8 must be from 16"),
        ({"world": "flat"}, 2, "world = 'flat' is unknown"),
        ({"reliefs": 1.5}, 2, "reliefs = 1.5"),
        ({"clean": -0.1}, 2, "clean = -0.1"),
        ({"broad": 1.5}, 2, "broad = 1.5"),
        ({"broad": 0.5}, 2, "clean = 0 leaves none"),
        ({"lights": 0}, 2, "lights = 0 must be"),
        ({"lights": [0.0, -1.0]}, 2, "lights ="),
        ({"lights": "few"}, 2, "lights = 'few'"),
        ({}, 0, "batch = 0"),
        ({"views": "missing.pack"}, 2, "missing.pack: there is no such file"),
    ],
)
def test_bad_options_are_said_in_one_line(data: dict[str, Any], batch: int, message: str) -> None:
    with pytest.raises(InputError, match=message) as raised:
        World(data, batch, 0)
    assert "\n" not in str(raised.value)


def test_a_pack_that_does_not_serve_is_refused(pack_path: Path) -> None:
    views = str(pack_path)
    assert len(World({**SMALL, "views": views, "split": "a"}, 1, 0).bank or []) == 1
    with pytest.raises(InputError, match="no items of the split 'c'"):
        World({**SMALL, "views": views, "split": "c"}, 1, 0)
    with pytest.raises(InputError, match=r"are 72x72 pixels, crops of 96 do not fit"):
        World({"size": 96, "views": views}, 1, 0)
