"""Relighting in torch: against the reference BRDFs in double precision, against Cycles on real renders, and its laws."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import torch

from gen.brdfs import BRDFS
from gen.capture import Capture
from gen.errors import InputError
from gen.farm import Farm
from gen.render import render
from gen.spec import spec_from
from learn.brdf_family import COATED, NARROW, SUBSTRATE, WIDE, Material, material_of, random_material, shade_material
from learn.random_fields import Draws
from learn.views import Views, height_in_pixels
from learn.world import relight

CPU = torch.device("cpu")
VALUES: dict[str, dict[str, Any]] = {
    "lambertian": {"diffuse": [0.8, 0.4, 0.1]},
    "substrate": {"diffuse": [0.8, 0.4, 0.1], "specular": [0.5, 0.2, 0.04], "alpha": 0.3},
    "two-lobe": {"diffuse": [0.8, 0.4, 0.1], "specular": [0.04, 0.1, 0.2], "alpha": 0.1, "alpha2": 0.5, "mix": 0.3},
    "oren-nayar": {"diffuse": [0.8, 0.4, 0.1], "specular": [0.04, 0.1, 0.2], "alpha": 0.2, "sigma": math.radians(35)},
    "metal": {"specular": [0.9, 0.6, 0.3], "alpha": 0.25},
}
LIGHTS = [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.3, 0.7, 0.65], [0.2, -0.9, 0.35]]


def directions(count: int, seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    unit: np.ndarray = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def doubled(material: Material) -> Material:
    return Material(**{f.name: getattr(material, f.name).double() for f in fields(Material)})


def chosen(material: Material, index: int, **changes: torch.Tensor) -> Material:
    """One of B materials, with some of its values changed."""
    return Material(**{f.name: changes.get(f.name, getattr(material, f.name)[index : index + 1]) for f in fields(Material)})


@pytest.mark.parametrize("kind", VALUES)
def test_the_family_holds_the_reference_brdfs(kind: str) -> None:
    normal, light = directions(400, 1), directions(5, 2)
    maps = torch.from_numpy(normal.T.reshape(1, 3, 20, 20))
    found = shade_material(doubled(material_of(kind, VALUES[kind])), maps, torch.from_numpy(light)[None, :, :, None, None])
    values = {k: np.asarray(np.float32(v), np.float64) for k, v in VALUES[kind].items()}
    for k in range(5):
        expected = BRDFS[kind](normal, light[k], np.array([0.0, 0.0, 1.0]), **values)
        for part, reference in zip(found, expected, strict=True):
            np.testing.assert_allclose(
                part[0, k].reshape(3, 400).T, reference, rtol=1e-7, atol=1e-12
            )  # torch rounds some constants to float32


def test_the_unseen_family_stays_unseen() -> None:
    with pytest.raises(InputError, match=r"blinn-phong.*training does not shade it"):
        material_of("blinn-phong", {"diffuse": [0.5] * 3, "specular": [0.5] * 3, "alpha": 0.2})


@pytest.fixture(scope="module")
def farm() -> Any:
    with Farm() as opened:
        yield opened


def rendered(farm: Farm, shape: dict[str, Any], kind: str, rotation: list[float]) -> Capture:
    values = dict(VALUES[kind])
    if "sigma" in values:
        values["sigma_degrees"] = math.degrees(values.pop("sigma"))
    if "diffuse" in values:
        values["albedo"] = values.pop("diffuse")
    spec = {
        "name": "relit",
        "resolution": [64, 64],
        "shape": shape,
        "pose": {"rotation_degrees": rotation},
        "material": {"kind": kind, **values},
        "lights": LIGHTS,
        "camera": {"kind": "orthographic", "width_mm": 60},
        "exposure": 1.0,
    }
    return render(spec_from(spec, "test"), farm=farm).capture


def views_of(capture: Capture) -> Views:
    normals, depth, mask = capture.truth.normals, capture.truth.depth, capture.mask
    assert normals is not None
    assert depth is not None
    height = height_in_pixels(normals, depth, mask)
    first = torch.from_numpy(np.ascontiguousarray(np.moveaxis(normals, 2, 0)))[None]
    return Views(first, torch.from_numpy(height)[None], torch.from_numpy(mask)[None])


@pytest.mark.render
@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        ("sphere", "substrate"),
        ("cylinder", "two-lobe"),
        ("ellipsoid", "oren-nayar"),
        ("ellipsoid", "metal"),
        ("sphere", "lambertian"),
    ],
)
def test_relighting_is_cycles_on_convex_shapes(shape: str, kind: str, farm: Farm) -> None:
    """Within 1e-4 of the peak: from a render's normals, depth and mask to the layers that Cycles rendered, shadows and all."""
    capture = rendered(farm, {"name": shape}, kind, [20, 30, 10])
    views = views_of(capture)
    lights = torch.from_numpy(capture.lights).float()[None]
    for name, layer in zip(
        ("diffuse", "specular", "matte"), relight(views, lights, material_of(kind, VALUES[kind])), strict=True
    ):
        truth = getattr(capture.truth, name)
        found = layer[0].permute(0, 2, 3, 1).numpy() * capture.intensities[:, None, None].astype(np.float32)
        peak = max(float(truth.max()), 1e-6)
        assert np.abs(found - truth).max() <= 1e-4 * peak, name
        assert name == "specular" or kind == "metal" or peak > 0.3


