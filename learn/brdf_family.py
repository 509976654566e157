"""Random materials that vary over the surface, and their shading in torch: the family of BRDFs that training sees.

A material is a base (Lambertian or Oren and Nayar's) that a coat may dim, under one or two lobes, with sheen; or metal. The members
`substrate`, `two-lobe`, `oren-nayar`, `metal` and `lambertian` of `gen.brdfs` are special cases, see `material_of`; Blinn-Phong is
none of them: it is kept for tests of a family that was never trained on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gen.brdfs import ggx_lobe
from gen.errors import InputError
from gen.substrate import lambertian, schlick, substrate_diffuse, substrate_specular
from learn.random_fields import Draws, textures

BARE, SUBSTRATE, COATED = 0, 1, 2
"""What a coat does to the base: nothing; the substrate's dimming with its lobe; (1 - F(mi)) (1 - F(mo))."""


@dataclass(frozen=True, eq=False)
class Material:
    """B materials over a picture. Maps are (B, c, H, W), or (B, c, 1, 1) where they do not vary; one number a capture is (B,).

    albedo: 3 channels, the matte twin's too; of metal it is F0. metal: 1 channel, the share that is metal, 0 or 1 in most pixels. coat:
    `BARE`, `SUBSTRATE` or `COATED`. sigma: Oren and Nayar's roughness in radians, 0 for Lambertian. specular: Schlick's F0, 1 or 3
    channels; of metal the albedo counts instead. strength: of the lobes, 0 for none. alpha, alpha2: widths of the two lobes. mix: share
    of the second. sheen: 3 channels, tint and weight of (1 - l.h)^5.
    """

    albedo: Tensor
    metal: Tensor
    coat: Tensor
    sigma: Tensor
    specular: Tensor
    strength: Tensor
    alpha: Tensor
    alpha2: Tensor
    mix: Tensor
    sheen: Tensor


@dataclass(frozen=True)
class Family:
    """Shares of what `random_material` draws; the ranges are in its docstring. matte: captures without or nearly without gloss. metal:
    those with metal, inlaid: of these, with metal in parts only. broad: of the glossy ones that are no metal, those whose lobes are made
    broad."""

    matte: float = 0.3
    metal: float = 0.18
    inlaid: float = 0.35
    two_lobes: float = 0.4
    sheen: float = 0.12
    gloss_maps: float = 0.35
    broad: float = 0.0
    oren_nayar: float = 0.4
    coats: Mapping[int, float] = field(default_factory=lambda: {BARE: 0.45, SUBSTRATE: 0.35, COATED: 0.2})
    albedos: Mapping[str, float] = field(
        default_factory=lambda: {
            "constant": 0.35,
            "smooth": 0.15,
            "noise": 0.12,
            "cells": 0.12,
            "stripes": 0.09,
            "checker": 0.07,
            "blots": 0.1,
        }
    )


WIDE = Family()
NARROW = Family(
    matte=0.15,
    metal=0.0,
    inlaid=0.0,
    two_lobes=0.0,
    sheen=0.0,
    gloss_maps=0.0,
    oren_nayar=0.0,
    coats={BARE: 0.5, SUBSTRATE: 0.5},
    albedos={"constant": 0.7, "smooth": 0.3},
)


