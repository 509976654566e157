"""Light patterns against their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from gen import lights
from gen.errors import InputError


@pytest.mark.parametrize("count", [1, 3, 4, 7])
@pytest.mark.parametrize("tilt", [5.0, 35.0, 80.0])
def test_ring_is_a_ring(count: int, tilt: float) -> None:
    L = lights.ring(count, tilt, start_degrees=20)
    assert L.shape == (count, 3)
    assert np.linalg.norm(L, axis=1) == pytest.approx(1, abs=1e-15)
    assert np.degrees(np.arccos(L[:, 2])) == pytest.approx(tilt)
    azimuth = np.degrees(np.unwrap(np.arctan2(L[:, 1], L[:, 0])))
    assert azimuth == pytest.approx(20 + 360 / count * np.arange(count))


def test_the_papers_five_lights() -> None:
    s, c = np.sin(np.radians(35)), np.cos(np.radians(35))
    expected = [[0, 0, 1], [s, 0, c], [0, s, c], [-s, 0, c], [0, -s, c]]
    assert lights.ring(4, 35, frontal=True) == pytest.approx(np.array(expected), abs=1e-15)


def test_hemisphere_covers_the_cap_evenly() -> None:
    L = lights.hemisphere(400, 60)
    assert np.linalg.norm(L, axis=1) == pytest.approx(1)
    assert L[:, 2].min() > np.cos(np.radians(60))
    # Mean of a uniform cap: (0, 0, (1 + cos) / 2). Neighbours: none much closer than the even spacing.
    assert L.mean(axis=0) == pytest.approx([0, 0, 0.75], abs=0.01)
    gram = L @ L.T - 2 * np.eye(len(L))
    spacing = np.degrees(np.arccos(gram.max(axis=1)))
    even = np.degrees(np.sqrt(2 * np.pi * (1 - 0.5) / 400))
    assert spacing.min() > 0.6 * even
    assert spacing.max() < 1.5 * even


def test_scattered_keeps_its_distance_and_its_seed() -> None:
    L = lights.scattered(10, 60, 15, np.random.default_rng(3))
    assert np.array_equal(L, lights.scattered(10, 60, 15, np.random.default_rng(3)))
    assert not np.array_equal(L, lights.scattered(10, 60, 15, np.random.default_rng(4)))
    assert (L @ L.T - 2 * np.eye(10)).max() <= np.cos(np.radians(15))
    assert L[:, 2].min() >= np.cos(np.radians(60))


def test_scattered_says_when_there_is_no_room() -> None:
    with pytest.raises(InputError, match=r"do not fit within 20 degrees"):
        lights.scattered(30, 20, 15, np.random.default_rng(0))
