"""The learned gloss removers as `recon.registry` knows them, and what they share: exposure, tiles, and layers that add up to the input.

`lime`, `specular`, `diffuse` and `group` use the shipped weights; `remover` makes the same of any others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gen.capture import LUMA, Bools, Capture, Fault, Floats
from gen.capture_lights import WITHOUT_DIRECTION
from gen.errors import InputError
from recon.registry import Layers, Remover

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from learn.weights import Loaded

EXPOSURE = (95.0, 0.8)
"""The percentile of the object's luma, and the level that it is brought to: the exposure of the pictures that the networks of single
pictures are trained on (the preset paper-train)."""

LIT = 0.02
"""Share of a picture's brightest above which a pixel counts as the object where no mask is given."""

SMALLEST = 8
"""Pixels of the smallest side that a network takes."""

OVERLAP = 64
"""Pixels that neighbouring tiles of a large picture share."""

MAX_PIXELS = 1_500_000
"""Pixels that a network of single pictures is given at once; more are done in tiles."""

MAX_SAMPLES = 5 * MAX_PIXELS
"""Pixels times pictures that the group network is given at once: five pictures of `MAX_PIXELS`."""

MARGIN, GRID = 32, 32
"""Pixels around the object that the group network is shown, and the grid on which that box begins, so that strides fall as on the whole."""


def lime(capture: Capture) -> Layers:
    """LIME's five networks, each picture alone: diffuse = input - m_s S, the paper's method (a).

    Each picture is exposed as those of the training were; outside the mask all is diffuse. Gives no matte twin and no confidence.
    Raises InputError where the picture is smaller than 8 pixels or no weights are there; MissingPart without torch.
    Source: Meka, Maximov, Zollhoefer, Chatterjee, Seidel, Richardt and Theobalt, "LIME: Live Intrinsic Material Estimation" (CVPR 2018);
    as a gloss remover: "Removing gloss using Deep Neural Network for 3D Reconstruction", method (a).
    """
    return remove_by(_shipped("lime"), capture)


def specular(capture: Capture) -> Layers:
    """SpecularNet alone, each picture alone: it predicts the gloss and diffuse = input - specular, the paper's method (b).

    Pictures, result and errors as for `lime`.
    Source: "Removing gloss using Deep Neural Network for 3D Reconstruction", method (b), with the SpecularNet of LIME (CVPR 2018).
    """
    return remove_by(_shipped("specular"), capture)


def diffuse(capture: Capture) -> Layers:
    """SpecularNet alone, each picture alone: it predicts the diffuse layer directly, the paper's method (c).

    Pictures, result and errors as for `lime`.
    Source: "Removing gloss using Deep Neural Network for 3D Reconstruction", method (c), with the SpecularNet of LIME (CVPR 2018).
    """
    return remove_by(_shipped("diffuse"), capture)


def group(capture: Capture) -> Layers:
    """One network over all pictures of the view: the matte twin, diffuse, specular and a confidence for every sample; method (d).

    Any number of pictures in any order; with fewer than three it sees colour and neighbourhood alone. The lights' directions are used
    unless a picture was taken under light that has none. Confidence is 0 outside the mask and where a sample is missing.
    Errors as for `lime`.
    Source: ours; the exchange over the pictures by their maximum is that of G. Chen, K. Han and K.-Y. Wong, "PS-FCN" (ECCV 2018).
    """
    return remove_by(_shipped("group"), capture)


def remover(method: str, weights: str | Path | None = None, device: str = "cpu") -> Remover:
    """The remover of a method with other weights than the shipped ones: a file, or the folder of a training.

    method: the one that the weights must be of. device: as in `learn.weights.open_device`. Raises InputError where they are of another
    method or cannot be read, MissingPart without torch.
    """
    from learn.weights import load_weights

    loaded = load_weights(method if weights is None else weights, device)
    if loaded.method != method:
        raise InputError(f"{loaded.path}: these are weights of the method {loaded.method}, not of {method}")
    return partial(remove_by, loaded)


