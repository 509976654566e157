"""Method (d): the group network, trained by what is measured with it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learn.models import create_model
from learn.models.evidence import luminance
from learn.models.group import GroupLayers, shrink_of
from learn.solve import angle, unit, weighted_least_squares
from learn.world import CaptureBatch, World

PLAIN = 0.3
"""Weight of the normal that plain least squares finds on the matte layer: the pictures have to be right without the confidence too."""

PICTURE = {"matte": 0.25, "diffuse": 0.2}
"""Weights of the logarithmic errors of the layers."""

COLOUR = 0.5
"""Weight of the angle in radians between the matte layer's colour, over all lights, and the true one's."""

EARLIER = 0.4
"""Weight of the layers before the refinements, all together."""

KNEE = 1.0
"""Degrees: errors of a capture well above it count by their ratio, so that easy captures are brought down as far as hard ones."""

HARM = 0.5
"""Weight of what a capture comes out worse than plain least squares on its pictures as they are, by the ratio of the angles."""

MEASURED = 3
"""Fewest lights whose least squares says anything of a normal; with fewer the pictures alone are judged."""

FLOOR = 0.03
"""Share of the pixel's brightness that is added before a logarithm: what is darker hardly counts."""


class Group:
    """The group network on an endless world of relit captures (`learn.world`).

    Options of the network: those of `learn.models.group.GroupNet`. Options of the data: those of `learn.world.World`.
    """

    name = "group"

    def build(self, options: Mapping[str, Any]) -> nn.Module:
        return create_model("group", **options)

    def source(self, data: Mapping[str, Any], batch: int, seed: int, device: torch.device, split: str) -> World:
        return World(data, batch, seed if split == "train" else seed + 1_000_003, device)

    def loss(self, model: nn.Module, batch: CaptureBatch, progress: float) -> tuple[Tensor, dict[str, Tensor]]:
        """The logarithms of each capture's mean angle of the measured normal, with and without confidence, what it is worse than without
        removal, and the layers' errors."""
        told = not model.training or batch.told
        lights, solve = (batch.lights, None) if told else (None, batch.lights)
        found: GroupLayers = model(batch.images, lights, batch.valid, batch.mask, solve, shrink_of(batch.mask))
        total, figures = judge(found, batch)
        for layers in found.earlier:
            total = total + EARLIER / len(found.earlier) * judge(layers, batch)[0]
        return total, figures

    def samples(self, model: nn.Module, batch: CaptureBatch) -> NDArray[np.uint8]:
        """Rows of captures: brightest-lit picture, specular, matte, true matte, confidence, normals found and true."""
        with torch.no_grad():
            found: GroupLayers = model(batch.images, batch.lights, batch.valid, batch.mask, shrink=shrink_of(batch.mask))
        rows = []
        for i in range(min(6, len(batch.images))):
            k = int(batch.specular[i].sum((1, 2, 3)).argmax())
            top = torch.quantile(batch.matte[i, k].flatten(), 0.98).clamp(min=1e-3)
            pictures = [batch.images[i, k], found.specular[i, k], found.matte[i, k], batch.matte[i, k]]
            tiles = [(tile / top).clamp(0, 1) ** (1 / 2.2) for tile in pictures]
            tiles.append(found.confidence[i, k].expand(3, -1, -1))
            tiles += [(n[i] + 1) / 2 for n in (found.normals, batch.normals)]
            rows.append(torch.cat(tiles, 2))
        sheet = (torch.cat(rows, 1) * 255).round().to(torch.uint8).permute(1, 2, 0)
        return sheet.cpu().numpy()


def judge(found: GroupLayers, batch: CaptureBatch) -> tuple[Tensor, dict[str, Tensor]]:
    """The loss of layers against the truth of a batch, and its parts in degrees and logarithms."""
    inside = batch.mask.to(batch.images.dtype)
    pixels = inside.sum((1, 2)).clamp(min=1)
    shown = batch.valid.to(batch.images.dtype)

    def degrees(normals: Tensor) -> Tensor:
        """Each capture's mean error."""
        return torch.rad2deg(angle(normals, batch.normals)).mul(inside).sum((1, 2)) / pixels

    def plainly(images: Tensor) -> Tensor:
        return degrees(unit(weighted_least_squares(luminance(images), batch.lights, shown + 1e-3)))

    measured, plain = degrees(found.normals), plainly(found.matte)
    with torch.no_grad():
        before = plainly(batch.images)
    floor = FLOOR * luminance(batch.matte).mean(1, keepdim=True).unsqueeze(2) + 1e-4
    errors = {name: _log_error(getattr(found, name), getattr(batch, name), floor, shown * inside[:, None]) for name in PICTURE}
    total = measured.new_zeros(())
    if batch.lights.shape[1] >= MEASURED:
        total = total + (torch.log(measured + KNEE) + PLAIN * torch.log(plain + KNEE)).mean()
        total = total + HARM * (torch.log(measured + KNEE) - torch.log(before + KNEE)).clamp(min=0).mean()
    for name, weight in PICTURE.items():
        total = total + weight * errors[name]
    colour = angle(*(unit((layers * shown[:, :, None]).sum(1)) for layers in (found.matte, batch.matte)))
    seen = inside * (shown.sum(1) > 0)
    colour = (colour * seen).sum() / seen.sum().clamp(min=1)
    total = total + COLOUR * colour
    figures = {
        "degrees": measured.mean(),
        "degrees_plain": plain.mean(),
        "degrees_input": before.mean(),
        "harmed": (measured > before).float().mean(),
        "degrees_colour": torch.rad2deg(colour),
    }
    return total, {
        **{key: value.detach() for key, value in figures.items()},
        **{f"log_{n}": e.detach() for n, e in errors.items()},
    }


def _log_error(found: Tensor, true: Tensor, floor: Tensor, weights: Tensor) -> Tensor:
    """Mean absolute difference of the logarithms over the samples that count. found, true: (B, K, 3, H, W). weights: (B, K, H, W)."""
    apart = (torch.log(found.clamp(min=0) + floor) - torch.log(true.clamp(min=0) + floor)).abs().mean(2)
    return (apart * weights).sum() / weights.sum().clamp(min=1)
