"""The paper's method (a): LIME's five networks, trained together on pictures of one Blinn-Phong material in surroundings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch
import torch.nn.functional as F
from torch import Tensor

from learn.methods.single import removed, score
from learn.models import create_model
from learn.models.blocks import as_recorded, linear_to_srgb
from learn.models.lime import LimeFactors, perceptual_loss
from learn.models.lime_nets import exponent_shares
from learn.pictures import PictureBatch, Pictures, sheet

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from torch import nn

WEIGHTS: Mapping[str, float] = {"mask": 0.1, "S": 1.0, "mirror": 0.3, "albedo": 0.5, "exponent": 0.02, "perceptual": 1.0}
"""Of the parts of the loss, our choice: about equal pulls after the first epochs, the diffuse layer's own parts ahead."""

ABSOLUTE = 0.1
"""Weight of the mean absolute error beside the squared one, for S and the mirror image."""


class Lime:
    """(a): segmentation, S, mirror image, reflectances and exponent; diffuse = I - m_s S. `learn.method.Method`."""

    name = "lime"

    def build(self, options: Mapping[str, Any]) -> nn.Module:
        """The five networks, wired. options: width, stem; see `learn.models.lime.LimeNet`. Raises InputError where one is wrong."""
        return create_model("lime", **options)

    def source(self, data: Mapping[str, Any], batch: int, seed: int, device: torch.device, split: str) -> Pictures:
        """Pictures of a pack with LIME's factors; data as in `learn.pictures.OPTIONS`. Raises InputError where it is wrong."""
        return Pictures(data, batch, seed, device, split, factors=True)

    def loss(self, model: nn.Module, batch: PictureBatch, progress: float) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted sum of `loss_parts`, which are the figures, with the paper's score mse of I - m_s S and mse_input of doing nothing.

        The networks work within the true mask, so that none waits for the segmentation, and in use within that or a user's.
        """
        said: LimeFactors = model(batch.image, batch.mask)
        parts = loss_parts(said, batch)
        loss = torch.stack([weight * parts[name] for name, weight in WEIGHTS.items()]).sum()
        with torch.no_grad():
            diffuse = (batch.image - said.m_s[:, :, None, None] * said.S).clamp(min=0)
            truth = as_recorded(batch.diffuse)
            figures = {"mse": score(as_recorded(diffuse), truth), "mse_input": score(as_recorded(batch.image), truth)}
        return loss, figures | {name: part.detach() for name, part in parts.items()}

    def samples(self, model: nn.Module, batch: PictureBatch) -> NDArray[np.uint8]:
        """Input; diffuse, specular and mirror image, each predicted and true; the segmentation and the true mask."""
        assert batch.mirror is not None
        diffuse, specular = removed(model, batch)
        training = model.training
        model.eval()
        with torch.no_grad():
            said = model(batch.image, batch.mask)
        model.train(training)
        mask = torch.sigmoid(said.mask_logit)
        true = batch.mask.float()
        return sheet([batch.image, diffuse, batch.diffuse, specular, batch.specular, said.mirror, batch.mirror, mask, true])


def loss_parts(said: LimeFactors, batch: PictureBatch) -> dict[str, Tensor]:
    """What each part of the loss comes to; keys of `WEIGHTS`. batch: with LIME's factors.

    mask: cross entropy over the picture. S, mirror: squared and a little absolute error of the sRGB-encoded values, inside the mask, S in
    the channels where the material has a highlight. albedo: absolute error of m_d and m_s. exponent: cross entropy with the two
    nearest classes, over pictures that have one. perceptual: see `learn.models.lime.perceptual_loss`.
    """
    assert batch.D is not None
    assert batch.S is not None
    assert batch.mirror is not None
    assert batch.m_d is not None
    assert batch.m_s is not None
    assert batch.exponent is not None
    shiny = batch.mask & (batch.m_s > 0)[:, :, None, None]
    there = batch.exponent > 0
    crossed = F.cross_entropy(said.exponent_logits.float(), exponent_shares(batch.exponent), reduction="none")
    return {
        "mask": F.binary_cross_entropy_with_logits(said.mask_logit.float(), batch.mask.float()),
        "S": _error(said.S_encoded, batch.S, shiny),
        "mirror": _error(said.mirror_encoded, batch.mirror, batch.mask.expand_as(batch.mirror)),
        "albedo": (said.m_d - batch.m_d).abs().mean() + (said.m_s - batch.m_s).abs().mean(),
        "exponent": (crossed * there).sum() / there.sum().clamp(min=1),
        "perceptual": perceptual_loss(batch.image, batch.mask, batch.D, said.S, said.m_d, said.m_s),
    }


def _error(encoded: Tensor, linear: Tensor, where: Tensor) -> Tensor:
    """Of an sRGB-encoded prediction (B, 3, H, W) against linear truth, over the samples that count."""
    off = (encoded.float() - linear_to_srgb(linear)) * where
    return (off.square() + ABSOLUTE * off.abs()).sum() / where.sum().clamp(min=1)