def remove_by(loaded: Loaded, capture: Capture) -> Layers:
    """The layers that loaded weights make of a capture, in its own units. Raises InputError as `separate` does."""
    missing = (capture.faults & Fault.MISSING) != 0
    known = not any(kind in WITHOUT_DIRECTION for kind in capture.light_kinds)
    found = separate(
        loaded,
        capture.reflectance(),
        capture.mask,
        capture.valid & ~missing,
        capture.lights if known else None,
        capture.source,
    )
    intensity = capture.intensities[:, None, None, :].astype(np.float32)
    gloss = np.where((capture.mask & ~missing)[..., None], found.specular * intensity, 0)
    gloss = np.clip(gloss, 0, np.maximum(capture.images, 0))
    return Layers(
        diffuse=capture.images - gloss,
        specular=gloss,
        matte=None if found.matte is None else found.matte * intensity,
        confidence=None
        if found.confidence is None
        else np.where(capture.mask & ~missing, found.confidence, 0).astype(np.float32),
    )


def separate(
    loaded: Loaded,
    images: Floats,
    mask: Bools | None,
    valid: Bools | None = None,
    lights: NDArray[np.float64] | None = None,
    where: str = "pictures",
) -> Layers:
    """The layers of linear pictures under white light of intensity 1.

    images: (K, H, W, 3) reflectance (radiance over light intensity); for the networks of single pictures any exposure will do. mask:
    (H, W); None: the whole frame (of LIME: what its segmentation finds). valid: (K, H, W); None: all. lights: (K, 3) unit, or None where
    unknown; single pictures do without. where: for the message. diffuse + specular is the input, to float rounding. Pictures of more than
    `MAX_PIXELS` are done in tiles. Raises InputError where a side is smaller than `SMALLEST`.
    """
    H, W = images.shape[1:3]
    if min(H, W) < SMALLEST:
        raise InputError(f"{where}: is {W}x{H} pixels; the networks need at least {SMALLEST}x{SMALLEST}")
    shown = np.ascontiguousarray(np.maximum(images, 0), dtype=np.float32)
    if loaded.method == "group":
        return _group(loaded, shown, mask, valid, lights)
    gloss = np.stack([_single(loaded, picture, mask) for picture in shown])
    return Layers(diffuse=images - gloss, specular=gloss)


def exposure_factor(picture: Floats, mask: Bools | None) -> float:
    """The factor that exposes a picture (H, W, 3) as those of the training were (see `EXPOSURE`); 1 where the object is black.

    mask: (H, W); None: the pixels that are not dark (see `LIT`).
    """
    percentile, level = EXPOSURE
    luma = picture @ LUMA.astype(np.float32)
    inside = luma > LIT * float(luma.max()) if mask is None else mask
    bright = float(np.percentile(luma[inside], percentile)) if inside.any() else 0.0
    return level / bright if bright > 0 else 1.0


