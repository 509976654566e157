"""The state of a training between two steps, as one safetensors file: no pickle, whole or not there, exact.

    network.NAME, average.NAME              parameters and buffers of the network, and of its moving average where there is one
    optimiser.NAME.exp_avg and so on        the optimiser's moments of each parameter
    random.cpu, random.cuda                 torch's generators, as bytes

Everything else is a few numbers in the metadata, as JSON. The schedule and the order of the data are functions of the step.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from gen.errors import InputError
from learn.weights import must_be_finite, must_match, read_tensors, write_tensors

FORMAT = "degloss checkpoint"
VERSION = "1"
MAX_BYTES = 2_000_000_000
"""The largest checkpoint that is read."""


@dataclass(frozen=True, eq=False)
class Parts:
    """What is saved and restored in place. average: the network of the moving average, or None."""

    network: nn.Module
    optimiser: torch.optim.Optimizer
    average: nn.Module | None
    device: torch.device


def random_state(device: torch.device) -> dict[str, Tensor]:
    """The states of torch's generators that a step on this device may use, each (n,) uint8."""
    states = {"random.cpu": torch.random.get_rng_state()}
    if device.type == "cuda":
        states["random.cuda"] = torch.cuda.get_rng_state(device)
    return states


def set_random_state(states: Mapping[str, Tensor], device: torch.device) -> None:
    """Set the generators. A state that is missing (a run that moves from a CPU to a GPU) leaves its generator alone."""
    torch.random.set_rng_state(states["random.cpu"])
    if device.type == "cuda" and "random.cuda" in states:
        torch.cuda.set_rng_state(states["random.cuda"], device)


def write_checkpoint(path: Path, parts: Parts, state: Mapping[str, Any], random: Mapping[str, Tensor]) -> None:
    """Write the state of a training; the earlier checkpoint stays until the new one is whole. state: plain values that JSON holds.

    Raises InputError where the weights are not finite (the earlier checkpoint stays) or the place cannot be written.
    """
    network = {f"network.{name}": tensor for name, tensor in parts.network.state_dict().items()}
    must_be_finite(network, f"{path}: not written, the training has diverged; lower the rate")
    average = (
        {f"average.{name}": tensor for name, tensor in parts.average.state_dict().items()} if parts.average is not None else {}
    )
    tensors = {**network, **average, **_moments(parts), **random}
    write_tensors(path, tensors, {"format": FORMAT, "version": VERSION, "state": json.dumps(state)})


def read_state(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The plain values and the tensors of a checkpoint. Raises InputError, one line, where it is not a whole checkpoint."""
    tensors, metadata = read_tensors(path, "a checkpoint", MAX_BYTES)
    if metadata.get("format") != FORMAT or metadata.get("version") != VERSION:
        raise InputError(f"{path}: is not a checkpoint of version {VERSION}; start again in another folder")
    try:
        state = json.loads(metadata.get("state", ""))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: its state is not JSON ({str(error)[:100]}); the file is damaged") from error
    if not isinstance(state, dict):
        raise InputError(f"{path}: its state is not a table; the file is damaged")
    return state, tensors


def restore(path: Path, tensors: Mapping[str, Tensor], parts: Parts) -> None:
    """Put the tensors of a checkpoint in their places, generators too. Raises InputError where they do not fit the network."""
    groups: dict[str, dict[str, Tensor]] = {"network": {}, "average": {}, "optimiser": {}, "random": {}}
    for key, tensor in tensors.items():
        kind, _, name = key.partition(".")
        if kind not in groups:
            raise InputError(f"{path}: holds an unknown tensor {key[:80]!r}; the file is damaged")
        groups[kind][name] = tensor
    expected = parts.network.state_dict()
    must_match(groups["network"], expected, f"{path}: does not fit the network of this config")
    must_match(groups["average"], expected if parts.average is not None else {}, f"{path}: its moving average does not fit")
    moments: dict[str, dict[str, Tensor]] = {}
    for key, tensor in groups["optimiser"].items():
        name, _, moment = key.rpartition(".")
        moments.setdefault(name, {})[moment] = tensor
    parameters = dict(parts.network.named_parameters())
    for name, found in moments.items():
        if name not in parameters:
            raise InputError(f"{path}: its optimiser has an unknown parameter {name[:80]!r}; the file is damaged")
        shape = parameters[name].detach()
        like = {"exp_avg": shape, "exp_avg_sq": shape, "step": torch.tensor(0.0)}
        must_match(found, like, f"{path}: its optimiser does not fit the network, {name}")
    must_be_finite(tensors, str(path))
    random = {f"random.{name}": tensor for name, tensor in groups["random"].items()}
    try:
        set_random_state(random, parts.device)
    except (KeyError, RuntimeError, TypeError) as error:
        raise InputError(f"{path}: its random generators are missing or damaged ({str(error)[:100]})") from error
    parts.network.load_state_dict(groups["network"])
    if parts.average is not None:
        parts.average.load_state_dict(groups["average"])
    for name, found in moments.items():
        place = parameters[name].device
        # Adam counts its steps on the CPU, wherever the parameters are.
        parts.optimiser.state[parameters[name]] = {k: v if k == "step" else v.to(place) for k, v in found.items()}


def _moments(parts: Parts) -> dict[str, Tensor]:
    found = {}
    for name, parameter in parts.network.named_parameters():
        for moment, value in parts.optimiser.state.get(parameter, {}).items():
            found[f"optimiser.{name}.{moment}"] = value
    return found