@pytest.mark.render
def test_cast_shadows_are_those_of_cycles_but_for_their_rims(farm: Farm) -> None:
    """A stepped shaft: what Cycles' rays find, the march over the height field finds in all but a few pixels."""
    capture = rendered(farm, {"name": "stepped_shaft"}, "lambertian", [0, 0, 35])
    views = views_of(capture)
    matte = relight(views, torch.from_numpy(capture.lights).float()[None], material_of("lambertian", VALUES["lambertian"]))[2]
    assert capture.truth.matte is not None
    truth = capture.truth.matte[..., 0]
    facing = np.einsum("hwc,kc->khw", capture.truth.normals, capture.lights) > 0.02
    cast = (truth < 1e-6) & facing & capture.mask
    assert cast.sum() > 30
    wrong = ((matte[0, :, 0].numpy() < 1e-6) != (truth < 1e-6)) & facing & capture.mask
    assert wrong.sum() < 0.005 * (facing & capture.mask).sum()
    assert wrong[cast].mean() < 0.1


def test_matte_never_depends_on_gloss() -> None:
    draws = Draws(1, 1, CPU)
    material = random_material(draws, 12, 16)
    normal = torch.from_numpy(directions(256, 5).T.reshape(1, 3, 16, 16)).float()
    light = torch.tensor(LIGHTS)[None, :, :, None, None]
    for index in range(12):
        full = chosen(material, index)
        other = chosen(
            material,
            index,
            strength=torch.zeros(1, 1, 1, 1),
            alpha=torch.full((1, 1, 1, 1), 0.11),
            specular=torch.full((1, 1, 1, 1), 0.3),
            sigma=torch.tensor([0.5]),
            coat=torch.zeros(1),
            metal=torch.zeros(1, 1, 1, 1),
        )
        matte = shade_material(full, normal, light)[2]
        assert torch.equal(matte, shade_material(other, normal, light)[2])
        expected = (
            full.albedo[0]
            * torch.einsum("chw,kc->khw", normal[0], torch.tensor(LIGHTS)).clamp_min(0)[:, None]
            * (normal[0, 2] > 0)
        )
        assert torch.allclose(matte[0], expected, atol=1e-6)


