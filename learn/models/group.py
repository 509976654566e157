"""GroupNet: gloss removal over all pictures of a capture at once, made for the measurement that follows. Ours, method (d)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from gen.errors import InputError
from learn.models.evidence import CHANNELS, Evidence, evidence, luminance, toward
from learn.solve import in_full, shading, unit, weighted_least_squares

OUTPUTS = 7
"""Per sample: log gain of matte over input (3 channels), logit of the diffuse share (3), logit of the confidence."""

CERTAIN = 2.0
"""Logit of the confidence before training: all samples count alike, as in least squares."""

DOUBTED = -4.0
"""What is added to that logit where a sample is not valid: clipped or dark."""

MATTE = 5.0
"""Logit of the diffuse share before training: nearly all of the input is diffuse."""

SEEN_ACROSS = 64
"""Pixels across, about, at which the trunk looks at an object: as large as it was in training."""

MOST_SHRUNK = 16
"""How far a picture is shrunk for the trunk at most."""


@dataclass(frozen=True)
class GroupLayers:
    """matte, diffuse, specular: (B, K, 3, H, W), in the input's units. confidence: (B, K, H, W) in (0, 1).

    normals: (B, 3, H, W) unit, of weighted least squares on the matte layer; zero where the lights are unknown.
    earlier: the same before each refinement, for the loss; empty in `eval`.
    """

    matte: Tensor
    diffuse: Tensor
    specular: Tensor
    confidence: Tensor
    normals: Tensor
    earlier: tuple[GroupLayers, ...] = ()


class GroupNet(nn.Module):
    """Encoder and decoder shared by all pictures, with features exchanged over the lights at each scale; a head at every pixel.

    widths: channels at 1/2, 1/4, 1/8 and 1/16 of the size. head: channels of the full-size head. rounds: how often the head looks again at
    what the normal that it found says of each sample, with the same weights each time. The trunk may look at smaller pictures than the head
    (`shrink`), so that a large object looks to it as it did in training. No layer mixes a picture with another but
    by the mean and the largest over the lights, so any number of pictures in any order will do. Every norm is over the channels of one
    pixel: of a whole picture nothing enters but its mean brightness (see `learn.models.evidence`). The last layers begin at zero: an
    untrained network hands back the input with equal weights, which is least squares.

    Source: the exchange by maximum follows G. Chen, K. Han and K.-Y. Wong, "PS-FCN", ECCV 2018; the rest is ours.
    """

    def __init__(self, widths: list[int] | None = None, head: int = 24, rounds: int = 1) -> None:
        super().__init__()
        self.widths = [16, 32, 48, 64] if widths is None else list(widths)
        if len(self.widths) < 2 or any(type(n) is not int or not 4 <= n <= 512 for n in (*self.widths, head)):
            raise InputError(f"group: widths = {self.widths} and head = {head} must be 2 or more whole numbers from 4 to 512")
        if type(rounds) is not int or not 0 <= rounds <= 8:
            raise InputError(f"group: rounds = {rounds!r} must be a whole number from 0 to 8")
        self.rounds = rounds
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
        self,
        images: Tensor,
        lights: Tensor | None,
        valid: Tensor,
        mask: Tensor,
        solve: Tensor | None = None,
        shrink: int = 1,
    ) -> GroupLayers:
        """The layers of captures. See `GroupLayers`.

        images: (B, K, 3, H, W) radiance over light intensity. lights: (B, K, 3) unit, or None where unknown. valid: (B, K, H, W) bool.
        mask: (B, H, W) bool. solve: lights for the normals alone, which the network does not see (training without lights). shrink: the
        trunk looks at means of shrink x shrink pixels, see `shrink_of`.
        """
        k, _, h, w = images.shape[1:]
        given = evidence(images, lights, valid, mask)
        features = given.features.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        seen = features if shrink == 1 else shrunk_features(images, lights, valid, mask, shrink)
        coarse = enlarged(self.trunk(seen, k), shrink)[..., :h, :w]
        return self.head(images, lights, valid, mask, given, features, coarse, solve)

    def trunk(self, seen: Tensor, k: int) -> Tensor:
        """What encoder and decoder make of the features (B * K, CHANNELS, h, w) of k pictures a view: (B * K, head, h / 2, w / 2)."""
        step = 1 << len(self.widths)
        x, skips = F.pad(seen, (0, -seen.shape[3] % step, 0, -seen.shape[2] % step)), []
        for down in self.down:
            x = down(x, k)
            skips.append(x)
        for up, skip in zip(self.up, skips[-2::-1], strict=True):
            x = up(x, skip)
        return self.coarse(x)

    @property
    def reach(self) -> int:
        """Pixels around it that the trunk looks at for each of its own."""
        return 6 << len(self.widths)

    def head(
        self,
        images: Tensor,
        lights: Tensor | None,
        valid: Tensor,
        mask: Tensor,
        given: Evidence,
        features: Tensor,
        coarse: Tensor,
        solve: Tensor | None = None,
    ) -> GroupLayers:
        """The layers by what the trunk saw, at each pixel: it looks no further around than one pixel, and one more in each refinement.

        given, features: the evidence, and its features (B * K, CHANNELS, H, W). coarse: (B * K, head, H, W), `enlarged`. The rest as in
        `forward`.
        """
        b, k, _, h, w = images.shape
        hidden = F.relu(self.mix(F.relu(self.fine(features) + coarse)))
        outputs = self.out(hidden).reshape(b, k, OUTPUTS, h, w)
        known = lights if solve is None else solve
        doubt = DOUBTED * (~valid)
        found, earlier = assemble(images, outputs, doubt, known), []
        for _ in range(self.rounds if lights is not None else 0):
            earlier.append(found)
            look = self._look_again(given.y, given.scale, found, lights).flatten(0, 1) * mask.repeat_interleave(k, 0).unsqueeze(1)
            hidden = F.relu(self.again(F.relu(self.look(look) + hidden)))
            outputs = outputs + self.change(hidden).reshape(b, k, OUTPUTS, h, w)
            found = assemble(images, outputs, doubt, known)
        return replace(found, earlier=tuple(earlier)) if self.training else found

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


def shrink_of(mask: Tensor) -> int:
    """By how much a picture is shrunk for the trunk: to about `SEEN_ACROSS` pixels across the object, of several the mean.

    mask: (..., H, W) bool.
    """
    across = float(mask.flatten(-2).sum(-1).float().mean()) ** 0.5
    return min(max(round(across / SEEN_ACROSS), 1), MOST_SHRUNK)


def enlarged(coarse: Tensor, shrink: int) -> Tensor:
    """What the trunk made of pictures that were shrunk so, at full size."""
    return F.interpolate(coarse, scale_factor=2 * shrink, mode="bilinear", align_corners=False)


@dataclass(frozen=True)
class Shrunk:
    """Pictures whose pixels are the means over shrink x shrink of the object's.

    images: (B, K, 3, h, w). valid: (B, K, h, w). mask: (B, h, w).
    """

    images: Tensor
    valid: Tensor
    mask: Tensor


def shrunk(images: Tensor, valid: Tensor, mask: Tensor, shrink: int) -> Shrunk:
    """Pictures made smaller; where they do not divide, the last pixels are means of fewer."""
    b, k, _, h, w = images.shape
    edge = (0, -w % shrink, 0, -h % shrink)

    def mean(maps: Tensor) -> Tensor:
        return F.avg_pool2d(F.pad(maps, edge), shrink)

    inside = mask[:, None].to(images.dtype)
    covered = mean(inside)
    share = covered.clamp(min=1e-6).repeat_interleave(k, 0)
    small = mean((images * inside[:, None]).flatten(0, 1)) / share
    shown = mean((valid * inside).flatten(0, 1)[:, None]) / share > 0.5
    size = small.shape[-2:]
    return Shrunk(small.reshape(b, k, 3, *size), shown.reshape(b, k, *size), covered[:, 0] >= 0.5)


def shrunk_features(images: Tensor, lights: Tensor | None, valid: Tensor, mask: Tensor, shrink: int) -> Tensor:
    """The features (B * K, CHANNELS, h, w) of the pictures made smaller."""
    small = shrunk(images, valid, mask, shrink)
    given = evidence(small.images, lights, small.valid, small.mask)
    return given.features.flatten(0, 1).contiguous(memory_format=torch.channels_last)


def pixel_norm(x: Tensor) -> Tensor:
    """x over the root mean square of its channels at each pixel, (N, C, H, W)."""
    return x * torch.rsqrt(x.square().mean(1, keepdim=True) + 1e-4)


@in_full
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
