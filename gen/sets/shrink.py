"""A capture at a whole fraction of its size: what a camera with larger pixels would have seen."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Fault, Scale, Truth
from gen.errors import InputError


def shrink(capture: Capture, n: int) -> Capture:
    """Every n x n block of pixels becomes one.

    Radiance (pictures and layers) is the mean over the block. The mask holds where at least half of the block does. Normals are the
    normalised sum of those on the object, depth, albedo and gloss their mean over it, as the studio forms them from sub-samples; a block
    whose normals cancel out leaves the mask. One clipped or missing pixel makes the block so, all dark ones make it dark. Layers of flags
    (shadow) take what most of the block is, the higher flag at a tie.
    Raises InputError where n does not divide the size or nothing of the mask is left.
    """
    if n == 1:
        return capture
    H, W = capture.size
    if n < 1 or H % n or W % n:
        raise InputError(f"{capture.source}: {W}x{H} pixels cannot be shrunk by {n}; choose a factor of both sides")
    truth = capture.truth
    inside = capture.mask
    share = mean(inside.astype(np.float64), n)
    mask = share >= 0.5
    normals = None
    if truth.normals is not None:
        total = mean(np.where(inside[..., None], truth.normals, 0).astype(np.float64), n)
        length = np.linalg.norm(total, axis=-1)
        mask = mask & (length > 1e-6)
        normals = np.where(mask[..., None], total / np.where(length > 0, length, 1)[..., None], 0).astype(np.float32)
    if not mask.any():
        raise InputError(f"{capture.source}: nothing of the mask is left at 1/{n} of its size; shrink it less")

    def on_object(layer: NDArray[Any] | None, outside: float) -> NDArray[np.float32] | None:
        if layer is None:
            return None
        wide = (slice(None), slice(None), *([None] * (layer.ndim - 2)))
        known = inside & np.isfinite(layer).reshape(H, W, -1).all(axis=-1)
        weight = mean(known.astype(np.float64), n)
        total = mean(np.where(known[wide], layer, 0).astype(np.float64), n)
        found = mask & (weight > 0)
        return np.where(found[wide], total / np.where(found, weight, 1)[wide], outside).astype(np.float32)

    def stacked(layer: NDArray[Any] | None) -> NDArray[Any] | None:
        if layer is None:
            return None
        return _most(layer, n) if layer.dtype == np.uint8 else np.stack([mean(frame, n) for frame in layer]).astype(np.float32)

    view: dict[str, Any] = {"normals": normals, "depth": on_object(truth.depth, np.nan)}
    view |= {name: on_object(getattr(truth, name), 0.0) for name in Truth.PER_VIEW if name not in view}
    per_light = {name: stacked(getattr(truth, name)) for name in Truth.PER_LIGHT}
    images = stacked(capture.images)
    assert images is not None
    return replace(
        capture,
        images=images,
        mask=mask,
        faults=np.stack([_faults(frame, n) for frame in capture.faults]),
        scale=_scale(capture.scale, n),
        truth=replace(truth, **view, **per_light),
    )


def mean(array: NDArray[Any], n: int) -> NDArray[np.float64]:
    """Means over n x n blocks of an array (n h, n w) or (n h, n w, C), formed in double precision."""
    result: NDArray[np.float64] = _blocks(array, n).mean(axis=(1, 3), dtype=np.float64)
    return result


def _blocks(array: NDArray[Any], n: int) -> NDArray[Any]:
    H, W = array.shape[:2]
    return array.reshape(H // n, n, W // n, n, *array.shape[2:])


def _faults(frame: NDArray[np.uint8], n: int) -> NDArray[np.uint8]:
    some = np.bitwise_or.reduce(np.bitwise_or.reduce(_blocks(frame, n), axis=3), axis=1)
    every = np.bitwise_and.reduce(np.bitwise_and.reduce(_blocks(frame, n), axis=3), axis=1)
    dark = np.uint8(Fault.DARK)
    flags: NDArray[np.uint8] = (some & ~dark) | (every & dark)
    return flags


def _most(flags: NDArray[np.uint8], n: int) -> NDArray[np.uint8]:
    kinds = np.unique(flags)[::-1]  # the higher first: argmax takes the first of equal counts
    votes = np.stack([[mean((frame == kind).astype(np.float64), n) for frame in flags] for kind in kinds])
    most: NDArray[np.uint8] = kinds[votes.argmax(axis=0)]
    return most


def _scale(scale: Scale, n: int) -> Scale:
    """Larger pixels; centres of pixels stay at whole numbers, so the principal point moves by half of the difference."""
    camera = None
    if scale.camera is not None:
        camera = scale.camera.copy()
        camera[:2] /= n
        camera[:2, 2] -= (n - 1) / (2 * n)
    return replace(scale, mm_per_pixel=None if scale.mm_per_pixel is None else scale.mm_per_pixel * n, camera=camera)
