"""The reflectance of a whole object, a few numbers, from how well they let every pixel be explained."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from recon.normals.explain_search import Pixels, Rig, hemisphere, search

Doubles = NDArray[np.float64]
Numbers = tuple[float, ...]
"""Log alpha, log strength over the object's median brightness, coat and roughness: what the estimate moves."""

SAMPLE, FIRST = 300, 3
"""Pixels, evenly spread, that are asked; every so manyth of them is enough to rank where to begin."""

SATURATION = 20.0
"""Cost of a pixel that has half its say: what no reflectance explains, such as a cast shadow, shall not decide."""

GRID, STARTS, ROUNDS = 60, 2, 6
"""Beginnings a pixel, how many are refined, and steps."""

MATTE = -12.0
"""Log strength of no lobe at all."""

ALPHAS = (0.05, 0.1, 0.2, 0.35, 0.6)
STRENGTHS = (-4.5, -3.0, -1.5, -0.25, 1.0)
"""Widths and log strengths (over the object's median brightness) from which the estimate begins, each with no coat and a full one."""

TOP = 3
"""How many of them are followed at first."""

LOWEST, HIGHEST = np.array([np.log(0.01), MATTE, 0.0, 0.0]), np.array([0.0, 3.0, 1.0, 0.9])
STEPS = np.array([0.35, 0.75, 0.5, 0.3])
"""Bounds and first steps of log alpha, log strength, coat and roughness."""

HALVINGS, SWEEPS, GAIN = 4, 4, 1e-3
"""Times the steps are halved, sweeps over the four at each, and the share of the cost that a step must save: as much as chance does."""

MATTE_GAIN = 0.02
"""The share of the cost that a lobe must save to be believed at all."""


@dataclass(frozen=True)
class Reflectance:
    """alpha: width of the lobe. strength: its reflectance at normal incidence, in the pictures' unit, 0 for none. coat: share of the
    dimming of the base by the substrate's coat, in [0, 1]. roughness: Oren and Nayar's sigma of the base, in radians."""

    alpha: float
    strength: float
    coat: float
    roughness: float

    def optics(self) -> Doubles:
        """(alpha, coat, A, B), with A and B Oren and Nayar's constants of the roughness."""
        square = self.roughness**2
        return np.array([self.alpha, self.coat, 1 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)])


def estimate(pixels: Pixels, of: Rig) -> Reflectance:
    """The reflectance with which some of the pixels are explained at least cost, each by its own best normal and albedo.

    A pattern search: from the best of a grid of beginnings, each number in turn is moved up and down as long as it pays. Four lights or
    more leave every pixel at least one equation more than it has unknowns, and there are hundreds of pixels for four numbers.
    """
    few = pixels.take(np.unique(np.linspace(0, len(pixels) - 1, SAMPLE).astype(np.intp)))
    unit = float(np.median(few.scale))
    fewer = few.take(np.arange(0, len(few), FIRST))
    grid = hemisphere(GRID)
    threads = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    known: dict[Numbers, float] = {}

    def reflectance(x: Numbers) -> Reflectance:
        return Reflectance(float(np.exp(x[0])), float(np.exp(x[1])) * unit if x[1] > MATTE else 0.0, x[2], x[3])

    def asked(x: Numbers, those: Pixels) -> float:
        there = reflectance(x)
        nothing = np.zeros((len(those), 0, 3))
        cost = search(those, of, there.optics(), there.strength, nothing, grid, STARTS, ROUNDS).cost
        return float(np.mean(1 / (1 / np.maximum(cost, 1e-12) + 1 / SATURATION)))

    def price(x: Numbers) -> float:
        if x not in known:
            known[x] = asked(x, few)
        return known[x]

    def cheapest(several: list[Numbers], by: Callable[[Numbers], float], count: int) -> list[Numbers]:
        """The first `count` by price, worked out on as many threads as numba is allowed; of equals the first."""
        if threads > 1:
            with ThreadPoolExecutor(threads) as pool:
                prices = list(pool.map(by, several))
        else:
            prices = [by(x) for x in several]
        return [several[i] for i in np.argsort(prices, kind="stable")[:count]]

    def swept(x: Numbers, steps: Doubles) -> Numbers:
        for i in np.flatnonzero(steps):
            moved: list[Numbers] = []
            for step in (-steps[i], steps[i]):
                value = round(float(np.clip(x[i] + step, LOWEST[i], HIGHEST[i])), 6)
                moved.append((*x[:i], value, *x[i + 1 :]))
            (better,) = cheapest(moved, price, 1)
            if price(better) < price(x) * (1 - GAIN):
                x = better
        return x

    lobed: list[Numbers] = [(round(float(np.log(a)), 6), s, c, 0.0) for a in ALPHAS for s in STRENGTHS for c in (0.0, 1.0)]
    matte = swept(min([(0.0, MATTE, 0.0, 0.0), (0.0, MATTE, 1.0, 0.0)], key=price), STEPS * np.array([0.0, 0.0, 1.0, 1.0]))
    best = min((swept(x, STEPS) for x in cheapest(lobed, lambda x: asked(x, fewer), TOP)), key=price)
    steps = STEPS
    for _ in range(HALVINGS):
        for _sweep in range(SWEEPS):
            after = swept(best, steps)
            if after == best:
                break
            best = after
        steps = steps / 2
    return reflectance(best if price(best) < (1 - MATTE_GAIN) * price(matte) else matte)
