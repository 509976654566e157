"""Inpainting: each picture's defects from the rest of that picture, inside the object's mask only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen import large
from gen.capture import Bools, Capture, Floats
from recon.registry import Repaired
from recon.repair.samples import missing, require_alike, weights_of

RADIUS = 3
"""Pixels around an unknown pixel that the inpainting looks at (cv2.inpaint's inpaintRadius; the biharmonic stencil's is 2)."""

PEAK = 2.0**20
"""The largest value given to cv2.inpaint. Its Telea adds a term of up to 1.4 whatever the scale of the values, which is invisible in 8 bits
and ruins floats near 1; at this peak it is a millionth."""

LARGEST = 50_000
"""Pixels of one connected hole up to which the biharmonic equation is solved at full resolution: 1.5 s and 300 MB for a round one, and
growing faster than its area."""

Painter = Callable[[Floats, Bools], NDArray[np.floating[Any]]]
"""(picture (H, W, 3), unknown (H, W)) -> the picture with the unknown pixels filled."""


def telea(images: Floats, defects: Bools, capture: Capture) -> Repaired:
    """Inpainting by the fast marching method, from inside the object's mask only.

    images: (K, H, W, 3) float32, worked on in float32, each channel alone. defects: (K, H, W). Samples outside the mask, and those that are
    not defects, come back bit for bit; a frame without one good sample in the object stays as it is. Weights are 1, 0 where missing.
    Raises InputError where shapes disagree.
    Source: A. Telea, "An image inpainting technique based on the fast marching method", J. Graphics Tools 9(1), 2004 (cv2.INPAINT_TELEA).
    """
    import cv2

    return _inpaint(images, defects, capture, lambda picture, unknown: _cv2(picture, unknown, cv2.INPAINT_TELEA))


def navier_stokes(images: Floats, defects: Bools, capture: Capture) -> Repaired:
    """Inpainting that carries the lines of equal brightness into the hole, from inside the object's mask only.

    Arguments, result and errors as for `telea`.
    Source: M. Bertalmio, A. Bertozzi and G. Sapiro, "Navier-Stokes, fluid dynamics, and image and video inpainting", CVPR 2001
    (cv2.INPAINT_NS).
    """
    import cv2

    return _inpaint(images, defects, capture, lambda picture, unknown: _cv2(picture, unknown, cv2.INPAINT_NS))


def biharmonic(images: Floats, defects: Bools, capture: Capture) -> Repaired:
    """Inpainting by the smoothest surface, continuing brightness and its slope into the hole, from inside the object's mask only.

    Arguments, result and errors as for `telea`. Holes of more than `LARGEST` connected pixels are solved at half the resolution, again
    halved while they are too large, and within a few pixels of their rim at the full one.
    Source: S. B. Damelin and N. S. Hoang, "On surface completion and image inpainting by biharmonic functions: numerical aspects", Int. J.
    Mathematics and Mathematical Sciences, 2018 (skimage.restoration.inpaint_biharmonic).
    """
    return _inpaint(images, defects, capture, smoothest)


def smoothest(picture: NDArray[np.floating[Any]], unknown: Bools) -> NDArray[np.float64]:
    """The picture (H, W, 3) with the unknown pixels (H, W) filled by the solution of the biharmonic equation, each channel alone."""
    import cv2
    from skimage.restoration import inpaint_biharmonic

    picture = picture.astype(np.float64)
    large = _parts_over(unknown, LARGEST)
    if large.any():
        rows, columns = (-(-n // 2) for n in unknown.shape)
        lost = cv2.resize(_even(large.astype(np.float32)), (columns, rows), interpolation=cv2.INTER_AREA) > 0
        coarse = smoothest(cv2.resize(_even(picture), (columns, rows), interpolation=cv2.INTER_AREA), lost)
        fine = cv2.resize(coarse, (2 * columns, 2 * rows), interpolation=cv2.INTER_LINEAR)
        inner = cv2.erode(large.astype(np.uint8), np.ones((4 * RADIUS + 1, 4 * RADIUS + 1), np.uint8)) > 0
        picture[inner] = fine[: unknown.shape[0], : unknown.shape[1]][inner]
        unknown = unknown & ~inner
    return inpaint_biharmonic(picture, unknown, split_into_regions=True, channel_axis=-1)


def _parts_over(unknown: Bools, pixels: int) -> Bools:
    """The connected parts of the unknown pixels that are larger than so many."""
    import cv2

    if np.count_nonzero(unknown) <= pixels:
        return np.zeros_like(unknown)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(unknown.astype(np.uint8), connectivity=8)
    over = stats[:, cv2.CC_STAT_AREA] > pixels
    over[0] = False
    found: Bools = over[labels]
    return found


def _even(picture: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """The picture with its last row or column again where it has an odd number of them."""
    H, W = picture.shape[:2]
    return np.pad(picture, [(0, H % 2), (0, W % 2), *[(0, 0)] * (picture.ndim - 2)], mode="edge")


def _inpaint(images: Floats, defects: Bools, capture: Capture, paint: Painter) -> Repaired:
    require_alike(images, defects, capture)
    lost = missing(capture)
    result = large.copy(images)
    for k in range(capture.count):
        hole = defects[k] & capture.mask & ~lost[k]
        known = capture.mask & ~defects[k] & ~lost[k]
        if hole.any() and known.any():
            box = _box(hole, known)
            result[k][box] = _fill(images[k][box], hole[box], known[box], capture.mask[box], paint)
            large.release(images, result)
    return Repaired(images=result, weights=weights_of(capture))


def _fill(image: Floats, hole: Bools, known: Bools, mask: Bools, paint: Painter) -> Floats:
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
    samples = work[known]
    peak = np.abs(samples).max(axis=0).astype(np.float64)
    gain = PEAK / np.where(peak > 0, peak, 1)
    painted = paint(work * gain.astype(np.float32), unknown)[hole]
    filled = image.copy()
    filled[hole] = np.clip((painted * (1 / gain).astype(np.float32)).astype(np.float32), samples.min(axis=0), samples.max(axis=0))
    return filled


def _cv2(picture: Floats, unknown: Bools, method: int) -> Floats:
    import cv2

    holes = unknown.astype(np.uint8)
    return np.stack([cv2.inpaint(np.ascontiguousarray(picture[..., c]), holes, RADIUS, method) for c in range(3)], axis=-1)


def _box(hole: Bools, known: Bools) -> tuple[slice, slice]:
    """The hole's bounding box with a margin in which there are known pixels; the whole frame where the margin has none."""
    margin = 3 * RADIUS
    rows, columns = np.flatnonzero(hole.any(axis=1)), np.flatnonzero(hole.any(axis=0))
    box = np.s_[max(rows[0] - margin, 0) : rows[-1] + margin + 1, max(columns[0] - margin, 0) : columns[-1] + margin + 1]
    return box if known[box].any() else np.s_[:, :]
