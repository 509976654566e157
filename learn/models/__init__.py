"""The networks by name, and the one factory that builds them; each module is imported when its network is asked for."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from gen.errors import InputError
from learn.method import check_options

if TYPE_CHECKING:
    from torch import nn

MODELS: Mapping[str, str] = {
    "segmentation": "learn.models.lime_nets:SegmentationNet",
    "specular": "learn.models.lime_nets:SpecularNet",
    "mirror": "learn.models.lime_nets:MirrorNet",
    "albedo": "learn.models.lime_nets:AlbedoNet",
    "exponent": "learn.models.lime_nets:ExponentNet",
    "lime": "learn.models.lime:LimeNet",
    "group": "learn.models.group:GroupNet",
}
"""LIME's five networks, the five wired together, and the group network: name -> "module:class"."""


def create_model(name: str, **options: Any) -> nn.Module:
    """The network of that name, with fresh weights. options: what its class takes, all with defaults.

    Raises InputError where the name or an option is unknown, or an option's value is of the wrong kind or out of its range.
    """
    if name not in MODELS:
        raise InputError(f"model {name!r}: unknown; there are {', '.join(MODELS)}")
    module, cls = MODELS[name].split(":")
    build = getattr(import_module(module), cls)
    defaults = {key: parameter.default for key, parameter in inspect.signature(build).parameters.items()}
    model: nn.Module = build(**check_options(options, defaults, f"model {name!r}"))
    return model
