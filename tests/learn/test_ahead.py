"""Batches made ahead by a thread are the same batches, and its errors come out where they are asked for."""

from __future__ import annotations

import pytest
import torch

from gen.errors import InputError
from learn.ahead import ahead
from learn.world import World


@pytest.mark.parametrize("prefetch", [False, True])
def test_batches_are_those_of_the_source(prefetch: bool) -> None:
    world = World({"size": 16, "lights": 3}, 2, seed=1)
    with ahead(world, prefetch) as batch:
        for step in (0, 1, 2, 7):  # 7: not the one that was begun
            made = batch(step, step + 1)
            assert torch.equal(made.images, world.batch(step).images)


def test_what_fails_in_the_thread_is_raised_where_it_is_asked_for() -> None:
    class Source:
        pictures, steps_per_epoch = 1, None

        def batch(self, step: int) -> int:
            if step == 1:
                raise InputError("damaged")
            return step

    with ahead(Source(), True) as batch:
        assert batch(0, 1) == 0
        with pytest.raises(InputError, match="damaged"):
            batch(1, None)
