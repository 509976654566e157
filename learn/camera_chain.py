"""What lies between a surface's reflectance and the pictures of a capture: lights that are not as stated, stray light, and the camera.

In the order in which it happens: errors of the lights' directions and intensities, fall-off of near lights, ambient light and light
thrown back by the object itself, exposure, shot noise, read noise, black level, the sensor's top, whole numbers; then the division by
exposure and stated intensity, as a reader of a capture does it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from learn.random_fields import Draws, plane, unit

LOST = 3.0
"""A sample is dark where no channel stands out of the black level by more than so many standard deviations of the read noise, as in
`gen.faults`."""


@dataclass(frozen=True)
class Faults:
    """Shares of captures that have a fault, and how large each may be. degrees, intensity: largest error of a capture's lights."""

    misstated: float = 0.75
    degrees: float = 3.0
    intensity: float = 0.06
    near: float = 0.25
    ambient: float = 0.4
    bounce: float = 0.35
    noise: float = 0.75
    black_level: float = 0.25
    clipped: float = 0.75
    quantised: float = 0.75


WIDE = Faults()
NARROW = Faults(misstated=0.0, near=0.0, ambient=0.0, bounce=0.0, noise=0.5, black_level=0.0, clipped=0.5, quantised=0.5)

BITS = {"8": 0.25, "8 srgb": 0.3, "10": 0.1, "12": 0.2, "16": 0.15}
"""How pictures are stored, and how often."""


def misdirected(draws: Draws, lights: Tensor, faults: Faults = WIDE) -> Tensor:
    """Stated directions (B, K, 3): each true one turned toward a random side by up to `faults.degrees`, by much or little a capture."""
    B, K, _ = lights.shape
    largest = draws.rng.uniform(0, math.radians(faults.degrees), (B, 1)) * (draws.rng.random((B, 1)) < faults.misstated)
    angle = draws.put(largest * np.sqrt(draws.rng.random((B, K))))[..., None]
    random = draws.normal(B, K, 3)
    side = unit(random - (random * lights).sum(-1, keepdim=True) * lights, -1)
    return unit(torch.cos(angle) * lights + torch.sin(angle) * side, -1)


def near_lights(draws: Draws, lights: Tensor, height: Tensor, mask: Tensor, faults: Faults = WIDE) -> tuple[Tensor, Tensor]:
    """Directions (B, K, 3, H, W) and fall-off (B, K, 1, H, W) at each pixel of lights that are not far away in a share of captures.

    lights: (B, K, 3) seen from the middle of the picture, where the fall-off is 1. height: (B, H, W) in pixels, square. A near light is 3
    to 20 picture widths away. Where no capture has one, the maps are (B, K, 3, 1, 1) and (B, K, 1, 1, 1).
    """
    B, K, _ = lights.shape
    size = height.shape[-1]
    near = draws.rng.random(B) < faults.near
    distance = draws.log_uniform(3, 20, B) * size
    if not near.any():
        return lights[..., None, None], torch.ones(B, K, 1, 1, 1, device=lights.device)
    x, y = plane(size, lights.device)
    middle = (height * mask).sum((1, 2)) / mask.sum((1, 2)).clamp_min(1)
    z = torch.where(mask, height - middle[:, None, None], 0.0)
    points = torch.stack([x.expand_as(z), y.expand_as(z), z], 1)
    way = (distance[:, None, None] * lights)[..., None, None] - points[:, None]
    direction = unit(way, 2)
    squared = way[:, :, :1].square() + way[:, :, 1:2].square() + way[:, :, 2:].square()
    is_near = draws.put(near)[:, None, None, None, None]
    direction = torch.where(is_near, direction, lights[..., None, None])
    return direction, torch.where(is_near, (distance * distance)[:, None, None, None, None] / squared, 1.0)


