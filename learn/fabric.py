"""Lightning's Fabric around a training: which device, which precision, several processes, and the loss as one module."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

import torch
from torch import Tensor, nn

from gen.errors import InputError
from learn.method import Method
from learn.weights import open_device


def launch(device: str, precision: str) -> Any:
    """Lightning's Fabric on one device, or on the one that torchrun gave this process. Raises InputError where there is none."""
    place = open_device(device)
    try:
        fabric_module = import_module("lightning_fabric")
    except ModuleNotFoundError:
        try:
            fabric_module = import_module("lightning.fabric")
        except ModuleNotFoundError:
            raise InputError("training needs the package lightning-fabric: pip install lightning-fabric") from None
    processes, here = (int(os.environ.get(name, "1")) for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE"))
    if processes > 1:
        # A loss may leave a part of a network out for a while (the stages of LIME).
        strategy = import_module(f"{fabric_module.__name__}.strategies").DDPStrategy(find_unused_parameters=True)
        where = {"devices": here, "num_nodes": processes // here, "strategy": strategy}
    else:
        where = {"devices": [place.index] if place.type == "cuda" else 1}
    fabric = fabric_module.Fabric(accelerator=place.type, precision=precision, **where)
    fabric.launch()
    return fabric


def agree(fabric: Any, told: bool, clock: bool) -> tuple[bool, bool]:
    """Whether any process was told to stop, and whether any finds the time over: the same answer in all of them."""
    votes = fabric.all_reduce(torch.tensor([float(told), float(clock)], device=fabric.device), reduce_op="sum")
    return bool(votes[0] > 0), bool(votes[1] > 0)


class Held:
    """A batch on its way through Fabric, which would take dataclasses apart."""

    def __init__(self, batch: Any) -> None:
        self.batch = batch


class Objective(nn.Module):
    """A method's loss as the forward of a module, so that Fabric wraps all of it: precision, and gradients over several GPUs."""

    def __init__(self, method: Method, network: nn.Module) -> None:
        super().__init__()
        self.method, self.network = method, network

    def forward(self, held: Held, progress: float) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of a batch, and figures to log."""
        loss, figures = self.method.loss(self.network, held.batch, progress)
        return loss, {name: value.detach() for name, value in figures.items()}


def device_name(place: torch.device) -> str:
    """The name of a device as people know it."""
    return torch.cuda.get_device_name(place) if place.type == "cuda" else f"CPU, {torch.get_num_threads()} threads"
