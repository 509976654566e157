"""The draws of lights for comparisons under few of them."""

from __future__ import annotations

import numpy as np
import pytest

from gen.errors import InputError
from recon.light_draws import CONDITION, draws


def test_draws_are_seeded_different_and_well_conditioned() -> None:
    lights = np.random.default_rng(0).normal(size=(30, 3)) * [0.4, 0.4, 0.1] + [0, 0, 1]
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    found = draws(lights, 8, 5)
    assert found == draws(lights, 8, 5) != draws(lights, 8, 5, seed=1)
    assert len({tuple(one) for one in found}) == 8
    for chosen in found:
        assert len(set(chosen)) == 5
        assert np.linalg.cond(lights[chosen]) < CONDITION


def test_too_few_or_too_similar_lights_are_refused() -> None:
    with pytest.raises(InputError, match="cannot be made of 4"):
        draws(np.ones((4, 3)), 1, 5)
    with pytest.raises(InputError, match="condition number"):
        draws(np.tile([0.0, 0.0, 1.0], (6, 1)), 1, 5)
