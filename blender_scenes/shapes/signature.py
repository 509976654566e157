"""Parameters of a builder read from its signature, and values checked against them."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from blender_scenes.shapes.mesh import Parameter


def read_parameters(function: Callable[..., Any], where: str) -> dict[str, Parameter]:
    """Every argument that is annotated `Annotated[float or int, Range(low, high)]` and has a default; others are not parameters.

    where: named in the TypeError for an argument with only one of the two.
    """
    hints = get_type_hints(function, include_extras=True)
    found: dict[str, Parameter] = {}
    for key, argument in inspect.signature(function).parameters.items():
        annotated, has_default = get_origin(hints[key]) is Annotated, argument.default is not inspect.Parameter.empty
        if annotated != has_default:
            raise TypeError(f"{where}: parameter {key} needs Annotated[kind, Range(low, high)] and a default")
        if annotated:
            kind, limits = get_args(hints[key])[:2]
            found[key] = Parameter(kind=kind, default=argument.default, low=limits.low, high=limits.high)
    return found


def checked(values: Mapping[str, Any], known: Mapping[str, Parameter], where: str) -> dict[str, float]:
    """The values, each of its parameter's kind. Raises ValueError, one line that starts with `where`, for the first that is unknown,
    no finite number, out of range or not whole."""
    sound: dict[str, float] = {}
    for key, value in values.items():
        if key not in known:
            raise ValueError(f"{where}: unknown parameter {key}; it has {', '.join(known)}")
        parameter = known[key]
        number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or not parameter.low <= value <= parameter.high:
            raise ValueError(f"{where}: {key} must be a number from {parameter.low:g} to {parameter.high:g}, got {value!r}")
        if parameter.kind is int and value != int(value):
            raise ValueError(f"{where}: {key} must be a whole number, got {value!r}")
        sound[key] = parameter.kind(value)
    return sound
