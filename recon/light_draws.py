"""Random subsets of a capture's lights, for every comparison under few lights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError

CONDITION = 12.0
"""Largest condition number of a draw's lights, where nobody says another."""

CORRUPT = {"bear": 20}
"""How many of a DiLiGenT object's first photographs are corrupt in the original set, which says so."""

TRIES = 1000
"""Draws that are tried for one that is well spread."""


def draws(lights: NDArray[np.float64], count: int, size: int, condition: float = CONDITION, seed: int = 0) -> list[list[int]]:
    """`count` draws of `size` different lights whose condition number is under `condition`, as sorted indices; the seed decides.

    lights: (K, 3) unit. Raises InputError where there are fewer lights than asked for, or hardly any draw is well conditioned.
    """
    if len(lights) < size:
        raise InputError(f"a draw of {size} lights cannot be made of {len(lights)}")
    rng = np.random.default_rng(seed)
    found: list[list[int]] = []
    for _ in range(TRIES * count):
        chosen = sorted(int(i) for i in rng.choice(len(lights), size, replace=False))
        if np.linalg.cond(lights[chosen]) < condition:
            found.append(chosen)
            if len(found) == count:
                return found
    raise InputError(f"hardly any {size} of these {len(lights)} lights have a condition number under {condition:g}")
