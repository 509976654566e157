"""How large a shape is, found on a coarse mesh and remembered: enough to check thousands of specs in seconds."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COARSE_SEGMENTS = 64
"""Facets around, in place of a default of hundreds: what a shape refuses does not depend on a default."""

MARGIN = 0.005
"""Of the size, added on every side: a circle of 64 chords lies .0012 of its radius under the true one at most."""


def box(name: str, parameters: Mapping[str, Any]) -> Array:
    """Corners (8, 3), mm, of a box in the object's frame that holds the shape, some per mille larger than needed.

    Raises ValueError, the shape's own line, where the shape refuses its parameters.
    """
    if not all(isinstance(value, int | float | str) for value in parameters.values()):
        _build(name, parameters)  # says which of them is no number
    return _box(name, tuple((key, value, type(value)) for key, value in sorted(parameters.items())))


def reach(name: str, parameters: Mapping[str, Any], direction: Array) -> float:
    """How far the shape reaches along `direction` (3,) from its origin, mm: exact, built whole.

    Raises ValueError where the shape refuses its parameters.
    """
    return float((_build(name, parameters) @ direction).max())


@lru_cache(maxsize=4096)
def _box(name: str, parameters: tuple[tuple[str, Any, type], ...]) -> Array:
    """See `box`. The types are part of the key: 1 and true are equal, and a shape takes only one of them."""
    from blender_scenes import shapes

    known = {} if name == "mesh" else shapes.parameters(name)
    coarse = {"segments": COARSE_SEGMENTS} if "segments" in known and known["segments"].default > COARSE_SEGMENTS else {}
    vertices = _build(name, {**coarse, **{key: value for key, value, _ in parameters}})
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    margin = MARGIN * float((high - low).max())
    sides = np.stack([low - margin, high + margin])
    corners: Array = np.stack([sides[[i, j, k], [0, 1, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    corners.setflags(write=False)
    return corners


def _build(name: str, parameters: Mapping[str, Any]) -> Array:
    if name == "mesh":
        from gen.meshes import load_mesh, mesh_file

        return load_mesh(mesh_file(parameters)).vertices
    from blender_scenes import shapes

    return shapes.build(name, **parameters).vertices