def tiles(
    height: int, width: int, most: int, overlap: int = OVERLAP
) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Overlapping parts of a picture of at most about `most` pixels, as (what is looked at, what is kept of the result).

    The kept parts cover the picture once; each seam lies in the middle of an overlap. Sides are as even as they can be.
    """
    side = max(int(most**0.5), 2 * overlap)
    if height * width <= most:
        yield (slice(0, height), slice(0, width)), (slice(0, height), slice(0, width))
        return
    for rows, kept_rows in _spans(height, side, overlap):
        for columns, kept_columns in _spans(width, side, overlap):
            yield (rows, columns), (kept_rows, kept_columns)


def _spans(length: int, side: int, overlap: int) -> Iterator[tuple[slice, slice]]:
    """Intervals of at most `side` that overlap by `overlap`, each with the part of the whole that is its own."""
    half = overlap // 2
    count = 1 if length <= side else -(-(length - overlap) // (side - overlap))
    edges = [round(length * i / count / GRID) * GRID for i in range(count)] + [length]
    for begin, end in pairwise(edges):
        yield slice(max(begin - half, 0), min(end + half, length)), slice(begin, end)


def _single(loaded: Loaded, picture: Floats, mask: Bools | None) -> Floats:
    """The specular layer (H, W, 3) of one picture."""
    import torch

    device = next(loaded.model.parameters()).device
    factor = np.float32(exposure_factor(picture, mask))
    result = np.empty_like(picture)
    with torch.inference_mode():
        for seen, kept in tiles(picture.shape[0], picture.shape[1], MAX_PIXELS):
            image = torch.from_numpy(np.moveaxis(picture[seen] * factor, 2, 0)[None].copy()).to(device)
            inside = None if mask is None else torch.from_numpy(mask[seen][None, None].copy()).to(device)
            _, gloss = _remove(loaded)(image, inside)
            part = np.moveaxis(gloss[0].float().cpu().numpy(), 0, 2) / factor
            result[kept] = part[_within(seen, kept)]
    return np.clip(np.nan_to_num(result, nan=0.0), 0, picture)


def _group(loaded: Loaded, images: Floats, mask: Bools | None, valid: Bools | None, lights: NDArray[np.float64] | None) -> Layers:
    """The layers of all pictures together. Only the object's box is looked at; outside it all is diffuse and matte."""
    import torch

    from learn.models.group import shrink_of

    device = next(loaded.model.parameters()).device
    K, H, W, _ = images.shape
    inside = np.ones((H, W), bool) if mask is None else mask
    known = np.ones((K, H, W), bool) if valid is None else valid
    toward = None if lights is None else torch.from_numpy(np.asarray(lights, np.float32))[None].to(device)
    gloss, matte, confidence = np.zeros_like(images), images.copy(), np.zeros((K, H, W), np.float32)
    top, left, bottom, right = _box(inside)
    shrink = shrink_of(torch.from_numpy(inside))
    with torch.inference_mode():
        for seen, kept in tiles(bottom - top, right - left, MAX_SAMPLES // K):
            rows, columns = (slice(s.start + at, s.stop + at) for s, at in zip(seen, (top, left), strict=True))
            if not inside[rows, columns].any():
                continue
            part = torch.from_numpy(np.moveaxis(images[:, rows, columns], 3, 1)[None].copy()).to(device)
            layers = loaded.model(
                part,
                toward,
                torch.from_numpy(known[:, rows, columns][None].copy()).to(device),
                torch.from_numpy(inside[rows, columns][None].copy()).to(device),
                shrink=shrink,
            )
            own = tuple(slice(s.start + at, s.stop + at) for s, at in zip(kept, (top, left), strict=True))
            within = _within(seen, kept)
            for whole, layer in ((gloss, layers.specular), (matte, layers.matte)):
                whole[(slice(None), *own)] = np.moveaxis(layer[0].float().cpu().numpy(), 1, 3)[(slice(None), *within)]
            confidence[(slice(None), *own)] = layers.confidence[0].float().cpu().numpy()[(slice(None), *within)]
    gloss = np.clip(np.nan_to_num(gloss, nan=0.0), 0, images)
    gloss[:, ~inside] = 0
    matte[:, ~inside] = images[:, ~inside]
    confidence[:, ~inside] = 0
    matte = np.maximum(np.nan_to_num(matte, nan=0.0), 0)
    return Layers(images - gloss, gloss, matte, np.clip(np.nan_to_num(confidence, nan=0.0), 0, 1))


def _remove(loaded: Loaded) -> Callable[..., Any]:
    remove: Callable[..., Any] = loaded.model.remove
    return remove


def _box(mask: Bools) -> tuple[int, int, int, int]:
    """top, left, bottom, right of the object's box with `MARGIN`, begun on `GRID`, at least `SMALLEST` wide."""
    H, W = mask.shape
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return 0, 0, H, W
    top, left = (max(int(line[0]) - MARGIN, 0) // GRID * GRID for line in (rows, columns))
    bottom, right = min(int(rows[-1]) + 1 + MARGIN, H), min(int(columns[-1]) + 1 + MARGIN, W)
    return top, left, bottom, right


def _within(seen: tuple[slice, slice], kept: tuple[slice, slice]) -> tuple[slice, slice]:
    """Where the kept part lies in what was looked at."""
    rows, columns = (slice(k.start - s.start, k.stop - s.start) for s, k in zip(seen, kept, strict=True))
    return rows, columns


@lru_cache(maxsize=4)
def _shipped(method: str) -> Loaded:
    from learn.weights import load_weights

    return load_weights(method)
