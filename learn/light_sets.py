"""Random sets of lights around an object, as captures have them: rings, a frontal light with them, hemispheres, grids."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError

Doubles = NDArray[np.float64]

MAX_CONDITION = 15.0
"""Largest condition number (largest over smallest singular value) of a set of three lights and more."""

COUNTS = {1: 0.06, 2: 0.04, 3: 0.1, 4: 0.12, 5: 0.36, 6: 0.1, 7: 0.06, 8: 0.06, 9: 0.03, 10: 0.03, 12: 0.02, 16: 0.02}
"""How many lights a batch has, and how often, where they are "mixed"."""

STEEPEST, FLATTEST = 10.0, 65.0
"""Degrees from the viewer: the range of tilts of lights that are not frontal."""


def random_lights(rng: np.random.Generator, count: int) -> Doubles:
    """(count, 3) unit directions of a random kind of set, in random order; three and more are well spread (`MAX_CONDITION`)."""
    names = list(KINDS)
    shares = np.array([KINDS[name][0] for name in names])
    while True:
        kind = names[int(rng.choice(len(names), p=shares / shares.sum()))]
        lights = KINDS[kind][1](rng, count)
        if count < 3 or condition_number(lights) < MAX_CONDITION:
            return lights[rng.permutation(count)]


def condition_number(lights: Doubles) -> float:
    """Largest over smallest singular value of (K, 3) directions; infinite where they lie in a plane."""
    s = np.linalg.svd(lights, compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 1e-9 * s[0] else math.inf


def light_counts(option: object) -> Mapping[int, float]:
    """Number of lights -> share, of the option `lights`: "mixed" (`COUNTS`), a number, or the weights of 1, 2, ... lights."""
    if option == "mixed":
        return COUNTS
    if type(option) is int and 1 <= option <= 64:
        return {option: 1.0}
    if isinstance(option, list) and 1 <= len(option) <= 64:
        weights = [float(w) if type(w) in (int, float) and 0 <= w < math.inf else math.nan for w in option]
        if sum(weights) > 0:
            return {k + 1: w for k, w in enumerate(weights)}
    raise InputError(
        f'data: lights = {option!r} must be "mixed", a number from 1 to 64, or a list of weights of 1, 2, ... lights'
    )


def _unit(tilt: Doubles, azimuth: Doubles) -> Doubles:
    """Directions of tilts from +z in degrees and azimuths in radians."""
    t = np.radians(tilt)
    return np.stack([np.sin(t) * np.cos(azimuth), np.sin(t) * np.sin(azimuth), np.cos(t)], -1)


def _ring(rng: np.random.Generator, count: int) -> Doubles:
    loose = rng.random() < 0.5
    # Two lights that face each other would lie in a plane with a frontal one.
    gap = rng.uniform(0.4, 0.75) * np.pi if count == 2 else 2 * np.pi / count
    azimuth = rng.uniform(0, 2 * np.pi) + gap * np.arange(count)
    azimuth = azimuth + loose * rng.normal(0, 0.3 / max(count, 3), count) * np.pi
    # The usual ring stands at 30 to 45 degrees.
    middle = rng.uniform(28, 45) if rng.random() < 0.4 else rng.uniform(15, 60)
    tilt = middle + loose * rng.uniform(-6, 6, count)
    return _unit(tilt.clip(STEEPEST, FLATTEST), azimuth)


def _frontal_and_ring(rng: np.random.Generator, count: int) -> Doubles:
    frontal = _unit(np.abs(rng.normal(0, 2.5, 1)) * (rng.random() < 0.5), rng.uniform(0, 2 * np.pi, 1))
    return np.concatenate([frontal, _ring(rng, count - 1)]) if count > 1 else frontal


def _hemisphere(rng: np.random.Generator, count: int) -> Doubles:
    """Evenly over a cap, none closer to another than a share of what would fit."""
    flattest = rng.uniform(35, FLATTEST)
    least = 0.6 * flattest / math.sqrt(count)
    lights: list[Doubles] = []
    tries = 0
    while len(lights) < count:
        z = rng.uniform(math.cos(math.radians(flattest)), math.cos(math.radians(STEEPEST)))
        light = _unit(np.array(math.degrees(math.acos(z))), np.array(rng.uniform(0, 2 * np.pi)))
        tries += 1
        apart = np.degrees(np.arccos(np.clip(np.array(lights) @ light, -1, 1))).min() if lights else math.inf
        if apart > least * 0.97**tries:
            lights.append(light)
    return np.array(lights)


def _grid(rng: np.random.Generator, count: int) -> Doubles:
    """Some lights of a wide grid of columns and rows, as in DiLiGenT."""
    columns, rows = np.meshgrid(np.linspace(-1, 1, 12), np.linspace(-1, 1, 8))
    points = np.stack([rng.uniform(0.5, 1.1) * columns.ravel(), rng.uniform(0.4, 0.8) * rows.ravel()], -1)
    lights = np.concatenate([points, np.ones((len(points), 1))], 1)
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    tilt = np.degrees(np.arccos(lights[:, 2]))
    inside = np.flatnonzero((tilt >= STEEPEST) & (tilt <= FLATTEST))
    return lights[rng.choice(inside, count, replace=False)]


KINDS: Mapping[str, tuple[float, Callable[[np.random.Generator, int], Doubles]]] = {
    "frontal and ring": (0.35, _frontal_and_ring),
    "ring": (0.15, _ring),
    "hemisphere": (0.25, _hemisphere),
    "grid": (0.25, _grid),
}
"""Kind of set -> how often it is drawn, and (rng, count) to directions."""
