"""The two shapes of network that LIME names: a U-Net from picture to picture, and an encoder from picture to a few numbers."""

from __future__ import annotations

from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from learn.models.blocks import ConvBlock, DoubleConv, check_width, masked_mean, pad_to_multiple, zero_start

GROWTH = (1, 2, 3, 4, 4)
"""Channels of each level, in widths; every level but the first halves the picture."""


class UNet(nn.Module):
    """Picture to picture with skip connections, any size. The layers are our choice (LIME's table was not published):

    ====================  ==================  =========================================================================
    part                  channels (widths)   layers
    ====================  ==================  =========================================================================
    level 0               1                   two ConvBlocks, the first of stride `stem`
    levels 1, 2, 3, 4     2, 3, 4, 4          two ConvBlocks each, the first of stride 2
    back to 3, 2, 1, 0    4, 3, 2, 1          upsampled twofold, beside the level's features of the way down, two ConvBlocks
    head                  1/2 (at least 8)    upsampled `stem`-fold, beside the input itself, one ConvBlock, a 1x1 convolution
    ====================  ==================  =========================================================================

    A ConvBlock is a 3x3 convolution, BatchNorm and ReLU. The last convolution starts at 0. The input beside the head keeps edges
    sharp where the stem works at half resolution, which costs a fourth.

    inputs, outputs: channels. width: 32 in the paper's configs, 12 to 16 on a CPU. stem: 1, or 2 to work at half resolution.
    Raises InputError where width or stem is out of range.
    """

    def __init__(self, inputs: int, outputs: int, width: int = 32, stem: int = 1) -> None:
        super().__init__()
        check_width(width, stem, "U-Net")
        sizes = [width * times for times in GROWTH]
        befores = [inputs, *sizes[:-1]]
        strides = [stem, *[2] * (len(sizes) - 1)]
        self.stem = stem
        self.multiple = stem * 2 ** (len(sizes) - 1)
        self.down = nn.ModuleList(DoubleConv(*level) for level in zip(befores, sizes, strides, strict=True))
        self.up = nn.ModuleList(DoubleConv(below + size, size) for below, size in zip(sizes[:0:-1], sizes[-2::-1], strict=True))
        head = max(8, width // 2)
        self.head = nn.Sequential(ConvBlock(width + inputs, head), zero_start(nn.Conv2d(head, outputs, 1)))

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H, W). Sides are padded to the network's multiple and cut back."""
        H, W = x.shape[-2:]
        x = features = pad_to_multiple(x, self.multiple)
        levels = []
        for level in self.down:
            features = level(features)
            levels.append(features)
        levels.pop()
        for level in self.up:
            features = level(torch.cat([_twice(features), levels.pop()], dim=1))
        if self.stem == 2:
            features = _twice(features)
        result: Tensor = self.head(torch.cat([features, x], dim=1))[..., :H, :W]
        return result


class Encoder(nn.Module):
    """Picture to a few numbers, any size. The layers are our choice (LIME's table was not published):

    ====================  ==================  =========================================================================
    part                  channels (widths)   layers
    ====================  ==================  =========================================================================
    levels 0 to 4         1, 2, 3, 4, 4       one ConvBlock each: the first of stride `stem`, the others of stride 2
    pooling               4                   mean over the object, each coarse pixel by its share of it
    head                  4, then outputs     linear, ReLU, linear
    ====================  ==================  =========================================================================

    inputs: channels. outputs: numbers. width, stem: as in `UNet`. The last layer starts at 0.
    """

    def __init__(self, inputs: int, outputs: int, width: int = 32, stem: int = 1) -> None:
        super().__init__()
        check_width(width, stem, "encoder")
        sizes = [width * times for times in GROWTH]
        self.multiple = stem * 2 ** (len(sizes) - 1)
        levels = [ConvBlock(before, size, 2) for before, size in pairwise(sizes)]
        self.levels = nn.Sequential(ConvBlock(inputs, width, stem), *levels)
        self.head = nn.Sequential(
            nn.Linear(sizes[-1], sizes[-1]), nn.ReLU(inplace=True), zero_start(nn.Linear(sizes[-1], outputs))
        )

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        """(B, inputs, H, W) with the object's mask (B, 1, H, W) to (B, outputs)."""
        H, W = x.shape[-2:]
        x = pad_to_multiple(x, self.multiple)
        inside = F.pad(mask.to(x.dtype), (0, x.shape[-1] - W, 0, x.shape[-2] - H))
        result: Tensor = self.head(masked_mean(self.levels(x), inside))
        return result


def _twice(features: Tensor) -> Tensor:
    return F.interpolate(features, scale_factor=2, mode="nearest")
