"""A method judged on batches that it does not learn from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import nn

from learn.checkpoint import random_state, set_random_state
from learn.logs import Meters
from learn.method import Method, Source


def validate(method: Method, network: nn.Module, source: Source, batches: int, place: torch.device) -> dict[str, float]:
    """The mean loss and figures over the first batches of a source, as at the end of the schedule."""
    meters = Meters()
    with torch.no_grad(), evaluating(network, place):
        for i in range(batches):
            loss, figures = method.loss(network, source.batch(i), 1.0)
            meters.add({"loss": loss, **figures})
    return meters.means()


@contextmanager
def evaluating(network: nn.Module, place: torch.device) -> Iterator[None]:
    """The network in evaluation mode, torch's generators at a seed of their own; both as they were afterwards."""
    training, random = network.training, random_state(place)
    network.eval()
    torch.manual_seed(0)
    try:
        yield
    finally:
        network.train(training)
        set_random_state(random, place)