def take_pictures(
    draws: Draws, radiance: Tensor, diffuse: Tensor, albedo: Tensor, mask: Tensor, faults: Faults = WIDE
) -> tuple[Tensor, Tensor]:
    """Pictures of a camera, divided by exposure and stated intensity, and which samples are valid.

    radiance: (B, K, 3, H, W) reflectance, the sum of the true layers. diffuse: (B, K, 3, H, W), what the object sheds on itself.
    albedo: (B, 3, H, W) or (B, 3, 1, 1). mask: (B, H, W). Returns images as `radiance` and valid (B, K, H, W): false where a channel is
    at the sensor's top or none stands out of the dark, and outside the mask.
    """
    B, K = radiance.shape[:2]
    rng = draws.rng
    # Lights of unequal strength and colour: each is divided out again, but not its noise and clipping.
    strength = draws.log_uniform(0.6, 1.6, B, K, 1) * draws.uniform(0.85, 1.15, B, 1, 3)
    wrong = rng.uniform(0, faults.intensity, (B, 1, 1)) * (rng.random((B, 1, 1)) < faults.misstated)
    error = 1 + draws.put(wrong * rng.uniform(-1, 1, (B, K, 1)))

    light = _stray(draws, radiance, diffuse, albedo, faults)
    picture = light * (strength * error)[..., None, None] * mask[:, None, None]
    exposure, clips = _exposure(draws, picture, mask, faults)
    picture = picture * exposure

    noisy = rng.random(B) < faults.noise
    electrons = draws.put(np.where(noisy, np.exp(rng.uniform(np.log(2e3), np.log(2e5), B)), np.inf))
    read = draws.put(np.where(noisy, np.exp(rng.uniform(np.log(1e-4), np.log(3e-3), B)), 0.0))
    deviation = (picture.clamp_min(0) / _wide(electrons) + _wide(read) ** 2).sqrt()
    picture = picture + deviation * draws.normal(*picture.shape)
    black = draws.put(rng.uniform(0, 0.01, B) * (rng.random(B) < faults.black_level))
    picture = picture + _wide(black)

    top = torch.where(clips, 1.0, math.inf)
    picture = torch.minimum(picture, _wide(top))
    storage = draws.kinds(BITS, B)
    storage[(rng.random(B) >= faults.quantised) | ~clips.cpu().numpy()] = ""
    picture, step = stored(picture, storage)
    clipped = (picture >= _wide(top)).any(2)
    floor = torch.maximum(LOST * read, 0.5 * step)
    dark = (picture <= _wide(black + floor)).all(2)
    images = picture / (exposure * strength[..., None, None])
    return images * mask[:, None, None], mask[:, None] & ~clipped & ~dark


def stored(picture: Tensor, storage: NDArray[np.str_]) -> tuple[Tensor, Tensor]:
    """What files of whole numbers hold of linear pictures (B, ...), as linear values, and the smallest step (B,).

    storage: (B,) keys of `BITS` ("8 srgb" is sRGB-encoded), or "" where the picture stays as it is.
    """
    result, steps = picture, torch.zeros(len(storage), device=picture.device)
    for kind in BITS:
        of_kind = np.nonzero(storage == kind)[0]
        if not len(of_kind):
            continue
        index = torch.from_numpy(of_kind).to(picture.device)
        bits, *encoding = kind.split()
        levels = float((1 << int(bits)) - 1)
        if result is picture:
            result = picture.clone()
        part = picture[index].clamp(0, 1)
        coded = _encoded(part) if encoding else part
        whole = torch.round(coded * levels) / levels
        result[index] = _decoded(whole) if encoding else whole
        steps[index] = 1 / (levels * 12.92) if encoding else 1 / levels
    return result, steps


def _stray(draws: Draws, radiance: Tensor, diffuse: Tensor, albedo: Tensor, faults: Faults) -> Tensor:
    """Ambient light, up to 4 % of a light's, and what the object throws on itself: albedo times a blurred copy of its diffuse light."""
    B, K, _, H, W = radiance.shape
    rng = draws.rng
    ambient = draws.put(rng.uniform(0, 0.04, B) * (rng.random(B) < faults.ambient))
    bounce = draws.put(rng.uniform(0, 0.16, B) * (rng.random(B) < faults.bounce))
    light = radiance + _wide(ambient) * albedo[:, None]
    if bool((bounce > 0).any()):
        knots = max(H // 16, 1)
        small = F.adaptive_avg_pool2d(diffuse.flatten(0, 1), (knots, knots))
        blurred = F.interpolate(small, size=(H, W), mode="bilinear", align_corners=False).view(B, K, 3, H, W)
        light = light + _wide(bounce) * albedo[:, None] * blurred
    return light


def _exposure(draws: Draws, picture: Tensor, mask: Tensor, faults: Faults) -> tuple[Tensor, Tensor]:
    """Exposure (B, 1, 1, 1, 1) that brings a percentile of the brightest channel to a level, and which captures the sensor clips."""
    rng = draws.rng
    B = len(picture)
    clips = draws.put(rng.random(B) < faults.clipped)
    # Every fourth pixel tells a percentile well enough and is four times faster to sort.
    bright = (picture.amax(2) * mask[:, None])[:, :, ::2, ::2].flatten(1).sort(1).values
    background = 1 - mask[:, ::2, ::2].float().mean((1, 2))
    percentile = draws.put(np.where(rng.random(B) < 0.3, 1.0, rng.choice([0.9, 0.95, 0.98, 0.99, 0.995, 0.999], B)))
    rank = (background + (1 - background) * percentile) * (bright.shape[1] - 1)
    level = bright.gather(1, rank.round().long().clamp(0, bright.shape[1] - 1)[:, None])[:, 0]
    # A narrow highlight may be hundreds of times as bright as the rest: no camera is set by it.
    median = bright.gather(1, ((background + (1 - background) * 0.9) * (bright.shape[1] - 1)).long()[:, None])[:, 0]
    level = torch.minimum(level, 8 * median.clamp_min(1e-6)).clamp_min(1e-4)
    aim = draws.uniform(0.5, 1.0, B)
    return _wide(aim / level), clips


def _encoded(linear: Tensor) -> Tensor:
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def _decoded(coded: Tensor) -> Tensor:
    return torch.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def _wide(values: Tensor) -> Tensor:
    return values[:, None, None, None, None]
