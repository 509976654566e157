"""Whether a capture can be measured at all, and what a reader of the figures must know about it."""

from __future__ import annotations

import numpy as np

from gen.capture import Capture, Fault, grey
from gen.capture_lights import NEAR, WITHOUT_DIRECTION
from gen.errors import InputError
from recon.conditioning import require_spanning_lights
from recon.near_light import places_known

TOO_MANY_CLIPPED = 0.9
"""Share of the object's samples that may be clipped before a capture is refused."""

NOTEWORTHY_CLIPPED = 0.02
"""Share of the object's samples that may be clipped before it is said."""


def require_suitable(capture: Capture) -> None:
    """InputError where photometric stereo cannot work on a capture.

    That is: a picture under light without a single direction, fewer than three lights, lights in one plane or too much alike, every
    light behind the object, a picture without a value, or hardly a sample that is not clipped.
    """
    where = capture.source
    for name, kind in zip(capture.names, capture.light_kinds, strict=True):
        if kind in WITHOUT_DIRECTION:
            what = "several lights at once" if kind == "several" else f"{kind} light"
            raise InputError(
                f"{where}: picture {name} was taken under {what}, photometric stereo needs one direction a picture; "
                "leave it out with --lights"
            )
    require_spanning_lights(capture.lights, where)
    if (capture.lights[:, 2] <= 0).all():
        raise InputError(
            f"{where}: every light comes from behind (z <= 0); z points from the object to the camera: check the signs"
        )
    empty = ((capture.faults & Fault.MISSING) > 0)[:, capture.mask].all(axis=1)
    if empty.any():
        name = capture.names[int(np.argmax(empty))]
        raise InputError(f"{where}: picture {name} holds not one value inside the mask; leave it out with --lights")
    clipped = clipped_share(capture)
    if clipped > TOO_MANY_CLIPPED:
        raise InputError(
            f"{where}: {100 * clipped:.0f} % of the object's samples are clipped; take the pictures with less exposure"
        )


def doubts(capture: Capture) -> list[str]:
    """Sentences on what is missing, borrowed or odd in a capture that can be measured; empty where all is well."""
    record = capture.provenance
    found = []
    if str(record.get("mask", "")).startswith("none given"):
        found.append("No mask was given: the whole frame was measured, background and all.")
    elif _mask_is_dark(capture):
        found.append("The mask covers the darker part of the pictures: is it inverted? White marks the object.")
    if "distance" in record:
        found.append(f"The camera's distance is the {record['distance']}: the scale of the heights is borrowed from the truth.")
    if record.get("not_in_the_table"):
        found.append(
            f"{len(record['not_in_the_table'])} pictures of the folder are not in its table of lights and were left aside."
        )
    clipped = clipped_share(capture)
    if clipped > NOTEWORTHY_CLIPPED:
        found.append(f"{100 * clipped:.0f} % of the object's samples are clipped: less exposure would measure more.")
    behind = int((capture.lights[:, 2] <= 0).sum())
    if behind:
        found.append(f"{behind} of {capture.count} lights come from behind the object (z <= 0): check their signs.")
    near = sum(kind in NEAR for kind in capture.light_kinds)
    if near and places_known(capture):
        found.append(
            f"{near} of {capture.count} lights are near, and were solved so: direction and fall-off were worked out at every point."
        )
    elif near:
        found.append(
            f"{near} of {capture.count} lights are near, but were solved as distant, since no scale says where they stand over a "
            "pixel: expect the surface to come out bent."
        )
    missing = float(((capture.faults & Fault.MISSING) > 0)[:, capture.mask].mean())
    if missing:
        found.append(f"{100 * missing:.2g} % of the object's samples hold no value and were left out.")
    if capture.scale.metres_per_pixel is None:
        found.append("No scale is known for this capture, so heights are in pixels.")
    return found


def clipped_share(capture: Capture) -> float:
    """Share of the object's samples that are clipped."""
    return float(((capture.faults & Fault.CLIPPED) > 0)[:, capture.mask].mean())


def _mask_is_dark(capture: Capture) -> bool:
    """Whether what the mask leaves out is at least twice as bright as what it holds."""
    if capture.mask.all():
        return False
    brightest = grey(capture.images).max(axis=0)
    return bool(np.median(brightest[~capture.mask]) > 2 * np.median(brightest[capture.mask]))
