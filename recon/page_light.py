"""The light of a picture, drawn and in words: a disc that is the hemisphere over the surface, as the camera sees it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def places(lights: Sequence[NDArray[Any]]) -> list[list[float]]:
    """Where lights (K vectors) stand in the disc: x to the right and y down, the rim is light that grazes the picture's plane.

    Light from behind that plane is drawn on the rim.
    """
    found = []
    for x, y, z in map(_unit, lights):
        across = math.hypot(x, y)
        by = 1.0 if z >= 0 or across == 0 else 1 / across
        found.append([round(x * by, 4), round(-y * by, 4)])
    return found


def words(light: Sequence[float] | NDArray[Any]) -> str:
    """A light's direction in words: "35° off the view, from the upper right (0.41, 0.41, 0.82)"."""
    x, y, z = _unit(light)
    angle, across = math.degrees(math.acos(min(1.0, max(-1.0, z)))), math.hypot(x, y)
    vector = f"({x:.2f}, {y:.2f}, {z:.2f})".replace("-", "\N{MINUS SIGN}")
    if angle < 1:
        return f"along the view {vector}"
    sine = math.sin(math.radians(22.5))  # eight directions, 45 degrees each
    upright = "upper" if y > sine * across else "lower" if y < -sine * across else ""
    sideways = "right" if x > sine * across else "left" if x < -sine * across else ""
    side = f"{upright} {sideways}".strip() if sideways else {"upper": "top", "lower": "bottom"}[upright]
    return f"{angle:.0f}° off the view, from the {side} {vector}"


def _unit(light: Sequence[float] | NDArray[Any]) -> NDArray[np.float64]:
    vector = np.asarray(light, dtype=np.float64)
    unit: NDArray[np.float64] = vector / np.linalg.norm(vector)
    return unit
