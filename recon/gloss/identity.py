"""The ends of every comparison: no removal at all, and the true layers of a rendered capture."""

from __future__ import annotations

import numpy as np

from gen.capture import Capture, Floats
from gen.errors import InputError
from recon.registry import Layers


def none(capture: Capture) -> Layers:
    """No removal: the pictures as they are count as diffuse, and nothing as specular.

    The row "do nothing" that every other method has to beat.
    """
    return Layers(diffuse=capture.images, specular=np.broadcast_to(np.float32(0), capture.images.shape))


def true_diffuse(capture: Capture) -> Layers:
    """The rendered diffuse layer itself: the ceiling of any perfect separation.

    Raises InputError where the capture has no true diffuse layer (a photograph).
    """
    diffuse = _layer(capture, capture.truth.diffuse, "diffuse")
    if capture.truth.specular is None:
        return Layers(diffuse=diffuse, specular=np.maximum(capture.images - diffuse, 0))
    return Layers(diffuse=diffuse, specular=_layer(capture, capture.truth.specular, "specular"))


def true_matte(capture: Capture) -> Layers:
    """The rendered matte twin itself: the ceiling of any method that measures with least squares.

    `diffuse` and `specular` are the true ones where they are there; else the matte twin stands for diffuse as well, cut at the input.
    Raises InputError where the capture has no matte twin (a photograph).
    """
    matte = _layer(capture, capture.truth.matte, "matte")
    if capture.truth.diffuse is not None:
        layers = true_diffuse(capture)
        return Layers(diffuse=layers.diffuse, specular=layers.specular, matte=matte)
    diffuse = np.minimum(matte, capture.images)
    return Layers(diffuse=diffuse, specular=capture.images - diffuse, matte=matte)


def _layer(capture: Capture, layer: Floats | None, name: str) -> Floats:
    if layer is None:
        raise InputError(
            f"{capture.source}: --gloss true-{name} needs a rendered capture with its {name} layer; this one has none"
        )
    return np.ascontiguousarray(np.broadcast_to(layer, capture.images.shape))
