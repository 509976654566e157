"""What physics says of each sample of a capture before any network looks: the input features of the group network.

All is per pixel and relative to the pixel's own brightness, so that it means the same on dark and light, small and large surfaces, and
order of the lights makes no difference but to the order of the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import torch
from torch import Tensor

from gen.capture import LUMA
from learn.solve import in_full, robust_start, shading, unit, weighted_least_squares

TRIPLETS = 20
"""Most triplets of lights that are solved: all of up to six lights, the best spread of more."""

CHANNELS = 21
"""Features of a sample."""

COLOUR_ALONE = 8
"""Features that need no lights."""

LIT = 0.1
"""Share of the pixel's brightness below which a sample's colour says nothing."""

GREY = (0.05, 0.1)
"""Saturation (1 - smallest / largest channel) of a pixel's middle lit sample up to which its colour is that of lamps, noise and rounding,
and from which it is the surface's own."""

FLAT = 0.1
"""Triplets that span less than this share of the best one's volume predict nothing that can be relied on, and are left out."""


@dataclass(frozen=True)
class Evidence:
    """features: (B, K, CHANNELS, H, W). scale: (B, 1, H, W), the pixel's brightness. y: (B, K, H, W), luma over scale, cut at `CUT`."""

    features: Tensor
    scale: Tensor
    y: Tensor


CUT = 20.0
"""Luma over the pixel's brightness above which it does not matter how bright a highlight is."""


