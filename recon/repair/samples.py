"""Repairs that leave the pictures as they are, and what all repairs share: the weights of samples, and the check of shapes."""

from __future__ import annotations

import numpy as np

from gen.capture import Bools, Capture, Fault, Floats
from gen.errors import InputError
from recon.conditioning import leave_out
from recon.registry import Repaired


def none(images: Floats, defects: Bools, capture: Capture) -> Repaired:
    """No repair: the samples stay as they are; only missing ones are left out."""
    require_alike(images, defects, capture)
    return Repaired(images=images, weights=weights_of(capture))


def drop(images: Floats, defects: Bools, capture: Capture) -> Repaired:
    """Leaving the defects out of photometric stereo: weight 0 where the lights that remain determine the normal, else weight 1.

    The remaining samples count only where they are valid (not dark, clipped or missing); at least three of them must be there, with
    a condition number of at most `recon.conditioning.MAX_CONDITION`, or the pixel keeps all its samples but the missing ones. images:
    (K, H, W, 3), handed back unchanged. defects: (K, H, W). Raises InputError where shapes disagree.
    Source: the selection of samples in E. Coleman and R. Jain, "Obtaining 3-dimensional shape of textured and specular surfaces using
    four-source photometry" (1982), with the condition number in place of their fixed choice of three among four lights.
    """
    require_alike(images, defects, capture)
    weights = weights_of(capture)
    # Judged on the valid samples alone: a shadow that happens to be left would determine nothing.
    valid = np.where(capture.valid, weights, 0).astype(np.float32)
    tried = leave_out(np.maximum(valid, defects * weights), defects & capture.mask, capture.lights)
    weights[defects & capture.mask & (tried == 0)] = 0
    return Repaired(images=images, weights=weights)


def missing(capture: Capture) -> Bools:
    """Samples without any value, (K, H, W)."""
    return (capture.faults & Fault.MISSING) != 0


def weights_of(capture: Capture) -> Floats:
    """Weights of a repair that leaves no sample out, (K, H, W): 1, and 0 where missing."""
    return (~missing(capture)).astype(np.float32)


def require_alike(images: Floats, defects: Bools, capture: Capture) -> None:
    """InputError unless pictures and defects are as large as the capture's own."""
    if images.shape != capture.images.shape or defects.shape != capture.faults.shape:
        raise InputError(
            f"{capture.source}: repair got pictures {images.shape} and defects {defects.shape} for a capture of {capture.images.shape}"
        )
