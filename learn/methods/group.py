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
from learn.models.group import GroupLayers
from learn.solve import angle, unit, weighted_least_squares
from learn.world import CaptureBatch, World

DROPPED = 0.1
"""Share of batches in which the network is not told the lights."""

PLAIN = 0.3
"""Weight of the normal that plain least squares finds on the matte layer: the pictures have to be right without the confidence too."""

PICTURE = {"matte": 0.25, "diffuse": 0.1}
"""Weights of the logarithmic errors of the layers."""

FIRST = 0.4
"""Weight of the layers before the refinement."""

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
        """The angle of the measured normal in degrees, with and without confidence, and the logarithmic errors of the layers."""
        # Whether the lights are told is a fact of the batch, so that a resumed run decides alike.
        told = not model.training or float(batch.lights.abs().sum() * 7919) % 1 >= DROPPED
        found: GroupLayers = model(
            batch.images, batch.lights if told else None, batch.valid, batch.mask, None if told else batch.lights
        )
        total, figures = judge(found, batch)
        if found.first is not None:
            total = total + FIRST * judge(found.first, batch)[0]
        return total, figures

    def samples(self, model: nn.Module, batch: CaptureBatch) -> NDArray[np.uint8]:
        """Rows of captures: brightest-lit picture, specular, matte, true matte, confidence, normals found and true."""
        with torch.no_grad():
            found: GroupLayers = model(batch.images, batch.lights, batch.valid, batch.mask)
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
    pixels = inside.sum().clamp(min=1)

    def degrees(weights: Tensor, images: Tensor) -> Tensor:
        n = unit(weighted_least_squares(luminance(images), batch.lights, weights))
        return torch.rad2deg(angle(n, batch.normals)).mul(inside).sum() / pixels

    shown = batch.valid.to(batch.images.dtype)
    measured = torch.rad2deg(angle(found.normals, batch.normals)).mul(inside).sum() / pixels
    plain = degrees(shown + 1e-3, found.matte)
    with torch.no_grad():
        before = degrees(shown + 1e-3, batch.images)
    floor = FLOOR * luminance(batch.matte).mean(1, keepdim=True).unsqueeze(2) + 1e-4
    errors = {name: _log_error(getattr(found, name), getattr(batch, name), floor, shown * inside[:, None]) for name in PICTURE}
    total = 0.1 * (measured + PLAIN * plain)
    for name, weight in PICTURE.items():
        total = total + weight * errors[name]
    figures = {"degrees": measured, "degrees_plain": plain, "degrees_input": before}
    return total, {
        **{key: value.detach() for key, value in figures.items()},
        **{f"log_{n}": e.detach() for n, e in errors.items()},
    }


def _log_error(found: Tensor, true: Tensor, floor: Tensor, weights: Tensor) -> Tensor:
    """Mean absolute difference of the logarithms over the samples that count. found, true: (B, K, 3, H, W). weights: (B, K, H, W)."""
    apart = (torch.log(found.clamp(min=0) + floor) - torch.log(true.clamp(min=0) + floor)).abs().mean(2)
    return (apart * weights).sum() / weights.sum().clamp(min=1)
