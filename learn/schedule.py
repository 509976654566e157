"""The length of a training, and the learning rate as a function of the step alone: resuming needs no state."""

from __future__ import annotations

import math

from gen.errors import InputError
from learn.config import Train
from learn.method import Source


def rate_factor(step: int, total: int, kind: str, warm_up: int) -> float:
    """What the peak rate is multiplied by at a step from 0 to total - 1.

    The first `warm_up` steps rise linearly and end at 1. Then "constant" stays, "cosine" falls as half a cosine that would reach 0
    at step `total` (Loshchilov and Hutter, "SGDR", ICLR 2017, without restarts).
    """
    if step < warm_up:
        return (step + 1) / warm_up
    if kind == "constant":
        return 1.0
    return 0.5 * (1 + math.cos(math.pi * (step - warm_up) / max(total - warm_up, 1)))


def rate_at(options: Train, step: int, total: int) -> float:
    """The learning rate of a step from 0."""
    return options.rate * rate_factor(step, total, options.schedule, options.warm_up)


def schedule_steps(options: Train, source: Source, ranks: int) -> int:
    """The length of the schedule. Raises InputError for epochs of a source that never ends."""
    if options.steps is not None:
        return options.steps
    if source.steps_per_epoch is None:
        raise InputError("train.epochs: this data is made up endlessly and has no epochs; give train.steps")
    return max(1, -(-(options.epochs or 1) * source.steps_per_epoch // ranks))
