"""Gloss removers that need no training: Capture -> Layers. The one step that the classical ones share is `remove`."""

from __future__ import annotations

import numpy as np

from gen import large
from gen.capture import Bools, Capture, Fault, Floats
from recon.registry import Layers


def workable(capture: Capture, rows: slice = slice(None)) -> Bools:
    """(K, H, W) bool: the samples a remover works on, inside the mask and not missing; of some rows, where they are given."""
    return capture.mask[None, rows] & ((capture.faults[:, rows] & Fault.MISSING) == 0)


def remove(capture: Capture, gloss: Floats, confidence: Floats | None = None) -> Layers:
    """Layers of a capture whose gloss is known as the share of it that has the light's own colour.

    gloss: (K, H, W) specular radiance / light intensity, the same in all three channels (the neutral interface of the dichromatic
    model). It is held between 0 and the sample's smallest channel, beyond which the diffuse part would be negative, and is 0
    outside the mask and where the sample is missing. confidence: (K, H, W), handed on.
    Source: S. Shafer, "Using color to separate reflection components" (1985).
    """
    there = workable(capture)
    diffuse, specular = (large.empty(capture.images.shape, np.float32) for _ in range(2))
    for k, image in enumerate(capture.images):
        intensity = capture.intensities[k].astype(np.float32)
        smallest = (image / intensity).min(axis=2)
        bounded = np.clip(np.nan_to_num(gloss[k], nan=0.0, posinf=0.0, neginf=0.0), 0, np.maximum(smallest, 0))
        specular[k] = np.where(there[k], bounded, 0).astype(np.float32)[..., None] * intensity
        # The product may round to a little more than the channel it came from.
        np.minimum(specular[k], np.maximum(image, 0), out=specular[k])
        np.subtract(image, specular[k], out=diffuse[k])
        large.release(capture.images, diffuse, specular)
    return Layers(diffuse=diffuse, specular=specular, confidence=confidence)
