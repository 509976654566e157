"""Captures that Cycles rendered, with their truth, cropped for the group network's training: what relighting only approximates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from gen.errors import InputError
from gen.sets.pack import Pack
from learn.random_fields import Draws, unit
from learn.views import place_of

LAYERS = ("diffuse", "specular", "matte", "albedo", "normals")
"""What the pack has to hold: degloss gen pack SET --layers diffuse,specular,matte,albedo,normals."""


@dataclass(frozen=True, eq=False)
class Rendered:
    """B captures of K lights: lights (B, K, 3); diffuse, specular, matte (B, K, 3, H, W) over light intensity; albedo, normals
    (B, 3, H, W); mask (B, H, W). Zero outside the mask."""

    lights: Tensor
    diffuse: Tensor
    specular: Tensor
    matte: Tensor
    albedo: Tensor
    normals: Tensor
    mask: Tensor


class RenderBank:
    """The captures of a pack, three lights and more each.

    Raises InputError where the pack lacks a layer of `LAYERS` or holds no such capture that shows anything.
    """

    def __init__(self, pack: Pack, device: torch.device) -> None:
        for name in LAYERS:
            pack[name]
        self.pack, self.device = pack, device
        frames = [pack.frames(i) for i in range(len(pack.items))]
        self.items = [i for i, of in enumerate(frames) if of.stop - of.start >= 3 and pack["mask"][i].any()]
        if not self.items:
            raise InputError(f"{pack.path}: holds no capture of three lights and more")
        self.least = min(frames[i].stop - frames[i].start for i in self.items)

    def crops(self, draws: Draws, count: int, lights: int, size: int) -> Rendered:
        """`count` crops of random captures, mirrored and turned by quarters, under `lights` of their lights, or as many as all have.

        size: of the crops; the whole picture where it is smaller, with nothing around it.
        """
        parts = [self._crop(draws, min(lights, self.least), size) for _ in range(count)]
        return Rendered(*(torch.stack(maps) for maps in zip(*parts, strict=True)))

    def _crop(self, draws: Draws, lights: int, size: int) -> tuple[Tensor, ...]:
        rng, pack = draws.rng, self.pack
        item = int(rng.choice(self.items))
        frames = pack.frames(item)
        chosen = frames.start + np.sort(rng.choice(frames.stop - frames.start, lights, replace=False))
        covered = pack["mask"][item]
        side = min(size, *covered.shape)
        row, column, _ = place_of(rng, covered, side)
        rows, columns = slice(row, row + side), slice(column, column + side)
        mask = torch.from_numpy(covered[rows, columns].copy())
        intensity = pack["intensities"][chosen][:, None, None, :]
        layers = {}
        for name in LAYERS:
            lit = name in ("diffuse", "specular", "matte")
            whole = pack[name][chosen][:, rows, columns] / intensity if lit else pack[name][item][None, rows, columns]
            layers[name] = torch.from_numpy(np.moveaxis(whole.astype(np.float32), 3, 1).copy()) * mask
        directions = torch.from_numpy(pack["lights"][chosen].copy())
        mirrored, quarters = bool(rng.integers(2)), int(rng.integers(4))

        def turned(maps: Tensor) -> Tensor:
            maps = torch.rot90(maps.flip(-1) if mirrored else maps, quarters, (-2, -1))
            return F.pad(maps, (0, size - side, 0, size - side))

        def turned_along(vectors: Tensor) -> Tensor:
            """Vectors (..., 3) as they stand in the turned picture."""
            x, y, z = vectors.unbind(-1)
            x = -x if mirrored else x
            for _ in range(quarters):
                x, y = -y, x
            return torch.stack([x, y, z], -1)

        normals = unit(turned(turned_along(layers["normals"][0].movedim(0, 2)).movedim(2, 0)), 0)
        return tuple(
            part.to(self.device)
            for part in (
                turned_along(directions), turned(layers["diffuse"]), turned(layers["specular"]), turned(layers["matte"]),
                turned(layers["albedo"][0]), normals, turned(mask.float()) > 0.5,
            )
        )  # fmt: skip
