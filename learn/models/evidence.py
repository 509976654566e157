"""What physics says of each sample of a capture before any network looks: the input features of the group network.

All is per pixel and relative to the pixel's own brightness, so that it means the same on dark and light, small and large surfaces, and
order of the lights makes no difference but to the order of the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import torch
from torch import Tensor

from gen.capture import LUMA
from learn.solve import robust_start, shading, unit, weighted_least_squares

TRIPLETS = 20
"""Most triplets of lights that are solved: all of up to six lights, the best spread of more."""

CHANNELS = 19
"""Features of a sample."""


@dataclass(frozen=True)
class Evidence:
    """features: (B, K, CHANNELS, H, W). scale: (B, 1, H, W), the pixel's brightness. y: (B, K, H, W), luma over scale, cut at `CUT`."""

    features: Tensor
    scale: Tensor
    y: Tensor


CUT = 20.0
"""Luma over the pixel's brightness above which it does not matter how bright a highlight is."""


def evidence(images: Tensor, lights: Tensor | None, valid: Tensor, mask: Tensor) -> Evidence:
    """The features of every sample.

    images: (B, K, 3, H, W) reflectance, may be slightly negative. lights: (B, K, 3) unit, or None where unknown. valid: (B, K, H, W) bool.
    mask: (B, H, W) bool. Features: square roots of the three channels over the pixel's brightness; validity; how grey the sample is beside
    the pixel's most colourful; the pixel's brightness beside the picture's (log); and with lights known: their direction, a robust
    Lambertian normal with n.l and n.h, the residual of its fit, of the fit without this sample, and of the least and the median prediction
    of this sample from triplets of the others.
    """
    b, k, _, h, w = images.shape
    inside = mask[:, None].to(images.dtype)
    luma = luminance(images).clamp(min=0) * inside
    level = (luma.sum((1, 2, 3)) / (inside.sum((1, 2, 3)) * k).clamp(min=1))[:, None, None, None]
    scale = luma.clamp(min=1e-12).sqrt().mean(1, keepdim=True).square() + 0.01 * level + 1e-6
    y = (luma / scale).clamp(max=CUT)
    shown = valid.to(images.dtype)
    colour = (images / scale.unsqueeze(2)).clamp(0, CUT)
    top = images.amax(2).clamp(min=1e-6)
    saturation = (1 - images.amin(2).clamp(min=0) / top) * inside
    parts = [
        colour.sqrt().flatten(0, 1),
        shown.reshape(b * k, 1, h, w),
        (saturation.amax(1, keepdim=True) - saturation).reshape(b * k, 1, h, w),
        (torch.log(scale / (level + 1e-6)).clamp(-4, 4) * inside).expand(b, k, h, w).reshape(b * k, 1, h, w),
    ]
    if lights is None:
        parts.append(images.new_zeros(b * k, CHANNELS - 6, h, w))
    else:
        parts.append(_geometry(y, lights, shown).flatten(0, 1))
    features = torch.cat(parts, 1) * mask.repeat_interleave(k, 0).unsqueeze(1)
    return Evidence(features.reshape(b, k, CHANNELS, h, w), scale, y)


def _geometry(y: Tensor, lights: Tensor, shown: Tensor) -> Tensor:
    """The features that need lights, (B, K, 13, H, W)."""
    b, k, h, w = y.shape
    start = robust_start(y, lights, shown)
    n = unit(start)
    nl, nh = toward(n, lights)
    fit = shading(start, lights)
    without = _left_out(y, lights, shown + 1e-3)
    least, median = triplet_predictions(y, lights)
    maps = torch.stack([nl, nh, _squash(y - fit), _squash(y - without), _squash(y - least), _squash(y - median)], 2)
    direction = lights[:, :, :, None, None].expand(b, k, 3, h, w)
    known = y.new_ones(b, k, 1, h, w)
    return torch.cat([direction, n[:, None].expand(b, k, 3, h, w), maps, known], 2)


def luminance(images: Tensor) -> Tensor:
    """Luma (B, K, H, W) of (B, K, 3, H, W)."""
    r, g, b = images.unbind(2)
    red, green, blue = (float(weight) for weight in LUMA)
    return red * r + green * g + blue * b


