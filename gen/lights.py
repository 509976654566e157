"""Patterns of light directions: (K, 3) unit vectors from the surface to the light, camera frame, from a few numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError

Directions = NDArray[np.float64]


def from_angles(tilt_degrees: object, azimuth_degrees: object) -> Directions:
    """Unit vectors (K, 3) of tilts away from +z (the viewer) and azimuths counter-clockwise from +x, in degrees."""
    tilt, azimuth = np.broadcast_arrays(
        np.radians(np.asarray(tilt_degrees, float)), np.radians(np.asarray(azimuth_degrees, float))
    )
    vectors = np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)], axis=-1).reshape(-1, 3)
    vectors[np.abs(vectors) < 1e-15] = 0.0  # sin(180 degrees) is not quite 0; a light on an axis should read so
    unit: Directions = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def ring(count: int, tilt_degrees: float, frontal: bool = False, start_degrees: float = 0.0) -> Directions:
    """`count` lights evenly around the optical axis, all `tilt_degrees` away from it, after one frontal light where asked for.

    start_degrees: azimuth of the first, counter-clockwise from +x. Returns (count + frontal, 3).
    """
    around = from_angles(tilt_degrees, start_degrees + np.arange(count) * 360.0 / count)
    return np.concatenate([[[0.0, 0.0, 1.0]], around]) if frontal else around


def hemisphere(count: int, max_tilt_degrees: float) -> Directions:
    """`count` lights spread evenly over the cap up to `max_tilt_degrees` from the axis, on a Fibonacci spiral.

    Returns (count, 3). Every light stands for the same solid angle. Source: Swinbank and Purser, "Fibonacci grids" (2006).
    """
    cos_edge = np.cos(np.radians(max_tilt_degrees))
    cos_tilt = 1.0 - (np.arange(count) + 0.5) / count * (1.0 - cos_edge)
    golden = 180.0 * (3.0 - np.sqrt(5.0))
    return from_angles(np.degrees(np.arccos(cos_tilt)), np.arange(count) * golden)


def scattered(count: int, max_tilt_degrees: float, min_spread_degrees: float, rng: np.random.Generator) -> Directions:
    """`count` lights drawn evenly over the cap, no two closer than `min_spread_degrees`. Returns (count, 3).

    Raises InputError where that many do not fit (thousands of draws found no room).
    """
    cos_edge, cos_spread = np.cos(np.radians([max_tilt_degrees, min_spread_degrees]))
    draws = 5000 + 20 * count
    tilt = np.degrees(np.arccos(rng.uniform(cos_edge, 1.0, draws)))
    azimuth = rng.uniform(0.0, 360.0, draws)
    needed = draws if count > 1 else 1  # the first of them is always taken
    candidates = from_angles(tilt[:needed], azimuth[:needed])
    chosen: list[Directions] = []
    while len(chosen) < count and len(candidates):
        chosen.append(candidates[0])
        candidates = candidates[1:][candidates[1:] @ candidates[0] <= cos_spread]
    if len(chosen) < count:
        raise InputError(
            f"lights: {count} lights at least {min_spread_degrees:g} degrees apart do not fit within {max_tilt_degrees:g} degrees; "
            "ask for fewer, closer or more tilted ones"
        )
    return np.stack(chosen)
