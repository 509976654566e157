"""The learned gloss removers as `recon.registry` knows them, and what they share: exposure, tiles, and layers that add up to the input.

`lime`, `specular`, `diffuse` and `group` use the shipped weights; `remover` makes the same of any others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gen import large
from gen.capture import LUMA, Bools, Capture, Fault, Floats
from gen.capture_lights import WITHOUT_DIRECTION
from gen.errors import InputError
from recon.gloss import workable
from recon.registry import FEWEST_FOR_GROUP, Layers, Remover

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    from learn.weights import Loaded

EXPOSURE = (95.0, 0.8)
"""The percentile of the object's luma, and the level that it is brought to: the exposure of the pictures that the networks of single
pictures are trained on (the preset paper-train)."""

LIT = 0.02
"""Share of a picture's brightest above which a pixel counts as the object where no mask is given."""

BLACK = (0.002, 0.04)
"""Share of the object's usual brightness below which a pixel of the mean picture shows the group network nothing: at least the first, and
with noise up to the second, no further, since the sparkle of dark metal passes for noise."""

SMALLEST = 8
"""Pixels of the smallest side that a network takes."""

OVERLAP = 64
"""Pixels that neighbouring tiles of a large picture share."""

MAX_PIXELS = 1_500_000
"""Pixels that a network of single pictures is given at once; more are done in tiles."""

MAX_SAMPLES = 2_000_000
"""Pixels times pictures that the group network is given at once: it takes a kilobyte for each."""

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

    Any number of pictures in any order; with fewer than three it sees colour and neighbourhood alone, and its gloss is given the light's
    colour; of one picture of something grey all stays. The lights' directions are used unless a picture was taken under light that has
    none. From three pictures on colour says what colour matte and gloss have (`learn.neutral_gloss`), and where the normals are less those
    of a surface than the pictures' own are, or nearly the same, the pictures stay (`learn.normals_check`). Confidence is 0 outside the
    mask and where a sample is missing.
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
    there = workable(capture)
    known = not any(kind in WITHOUT_DIRECTION for kind in capture.light_kinds)
    shown = Shown(
        capture.images,
        capture.intensities.astype(np.float32),
        capture.mask,
        capture.valid,
        capture.lights if known else None,
    )
    layers = _layers(loaded, shown, capture.source, there)
    if loaded.method == "group" and known and capture.count >= FEWEST_FOR_GROUP:
        layers = _look_again(capture, layers, shown.lit)
    return layers


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
    unknown; single pictures do without. where: for the message. diffuse + specular is the input, to float rounding. Large pictures are
    done in tiles (`MAX_PIXELS`, `MAX_SAMPLES`). Raises InputError where a side is smaller than `SMALLEST`.
    """
    shown = Shown(images, np.ones((len(images), 3), np.float32), mask, valid, lights)
    layers = _layers(loaded, shown, where)
    if loaded.method == "group" and lights is not None and len(images) >= FEWEST_FOR_GROUP:
        faults = None if valid is None else np.where(valid, 0, int(Fault.CLIPPED)).astype(np.uint8)
        layers = _look_again(Capture(images, lights, shown.inside, faults=faults, source=where), layers, shown.lit)  # type: ignore[arg-type]
    return layers


def _look_again(capture: Capture, layers: Layers, lit: Bools) -> Layers:
    """The group network's layers after what colour and the normals say of them, where the lights are known and enough."""
    from learn import neutral_gloss, normals_check

    neutral_gloss.colour(capture, layers)
    return normals_check.check(capture, layers, lit)


