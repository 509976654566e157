"""What training sees of a method of gloss removal: a network, a source of batches, a loss. The methods by name."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from gen.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import torch
    from numpy.typing import NDArray
    from torch import Tensor, nn


class Source(Protocol):
    """Endless batches, each a pure function of the seed and its number, so that resuming needs no state.

    pictures: how many pictures a batch holds. steps_per_epoch: batches until each training picture came once; None where
    pictures are made up as they are asked for.
    """

    pictures: int
    steps_per_epoch: int | None

    def batch(self, step: int) -> Any:
        """Batch number `step`, on the source's device."""


class Method(Protocol):
    """A method of gloss removal, as training sees it.

    build: the network of these options. source: batches of one split ("train" or "validation") of the config's `data` table.
    loss: what is minimised, and figures to log; `progress` runs from 0 to 1 over the schedule. samples: a contact sheet
    (h, w, 3) of input, output and truth. build and source raise InputError for an unknown or impossible option.
    """

    name: str

    def build(self, options: Mapping[str, Any]) -> nn.Module: ...

    def source(self, data: Mapping[str, Any], batch: int, seed: int, device: torch.device, split: str) -> Source: ...

    def loss(self, model: nn.Module, batch: Any, progress: float) -> tuple[Tensor, dict[str, Tensor]]: ...

    def samples(self, model: nn.Module, batch: Any) -> NDArray[np.uint8]: ...


METHODS: Mapping[str, str] = {
    "lime": "learn.methods.lime:Lime",
    "specular": "learn.methods.single:Specular",
    "diffuse": "learn.methods.single:Diffuse",
    "group": "learn.methods.group:Group",
}
"""The paper's methods (a), (b), (c), and the group method (d): name -> "module:class"."""


def create_method(name: str) -> Method:
    """The method of that name. Raises InputError where it is unknown."""
    if name not in METHODS:
        raise InputError(f"method {name!r}: unknown; there are {', '.join(METHODS)}")
    module, cls = METHODS[name].split(":")
    method: Method = getattr(import_module(module), cls)()
    return method


def check_options(given: Mapping[str, Any], known: Mapping[str, Any], where: str) -> dict[str, Any]:
    """`known` (option -> default) overlaid with `given`. Raises InputError for an unknown option or one of another type than its default.

    A default of None takes anything; whole numbers pass for floats.
    """
    for key, value in given.items():
        if key not in known:
            raise InputError(f"{where}: unknown option {key!r}; there are {', '.join(known)}")
        default = known[key]
        fits = default is None or type(value) is type(default) or (type(default) is float and type(value) is int)
        if not fits:
            raise InputError(f"{where}: {key} = {value!r} must be a {type(default).__name__}")
    return {**known, **{key: float(value) if type(known[key]) is float else value for key, value in given.items()}}