def random_material(draws: Draws, count: int, size: int, family: Family = WIDE) -> Material:
    """Materials of `count` captures of size x size pixels.

    alpha: .02 to .9 log-uniform, the second lobe's too, broad ones .45 to .9; F0: .02 to .6, half of them log-uniform; Oren-Nayar's
    sigma: 0 to .8. Matte ones: a third without a lobe, the others with F0 .01 to .04 and alpha .4 to .9; half of them Oren-Nayar of sigma
    .2 to .8. Metal: alpha .03 to .8, coloured F0 .4 to .98; inlaid in a pattern, or all of it. Gloss maps vary alpha by up to 3 times
    either way within the range, and the lobe's strength.
    """
    rng = draws.rng
    matte = rng.random(count) < family.matte
    metal = ~matte & (rng.random(count) < family.metal / max(1 - family.matte, 1e-6))
    lobeless = matte & (rng.random(count) < 1 / 3)
    coat = np.array(draws.kinds({str(c): w for c, w in family.coats.items()}, count), np.int64)
    coat = np.where(matte, np.where(coat == SUBSTRATE, BARE, coat), coat)
    coat = np.where(metal | lobeless, BARE, coat)

    sigma = np.where(rng.random(count) < family.oren_nayar, rng.uniform(0, 0.8, count), 0.0)
    rough = rng.uniform(0.2, 0.8, count) if family.oren_nayar else np.zeros(count)
    sigma = np.where(matte, np.where(rng.random(count) < 0.5, rough, 0.0), sigma)
    sigma = np.where((coat == SUBSTRATE) | metal, 0.0, sigma)

    low, high = np.log(0.02), np.log(0.9)
    alphas = np.exp(rng.uniform(low, high, (2, count)))
    alphas = np.where(metal, np.exp(rng.uniform(np.log(0.03), np.log(0.8), (2, count))), alphas)
    alphas = np.where(matte, rng.uniform(0.4, 0.9, (2, count)), alphas)
    if family.broad:  # drawn only where it is asked for: other families stay as they are
        broad = ~matte & ~metal & (rng.random(count) < family.broad)
        alphas = np.where(broad, rng.uniform(0.45, 0.9, (2, count)), alphas)
    specular = np.where(
        rng.random(count) < 0.5, np.exp(rng.uniform(np.log(0.02), np.log(0.6), count)), rng.uniform(0.02, 0.6, count)
    )
    specular = np.where(matte, rng.uniform(0.01, 0.04, count), specular)
    mix = np.where((rng.random(count) < family.two_lobes) & (coat != SUBSTRATE), rng.uniform(0.1, 0.9, count), 0.0)

    varied = draws.put(~matte & (rng.random(count) < family.gloss_maps))
    gloss = torch.where(
        varied[:, None, None, None], textures(draws, count, size, _without_constant(family.albedos))[:, None], 0.5
    )
    spread = draws.uniform(0.3, 2.2, count)[:, None, None, None] * (gloss - 0.5)
    widths = [(draws.put(np.log(a))[:, None, None, None] + spread).clamp(low, high).exp() for a in alphas]
    fades = draws.chance(0.5, count)[:, None, None, None] & varied[:, None, None, None]
    strength = torch.where(fades, (2 * draws.uniform(0, 1, count)[:, None, None, None] * gloss).clamp(0, 1), 1.0)
    strength = strength * draws.put((~lobeless).astype(np.float32))[:, None, None, None]

    albedo = random_albedo(draws, count, size, family.albedos, metal)
    inlay = textures(draws, count, size, _without_constant(family.albedos))[:, None] if metal.any() else 1.0
    inlay = torch.where(draws.chance(family.inlaid, count)[:, None, None, None], inlay, 1.0)
    has_sheen = (rng.random(count) < family.sheen) & ~metal & ~matte
    sheen = _colours(draws, count, np.where(has_sheen, rng.uniform(0.05, 0.5, count), 0.0))
    return Material(
        albedo=albedo,
        metal=draws.put(metal.astype(np.float32))[:, None, None, None] * inlay,
        coat=draws.put(coat.astype(np.float32)),
        sigma=draws.put(sigma),
        specular=draws.put(specular)[:, None, None, None],
        strength=strength,
        alpha=widths[0],
        alpha2=widths[1],
        mix=draws.put(mix),
        sheen=sheen[..., None, None],
    )


