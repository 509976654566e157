"""LIME's five networks. All take linear radiance and see it sRGB-encoded, because that is where results are scored.

Source: Meka, Maximov, Zollhoefer, Chatterjee, Seidel, Richardt and Theobalt, "LIME: Live Intrinsic Material Estimation" (CVPR 2018),
for what each network takes and gives. The layers are our own: see `learn.models.unet`.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gen.errors import InputError
from learn.models.blocks import as_recorded, linear_to_srgb, srgb_to_linear
from learn.models.unet import Encoder, UNet

EXPONENTS = tuple(4 * 2 ** (k / 2) for k in range(17))
"""The classes of shininess: Blinn-Phong exponents from 4 to 1024, two an octave (alpha .58 to .044)."""

LAYERS = ("specular", "diffuse")


class SegmentationNet(nn.Module):
    """Picture to mask. Above 0 is object."""

    def __init__(self, width: int = 32, stem: int = 1) -> None:
        super().__init__()
        self.net = UNet(3, 1, width, stem)

    def forward(self, image: Tensor) -> Tensor:
        """image: (B, 3, H, W) linear. Returns logits (B, 1, H, W)."""
        return self.net(as_recorded(image))


class SpecularNet(nn.Module):
    """Masked picture to gloss: a part of LIME, and alone the paper's methods (b) and (c).

    `forward` gives three sRGB-encoded numbers a pixel, unbounded; who asks says what they are. In LIME they are the specular shading S.
    In `remove` they are, by `layer`:

    - "specular", method (b): how much brighter gloss has made the recorded picture. The specular layer is what vanishes when the picture
      is darkened by that much, and diffuse = input - specular. Predicting on the curve, where the score is measured, keeps errors in
      dark diffuse under bright highlights from being magnified, and an untrained network says "no gloss".
    - "diffuse", method (c): the diffuse layer itself.

    Raises InputError where layer is another word, or width or stem is out of range.
    """

    def __init__(self, width: int = 32, stem: int = 1, layer: str = "specular") -> None:
        if layer not in LAYERS:
            raise InputError(f"SpecularNet: layer = {layer!r} must be one of {', '.join(LAYERS)}")
        super().__init__()
        self.net = UNet(3, 3, width, stem)
        self.layer = layer

    def forward(self, masked: Tensor) -> Tensor:
        """masked: (B, 3, H, W) linear, 0 outside the object. Returns (B, 3, H, W), sRGB-encoded, unbounded on both sides."""
        return self.net(as_recorded(masked))

    def remove(self, image: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """(diffuse, specular), each (B, 3, H, W) linear and not negative; their sum is the image, to float rounding.

        image: (B, 3, H, W) linear, not negative, so exposed that 1 is the sensor's top: what exceeds 1 counts as gloss. Any size.
        mask: (B, 1, H, W) bool; outside it all is diffuse. None: the whole picture is the object.
        """
        predicted = self(image if mask is None else image * mask)
        encoded = encoded_diffuse(self.layer, image, predicted, mask)
        diffuse = torch.minimum(srgb_to_linear(torch.minimum(encoded, as_recorded(image))), image)
        if mask is not None:
            diffuse = torch.where(mask, diffuse, image)
        return diffuse, image - diffuse


def encoded_diffuse(layer: str, image: Tensor, predicted: Tensor, mask: Tensor | None = None) -> Tensor:
    """The diffuse layer that a SpecularNet's output says, sRGB-encoded and not yet bounded (B, 3, H, W): what training is judged on.

    layer: one of `LAYERS`. image: (B, 3, H, W) linear. predicted: (B, 3, H, W), the network's output. mask: (B, 1, H, W) bool, outside
    which the recorded picture is returned; None: everywhere is object.
    Bounding it to 0..recorded, where the truth lies too, can only bring it nearer to the truth. So its error bounds that of
    `SpecularNet.remove`, and unlike that one's its gradient vanishes nowhere.
    """
    recorded = as_recorded(image)
    diffuse = recorded - predicted.float() if layer == "specular" else predicted.float()
    return diffuse if mask is None else torch.where(mask, diffuse, recorded)


class MirrorNet(nn.Module):
    """Specular shading to what a mirror of the same shape would show."""

    def __init__(self, width: int = 32, stem: int = 1) -> None:
        super().__init__()
        self.net = UNet(3, 3, width, stem)

    def forward(self, S: Tensor) -> Tensor:
        """S: (B, 3, H, W) linear. Returns the mirror image (B, 3, H, W), sRGB-encoded, unbounded on both sides."""
        return self.net(linear_to_srgb(S))


class AlbedoNet(nn.Module):
    """Picture and specular shading to the two reflectances of the one material."""

    def __init__(self, width: int = 32, stem: int = 1) -> None:
        super().__init__()
        self.net = Encoder(6, 6, width, stem)

    def forward(self, masked: Tensor, S: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """masked, S: (B, 3, H, W) linear. mask: (B, 1, H, W). Returns m_d and m_s (B, 3), each between 0 and 1."""
        both = torch.sigmoid(self.net(torch.cat([as_recorded(masked), linear_to_srgb(S)], dim=1), mask).float())
        return both[:, :3], both[:, 3:]


class ExponentNet(nn.Module):
    """Specular shading and mirror image to a class of shininess: how much wider than the mirror's the highlights are."""

    def __init__(self, width: int = 32, stem: int = 1) -> None:
        super().__init__()
        self.net = Encoder(6, len(EXPONENTS), width, stem)

    def forward(self, S: Tensor, mirror: Tensor, mask: Tensor) -> Tensor:
        """S, mirror: (B, 3, H, W) linear. mask: (B, 1, H, W). Returns logits (B, classes) over `EXPONENTS`."""
        return self.net(torch.cat([linear_to_srgb(S), linear_to_srgb(mirror)], dim=1), mask)


def exponent_shares(exponent: Tensor) -> Tensor:
    """Class probabilities (B, classes) that say an exponent (B,): shared between its two neighbours so that `expected_exponent` returns it.

    Exponents beyond the classes count as the last one. A share, not the nearest class, so that the target is not rounded by up to 19 %.
    """
    place = (torch.log2(exponent.clamp(EXPONENTS[0], EXPONENTS[-1]) / EXPONENTS[0]) * 2)[:, None]
    classes = torch.arange(len(EXPONENTS), device=exponent.device)
    return (1 - (place - classes).abs()).clamp(min=0)


def expected_exponent(logits: Tensor) -> Tensor:
    """The exponent (B,) that class logits (B, classes) expect: the mean of its logarithm, as the classes are even in that."""
    logs = torch.tensor([math.log(exponent) for exponent in EXPONENTS], device=logits.device)
    return torch.exp(F.softmax(logits.float(), dim=1) @ logs)