@dataclass(frozen=True, eq=False)
class Shown:
    """What a network is shown. images: (K, H, W, 3) radiance. intensities: (K, 3). The rest as in `separate`."""

    images: Floats
    intensities: Floats
    mask: Bools | None
    valid: Bools | None
    lights: NDArray[np.float64] | None

    @property
    def inside(self) -> Bools:
        """The mask (H, W), or the whole frame."""
        return np.ones(self.images.shape[1:3], bool) if self.mask is None else self.mask

    @cached_property
    def lit(self) -> Bools:
        """The `lit_pixels` of the mask (H, W)."""
        return lit_pixels(self)

    def reflectance(self, of: slice, rows: slice, columns: slice) -> Floats:
        """(K, h, w, 3) radiance over light intensity of some pictures and a part of them, not negative."""
        part = self.images[of, rows, columns] / self.intensities[of, None, None, :]
        return np.ascontiguousarray(np.maximum(part, 0), dtype=np.float32)


Found = tuple[tuple[slice, slice, slice], Floats, Floats | None, Floats | None]
"""Which pictures, rows and columns; their specular layer (K, h, w, 3), matte layer and confidence (K, h, w), in reflectance."""


def _layers(loaded: Loaded, shown: Shown, where: str, there: Bools | None = None) -> Layers:
    """The layers in the units of the pictures. there: (K, H, W), the samples that may have gloss and confidence; None: all."""
    images = shown.images
    H, W = images.shape[1:3]
    if min(H, W) < SMALLEST:
        raise InputError(f"{where}: is {W}x{H} pixels; the networks need at least {SMALLEST}x{SMALLEST}")
    intensity = shown.intensities[:, None, None, :]
    diffuse, specular = large.empty(images.shape, np.float32), large.zeros(images.shape, np.float32)
    matte = confidence = None
    if loaded.method == "group":
        matte, confidence = large.empty(images.shape, np.float32), large.zeros(images.shape[:3], np.float32)
        inside = shown.inside
        for k in range(len(images)):
            matte[k] = shown.reflectance(slice(k, k + 1), slice(None), slice(None))[0] * intensity[k]
            confidence[k] = inside if there is None else inside & there[k]
            large.release(images, matte, confidence)
    for at, gloss, twin, trust in _group(loaded, shown) if loaded.method == "group" else _singles(loaded, shown):
        gloss = gloss * intensity[at[0]]
        if there is not None:
            gloss = np.where(there[at][..., None], gloss, 0)
        specular[at] = np.clip(gloss, 0, np.maximum(images[at], 0))
        if matte is not None and confidence is not None and twin is not None and trust is not None:
            matte[at] = twin * intensity[at[0]]
            confidence[at] = trust if there is None else np.where(there[at], trust, 0)
        large.release(images, specular, matte, confidence)
    for k in range(len(images)):
        np.subtract(images[k], specular[k], out=diffuse[k])
        large.release(images, specular, diffuse)
    layers = Layers(diffuse, specular, matte, confidence)
    if loaded.method == "group" and len(images) < FEWEST_FOR_GROUP:
        from learn.neutral_gloss import colour_alone

        colour_alone(images, shown.intensities, shown.inside, layers)
    return layers


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


def _singles(loaded: Loaded, shown: Shown) -> Iterator[Found]:
    """The specular layers, picture by picture."""
    whole = slice(None)
    for k in range(len(shown.images)):
        of = slice(k, k + 1)
        yield (of, whole, whole), _single(loaded, shown.reflectance(of, whole, whole)[0], shown.mask)[None], None, None


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


