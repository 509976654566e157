"""The paper's methods (b) and (c): SpecularNet alone, which predicts the specular layer, or the diffuse layer directly."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from gen.errors import InputError
from learn.models import create_model
from learn.models.blocks import as_recorded
from learn.models.lime_nets import encoded_diffuse
from learn.pictures import PictureBatch, Pictures, sheet

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from torch import nn

ABSOLUTE = 0.01
"""Weight of the mean absolute error beside the squared one: it keeps pulling at pixels that are nearly right."""


class Specular:
    """(b): SpecularNet predicts gloss, diffuse = input - specular. `learn.method.Method`."""

    name = "specular"

    def build(self, options: Mapping[str, Any]) -> nn.Module:
        """The network. options: width, stem; see `learn.models.lime_nets.SpecularNet`. Raises InputError where one is wrong."""
        if "layer" in options:
            raise InputError(f"method {self.name!r}: the option layer is the method's own; choose method specular or diffuse")
        return create_model("specular", layer=self.name, **options)

    def source(self, data: Mapping[str, Any], batch: int, seed: int, device: torch.device, split: str) -> Pictures:
        """Pictures of a pack; data as in `learn.pictures.OPTIONS`. Raises InputError where it is wrong."""
        return Pictures(data, batch, seed, device, split)

    def loss(self, model: nn.Module, batch: PictureBatch, progress: float) -> tuple[Tensor, dict[str, Tensor]]:
        """Mean squared error of the sRGB-encoded diffuse layer (0..1) over the whole picture, and a little of the absolute one.

        Figures: mse, the paper's score of the batch (8-bit values squared), and mse_input, that of doing nothing. Not bounding what the
        network says is meant: see `learn.models.lime_nets.encoded_diffuse`.
        """
        encoded = encoded_diffuse(self.name, batch.image, model(batch.image * batch.mask), batch.mask)
        truth, recorded = as_recorded(batch.diffuse), as_recorded(batch.image)
        off = encoded - truth
        loss = off.square().mean() + ABSOLUTE * off.abs().mean()
        bounded = torch.minimum(encoded.detach().clamp(min=0), recorded)
        return loss, {"mse": score(bounded, truth), "mse_input": score(recorded, truth)}

    def samples(self, model: nn.Module, batch: PictureBatch) -> NDArray[np.uint8]:
        """Input; diffuse, predicted and true; specular, predicted and true."""
        diffuse, specular = removed(model, batch)
        return sheet([batch.image, diffuse, batch.diffuse, specular, batch.specular])


class Diffuse(Specular):
    """(c): the same network predicts the diffuse layer directly. `learn.method.Method`."""

    name = "diffuse"


def score(encoded: Tensor, truth: Tensor) -> Tensor:
    """Mean squared error on 8-bit values, of sRGB-encoded pictures in 0..1: the paper's Table 1."""
    return (255 * (encoded - truth)).square().mean()


def removed(model: nn.Module, batch: PictureBatch) -> tuple[Tensor, Tensor]:
    """What a network makes of a batch, as in use: averages of BatchNorm, no gradient. It is left in the mode that it was in."""
    training = model.training
    model.eval()
    with torch.no_grad():
        diffuse, specular = model.remove(batch.image, batch.mask)
    model.train(training)
    return diffuse, specular
