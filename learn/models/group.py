"""GroupNet: gloss removal over all pictures of a capture at once, made for the measurement that follows. Ours, method (d)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from gen.errors import InputError
from learn.models.evidence import CHANNELS, evidence, luminance, toward
from learn.solve import shading, unit, weighted_least_squares

OUTPUTS = 7
"""Per sample: log gain of matte over input (3 channels), logit of the diffuse share (3), logit of the confidence."""

CERTAIN = 2.0
"""Logit of the confidence before training: all samples count alike, as in least squares."""

DOUBTED = -4.0
"""What is added to that logit where a sample is not valid: clipped or dark."""

MATTE = 5.0
"""Logit of the diffuse share before training: nearly all of the input is diffuse."""


@dataclass(frozen=True)
class GroupLayers:
    """matte, diffuse, specular: (B, K, 3, H, W), in the input's units. confidence: (B, K, H, W) in (0, 1).

    normals: (B, 3, H, W) unit, of weighted least squares on the matte layer; zero where the lights are unknown.
    first: the same before the refinement, for the loss; None in `eval`.
    """

    matte: Tensor
    diffuse: Tensor
    specular: Tensor
    confidence: Tensor
    normals: Tensor
    first: GroupLayers | None = None


class GroupNet(nn.Module):
    """Encoder and decoder shared by all pictures, with features exchanged over the lights at each scale; a head at every pixel.

    widths: channels at 1/2, 1/4, 1/8 and 1/16 of the size. head: channels of the full-size head. No layer mixes a picture with another but
    by the mean and the largest over the lights, so any number of pictures in any order will do. Every norm is over the channels of one
    pixel: of a whole picture nothing enters but its mean brightness (see `learn.models.evidence`). The last layers begin at zero: an
    untrained network hands back the input with equal weights, which is least squares.

    Source: the exchange by maximum follows G. Chen, K. Han and K.-Y. Wong, "PS-FCN", ECCV 2018; the rest is ours.
    """

    def __init__(self, widths: list[int] | None = None, head: int = 24) -> None:
        super().__init__()
        self.widths = [16, 32, 48, 64] if widths is None else list(widths)
        if len(self.widths) < 2 or any(type(n) is not int or not 4 <= n <= 512 for n in (*self.widths, head)):
            raise InputError(f"group: widths = {self.widths} and head = {head} must be 2 or more whole numbers from 4 to 512")
        down, up = [], []
        before = CHANNELS
        for width in self.widths:
            down.append(Down(before, width))
            before = width
        for wide, narrow in zip(self.widths[:0:-1], self.widths[-2::-1], strict=True):
            up.append(Up(wide, narrow))
        self.down, self.up = nn.ModuleList(down), nn.ModuleList(up)
        self.fine = nn.Conv2d(CHANNELS, head, 3, padding=1)
        self.coarse = nn.Conv2d(self.widths[0], head, 1)
        self.mix = nn.Conv2d(head, head, 1)
        self.out = _zero(nn.Conv2d(head, OUTPUTS, 1))
        self.look = nn.Conv2d(REFINED, head, 3, padding=1)
        self.again = nn.Conv2d(head, head, 1)
        self.change = _zero(nn.Conv2d(head, OUTPUTS, 1))

    def forward(
        self, images: Tensor, lights: Tensor | None, valid: Tensor, mask: Tensor, solve: Tensor | None = None
    ) -> GroupLayers:
        """The layers of captures. See `GroupLayers`.

        images: (B, K, 3, H, W) radiance over light intensity. lights: (B, K, 3) unit, or None where unknown. valid: (B, K, H, W) bool.
        mask: (B, H, W) bool. solve: lights for the normals alone, which the network does not see (training without lights).
        """
        b, k, _, h, w = images.shape
        given = evidence(images, lights, valid, mask)
        features = given.features.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        step = 1 << len(self.widths)
        padded = F.pad(features, (0, -w % step, 0, -h % step))
        x, skips = padded, []
        for down in self.down:
            x = down(x, k)
            skips.append(x)
        for up, skip in zip(self.up, skips[-2::-1], strict=True):
            x = up(x, skip)
        coarse = F.interpolate(self.coarse(x), scale_factor=2, mode="bilinear", align_corners=False)[..., :h, :w]
        hidden = F.relu(self.mix(F.relu(self.fine(features) + coarse)))
        first = self.out(hidden).reshape(b, k, OUTPUTS, h, w)
        known = lights if solve is None else solve
        doubt = DOUBTED * (~valid)
        one = assemble(images, first, doubt, known)
        if lights is None:
            return one
        refined = self._look_again(given.y, given.scale, one, lights).flatten(0, 1) * mask.repeat_interleave(k, 0).unsqueeze(1)
        hidden = F.relu(self.again(F.relu(self.look(refined) + hidden)))
        two = assemble(images, first + self.change(hidden).reshape(b, k, OUTPUTS, h, w), doubt, known)
        return GroupLayers(two.matte, two.diffuse, two.specular, two.confidence, two.normals, one if self.training else None)

    @staticmethod
    def _look_again(y: Tensor, scale: Tensor, found: GroupLayers, lights: Tensor) -> Tensor:
        """What the first normal says of each sample: (B, K, REFINED, H, W)."""
        matte = luminance(found.matte) / scale
        fit = shading(weighted_least_squares(matte, lights, found.confidence), lights)
        nl, nh = toward(found.normals, lights)
        apart = (matte - fit).clamp(-5, 5)
        return torch.stack([nl, nh, nl.clamp(max=0), apart, (y - fit).clamp(-5, 5), fit.clamp(max=5), found.confidence], 2)


REFINED = 7
"""Features of a sample for the refinement."""


class Down(nn.Module):
    """Halves the size, exchanges over the lights, and looks around: (B*K, before, H, W) -> (B*K, width, H/2, W/2)."""

    def __init__(self, before: int, width: int) -> None:
        super().__init__()
        self.halve = nn.Conv2d(before, width, 4, stride=2, padding=1)
        self.own = nn.Conv2d(width, width, 3, padding=1)
        self.shared = nn.Conv2d(2 * width, width, 1)

    def forward(self, x: Tensor, k: int) -> Tensor:
        x = F.relu(pixel_norm(self.halve(x)))
        group = x.unflatten(0, (-1, k))
        told = self.shared(torch.cat([group.amax(1), group.mean(1)], 1))
        return F.relu(pixel_norm(self.own(x) + told.repeat_interleave(k, 0)) + x)


class Up(nn.Module):
    """Doubles the size and adds what was there before it was halved."""

    def __init__(self, wide: int, narrow: int) -> None:
        super().__init__()
        self.bring = nn.Conv2d(wide, narrow, 1)
        self.join = nn.Conv2d(narrow, narrow, 3, padding=1)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        x = F.interpolate(self.bring(x), scale_factor=2, mode="bilinear", align_corners=False) + skip
        return F.relu(pixel_norm(self.join(x)) + skip)


def pixel_norm(x: Tensor) -> Tensor:
    """x over the root mean square of its channels at each pixel, (N, C, H, W)."""
    return x * torch.rsqrt(x.square().mean(1, keepdim=True) + 1e-4)


def assemble(images: Tensor, outputs: Tensor, doubt: Tensor, lights: Tensor | None) -> GroupLayers:
    """Layers of the network's outputs (B, K, OUTPUTS, H, W) for images (B, K, 3, H, W); normals zero where lights is None.

    doubt: (B, K, H, W), added to the confidence's logit.
    """
    gain, share, trust = outputs[:, :, :3], outputs[:, :, 3:6], outputs[:, :, 6]
    shown = images.clamp(min=0)
    matte = shown * torch.exp(gain.clamp(-6, 3))
    diffuse = images * torch.sigmoid(share + MATTE)
    confidence = torch.sigmoid(trust + CERTAIN + doubt)
    if lights is None:
        normals = images.new_zeros(images.shape[0], 3, *images.shape[-2:])
    else:
        normals = unit(weighted_least_squares(luminance(matte), lights, confidence))
    return GroupLayers(matte, diffuse, images - diffuse, confidence, normals)


def _zero(layer: nn.Conv2d) -> nn.Conv2d:
    nn.init.zeros_(layer.weight)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
    return layer