def random_albedo(draws: Draws, count: int, size: int, kinds: Mapping[str, float], metal: NDArray[np.bool_]) -> Tensor:
    """Albedo (count, 3, size, size) in .02 to .98: a texture between two colours, a second one over some. metal: (count,), bright."""
    rng = draws.rng
    black, white = rng.random(count) < 0.08, rng.random(count) < 0.1
    values = np.exp(rng.uniform(np.log(0.08), np.log(0.95), (3, count)))
    values = np.where(rng.random(count) < 0.5, rng.uniform(0.15, 0.95, (3, count)), values)
    values = np.where(black, rng.uniform(0.02, 0.08, (3, count)), values)
    values = np.where(white, rng.uniform(0.75, 0.95, (3, count)), values)
    values = np.where(metal, rng.uniform(0.4, 0.98, (3, count)), values)
    saturated = rng.random(count)
    tint = np.where(saturated < 0.35, 0.0, np.where(saturated < 0.7, rng.uniform(0, 0.5, count), rng.uniform(0.5, 0.98, count)))
    tint = np.where(white, 0.1 * tint, np.where(metal, 0.6 * tint, tint))
    # Textures of one hue are as frequent as motley ones.
    one_hue = np.where(rng.random(count) < 0.5, 1.0, 0.0)
    hue = (rng.random(count) + (1 - one_hue) * rng.random((3, count))) % 1.0
    first, second, third = (_colours(draws, count, value, tint, h)[..., None, None] for value, h in zip(values, hue, strict=True))
    plain = draws.put(metal)[:, None, None, None] & draws.chance(0.6, count)[:, None, None, None]
    pattern = textures(draws, count, size, kinds)[:, None]
    pattern = torch.where(plain, 0.5, pattern)
    albedo = first + (second - first) * pattern
    over = draws.chance(0.25, count)[:, None, None, None] & ~plain
    layer = textures(draws, count, size, _without_constant(kinds))[:, None]
    albedo = torch.where(over, albedo + (third - albedo) * layer, albedo)
    return albedo.clamp(0.02, 0.98)


def shade_material(material: Material, normal: Tensor, light: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(diffuse, specular, matte), each (B, K, 3, H, W): radiance over light intensity seen from +z, attached shadows only.

    normal: (B, 3, H, W) unit. light: (B, K, 3, 1, 1) or (B, K, 3, H, W), unit, to the light. Black where the normal turns from the light
    or the viewer. Equal to `gen.brdfs` for the kinds of `material_of`. The lobe of a coat or metal is GGX with Smith's masking, that of
    the substrate pbrt's. Sheen counts as diffuse, as in Cycles; the matte twin is Lambertian of the same albedo.
    """
    m = material
    mi, mo, mh, md, sh2 = _cosines(normal[:, None], light)
    albedo = m.albedo[:, None]
    metal, coat, mix = m.metal[:, None], _per_capture(m.coat), _per_capture(m.mix)
    matte = lambertian(mi, albedo) * (mo > 0)

    base = matte
    if bool((m.sigma > 0).any()):
        base = base * oren_nayar_factor(mi, mo, light[:, :, 2:3], _per_capture(m.sigma))
    specular = m.specular[:, None]
    if bool((m.coat == COATED).any()):
        through = (1 - schlick(specular, mi.clamp(0, 1))) * (1 - schlick(specular, mo.clamp(0, 1)))
        base = torch.where(coat == COATED, base * through, base)
    if bool((m.coat == SUBSTRATE).any()):
        base = torch.where(coat == SUBSTRATE, substrate_diffuse(mi, mo, albedo, specular), base)
    if bool((m.sheen > 0).any()):
        base = base + m.sheen[:, None] * ((1 - md.clamp(0, 1)) ** 5) * mi.clamp_min(0) * (mo > 0)
    base = base * (1 - metal)

    alpha, alpha2 = m.alpha[:, None], m.alpha2[:, None]
    lobe = ggx_lobe(mi, mo, mh, alpha, sh2)
    if bool((m.mix > 0).any()):
        lobe = lobe + mix * (ggx_lobe(mi, mo, mh, alpha2, sh2) - lobe)
    fresnel = schlick(specular, md)
    gloss = fresnel * lobe
    if bool((m.coat == SUBSTRATE).any()):
        gloss = torch.where(coat == SUBSTRATE, substrate_specular(mi, mo, mh, md, specular, alpha, sh2), gloss)
    if bool((m.metal > 0).any()):
        gloss = gloss + metal * (schlick(albedo, md) * lobe - gloss)
    gloss = (gloss * m.strength[:, None]).expand(matte.shape)
    return base, gloss, matte


def oren_nayar_factor(mi: Tensor, mo: Tensor, lv: Tensor, sigma: Tensor) -> Tensor:
    """What Oren and Nayar's surface of roughness sigma sends out, over a Lambertian one; see `gen.brdfs.shade_oren_nayar`."""
    s2 = sigma * sigma
    a, b = 1 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)
    larger = torch.maximum(mi, mo)
    return a + b * (lv - mi * mo).clamp_min(0) / torch.where(larger > 0, larger, 1.0)


