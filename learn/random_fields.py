"""Random numbers that depend on (seed, step) alone, and random pictures made of them: noise of many scales and textures.

Scalars come from a numpy generator and whole pictures from torch's on the device, both seeded from (seed, step), so a batch does not
depend on which batches were made before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

OCTAVES = (2, 4, 8, 16, 32)
"""Knots along a side of the layers of `octaves`."""


class Draws:
    """Random tensors on one device. Same (seed, step) and same calls: same numbers, bit for bit on a CPU."""

    def __init__(self, seed: int, step: int, device: torch.device) -> None:
        self.device = device
        self.rng = np.random.default_rng([seed, step])
        self.generator = torch.Generator(device)
        self.generator.manual_seed(int(self.rng.integers(2**62)))

    def put(self, values: NDArray[np.generic] | Sequence[float]) -> Tensor:
        """Numbers of the CPU as float32, booleans as booleans, on the device."""
        array = np.asarray(values)
        if array.dtype.kind == "f":
            array = array.astype(np.float32)
        return torch.from_numpy(array).to(self.device)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        return self.put(self.rng.uniform(low, high, shape))

    def log_uniform(self, low: float, high: float, *shape: int) -> Tensor:
        return self.put(np.exp(self.rng.uniform(math.log(low), math.log(high), shape)))

    def chance(self, share: float, *shape: int) -> Tensor:
        """True with that probability."""
        return self.put(self.rng.random(shape) < share)

    def kinds(self, weights: Mapping[str, float], count: int) -> NDArray[np.str_]:
        """(count,) names, drawn by their weights."""
        share = np.array(list(weights.values()), np.float64)
        return np.asarray(list(weights))[self.rng.choice(len(share), count, p=share / share.sum())]

    def normal(self, *shape: int) -> Tensor:
        """Standard normal noise, drawn on the device."""
        return torch.randn(shape, generator=self.generator, device=self.device)


def plane(size: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """x (1, 1, size) to the right and y (1, size, 1) up, in pixels from the middle of the picture."""
    at = torch.arange(size, dtype=torch.float32, device=device) - (size - 1) / 2
    return at[None, None, :], -at[None, :, None]


def unit(vectors: Tensor, axis: int) -> Tensor:
    """Vectors of length 1 along an axis of three, zero where they are (nearly) zero; much faster than torch's over an inner axis."""
    x, y, z = vectors.unbind(axis)
    return vectors / (x * x + y * y + z * z).sqrt().clamp_min(1e-12).unsqueeze(axis)


def turned_plane(size: int, angle: Tensor) -> tuple[Tensor, Tensor]:
    """Coordinates (B, size, size) in pixels along and across the direction `angle` (B,) radians, from the middle."""
    x, y = plane(size, angle.device)
    c, s = torch.cos(angle)[:, None, None], torch.sin(angle)[:, None, None]
    return c * x + s * y, c * y - s * x


