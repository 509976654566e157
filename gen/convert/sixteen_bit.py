"""Linear radiance in whole numbers of 16 bits, one scale for a capture, and what is lost on the way."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Fault, Floats
from gen.errors import InputError

TOP = 65535

COARSE = 256
"""With fewer steps than these from black to the object's median, rounding shows: that is what 8-bit files have."""

Words = NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class Pictures:
    """A capture's pictures as they are stored. words: (K, H, W, 3) uint16. white: the radiance that 65535 stands for.

    lost: what these numbers do not say of the capture, in plain words.
    """

    words: Words
    white: float
    lost: tuple[str, ...]


def to_sixteen_bits(capture: Capture, white: float | None, layers: Iterable[Floats] = (), holes: bool = False) -> Pictures:
    """A capture's pictures in 16 bits.

    white: the radiance of 65535; None: the smallest power of two that nothing exceeds, so that the numbers of 8 and 16-bit files stay
    exact. layers: further pictures that share the scale. holes: whether missing samples are marked elsewhere.

    65535 means clipped, there and nowhere else: a clipped sample has it in its brightest channel, any other stays below. Raises
    InputError where `white` is no positive number.
    """
    if white is not None and not (math.isfinite(white) and white > 0):
        raise InputError(f"--white {white}: must be a positive number, the radiance that is stored as {TOP}")
    images, faults = capture.images, capture.faults
    used = white_level((images, *layers)) if white is None else white
    words = quantised(images, used)
    over = (images > np.float32(used)).any(axis=-1)
    clipped = over | ((faults & Fault.CLIPPED) > 0)
    brightest = words == words.max(axis=-1, keepdims=True)
    words = np.where(clipped[..., None], np.where(brightest, TOP, words), np.minimum(words, TOP - 1)).astype(np.uint16)
    return Pictures(words, used, tuple(_lost(capture, words, used, over, holes)))


def white_level(stacks: Iterable[NDArray[Any]]) -> float:
    """The smallest power of two that no value of the arrays exceeds; 1 where none is above 0."""
    top = max(float(stack.max()) for stack in stacks)
    if top <= 0:
        return 1.0
    fraction, exponent = math.frexp(top)
    return math.ldexp(1.0, exponent - (fraction == 0.5))


def quantised(values: Floats, white: float) -> Words:
    """Linear values as uint16, 0 to `white` on 0 to 65535, rounded to the nearest; what lies outside is cut."""
    share = np.clip(values / np.float32(white), 0, 1)
    words: Words = np.rint(share * np.float32(TOP)).astype(np.uint16)
    return words


def _lost(capture: Capture, words: Words, white: float, over: NDArray[np.bool_], holes: bool) -> Iterable[str]:
    faults, mask = capture.faults, capture.mask
    missing = (faults & Fault.MISSING) > 0
    if over.any():
        yield "radiance above --white, which is marked as clipped"
    if (capture.images < 0).any():
        yield "values below 0, which become 0"
    if (((faults & Fault.DARK) > 0) & ~missing & words.any(axis=-1)).any():
        yield "which samples are lost in the noise"
    if missing.any() and not holes:
        yield "which samples are missing (they are 0)"
    bright = words[:, mask].max(axis=-1)
    lit = bright[bright > 0]
    if lit.size and np.median(lit) < COARSE:
        yield f"the object in more than {COARSE} steps beside so bright a highlight (--white would cut it)"