def material_of(kind: str, values: Mapping[str, Any], size: int = 1) -> Material:
    """One material (B = 1) of `gen.brdfs`: kind and parameters as there, colours (3,). Raises InputError for a kind outside the family."""
    known = {"substrate", "two-lobe", "oren-nayar", "metal", "lambertian"}
    if kind not in known:
        raise InputError(f"material {kind!r}: training does not shade it; it knows {', '.join(sorted(known))}")

    def colour(name: str) -> Tensor:
        value = torch.as_tensor(np.broadcast_to(np.asarray(values.get(name, 0.0), np.float32), 3).copy())
        return value.view(1, 3, 1, 1).expand(1, 3, size, size)

    def number(name: str, default: float) -> Tensor:
        return torch.tensor([float(values.get(name, default))])

    alpha = number("alpha", 0.5)
    return Material(
        albedo=colour("specular" if kind == "metal" else "diffuse"),
        metal=torch.tensor(float(kind == "metal")).view(1, 1, 1, 1),
        coat=torch.tensor([float(SUBSTRATE if kind == "substrate" else BARE)]),
        sigma=number("sigma", 0.0),
        specular=colour("specular"),
        strength=torch.tensor(float(kind != "lambertian")).view(1, 1, 1, 1),
        alpha=alpha.view(1, 1, 1, 1),
        alpha2=number("alpha2", float(alpha)).view(1, 1, 1, 1),
        mix=number("mix", 0.0),
        sheen=torch.zeros(1, 3, 1, 1),
    )


def _cosines(normal: Tensor, light: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """`gen.substrate.cosines` for the view +z and colour along the third axis from the end: maps (B, K, 1, H, W)."""
    half = light + light.new_tensor([0.0, 0.0, 1.0])[:, None, None]
    half = half / half.square().sum(2, keepdim=True).sqrt()
    nx, ny, nz = normal[:, :, 0:1], normal[:, :, 1:2], normal[:, :, 2:3]
    hx, hy, hz = half[:, :, 0:1], half[:, :, 1:2], half[:, :, 2:3]
    mi = nx * light[:, :, 0:1] + ny * light[:, :, 1:2] + nz * light[:, :, 2:3]
    mh = nx * hx + ny * hy + nz * hz
    md = light[:, :, 0:1] * hx + light[:, :, 1:2] * hy + light[:, :, 2:3] * hz
    apart = (nx - hx).square() + (ny - hy).square() + (nz - hz).square()
    return mi, nz, mh, md, apart * (1 - 0.25 * apart)


def _per_capture(values: Tensor) -> Tensor:
    return values[:, None, None, None, None]


def _without_constant(kinds: Mapping[str, float]) -> dict[str, float]:
    return {kind: weight for kind, weight in kinds.items() if kind != "constant"}


def _colours(
    draws: Draws,
    count: int,
    value: NDArray[np.float64],
    saturation: NDArray[np.float64] | None = None,
    hue: NDArray[np.float64] | None = None,
) -> Tensor:
    """(count, 3) linear colours of brightest channel `value`; hue 0..1 and saturation are drawn where they are not given."""
    h = draws.rng.random(count) if hue is None else hue
    s = draws.rng.random(count) if saturation is None else saturation
    wheel = (np.array([5.0, 3.0, 1.0]) + 6 * h[:, None]) % 6
    return draws.put(value[:, None] * (1 - s[:, None] * np.clip(np.minimum(wheel, 4 - wheel), 0, 1)))
