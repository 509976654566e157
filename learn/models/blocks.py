"""What the networks of single pictures are made of: the sRGB curve with a safe gradient, convolution blocks, padding, pooling."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gen.errors import InputError


def linear_to_srgb(linear: Tensor) -> Tensor:
    """sRGB-encoded values of linear ones (IEC 61966-2-1; any shape), endless above 1; what is negative counts as 0.

    Both branches of the curve are kept away from the place where the other one's gradient is infinite: a `where` alone would turn
    0 * inf into NaN.
    """
    low = linear.clamp(min=0)
    power = 1.055 * low.clamp(min=0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(low <= 0.0031308, 12.92 * low, power)


def srgb_to_linear(encoded: Tensor) -> Tensor:
    """The inverse of `linear_to_srgb`; what is negative counts as 0."""
    low = encoded.clamp(min=0)
    power = ((low.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(low <= 0.04045, low / 12.92, power)


def as_recorded(image: Tensor) -> Tensor:
    """The sRGB-encoded picture in 0..1 that a camera whose top is radiance 1 would have stored, without its rounding."""
    return linear_to_srgb(image.clamp(max=1))


class ConvBlock(nn.Sequential):
    """3x3 convolution, BatchNorm, ReLU. stride 2 halves the picture."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__(nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class DoubleConv(nn.Sequential):
    """Two blocks; the first may halve the picture."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__(ConvBlock(inputs, outputs, stride), ConvBlock(outputs, outputs))


def pad_to_multiple(x: Tensor, multiple: int) -> Tensor:
    """(B, C, H, W) with its last row and column repeated until both sides are multiples; the picture stays at the top left."""
    H, W = x.shape[-2:]
    down, right = -H % multiple, -W % multiple
    return F.pad(x, (0, right, 0, down), mode="replicate") if down or right else x


def masked_mean(features: Tensor, mask: Tensor) -> Tensor:
    """The mean (B, C) of features (B, C, h, w) over the object. mask: (B, 1, H, W), H >= h; an empty one takes the whole picture.

    A coarse pixel counts by the share of the object in it, so that the surroundings do not dilute what is said of the object.
    """
    share = F.adaptive_avg_pool2d(mask.to(features.dtype), features.shape[-2:])
    total = share.sum(dim=(2, 3))
    share = torch.where(total[..., None, None] > 0, share, torch.ones_like(share))
    return (features * share).sum(dim=(2, 3)) / share.sum(dim=(2, 3))


def zero_start(layer: nn.Conv2d | nn.Linear) -> nn.Conv2d | nn.Linear:
    """The same layer with weights and bias 0: a network that ends in it starts by saying 0 everywhere."""
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


def check_width(width: int, stem: int, what: str) -> None:
    """Raise InputError unless width (channels at the finest level) is 4 to 128 and stem (the first stride) is 1 or 2."""
    if not 4 <= width <= 128:
        raise InputError(f"{what}: width = {width} must be from 4 to 128 channels")
    if stem not in (1, 2):
        raise InputError(f"{what}: stem = {stem} must be 1 (work at full resolution) or 2 (at half)")