def lit_pixels(shown: Shown) -> Bools:
    """The pixels of the mask that some light reaches, (H, W): those whose mean picture is more than noise, and than `BLACK`. Ours.

    A mask that is larger than the object, or none, would show the network a black background, which it takes for a part of the object.
    Noise is what the darkest quarter of the mask varies by from pixel to pixel. Where nothing is lit, the whole mask.
    """
    import cv2

    mask = shown.inside
    mean, rough = (np.zeros(mask.shape, np.float32) for _ in range(2))
    whole, luma = slice(None), LUMA.astype(np.float32)
    for rows in large.strips((3 * len(shown.images), *mask.shape)):
        samples = np.nan_to_num(shown.reflectance(whole, rows, whole) @ luma, nan=0.0, posinf=0.0)
        mean[rows] = samples.mean(axis=0)
        rough[rows, 1:-1] = np.abs(samples[:, :, 1:-1] - (samples[:, :, :-2] + samples[:, :, 2:]) / 2).mean(axis=0)
        large.release(shown.images)
    inside = mean[mask]
    if not inside.any():
        return mask
    # Of a normal variable the mean distance from 0 is .8 deviations, and such a difference has the root of 1.5 of them.
    noise = float(rough[mask & (mean <= np.percentile(inside, 25))].mean()) / (0.8 * 1.5**0.5)
    # A mean of roots that is weighted by itself: neither highlights nor black pixels, however many, count much.
    roots = np.sqrt(inside, dtype=np.float64)
    usual = float((inside.sum(dtype=np.float64) / roots.sum()) ** 2)
    # Around it half of the pixels, or it by far: noise alone is not so bright twice.
    around = np.maximum(cv2.medianBlur(mean, 5), mean / 3)
    kept = mask & (around > np.clip(2 * noise, BLACK[0] * usual, BLACK[1] * usual))
    return kept if kept.any() else mask


def _group(loaded: Loaded, shown: Shown) -> Iterator[Found]:
    """The layers of all pictures together, part by part. Only the box of the `lit_pixels` is looked at; all else is diffuse and matte."""
    import torch

    from learn.group_tiles import Given, layers_in_tiles
    from learn.models.group import shrink_of

    device = next(loaded.model.parameters()).device
    K = len(shown.images)
    object_mask = shown.inside
    mask = shown.lit
    toward = None if shown.lights is None else torch.from_numpy(np.asarray(shown.lights, np.float32))[None].to(device)
    top, left, bottom, right = _box(mask)
    every = slice(None)

    def placed(part: tuple[slice, slice]) -> tuple[slice, slice, slice]:
        rows, columns = (slice(s.start + at, s.stop + at) for s, at in zip(part, (top, left), strict=True))
        return every, rows, columns

    def images(part: tuple[slice, slice]) -> Tensor:
        return torch.from_numpy(np.moveaxis(shown.reflectance(*placed(part)), 3, 1)[None].copy()).to(device)

    def valid(part: tuple[slice, slice]) -> Tensor:
        _, rows, columns = placed(part)
        known = np.ones((K, rows.stop - rows.start, columns.stop - columns.start), bool)
        return torch.from_numpy((known if shown.valid is None else shown.valid[:, rows, columns])[None].copy()).to(device)

    inside = torch.from_numpy(mask[top:bottom, left:right].copy()).to(device)
    given, whole = Given(images, valid, inside, toward), (slice(0, bottom - top), slice(0, right - left))
    with torch.inference_mode():
        if K * inside.numel() <= MAX_SAMPLES:
            found = loaded.model(images(whole), toward, valid(whole), inside[None], shrink=shrink_of(inside))
            parts = iter([(whole, found)])
        else:
            parts = layers_in_tiles(loaded.model, given, tiles(bottom - top, right - left, MAX_SAMPLES // K), MAX_SAMPLES)
        for part, layers in parts:
            at = placed(part)
            picture, outside = shown.reflectance(*at), ~mask[at[1:]]
            gloss, matte = (np.moveaxis(layer[0].float().cpu().numpy(), 1, 3) for layer in (layers.specular, layers.matte))
            gloss = np.clip(np.nan_to_num(gloss, nan=0.0), 0, picture)
            matte = np.where(outside[..., None], picture, np.maximum(np.nan_to_num(matte, nan=0.0), 0))
            trust = np.clip(np.nan_to_num(layers.confidence[0].float().cpu().numpy(), nan=0.0), 0, 1)
            gloss[:, outside] = 0
            trust[:, outside] = object_mask[at[1:]][outside]  # what is not lit counts alike
            yield at, gloss, matte, trust


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