def toward(n: Tensor, lights: Tensor) -> tuple[Tensor, Tensor]:
    """n.l and n.h, each (B, K, H, W), h the half vector of the light and the view along +z. n: (B, 3, H, W). lights: (B, K, 3)."""
    half = lights + lights.new_tensor([0.0, 0.0, 1.0])
    half = half / half.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    b, _, h, w = n.shape
    flat = n.reshape(b, 3, h * w)
    return torch.bmm(lights, flat).reshape(b, -1, h, w), torch.bmm(half, flat).reshape(b, -1, h, w)


def _left_out(y: Tensor, lights: Tensor, weights: Tensor) -> Tensor:
    """What the other samples of a pixel predict for each, by least squares without it: y - r / (1 - leverage)."""
    b, k, h, w = y.shape
    if k < 4:
        return y
    fitted = torch.bmm(lights, weighted_least_squares(y, lights, weights).reshape(b, 3, h * w)).reshape(b, k, h, w)
    matrix = lights.transpose(1, 2) @ lights + 1e-4 * torch.eye(3, device=y.device, dtype=y.dtype)
    leverage = torch.einsum("bki,bij,bkj->bk", lights, torch.linalg.inv(matrix), lights).clamp(max=0.98)
    return (y - (y - fitted) / (1 - leverage)[:, :, None, None]).clamp(-CUT, CUT)


def triplet_predictions(y: Tensor, lights: Tensor) -> tuple[Tensor, Tensor]:
    """The least and the median of what well-spread triplets of other lights predict for each sample, each (B, K, H, W); y where K < 4.

    y: (B, K, H, W). lights: (B, K, 3). A highlight makes the triplets with it overshoot; the least prediction is the one without.
    """
    b, k, h, w = y.shape
    if k < 4:
        return y, y
    chosen, inverse = _triplets(lights)
    t = chosen.shape[1]
    flat = y.reshape(b, k, h * w)
    samples = torch.gather(flat, 1, chosen.reshape(b, t * 3, 1).expand(-1, -1, h * w)).reshape(b, t, 3, h * w)
    # l_k . (L_t^-1 y_t): the weights of the three samples in each prediction
    mixing = torch.einsum("bki,btij->bktj", lights, inverse)
    used = (chosen[:, None] == torch.arange(k, device=y.device)[None, :, None, None]).any(-1)
    least, median = [], []
    for i in range(k):
        predicted = torch.einsum("btj,btjp->btp", mixing[:, i], samples).clamp(0, CUT)
        predicted = torch.where(used[:, i, :, None], predicted.new_full((), torch.inf), predicted)
        ordered = predicted.sort(1).values
        others = (~used[:, i]).sum(1)
        least.append(torch.where(ordered[:, 0].isfinite(), ordered[:, 0], flat[:, i]))
        middle = torch.gather(ordered, 1, ((others - 1).clamp(min=0) // 2)[:, None, None].expand(-1, 1, h * w))[:, 0]
        median.append(torch.where(middle.isfinite(), middle, flat[:, i]))
    return torch.stack(least, 1).reshape(b, k, h, w), torch.stack(median, 1).reshape(b, k, h, w)


def _triplets(lights: Tensor) -> tuple[Tensor, Tensor]:
    """The triplets whose directions span best: indices (B, T, 3) and inverses of their directions (B, T, 3, 3).

    Chosen over the lights in order of direction, so that the order in which pictures come makes no difference.
    """
    b, k, _ = lights.shape
    every = torch.tensor(list(combinations(range(k), 3)), device=lights.device)
    key = (lights * lights.new_tensor([1.0, 1.618, 2.414])).sum(-1)
    index = torch.argsort(key, 1)[:, every]
    directions = torch.gather(lights, 1, index.reshape(b, -1, 1).expand(-1, -1, 3)).reshape(b, -1, 3, 3)
    determinant = torch.linalg.det(directions)
    best = determinant.abs().topk(min(TRIPLETS, index.shape[1]), 1).indices
    index = torch.gather(index, 1, best[..., None].expand(-1, -1, 3))
    directions = torch.gather(directions, 1, best[..., None, None].expand(-1, -1, 3, 3))
    # Coplanar lights have no inverse: the pseudo-inverse gives a bounded prediction.
    return index, torch.linalg.pinv(directions, rtol=0.05)


def _squash(x: Tensor) -> Tensor:
    """Signed square root: small residuals are told apart, large ones do not drown them."""
    return torch.sign(x) * (x.abs() + 1e-4).sqrt()