@in_full
def evidence(images: Tensor, lights: Tensor | None, valid: Tensor, mask: Tensor, level: Tensor | None = None) -> Evidence:
    """The features of every sample.

    images: (B, K, 3, H, W) reflectance, may be slightly negative. lights: (B, K, 3) unit, or None where unknown. valid: (B, K, H, W) bool.
    mask: (B, H, W) bool. level: (B, 1, 1, 1), the brightness of the whole of which this is a part; None: this is all (see `roots`).
    Features: square roots of the three channels over the pixel's brightness; validity; how grey the sample is beside
    the pixel's most colourful, and how colourful that one is; what the colour says of the diffuse share (`diffuse_by_colour`, log); the
    pixel's brightness beside the picture's (log); and with lights known: their direction, a robust Lambertian normal with n.l and n.h,
    the residual of its fit, of the fit without this sample, and of the least and the median prediction of this sample from triplets of
    the others.
    """
    b, k, _, h, w = images.shape
    inside = mask[:, None].to(images.dtype)
    luma = luminance(images).clamp(min=0) * inside
    dim = luma.clamp(min=1e-12).sqrt().mean(1, keepdim=True)
    if level is None:
        level = level_of((dim * inside).sum((2, 3), keepdim=True), inside.sum((2, 3), keepdim=True))
    # Of a pixel too, but no more than that of its lights' middle one (or the picture's, where most are shadowed) allows: else a strong
    # highlight would make all other samples look dark.
    middle = luma.sort(1).values[:, (k - 1) // 2, None]
    scale = torch.minimum(dim.square(), torch.maximum(3 * middle, level)) + 0.01 * level + 1e-6
    y = (luma / scale).clamp(max=CUT)
    shown = valid.to(images.dtype)
    images = without_cast(images, y)
    colour = (images / scale.unsqueeze(2)).clamp(0, CUT)
    saturation = saturations(images) * inside
    most = (saturation * (y > LIT)).amax(1, keepdim=True)
    parts = [
        colour.sqrt().flatten(0, 1),
        shown.reshape(b * k, 1, h, w),
        (most - saturation).reshape(b * k, 1, h, w),
        most.expand(b, k, h, w).reshape(b * k, 1, h, w),
        (torch.log((diffuse_by_colour(images, y) + 0.03) / (y + 0.03)) * inside).reshape(b * k, 1, h, w),
        (torch.log(scale / (level + 1e-6)).clamp(-4, 4) * inside).expand(b, k, h, w).reshape(b * k, 1, h, w),
    ]
    if lights is None:
        parts.append(images.new_zeros(b * k, CHANNELS - COLOUR_ALONE, h, w))
    else:
        parts.append(_geometry(y, lights, shown).flatten(0, 1))
    features = torch.cat(parts, 1) * mask.repeat_interleave(k, 0).unsqueeze(1)
    return Evidence(features.reshape(b, k, CHANNELS, h, w), scale, y)


def roots(images: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Of a part of a picture what its brightness is made of, each (B, 1, 1, 1): both add up over the parts. Arguments as in `evidence`.

    They are the sum over the object's pixels of the root of their luma, mean over the lights, and the number of these pixels.
    """
    inside = mask[:, None].to(images.dtype)
    dim = (luminance(images).clamp(min=0) * inside).clamp(min=1e-12).sqrt().mean(1, keepdim=True)
    return (dim * inside).sum((2, 3), keepdim=True), inside.sum((2, 3), keepdim=True)


def level_of(total: Tensor, pixels: Tensor) -> Tensor:
    """A picture's brightness by its `roots`: highlights, however bright, hardly move a mean of roots."""
    return (total / pixels.clamp(min=1)).square()


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


def saturations(images: Tensor) -> Tensor:
    """1 - smallest / largest channel of each sample, (B, K, H, W) from 0 to 1, of images (B, K, 3, H, W); 1 where it is black."""
    return 1 - images.amin(2).clamp(min=0) / images.amax(2).clamp(min=1e-6)


def without_cast(images: Tensor, y: Tensor) -> Tensor:
    """The images (B, K, 3, H, W) with the pixels that are nearly grey made grey, by `GREY`; luma stays. Ours.

    White gloss cannot be told from a grey surface by colour, but lamps that differ by a percent or two would seem to tell it.
    images: (B, K, 3, H, W). y: (B, K, H, W), luma over the pixel's brightness.
    """
    lit = y > LIT
    ordered = torch.where(lit, saturations(images), 1.0).sort(1).values  # those in shadow come last
    middle = ordered.gather(1, (lit.sum(1, keepdim=True) - 1).clamp(min=0) // 2)
    own = ((middle - GREY[0]) / (GREY[1] - GREY[0])).clamp(0, 1).unsqueeze(2)
    grey = luminance(images).unsqueeze(2)
    return torch.where(own < 1, grey + own * (images - grey), images)


def diffuse_by_colour(images: Tensor, y: Tensor) -> Tensor:
    """What a white gloss leaves of each sample by its colour alone, in the units of y and at most y; all of it where the pixel is grey.

    images: (B, K, 3, H, W). y: (B, K, H, W) luma in any unit. Gloss adds the same to all channels, so the difference of the largest and
    the smallest is diffuse; the lit sample with the least luma for its difference is taken as free of gloss.
    Source: the dichromatic model, S. Shafer, Color Research and Application 10(4), 1985.
    """
    shown = images.clamp(min=0)
    chroma = shown.amax(2) - shown.amin(2)
    ratio = torch.where((y > LIT) & (chroma > 0), y / chroma.clamp(min=1e-9), torch.inf).amin(1, keepdim=True)
    return torch.minimum(torch.where(ratio.isfinite(), chroma * ratio, y), y)


def luminance(images: Tensor) -> Tensor:
    """Luma (B, K, H, W) of (B, K, 3, H, W)."""
    r, g, b = images.unbind(2)
    red, green, blue = (float(weight) for weight in LUMA)
    return red * r + green * g + blue * b


@in_full
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
    chosen, inverse, flat = _triplets(lights)
    t = chosen.shape[1]
    given = y.reshape(b, k, h * w)
    samples = torch.gather(given, 1, chosen.reshape(b, t * 3, 1).expand(-1, -1, h * w)).reshape(b, t, 3, h * w)
    # l_k . (L_t^-1 y_t): the weights of the three samples in each prediction
    mixing = torch.einsum("bki,btij->bktj", lights, inverse)
    unfit = (chosen[:, None] == torch.arange(k, device=y.device)[None, :, None, None]).any(-1) | flat[:, None]
    # Of a sample's triplets the fit ones come first; no more are looked at than there are without it.
    order = (~unfit).to(y.dtype).topk(min(comb(k - 1, 3), t), 2).indices
    least, median = [], []
    for i in range(k):
        mine = order[:, i]
        weights = torch.gather(mixing[:, i], 1, mine[..., None].expand(-1, -1, 3))
        of_mine = torch.gather(samples, 1, mine[..., None, None].expand(-1, -1, 3, h * w))
        predicted = torch.einsum("btj,btjp->btp", weights, of_mine).clamp(0, CUT)
        out = torch.gather(unfit[:, i], 1, mine)
        predicted = predicted.masked_fill(out[..., None], torch.inf)
        ordered = predicted.sort(1).values
        others = (~out).sum(1)
        least.append(torch.where(ordered[:, 0].isfinite(), ordered[:, 0], given[:, i]))
        middle = torch.gather(ordered, 1, ((others - 1).clamp(min=0) // 2)[:, None, None].expand(-1, 1, h * w))[:, 0]
        median.append(torch.where(middle.isfinite(), middle, given[:, i]))
    return torch.stack(least, 1).reshape(b, k, h, w), torch.stack(median, 1).reshape(b, k, h, w)


def _triplets(lights: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The triplets whose directions span best: indices (B, T, 3), inverses of their directions (B, T, 3, 3), and which are `FLAT` (B, T).

    Chosen over the lights in order of direction, so that the order in which pictures come makes no difference.
    """
    b, k, _ = lights.shape
    every = torch.tensor(list(combinations(range(k), 3)), device=lights.device)
    key = (lights * lights.new_tensor([1.0, 1.618, 2.414])).sum(-1)
    index = torch.argsort(key, 1)[:, every]
    directions = torch.gather(lights, 1, index.reshape(b, -1, 1).expand(-1, -1, 3)).reshape(b, -1, 3, 3)
    volume, best = torch.linalg.det(directions).abs().topk(min(TRIPLETS, index.shape[1]), 1)
    index = torch.gather(index, 1, best[..., None].expand(-1, -1, 3))
    directions = torch.gather(directions, 1, best[..., None, None].expand(-1, -1, 3, 3))
    # Coplanar lights have no inverse: the pseudo-inverse gives a bounded prediction.
    return index, torch.linalg.pinv(directions, rtol=0.05), volume < FLAT * volume[:, :1].clamp(min=1e-6)


def _squash(x: Tensor) -> Tensor:
    """Signed square root: small residuals are told apart, large ones do not drown them."""
    return torch.sign(x) * ((x.abs() + 1e-4).sqrt() - 1e-2)
