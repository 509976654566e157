"""Shapes: functions from parameters in millimetres to mesh arrays, found by name. numpy alone.

A shape family is one module: a function of the family's name from keyword parameters to a `Mesh`, and `sample(rng)`, which draws
its parameters. To add one: write the module and enter it in `SHAPES`. Every parameter is annotated `Annotated[float, Range(low, high)]`
(or int) and has a default; `parameters` and `build` read the signature, so nothing is listed twice.

At rest a shape is centred on the origin of its own frame, x right, y up, z toward the viewer.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from blender_scenes.shapes.mesh import Mesh, Parameter, Range
from blender_scenes.shapes.signature import checked, read_parameters

SHAPES = {
    "capsule": "blender_scenes.shapes.capsule",
    "cone": "blender_scenes.shapes.cone",
    "cylinder": "blender_scenes.shapes.cylinder",
    "ellipsoid": "blender_scenes.shapes.ellipsoid",
    "flange": "blender_scenes.shapes.flange",
    "gear": "blender_scenes.shapes.gear",
    "helical_spring": "blender_scenes.shapes.helical_spring",
    "hexagonal_bolt": "blender_scenes.shapes.hexagonal_bolt",
    "pipe_elbow": "blender_scenes.shapes.pipe_elbow",
    "relief": "blender_scenes.shapes.relief",
    "rounded_box": "blender_scenes.shapes.rounded_box",
    "sphere": "blender_scenes.shapes.sphere",
    "stepped_shaft": "blender_scenes.shapes.stepped_shaft",
    "superquadric": "blender_scenes.shapes.superquadric",
    "torus": "blender_scenes.shapes.torus",
    "truncated_cone": "blender_scenes.shapes.truncated_cone",
    "turbine_blade": "blender_scenes.shapes.turbine_blade",
    "turned_vase": "blender_scenes.shapes.turned_vase",
}
"""Name of each shape and the module that holds its function (of the same name) and its `sample`."""

CONVEX = frozenset({"capsule", "cone", "cylinder", "ellipsoid", "rounded_box", "sphere", "truncated_cone"})
"""Those that are convex whatever their parameters. Of others `Mesh.is_convex` finds out, which may take as long as a small picture."""

__all__ = ["CONVEX", "SHAPES", "Mesh", "Parameter", "Range", "build", "describe", "parameters", "sample"]


@cache
def parameters(name: str) -> dict[str, Parameter]:
    """Each parameter of a shape with its kind, default and range, read from the function's signature.

    Raises ValueError where the name is unknown.
    """
    found = read_parameters(_function(name), f"shape {name}")
    missing = set(inspect.signature(_function(name)).parameters) - set(found)
    if missing:
        raise TypeError(f"shape {name}: parameter {min(missing)} needs Annotated[kind, Range(low, high)] and a default")
    return found


def build(name: str, /, **values: Any) -> Mesh:
    """The mesh of a named shape; parameters that are not given take their defaults.

    Raises ValueError, one line, for unknown names, unknown parameters and values that are not finite or out of range.
    """
    mesh: Mesh = _function(name)(**checked(values, parameters(name), f"shape {name}"))
    return mesh


def sample(name: str, rng: np.random.Generator) -> dict[str, float]:
    """Parameters of a named shape drawn from `rng`; `build(name, **sample(name, rng))` is the mesh."""
    drawn: dict[str, float] = _module(name).sample(rng)
    return drawn


def describe() -> dict[str, str]:
    """The first line of each shape's docstring."""
    return {name: (inspect.getdoc(_function(name)) or "").split("\n")[0] for name in SHAPES}


def _module(name: str) -> ModuleType:
    if name not in SHAPES:
        raise ValueError(f"shape {name}: unknown; there are {', '.join(SHAPES)}")
    return import_module(SHAPES[name])


def _function(name: str) -> Callable[..., Mesh]:
    function: Callable[..., Mesh] = getattr(_module(name), name)
    return function
