"""The world that the group method trains in: endless captures with their truth, lit in torch from geometry at hand.

A batch is a pure function of (seed, step): views, materials, lights and faults are all drawn from a generator of that step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gen.errors import InputError
from gen.sets.pack import read_pack
from learn import brdf_family, camera_chain
from learn.brdf_family import Family, Material, random_material, shade_material
from learn.camera_chain import Faults, misdirected, near_lights, take_pictures
from learn.cast_shadows import thrown_in, visible
from learn.light_sets import light_counts, random_lights
from learn.method import check_options
from learn.random_fields import Draws
from learn.rendered import RenderBank
from learn.views import ViewBank, Views, joined, random_relief, with_detail

OPTIONS: Mapping[str, Any] = {
    "views": "",
    "split": "",
    "reliefs": 0.3,
    "size": 64,
    "large": 0.25,
    "lights": None,
    "world": "wide",
    "captures": "",
    "rendered": 0.12,
    "dropped": 0.1,
    "clean": 0.0,
    "broad": 0.0,
}
"""Options of `World` and their defaults; lights: None is "mixed"."""


@dataclass(frozen=True, eq=False)
class CaptureBatch:
    """B captures of K lights.

    images (B, K, 3, H, W): what the camera saw over the stated intensities, zero outside the mask. lights (B, K, 3): stated, unit. valid
    (B, K, H, W): false where clipped, dark or missing. mask (B, H, W). matte, diffuse, specular (B, K, 3, H, W): truth in the same
    units under the true lights, without faults and never cut, cast shadows in all three. normals (B, 3, H, W): true, zero outside.
    told: whether the network may know the lights.
    """

    images: Tensor
    lights: Tensor
    valid: Tensor
    mask: Tensor
    matte: Tensor
    diffuse: Tensor
    specular: Tensor
    normals: Tensor
    told: bool = True


@dataclass(frozen=True)
class Kind:
    """What a kind of world draws from. detail: share of views with fine relief. thrown_in, soft: shares of captures with shadows from
    outside the picture and with soft rims."""

    family: Family
    faults: Faults
    detail: float
    thrown_in: float
    soft: float


WORLDS: Mapping[str, Kind] = {
    "wide": Kind(brdf_family.WIDE, camera_chain.WIDE, detail=0.35, thrown_in=0.3, soft=0.3),
    "narrow": Kind(brdf_family.NARROW, camera_chain.NARROW, detail=0.0, thrown_in=0.0, soft=0.0),
}


class World:
    """Endless batches of captures; see `learn.method.Source`.

    data: options, see `OPTIONS`. views: path of a pack with normals and depth; without one all geometry is random relief. split: take
    the pack's views of that split alone. reliefs: share of captures on random relief. size: of the square pictures; a share `large` of the
    batches has a quarter of the captures at twice the size. lights: "mixed", a number, or weights of 1, 2, ... lights; a batch has one
    number. world: a key of `WORLDS`. captures: path of a pack of rendered captures (`learn.rendered`), which a share `rendered` of the
    batches is taken from. dropped: share of batches in which the network is not told the lights. clean: share of batches of the world
    "narrow", whatever `world` is: lights as stated, plain materials, as the paper's stacks have them. broad: share of the glossy captures
    in these whose lobes are made broad. batch: captures in a batch.
    Raises InputError for an unknown or impossible option and a pack that does not serve.
    """

    steps_per_epoch: int | None = None

    def __init__(self, data: Mapping[str, Any], batch: int, seed: int, device: torch.device | str = "cpu") -> None:
        options = check_options(data, OPTIONS, "data")
        if type(batch) is not int or batch < 1:
            raise InputError(f"batch = {batch!r} must be a whole number from 1")
        if options["world"] not in WORLDS:
            raise InputError(f"data: world = {options['world']!r} is unknown; there are {', '.join(WORLDS)}")
        for share in ("reliefs", "large", "rendered", "dropped", "clean", "broad"):
            if not 0 <= options[share] <= 1:
                raise InputError(f"data: {share} = {options[share]:g} must be a share from 0 to 1")
        if not 16 <= options["size"] <= 1024:
            raise InputError(f"data: size = {options['size']} must be from 16 to 1024 pixels")
        if options["broad"] and not options["clean"]:
            raise InputError(f"data: broad = {options['broad']:g} is a share of the clean batches, and clean = 0 leaves none")
        counts = light_counts("mixed" if options["lights"] is None else options["lights"])
        self.size: int = options["size"]
        self.reliefs: float = options["reliefs"]
        self.large: float = options["large"]
        self.dropped: float = options["dropped"]
        self.clean: float = options["clean"]
        narrow = WORLDS["narrow"]
        self.clean_kind = replace(narrow, family=replace(narrow.family, broad=options["broad"]))
        self.kind = WORLDS[options["world"]]
        self.device = torch.device(device)
        self.captures, self.seed = batch, seed
        self._counts, self._shares = list(counts), np.array(list(counts.values())) / sum(counts.values())
        captures = (1 - self.large) * batch + self.large * max(batch // 4, 1)
        self.pictures = round(captures * float(np.dot(self._counts, self._shares)))
        self.bank = self._bank(options["views"], options["split"])
        self.rendered: float = options["rendered"] if options["captures"] else 0.0
        self.renders = RenderBank(read_pack(Path(options["captures"])), self.device) if options["captures"] else None

    def batch(self, step: int) -> CaptureBatch:
        """Batch number `step`: the same bits whenever it is asked for on a CPU."""
        draws = Draws(self.seed, step, self.device)
        K = int(draws.rng.choice(self._counts, p=self._shares))
        large, rendered, told = draws.rng.random(3) < (self.large, self.rendered, 1 - self.dropped)
        size, B = (2 * self.size, max(self.captures // 4, 1)) if large else (self.size, self.captures)
        # drawn only where it is asked for: batches of a world without clean ones stay as they are
        kind = self.clean_kind if self.clean and draws.rng.random() < self.clean else self.kind
        with torch.no_grad():
            taken = self.renders if rendered else None
            made = self._rendered(draws, taken, B, K, size, kind) if taken else self._relit(draws, B, K, size, kind)
        return replace(made, told=bool(told))

    def _relit(self, draws: Draws, B: int, K: int, size: int, kind: Kind) -> CaptureBatch:
        """B captures of K lights, shaded here."""
        views = self.views(draws, B, size, kind.detail)
        lights = draws.put(np.stack([random_lights(draws.rng, K) for _ in range(B)]))
        material = random_material(draws, B, size, kind.family)
        directions, fall_off = near_lights(draws, lights, views.height, views.mask, kind.faults)
        soft = draws.log_uniform(0.005, 0.08, B) * draws.chance(kind.soft, B)
        light = fall_off * thrown_in(draws, B, K, size, kind.thrown_in, 0.3)[:, :, None]
        diffuse, specular, matte = relight(views, lights, material, directions, light, soft)
        images, valid = take_pictures(draws, diffuse + specular, diffuse, material.albedo, views.mask, kind.faults)
        stated = misdirected(draws, lights, kind.faults)
        return CaptureBatch(images, stated, valid, views.mask, matte, diffuse, specular, views.normals)

    def _rendered(self, draws: Draws, bank: RenderBank, B: int, K: int, size: int, kind: Kind) -> CaptureBatch:
        """B captures of K lights, or as many as they have, of what Cycles rendered, photographed here."""
        given = bank.crops(draws, B, K, size)
        faults = replace(kind.faults, bounce=0.0)  # it is in the renders
        radiance = given.diffuse + given.specular
        images, valid = take_pictures(draws, radiance, given.diffuse, given.albedo, given.mask, faults)
        stated = misdirected(draws, given.lights, faults)
        return CaptureBatch(images, stated, valid, given.mask, given.matte, given.diffuse, given.specular, given.normals)

    def views(self, draws: Draws, captures: int, size: int, detail: float) -> Views:
        """The geometry of a batch, of the pack and random reliefs in random proportion. detail: share of it with fine relief."""
        count = int((draws.rng.random(captures) < self.reliefs).sum()) if self.bank else captures
        parts = [random_relief(draws, count, size)] if count else []
        if self.bank and count < captures:
            parts.append(self.bank.crops(draws, captures - count, size))
        return with_detail(draws, joined(*parts), detail)

    def _bank(self, path: str, split: str) -> ViewBank | None:
        if not path:
            return None
        pack = read_pack(Path(path))
        items = pack.of_split(split) if split else None
        if items is not None and not items:
            raise InputError(f"{path}: has no items of the split {split!r}")
        return ViewBank(pack, self.size, self.device, items)


def relight(
    views: Views,
    lights: Tensor,
    material: Material,
    directions: Tensor | None = None,
    light: Tensor | None = None,
    softness: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """(diffuse, specular, matte), each (B, K, 3, H, W): what the surface sends to a distant viewer at +z over light intensity.

    views: B views. lights: (B, K, 3) unit. directions: (B, K, 3, H, W) at each pixel where lights are near; light: factor (B, K, 1, H, W)
    on all three, as fall-off and shadows of what is not in the picture. softness: see `learn.cast_shadows.visible`. Attached and cast
    shadows are in all three; outside the mask they are zero.
    """
    if directions is None:
        directions = lights[..., None, None]
    reaching = visible(views.height, views.mask, lights, softness)[:, :, None] * views.mask[:, None, None]
    if light is not None:
        reaching = reaching * light
    diffuse, specular, matte = (part * reaching for part in shade_material(material, views.normals, directions))
    return diffuse, specular, matte
