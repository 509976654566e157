"""Crops of rendered captures: however they are mirrored and turned, the light still falls on the surface as the truth says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from gen.errors import InputError
from gen.sets.pack import header_bytes, read_pack
from learn.random_fields import Draws
from learn.rendered import LAYERS, RenderBank
from learn.world import World

CPU = torch.device("cpu")
SIZE, LIGHTS = 40, 5


def write_pack(path: Path, without: str = "", lights: int = LIGHTS) -> Path:
    """Two captures of a sphere with an albedo of three slopes under lights of unequal intensity; matte = albedo * max(n.l, 0)."""
    rng = np.random.default_rng(0)
    y, x = np.meshgrid((SIZE - 1) / 2 - np.arange(SIZE), np.arange(SIZE) - (SIZE - 1) / 2, indexing="ij")
    x, y = x / 17 - 0.1, y / 17 + 0.2
    mask = x**2 + y**2 < 0.9
    normals = np.stack([x, y, np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))], -1) * mask[..., None]
    albedo = np.stack([0.5 + 0.2 * x, 0.5 + 0.2 * y, 0.4 - 0.1 * x], -1) * mask[..., None]
    directions = rng.normal(size=(2 * lights, 3)) * [0.5, 0.5, 0] + [0, 0, 1]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    strength = rng.uniform(0.5, 2, (2 * lights, 3))
    matte = albedo * np.maximum(np.einsum("hwi,ki->khw", normals, directions), 0)[..., None] * strength[:, None, None]
    whole = {
        "diffuse": ("F16", 0.8 * matte), "specular": ("F16", 0.1 * matte), "matte": ("F16", matte),
        "albedo": ("F16", np.stack([albedo] * 2)), "normals": ("F32", np.stack([normals] * 2)), "mask": ("BOOL", np.stack([mask] * 2)),
        "valid": ("BOOL", np.stack([mask] * 2 * lights)), "lights": ("F32", directions), "intensities": ("F32", strength),
        "item": ("I32", np.repeat([0, 1], lights)),
    }  # fmt: skip
    kinds = {"F16": np.float16, "F32": np.float32, "BOOL": np.bool_, "I32": np.int32}
    arrays = {name: (kind, a.astype(kinds[kind])) for name, (kind, a) in whole.items() if name != without}
    facts = {"items": [{"id": str(i), "frames": [i * lights, (i + 1) * lights]} for i in range(2)]}
    metadata = {"format": "degloss pack", "version": "1", "facts": json.dumps(facts)}
    opening, places = header_bytes({name: (kind, a.shape) for name, (kind, a) in arrays.items()}, metadata)
    content = bytearray(opening + bytes(sum(a.nbytes for _, a in arrays.values())))
    for name, (_, a) in arrays.items():
        content[places[name] : places[name] + a.nbytes] = np.ascontiguousarray(a).tobytes()
    path.write_bytes(bytes(content))
    return path


@pytest.mark.parametrize("size", [24, 48])
def test_crops_are_lit_as_their_truth_says(tmp_path: Path, size: int) -> None:
    bank = RenderBank(read_pack(write_pack(tmp_path / "a.pack")), CPU)
    for step in range(6):  # mirrored and not, all quarters
        found = bank.crops(Draws(1, step, CPU), 4, 4, size)
        assert found.matte.shape == (4, 4, 3, size, size)
        shading = torch.einsum("bchw,bkc->bkhw", found.normals, found.lights).clamp_min(0)
        expected = found.albedo[:, None] * shading[:, :, None]
        assert torch.allclose(found.matte, expected, atol=3e-3)
        assert torch.allclose(found.diffuse, 0.8 * expected, atol=3e-3)
        assert (found.matte[~found.mask[:, None, None].expand_as(found.matte)] == 0).all()


def test_more_lights_than_there_are_is_as_many_as_there_are(tmp_path: Path) -> None:
    bank = RenderBank(read_pack(write_pack(tmp_path / "a.pack")), CPU)
    assert bank.crops(Draws(1, 0, CPU), 2, 9, 24).lights.shape == (2, LIGHTS, 3)


@pytest.mark.parametrize("layer", LAYERS)
def test_a_pack_without_a_layer_is_refused(tmp_path: Path, layer: str) -> None:
    with pytest.raises(InputError, match=layer):
        RenderBank(read_pack(write_pack(tmp_path / "a.pack", without=layer)), CPU)


def test_a_pack_of_single_pictures_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="three lights"):
        RenderBank(read_pack(write_pack(tmp_path / "a.pack", lights=1)), CPU)


def test_the_world_takes_its_share_from_renders(tmp_path: Path) -> None:
    path = write_pack(tmp_path / "a.pack")
    data = {"size": 24, "large": 0.0, "lights": 4, "captures": str(path)}
    given = World({**data, "rendered": 1.0}, 3, seed=1).batch(0)
    away = given.diffuse + given.specular - 0.9 * given.matte
    assert float(away.abs().max()) < 3e-3
    assert given.images.shape == (3, 4, 3, 24, 24)
    assert float((given.images - 0.9 * given.matte)[given.valid[:, :, None].expand_as(given.matte)].abs().median()) < 0.05
    assert torch.equal(given.images, World({**data, "rendered": 1.0}, 3, seed=1).batch(0).images)
    other = World({**data, "rendered": 0.0}, 3, seed=1).batch(0)
    assert float((other.diffuse + other.specular - 0.9 * other.matte).abs().max()) > 0.01
