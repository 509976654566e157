"""What becomes of the defects: nothing, inpainting from the object's own surroundings, or leaving the samples out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.capture import Bools, Capture, Fault, Floats
from gen.errors import InputError
from recon.conditioning import leave_out
from recon.registry import Repaired

RADIUS = 3
"""Pixels around an unknown pixel that the inpainting looks at (cv2.inpaint's inpaintRadius)."""

PEAK = 2.0**20
"""The largest value given to cv2.inpaint. Its Telea adds a term of up to 1.4 whatever the scale of the values, which is invisible in 8 bits
and ruins floats near 1; at this peak it is a millionth."""


def none(images: Floats, defects: Bools, capture: Capture) -> Repaired:
    """No repair: the samples stay as they are; only missing ones are left out."""
    _check(images, defects, capture)
    return Repaired(images=images, weights=_weights(capture))


def telea(images: Floats, defects: Bools, capture: Capture) -> Repaired:
    """Inpainting by the fast marching method, from inside the object's mask only.

    images: (K, H, W, 3) float32, worked on in float32, each channel alone. defects: (K, H, W). Samples outside the mask, and those that are
    not defects, come back bit for bit; a frame without one good sample in the object stays as it is. Weights are 1, 0 where missing.
    Raises InputError where shapes disagree.
    Source: A. Telea, "An image inpainting technique based on the fast marching method", J. Graphics Tools 9(1), 2004 (cv2.INPAINT_TELEA).
    """
    import cv2

    return _inpaint(images, defects, capture, cv2.INPAINT_TELEA)


def navier_stokes(images: Floats, defects: Bools, capture: Capture) -> Repaired:
    """Inpainting that carries the lines of equal brightness into the hole, from inside the object's mask only.

    Arguments, result and errors as for `telea`.
    Source: M. Bertalmio, A. Bertozzi and G. Sapiro, "Navier-Stokes, fluid dynamics, and image and video inpainting", CVPR 2001
    (cv2.INPAINT_NS).
    """
    import cv2

    return _inpaint(images, defects, capture, cv2.INPAINT_NS)


def drop(images: Floats, defects: Bools, capture: Capture) -> Repaired:
    """Leaving the defects out of photometric stereo: weight 0 where the lights that remain determine the normal, else weight 1.

    The remaining samples count only where they are valid (not dark, clipped or missing); at least three of them must be there, with
    a condition number of at most `recon.conditioning.MAX_CONDITION`, or the pixel keeps all its samples but the missing ones. images and
    defects as for `telea`; the pictures are handed back unchanged.
    Source: the selection of samples in E. Coleman and R. Jain, "Obtaining 3-dimensional shape of textured and specular surfaces using
    four-source photometry" (1982), with the condition number in place of their fixed choice of three among four lights.
    """
    _check(images, defects, capture)
    weights = _weights(capture)
    # Judged on the valid samples alone: a shadow that happens to be left would determine nothing.
    valid = np.where(capture.valid, weights, 0).astype(np.float32)
    tried = leave_out(np.maximum(valid, defects * weights), defects & capture.mask, capture.lights)
    weights[defects & capture.mask & (tried == 0)] = 0
    return Repaired(images=images, weights=weights)


def _inpaint(images: Floats, defects: Bools, capture: Capture, method: int) -> Repaired:
    _check(images, defects, capture)
    missing = (capture.faults & Fault.MISSING) != 0
    result = images.copy()
    for k in range(capture.count):
        hole = defects[k] & capture.mask & ~missing[k]
        known = capture.mask & ~defects[k] & ~missing[k]
        if hole.any() and known.any():
            box = _box(hole, known)
            result[k][box] = _fill(images[k][box], hole[box], known[box], capture.mask[box], method)
    return Repaired(images=result, weights=_weights(capture))


def _fill(image: Floats, hole: Bools, known: Bools, mask: Bools, method: int) -> Floats:
    """One picture (H, W, 3) with the hole filled from the known pixels.

    Beyond the object each pixel takes the nearest known one's value, and within reach of the hole it counts as unknown: so neither
    the background nor that rough extension enters the hole directly.
    """
    import cv2
    from scipy.ndimage import distance_transform_edt

    unknown = hole | (mask & ~known)
    work = image
    if not mask.all() or (unknown & ~hole).any():
        rows, columns = distance_transform_edt(~known, return_distances=False, return_indices=True)
        work = np.where(known[..., None], image, image[rows, columns])
        near = cv2.dilate(hole.astype(np.uint8), np.ones((2 * RADIUS + 1, 2 * RADIUS + 1), np.uint8)) > 0
        unknown |= ~mask & near
    holes = unknown.astype(np.uint8)
    filled = image.copy()
    for channel in range(3):
        peak = float(np.abs(work[..., channel][known]).max())
        if peak == 0:
            filled[hole, channel] = 0
            continue
        plane = np.ascontiguousarray(work[..., channel] * np.float32(PEAK / peak), dtype=np.float32)
        painted = cv2.inpaint(plane, holes, RADIUS, method)
        lowest, highest = float(work[..., channel][known].min()), peak
        filled[hole, channel] = np.clip(painted[hole] * np.float32(peak / PEAK), lowest, highest)
    return filled


def _box(hole: Bools, known: Bools) -> tuple[slice, slice]:
    """The hole's bounding box with a margin in which there are known pixels; the whole frame where the margin has none."""
    margin = 3 * RADIUS
    rows, columns = np.flatnonzero(hole.any(axis=1)), np.flatnonzero(hole.any(axis=0))
    box = np.s_[max(rows[0] - margin, 0) : rows[-1] + margin + 1, max(columns[0] - margin, 0) : columns[-1] + margin + 1]
    return box if known[box].any() else np.s_[:, :]


def _weights(capture: Capture) -> Floats:
    return ((capture.faults & Fault.MISSING) == 0).astype(np.float32)


def _check(images: NDArray[np.float32], defects: Bools, capture: Capture) -> None:
    if images.shape != capture.images.shape or defects.shape != capture.faults.shape:
        raise InputError(
            f"{capture.source}: repair got pictures {images.shape} and defects {defects.shape} for a capture of {capture.images.shape}"
        )
