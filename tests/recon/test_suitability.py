"""Captures that cannot be measured are refused with the reason, and what is doubtful is said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gen.capture import Capture, Fault, Scale
from gen.errors import InputError
from recon.pipeline import measure
from recon.suitability import doubts, require_suitable

NEAR = np.array([[0, 0, 300.0], [150, 0, 300], *[[np.nan] * 3] * 3])
Synthetic = Callable[..., Capture]


def faulty(capture: Capture, fault: Fault, where: object) -> Capture:
    faults = capture.faults.copy()
    faults[where] |= int(fault)
    return replace(capture, faults=faults)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda c: replace(c, lights=c.lights * [1, 1, -1]), "every light comes from behind"),
        (lambda c: faulty(c, Fault.CLIPPED, np.s_[:]), "100 % of the object's samples are clipped"),
        (lambda c: faulty(c, Fault.MISSING, np.s_[2]), "picture 003 holds not one value"),
        (lambda c: replace(c, lights=c.lights * [1, 0, 1]), "one plane"),
        (lambda c: c.select([0, 1]), "at least three lights"),
        (lambda c: replace(c, light_kinds=("sun",) * 4 + ("environment",)), "picture 005 was taken under environment light"),
        (lambda c: replace(c, light_kinds=("sun", "ambient") + ("sun",) * 3), "picture 002 was taken under ambient light"),
        (lambda c: replace(c, light_kinds=("several",) * 5), "picture 001 was taken under several lights at once"),
    ],
)
def test_what_cannot_be_measured_is_refused(spoil: Callable[[Capture], Capture], says: str, synthetic: Synthetic) -> None:
    with pytest.raises(InputError, match=f"synthetic sphere: .*{says}"):
        measure(spoil(synthetic("sphere", 24)))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: replace(c, provenance={"mask": "none given (mask.png is not there): the whole frame"}), "No mask was given"),
        (lambda c: replace(c, mask=~c.mask, images=c.images + 0.01), "is it inverted"),
        (lambda c: replace(c, provenance={"distance": "median of the true depth"}), "borrowed from the truth"),
        (lambda c: replace(c, provenance={"not_in_the_table": ["a.png", "b.png"]}), "2 pictures of the folder"),
        (lambda c: faulty(c, Fault.CLIPPED, np.s_[:, 10:14]), "samples are clipped"),
        (lambda c: replace(c, lights=np.vstack([c.lights[:4], [0.8, 0, -0.6]])), "1 of 5 lights come from behind"),
        (lambda c: faulty(c, Fault.MISSING, np.s_[2, 10:14]), "hold no value"),
        (lambda c: replace(c, light_kinds=("point", "area") + ("sun",) * 3, positions=NEAR), "2 of 5 lights are near, and were"),
        (lambda c: replace(c, scale=Scale()), "heights are in pixels"),
    ],
)
def test_what_is_doubtful_is_said(change: Callable[[Capture], Capture], says: str, synthetic: Synthetic) -> None:
    sound = replace(synthetic("sphere", 24), scale=Scale(mm_per_pixel=0.1))
    assert doubts(sound) == []
    found = doubts(change(sound))
    assert len(found) == 1
    assert says in found[0]


def test_a_picture_that_is_left_out_does_not_matter(synthetic: Synthetic) -> None:
    capture = replace(synthetic("sphere", 24), light_kinds=("sun",) * 4 + ("ambient",))
    require_suitable(capture.select([0, 1, 2, 3]))
