"""LIME: the five networks wired together, the paper's method (a).

Source: Meka et al., "LIME: Live Intrinsic Material Estimation" (CVPR 2018). Its image formation, picture = m_d D + m_s S with the shadings
D and S of one uniform material, is ours too (`gen.lime`); the layers and what is said below of D are our own choices.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from learn.models.blocks import srgb_to_linear
from learn.models.lime_nets import (
    AlbedoNet,
    ExponentNet,
    MirrorNet,
    SegmentationNet,
    SpecularNet,
    expected_exponent,
)


class LimeFactors(NamedTuple):
    """What LIME says of a picture.

    mask_logit: (B, 1, H, W), what the segmentation says even where another mask was given. mask: (B, 1, H, W) bool, the one that was used.
    S_encoded, mirror_encoded: (B, 3, H, W), sRGB-encoded and unbounded. m_d, m_s: (B, 3). exponent_logits: (B, classes).
    """

    mask_logit: Tensor
    mask: Tensor
    S_encoded: Tensor
    mirror_encoded: Tensor
    m_d: Tensor
    m_s: Tensor
    exponent_logits: Tensor

    @property
    def S(self) -> Tensor:
        """The specular shading (B, 3, H, W), linear, not negative, 0 outside the mask."""
        return srgb_to_linear(self.S_encoded) * self.mask

    @property
    def mirror(self) -> Tensor:
        """The mirror image (B, 3, H, W), linear, not negative, 0 outside the mask."""
        return srgb_to_linear(self.mirror_encoded) * self.mask

    @property
    def exponent(self) -> Tensor:
        """The Blinn-Phong exponent (B,)."""
        return expected_exponent(self.exponent_logits)

    @property
    def specular(self) -> Tensor:
        """m_s S (B, 3, H, W), linear."""
        return self.m_s[:, :, None, None] * self.S


class LimeNet(nn.Module):
    """Segmentation; the masked picture's S; from S the mirror image; from picture and S the reflectances; from S and mirror the exponent.

    SpecularNet and the encoders are `width` wide; SegmentationNet and MirrorNet, whose tasks are easier or matter to the exponent alone,
    half as wide (at least 8). The diffuse layer is I - m_s S: no network predicts D, which that difference over m_d gives.
    Raises InputError where width or stem is out of range.
    """

    def __init__(self, width: int = 32, stem: int = 1) -> None:
        super().__init__()
        narrow = min(width, max(8, width // 2))
        self.segmentation = SegmentationNet(narrow, stem)
        self.specular = SpecularNet(width, stem)
        self.mirror = MirrorNet(narrow, stem)
        self.albedo = AlbedoNet(width, stem)
        self.exponent = ExponentNet(width, stem)

    def forward(self, image: Tensor, mask: Tensor | None = None) -> LimeFactors:
        """image: (B, 3, H, W) linear, any size. mask: (B, 1, H, W) bool takes the place of the segmentation, in training the true one.

        A threshold has no gradient, so the segmentation learns from its own loss alone; the other networks learn from each other's errors.
        """
        mask_logit = self.segmentation(image)
        inside = mask_logit > 0 if mask is None else mask
        masked = image * inside
        S_encoded = self.specular(masked).float()
        S = srgb_to_linear(S_encoded) * inside
        mirror_encoded = self.mirror(S).float()
        m_d, m_s = self.albedo(masked, S, inside)
        logits = self.exponent(S, srgb_to_linear(mirror_encoded) * inside, inside)
        return LimeFactors(mask_logit, inside, S_encoded, mirror_encoded, m_d, m_s, logits)

    def remove(self, image: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """(diffuse, specular) = (I - m_s S, m_s S), each (B, 3, H, W) linear and not negative; their sum is the image, to float rounding.

        m_s S is cut where it exceeds the picture. mask: as in `forward`; None segments the picture. Outside the mask all is diffuse.
        """
        specular = torch.minimum(self(image, mask).specular, image)
        diffuse = image - specular
        return diffuse, specular


def perceptual_loss(image: Tensor, mask: Tensor, D: Tensor, S: Tensor, m_d: Tensor, m_s: Tensor) -> Tensor:
    """LIME's |M (I - (m_d D + m_s S))|, the mean over the object's pixels and channels: 0 where the factors explain the picture.

    image, D, S: (B, 3, H, W) linear. mask: (B, 1, H, W) bool. m_d, m_s: (B, 3).
    In training D is the TRUE diffuse shading, S, m_d and m_s are predicted. No network of the five predicts D, and with the D that
    follows from the others, (I - m_s S) / m_d, the difference would be 0 whatever they say.
    """
    explained = m_d[:, :, None, None] * D + m_s[:, :, None, None] * S
    return ((image - explained).abs() * mask).sum() / (3 * mask.sum()).clamp(min=1)
