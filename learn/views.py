"""Geometry to light anew: views of a pack of rendered captures, cropped and turned, and random reliefs made on the spot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from gen.errors import InputError
from gen.sets.pack import Pack
from learn.random_fields import OCTAVES, Draws, grain, octaves, plane, turned_plane, unit

LEAST_COVERED = 0.25
"""Share of a crop that the object fills, where the view has such a crop."""

STEEP = 0.15
"""Pixels whose n.z is smaller say nothing sure of a view's scale."""


@dataclass(frozen=True, eq=False)
class Views:
    """B views. normals (B, 3, H, W) unit, zero outside mask (B, H, W). height (B, H, W) along +z in pixels, 0 outside the mask."""

    normals: Tensor
    height: Tensor
    mask: Tensor


class ViewBank:
    """The views of a pack, on a device.

    Normals are kept in halves and made unit again when used (.03 degrees), heights in pixels as float32. Seen as orthographic.
    """

    def __init__(self, pack: Pack, size: int, device: torch.device, items: Sequence[int] | None = None) -> None:
        """items: which of the pack's views, all by default. size: of the crops. Raises InputError where the pack lacks normals or depth,
        is smaller than a crop, or none of its views shows anything."""
        chosen = np.arange(len(pack.items)) if items is None else np.asarray(list(items), np.int64)
        if min(pack.size) < size:
            raise InputError(f"{pack.path}: its pictures are {pack.size[1]}x{pack.size[0]} pixels, crops of {size} do not fit")
        normals, depth, mask = pack["normals"], pack["depth"], pack["mask"]
        keep = [int(i) for i in chosen if mask[i].any()]
        if not keep:
            raise InputError(f"{pack.path}: shows no object in any of the {len(chosen)} views asked for")
        self.size = size
        self.covered = np.stack([mask[i] for i in keep])
        self.mask = torch.from_numpy(self.covered.copy()).to(device)
        heights = np.stack([height_in_pixels(normals[i], depth[i], mask[i]) for i in keep])
        self.height = torch.from_numpy(heights).to(device)
        first = np.stack([np.moveaxis(normals[i].astype(np.float16), 2, 0) for i in keep])
        self.normals = torch.from_numpy(first).to(device)

    def __len__(self) -> int:
        return len(self.covered)

    def crops(self, draws: Draws, count: int, size: int | None = None) -> Views:
        """`count` random crops of random views, thinned out to every second or fourth pixel in a share, mirrored and turned by quarters.

        size: of the crops, as the bank's by default. Where it is larger, half of them (all, where the views are smaller) are looked at from
        nearer: crops of half the size, drawn out smoothly.
        """
        return _stacked([self._crop(draws, size or self.size) for _ in range(count)])

    def _crop(self, draws: Draws, size: int) -> Views:
        rng = draws.rng
        view = int(rng.integers(len(self)))
        H, W = self.covered.shape[1:]
        if size > self.size and (size > min(H, W) or rng.random() < 0.5):
            return drawn_out(self._crop(draws, (size + 1) // 2), size)
        most = min(H, W) // size
        stride = int(rng.choice([s for s in (1, 1, 2, 4) if s <= most]))
        row, column, share = place_of(rng, self.covered[view], size * stride)
        if share < LEAST_COVERED and stride > 1:
            stride = 1  # a small object, seen from near by
            row, column, _ = place_of(rng, self.covered[view], size)
        rows, columns = (slice(start, start + size * stride, stride) for start in (row, column))
        normals = unit(self.normals[view, :, rows, columns].float(), 0)
        mask = self.mask[view, rows, columns]
        height = self.height[view, rows, columns] / stride
        middle = (height * mask).sum() / mask.sum().clamp_min(1)
        return moved(normals * mask, torch.where(mask, height - middle, 0.0), mask, bool(rng.integers(2)), int(rng.integers(4)))


def drawn_out(view: Views, size: int) -> Views:
    """One view (3, h, w), (h, w), (h, w) at size x size pixels, larger than it was: interpolated bilinearly inside the mask."""
    inside = view.mask.float()
    maps = torch.cat([view.normals, (view.height * inside)[None], inside[None]])[None]
    normals, height, weight = F.interpolate(maps, size=(size, size), mode="bilinear", align_corners=False)[0].split([3, 1, 1])
    mask = weight[0] >= 0.5
    heights = height[0] / weight[0].clamp_min(1e-3) * (size / view.mask.shape[-1])
    return Views(unit(normals, 0) * mask, torch.where(mask, heights, 0.0), mask)


def moved(normals: Tensor, height: Tensor, mask: Tensor, mirrored: bool, quarters: int) -> Views:
    """One view (3, H, W), (H, W), (H, W), mirrored left to right, then turned left by quarters of a turn; normals turn along."""
    nx, ny, nz = normals
    maps = torch.stack([nx, ny, nz, height, mask.float()])
    if mirrored:
        maps = maps.flip(2)
        maps = torch.cat([-maps[:1], maps[1:]])
    for _ in range(quarters):
        maps = torch.cat([-maps[1:2], maps[:1], maps[2:]])
    maps = torch.rot90(maps, quarters, (1, 2))
    return Views(maps[:3], maps[3], maps[4] > 0.5)


def height_in_pixels(
    normals: NDArray[np.floating[Any]], depth: NDArray[np.floating[Any]], mask: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Height (H, W) along +z in pixels, 0 outside the mask, of a view's depth in any unit. normals: (H, W, 3).

    The size of a pixel is found from the view itself: the normals say how many pixels the height rises from one pixel to the next, the
    depth how many of its units.
    """
    n = normals.astype(np.float64)
    mask = mask & np.isfinite(depth)
    height = -np.where(mask, depth, 0.0).astype(np.float64)
    facing = mask & (n[..., 2] > STEEP)
    slope = np.zeros((*n.shape[:2], 2))
    slope[facing] = -n[facing, :2] / n[facing, 2:]
    rises, units = [], []
    for axis, sign in ((1, 1.0), (0, -1.0)):  # x runs with the columns, y against the rows
        one = (slice(None), slice(None, -1)) if axis == 1 else (slice(None, -1), slice(None))
        two = (slice(None), slice(1, None)) if axis == 1 else (slice(1, None), slice(None))
        both = facing[one] & facing[two]
        along = slope[..., 0 if axis == 1 else 1]
        rises.append(sign * 0.5 * (along[one] + along[two])[both])
        units.append((height[two] - height[one])[both])
    rise, unit = np.concatenate(rises), np.concatenate(units)
    steep = np.abs(rise) > 0.05
    # A median: steps and creases between two pixels are not what their normals say.
    scale = float(np.median(unit[steep] / rise[steep])) if steep.any() else 0.0
    if not (math.isfinite(scale) and scale > 0):
        return np.zeros(mask.shape, np.float32)  # flat, or without a scale: it throws no shadow on itself
    pixels = height / scale
    pixels -= pixels[mask].mean() if mask.any() else 0
    return np.where(mask, pixels, 0).astype(np.float32)


def random_relief(draws: Draws, count: int, size: int) -> Views:
    """Random height fields (count views of size x size): noise of many scales, bosses and hollows, ridges, plates with hard edges.

    A share are the bellies of ellipsoids, up to their silhouettes. Slopes are differentiated in closed form where there is one, from the
    noise's neighbours otherwise; the walls of plates are upright, so no pixel shows them. Masks are the whole frame or a blot.
    """
    rng, device = draws.rng, draws.device
    margin = size + 2
    # The slopes, not the heights, of the layers are drawn: a layer of n knots a side has a slope of about 1.5 n / size.
    decay = rng.uniform(0.3, 1.1, (count, 1)) ** np.arange(len(OCTAVES))
    layers = decay * rng.random((count, len(OCTAVES))) * (rng.random((count, len(OCTAVES))) < 0.8)
    layers /= np.maximum(np.sqrt((layers**2).sum(1, keepdims=True)), 1e-3)
    steepness = np.exp(rng.uniform(np.log(0.03), np.log(0.7), (count, 1)))
    weights = draws.put(layers * steepness * size / (1.5 * np.array(OCTAVES)))
    height = octaves(draws, weights, margin)
    slopes = _gradient(height)
    height = height[:, 1:-1, 1:-1]
    for part in (_bosses, _ridges, _plates):
        more, more_slopes = part(draws, count, size)
        height, slopes = height + more, slopes + more_slopes
    body = draws.put(rng.random(count) < 0.4)[:, None, None]
    belly, belly_slopes, inside = _bellies(draws, count, size)
    # A body carries less of the rest, or nothing of it.
    less = torch.where(body, draws.put(rng.choice([0.0, 0.1, 0.5], count))[:, None, None], 1.0)
    height = less * height + torch.where(body, belly, 0.0)
    slopes = less[:, None] * slopes + torch.where(body[:, None], belly_slopes, 0.0)
    mask = torch.where(body, inside, torch.ones_like(inside))
    blots = octaves(draws, draws.uniform(0, 1, count, 3), size) + 0.6
    holed = draws.chance(0.3, count)[:, None, None] & (blots > 0).float().mean((1, 2), keepdim=True).gt(LEAST_COVERED)
    mask = torch.where(holed, mask & (blots > 0), mask)
    normals = unit(torch.cat([-slopes, torch.ones(count, 1, size, size, device=device)], 1), 1)
    return Views(normals * mask[:, None], torch.where(mask, height, 0.0), mask)


def with_detail(draws: Draws, views: Views, share: float) -> Views:
    """The views with fine relief in the normals of a share: bumps of down to two pixels, or grooves. It is too low for shadows."""
    normals = views.normals
    count, _, size, _ = normals.shape
    rng = draws.rng
    has = rng.random(count) < share
    if not has.any():
        return views
    period = int(rng.choice([2, 2, 3, 4, 8]))
    bumps = torch.stack([grain(draws, count, size, period), grain(draws, count, size, period)], 1)
    along, _ = turned_plane(size, turn := draws.uniform(0, 2 * math.pi, count))
    wave = torch.sin(along * 2 * math.pi / draws.log_uniform(3, 16, count)[:, None, None])
    across = torch.stack([torch.cos(turn), torch.sin(turn)], 1)[:, :, None, None]
    grooves = wave[:, None] * across
    slopes = torch.where(draws.chance(0.35, count)[:, None, None, None], grooves, bumps)
    slopes = slopes * draws.log_uniform(0.01, 0.3, count)[:, None, None, None]
    nz = normals[:, 2:3]
    changed = unit(torch.cat([normals[:, :2] - slopes * nz, nz], 1), 1)
    there = views.mask[:, None] & draws.put(has)[:, None, None, None]
    return Views(torch.where(there, changed, normals), views.height, views.mask)


def joined(*parts: Views) -> Views:
    """One batch of several."""
    return Views(*(torch.cat([getattr(part, name) for part in parts]) for name in ("normals", "height", "mask")))


def _stacked(views: Sequence[Views]) -> Views:
    return Views(*(torch.stack([getattr(view, name) for view in views]) for name in ("normals", "height", "mask")))


def place_of(rng: np.random.Generator, covered: NDArray[np.bool_], side: int) -> tuple[int, int, float]:
    """Top left corner of a crop that the object fills well enough, the best of a few where none does, and the share that it fills."""
    H, W = covered.shape
    rows, columns = np.nonzero(covered)
    best, place = -1.0, (0, 0)
    for _ in range(8):
        at = int(rng.integers(len(rows)))
        row = int(np.clip(rows[at] - rng.integers(side), 0, H - side))
        column = int(np.clip(columns[at] - rng.integers(side), 0, W - side))
        share = float(covered[row : row + side, column : column + side].mean())
        if share > best:
            best, place = share, (row, column)
        if share >= LEAST_COVERED:
            break
    return *place, best


def _gradient(height: Tensor) -> Tensor:
    """Central differences (B, 2, H-2, W-2) along x and y of (B, H, W)."""
    dx = 0.5 * (height[:, 1:-1, 2:] - height[:, 1:-1, :-2])
    dy = 0.5 * (height[:, :-2, 1:-1] - height[:, 2:, 1:-1])
    return torch.stack([dx, dy], 1)


def _bosses(draws: Draws, count: int, size: int) -> tuple[Tensor, Tensor]:
    """Gaussian bosses and hollows: heights (count, size, size) and slopes (count, 2, size, size)."""
    n = 6
    x, y = plane(size, draws.device)
    present = draws.chance(0.35, count)[:, None] & draws.chance(0.6, count, n)
    centre = draws.uniform(-size / 2, size / 2, 2, count, n)[..., None, None]
    width = draws.log_uniform(2, size / 3, count, n)
    top = present * width * draws.uniform(-1.2, 1.2, count, n)
    dx, dy = x[:, None] - centre[0], y[:, None] - centre[1]
    inverse = 1 / width[..., None, None] ** 2
    bell = top[..., None, None] * torch.exp(-0.5 * (dx * dx + dy * dy) * inverse)
    return bell.sum(1), torch.stack([(-dx * inverse * bell).sum(1), (-dy * inverse * bell).sum(1)], 1)


def _ridges(draws: Draws, count: int, size: int) -> tuple[Tensor, Tensor]:
    """Folds with sharp crests and valleys."""
    angle = draws.uniform(0, 2 * math.pi, count)
    along, _ = turned_plane(size, angle)
    period = draws.log_uniform(8, 2 * size, count)[:, None, None]
    steep = (draws.chance(0.2, count) * draws.uniform(0.1, 1.2, count))[:, None, None]
    phase = torch.remainder(along / period + draws.uniform(0, 1, count)[:, None, None], 1) - 0.5
    slope = steep * torch.sign(phase)
    across = torch.stack([torch.cos(angle), torch.sin(angle)], 1)[:, :, None, None]
    return steep * period * phase.abs(), slope[:, None] * across


def _plates(draws: Draws, count: int, size: int) -> tuple[Tensor, Tensor]:
    """Raised or sunken regions with hard edges, each a plane of its own tilt: half planes, bars and discs."""
    x, y = plane(size, draws.device)
    height = torch.zeros(count, size, size, device=draws.device)
    slopes = torch.zeros(count, 2, size, size, device=draws.device)
    some = draws.chance(0.35, count)
    for _ in range(3):
        here = (some & draws.chance(0.7, count))[:, None, None]
        along, across = turned_plane(size, draws.uniform(0, 2 * math.pi, count))
        shift = draws.uniform(-0.4, 0.4, 2, count)[..., None, None] * size
        half = draws.uniform(0.08, 0.5, 2, count)[..., None, None] * size
        a, b = along - shift[0], across - shift[1]
        bar = (a.abs() < half[0]) & (b.abs() < half[1])
        disc = a * a + b * b < half[0] ** 2
        kind = draws.rng.integers(0, 3, count)
        region = (
            torch.where(draws.put(kind == 0)[:, None, None], a < 0, torch.where(draws.put(kind == 1)[:, None, None], bar, disc))
            & here
        )
        tilt = draws.uniform(-0.5, 0.5, 2, count)[..., None, None] * draws.chance(0.6, count)[:, None, None]
        rise = draws.uniform(-0.25, 0.35, count)[:, None, None] * size
        height = height + region * (rise + tilt[0] * x + tilt[1] * y)
        slopes = slopes + torch.stack([region * tilt[0], region * tilt[1]], 1)
    return height, slopes


def _bellies(draws: Draws, count: int, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Upper halves of turned ellipsoids and cylinders, and where they are."""
    angle = draws.uniform(0, 2 * math.pi, count)
    along, across = turned_plane(size, angle)
    half = draws.uniform(0.35, 0.75, 2, count)[..., None, None] * size
    half[0] = torch.where(draws.chance(0.25, count)[:, None, None], 1e4, half[0])
    deep = draws.uniform(0.3, 1.3, count)[:, None, None] * half.amin(0)
    shift = draws.uniform(-0.2, 0.2, 2, count)[..., None, None] * size
    a, b = (along - shift[0]) / half[0], (across - shift[1]) / half[1]
    rest = 1 - a * a - b * b
    inside = rest > 2e-3
    root = rest.clamp_min(2e-3).sqrt()
    da, db = -deep * a / (root * half[0]), -deep * b / (root * half[1])
    c, s = torch.cos(angle)[:, None, None], torch.sin(angle)[:, None, None]
    slopes = torch.stack([c * da - s * db, s * da + c * db], 1)
    return deep * root, slopes, inside