@pytest.mark.parametrize("view", [0.4, 0.8, 1.0])
def test_no_surface_sends_out_more_than_it_gets(view: float) -> None:
    """The share of light from everywhere that goes to the viewer, of white surfaces of each kind, summed over half vectors."""
    B, tilt = 60, float(np.arccos(view))
    normal = torch.tensor([math.sin(tilt), 0.0, view], dtype=torch.float64).view(1, 3, 1, 1).expand(B, 3, 1, 1)
    u, phi = np.meshgrid((np.arange(120) + 0.5) / 120, (np.arange(48) + 0.5) / 48 * 2 * np.pi, indexing="ij")
    theta = np.pi / 2 * u**2
    h = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    h = h @ np.array([[view, 0, -math.sin(tilt)], [0, 1, 0], [math.sin(tilt), 0, view]])
    light = torch.from_numpy(2 * h[:, 2:] * h - np.array([0.0, 0.0, 1.0]))[None, :, :, None, None]
    # d h = sin(theta) dtheta dphi, d wi = 4 (l.h) d h
    measure = torch.from_numpy(4 * h[:, 2].clip(0) * (np.sin(theta) * np.pi * u).ravel() / 120 * 2 * np.pi / 48 / np.pi)
    drawn = random_material(Draws(2, 7, CPU), B, 16)
    flat = {name: getattr(drawn, name)[:, :, :1, :1] for name in ("alpha", "alpha2", "strength", "metal")}
    white = {"albedo": torch.ones(B, 3, 1, 1), "sheen": torch.zeros(B, 3, 1, 1)}
    material = doubled(replace(drawn, **flat, **white))
    base, lobe = (torch.einsum("bkchw,k->bc", part, measure)[:, 0] for part in shade_material(material, normal, light)[:2])
    wide = (torch.minimum(material.alpha, material.alpha2) > 0.06).flatten()  # others are too narrow for this sum
    assert wide.sum() > 25
    assert lobe[wide].max() < 1.02
    assert base.max() < 1.05
    # A bare base and its lobe are not layered: their sum may exceed the light by what the lobe takes. Coats take their share.
    assert (base + lobe)[wide & (material.coat == SUBSTRATE)].max() < 1.05
    assert (base + lobe)[wide & (material.coat == COATED)].max() < 1.05


def test_the_family_covers_what_it_promises() -> None:
    draws = Draws(4, 2, CPU)
    m = random_material(draws, 3000, 8)
    plain = (m.strength > 0).flatten(1).any(1)
    metal = m.metal.flatten(1).amax(1) > 0
    nearly_matte = ~plain | ((m.specular[:, 0, 0, 0] <= 0.04) & (m.alpha.flatten(1).amin(1) >= 0.4) & (m.coat != 1) & ~metal)
    assert nearly_matte.float().mean() == pytest.approx(0.3, abs=0.04)
    assert ((m.sigma > 0.2) & nearly_matte).sum() / nearly_matte.sum() == pytest.approx(0.5, abs=0.05)
    assert metal.float().mean() == pytest.approx(0.18, abs=0.03)
    inlaid = metal & (m.metal.flatten(1).amin(1) < 0.9)
    assert inlaid.sum() / metal.sum() == pytest.approx(0.35, abs=0.1)
    assert m.alpha.min() >= 0.0199
    assert m.alpha.min() < 0.022
    assert m.alpha.max() <= 0.9001
    assert m.alpha.max() > 0.88
    glossy = m.alpha[plain & ~nearly_matte].flatten(1).mean(1)
    for low, high in zip((0.02, 0.05, 0.1, 0.2, 0.4), (0.05, 0.1, 0.2, 0.4, 0.9), strict=True):
        assert ((glossy >= low) & (glossy <= high)).float().mean() > 0.1
    assert m.specular.min() >= 0.01
    assert m.specular.max() > 0.55
    assert m.albedo.min() >= 0.0199
    assert m.albedo.max() <= 0.9801
    assert (m.alpha.flatten(1).std(1) > 0.01).float().mean() > 0.15, "gloss maps"
    saturation = 1 - m.albedo.flatten(2).mean(2).amin(1) / m.albedo.flatten(2).mean(2).amax(1)
    assert (saturation < 0.02).float().mean() > 0.2
    assert (saturation > 0.6).float().mean() > 0.1
    assert all((m.coat == coat).float().mean() > 0.05 for coat in (0, 1, 2))
    narrow = random_material(draws, 200, 8, NARROW)
    assert narrow.metal.max() == narrow.sigma.max() == narrow.mix.max() == narrow.sheen.max() == 0
    assert WIDE.matte == 0.3


def test_a_share_of_the_glossy_ones_is_broad() -> None:
    families = [NARROW, replace(NARROW, broad=0.4), replace(NARROW, broad=1.0)]
    plain, some, every = (random_material(Draws(3, 0, CPU), 1000, 8, family) for family in families)
    narrow = [float((material.alpha < 0.39).float().mean()) for material in (plain, some, every)]
    assert narrow[0] > 0.5
    assert 0.4 * narrow[0] < narrow[1] < 0.8 * narrow[0]
    assert narrow[2] == 0
    assert 0.4 <= every.alpha.min() <= every.alpha.max() <= 0.9
    assert torch.equal(plain.coat, every.coat)