def octaves(draws: Draws, weights: Tensor, size: int) -> Tensor:
    """Smooth noise (B, size, size): layers of `OCTAVES` knots a side, each of unit variance at its knots, times weights (B, n)."""
    total = torch.zeros(len(weights), size, size, device=draws.device)
    for i, knots in enumerate(OCTAVES[: weights.shape[1]]):
        # The outer knots lie outside the picture, so that its rim is as lively as its middle.
        noise = draws.normal(len(weights), 1, knots + 2, knots + 2)
        wide = F.interpolate(noise, size=size + 2 * size // knots, mode="bicubic", align_corners=False)
        edge = (wide.shape[-1] - size) // 2
        total = total + weights[:, i, None, None] * wide[:, 0, edge : edge + size, edge : edge + size]
    return total


def grain(draws: Draws, count: int, size: int, period: int) -> Tensor:
    """Noise (count, size, size) of about unit variance whose finest detail is `period` pixels."""
    knots = max(size // period, 1)
    return F.interpolate(draws.normal(count, 1, knots, knots), size=(size, size), mode="bilinear", align_corners=False)[:, 0]


def textures(draws: Draws, count: int, size: int, weights: Mapping[str, float]) -> Tensor:
    """Random textures (count, size, size) in 0..1, each of a kind of `TEXTURES` drawn by `weights`."""
    kinds = draws.kinds(weights, count)
    result = torch.zeros(count, size, size, device=draws.device)
    for kind in weights:
        of_kind = np.nonzero(kinds == kind)[0]
        if len(of_kind):
            result[torch.from_numpy(of_kind).to(draws.device)] = TEXTURES[kind](draws, len(of_kind), size)
    return result


def _constant(draws: Draws, count: int, size: int) -> Tensor:
    return torch.full((count, size, size), 0.5, device=draws.device)


def _smooth(draws: Draws, count: int, size: int) -> Tensor:
    weights = draws.uniform(0, 1, count, 3) * draws.put(np.array([1.0, 0.8, 0.5]))
    return torch.sigmoid(draws.uniform(1, 4, count)[:, None, None] * octaves(draws, weights, size))


def _noise(draws: Draws, count: int, size: int) -> Tensor:
    fine = torch.stack([grain(draws, 1, size, int(period))[0] for period in draws.rng.choice([1, 2, 3, 4, 6], count)])
    return torch.sigmoid(draws.uniform(0.5, 4, count)[:, None, None] * fine)


def _cells(draws: Draws, count: int, size: int) -> Tensor:
    """Voronoi cells of flat values."""
    most = 64
    points = draws.uniform(-size / 2, size / 2, count, most, 2)
    used = torch.floor(draws.log_uniform(3, most, count))
    unused = torch.arange(most, device=draws.device)[None] >= used[:, None]
    points = torch.where(unused[..., None], 1e6, points)
    x, y = plane(size, draws.device)
    apart = (x[:, None] - points[..., 0, None, None]) ** 2 + (y[:, None] - points[..., 1, None, None]) ** 2
    values = draws.uniform(0, 1, count, most)
    return torch.gather(values, 1, apart.argmin(1).flatten(1)).view(count, size, size)


def _waves(draws: Draws, count: int, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Sines along and across a random direction, and how hard their edges are."""
    along, across = turned_plane(size, draws.uniform(0, 2 * math.pi, count))
    period = draws.log_uniform(3, size / 2, count)[:, None, None]
    shift = draws.uniform(0, 2 * math.pi, 2, count)[..., None, None]
    hardness = torch.where(draws.chance(0.7, count), 100.0, 1.0)[:, None, None]
    return torch.sin(along * 2 * math.pi / period + shift[0]), torch.sin(across * 2 * math.pi / period + shift[1]), hardness


def _stripes(draws: Draws, count: int, size: int) -> Tensor:
    along, _, hardness = _waves(draws, count, size)
    return torch.sigmoid(4 * hardness * (along - draws.uniform(-0.7, 0.7, count)[:, None, None]))


def _checker(draws: Draws, count: int, size: int) -> Tensor:
    along, across, hardness = _waves(draws, count, size)
    return torch.sigmoid(6 * hardness * along * across)


def _blots(draws: Draws, count: int, size: int) -> Tensor:
    """Hard-edged islands of random outline."""
    weights = draws.uniform(0, 1, count, len(OCTAVES)) * draws.put(np.array([0.3, 1.0, 1.0, 0.7, 0.4]))
    field = octaves(draws, weights, size)
    return (field > draws.uniform(-0.8, 0.8, count)[:, None, None]).float()


TEXTURES: Mapping[str, Callable[[Draws, int, int], Tensor]] = {
    "constant": _constant,
    "smooth": _smooth,
    "noise": _noise,
    "cells": _cells,
    "stripes": _stripes,
    "checker": _checker,
    "blots": _blots,
}
"""Kind of texture -> (draws, count, size) to maps (count, size, size) in 0..1."""
