"""The exponential moving average of a network's weights, its buffers included."""

from __future__ import annotations

import copy

import torch
from torch import nn


class MovingAverage:
    """A copy of a network that follows it slowly. network: the copy, in evaluation mode, without gradients.

    After update n (from 0) the decay is min(decay, (1 + n) / (10 + n)), so that the first, random weights are soon forgotten.
    Parameters and floating buffers (BatchNorm's mean and variance) are averaged, whole numbers are copied, as
    torch.optim.swa_utils.AveragedModel(..., use_buffers=True) does; with the buffers left out the statistics would be stale.
    """

    def __init__(self, network: nn.Module, decay: float) -> None:
        self.network = copy.deepcopy(network).requires_grad_(False).eval()
        self.decay = decay

    def update(self, network: nn.Module, n: int) -> None:
        """Take in the weights of `network` after its update n, counted from 0."""
        decay = min(self.decay, (1 + n) / (10 + n))
        averaged, current = [], []
        for old, new in zip(_tensors(self.network), _tensors(network), strict=True):
            if old.is_floating_point():
                averaged.append(old)
                current.append(new)
            else:
                old.copy_(new)
        with torch.no_grad():
            torch._foreach_lerp_(averaged, current, 1 - decay)


def _tensors(network: nn.Module) -> list[torch.Tensor]:
    return [tensor.detach() for tensor in (*network.parameters(), *network.buffers())]
