"""The group network checked by its normals: those of a surface have no curl. Where they have more than the pictures', it is doubted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from gen import large
from gen.capture import LUMA, Bools, Capture, Floats
from recon.gloss import workable
from recon.registry import Layers

ACROSS = 128
"""Pixels across an object, about, at which normals are compared: of more, means are taken, and noise hardly counts."""

SMOOTHED = 1.0
"""Standard deviation, in these pixels, of the mean over neighbouring normals."""

AROUND = 6.0
"""The curl of a pixel is the mean over its surroundings, whose standard deviation is this part of the object."""

MORE = (0.01, 0.04)
"""By how much the curl has to be larger for the network to be doubted at all, and to be left out: see `curl`. All these were chosen on the
tile of metals, bear and cat of the reference data, paper-stack, group-test and some metals by Cycles; half of the surroundings and a sharp
threshold between the two do nearly as well."""

STEEPEST = 0.15
"""Least z of a normal: the slopes of steeper ones are taken as of this."""


def check(capture: Capture, layers: Layers) -> Layers:
    """The layers with the pictures in place of matte, and equal confidence, where the network is doubted (`doubt`), and with that doubt.

    Of metal that mirrors more than it scatters there is hardly a matte layer to be found, and what the network takes for one has the
    normals of no surface. Between belief and doubt both are mixed. diffuse and specular stay; matte and confidence are changed in place.
    Raises ValueError where the layers have no matte layer or no confidence.
    """
    if layers.matte is None or layers.confidence is None:
        raise ValueError("these layers have no matte layer with a confidence")
    doubted = doubt(capture, layers)
    for rows in large.strips((3 * capture.count, *capture.size)):  # of three channels each
        share = doubted[rows]
        if share.any():
            trust, matte, there = layers.confidence[:, rows], layers.matte[:, rows], workable(capture, rows)
            trust += share * (trust.max(axis=0) * there - trust)
            matte += np.where(there, share, 0)[..., None] * (np.maximum(capture.images[:, rows], 0) - matte)
        large.release(capture.images, layers.matte, layers.confidence)
    return replace(layers, doubt=doubted)


def doubt(capture: Capture, layers: Layers) -> Floats:
    """How far each pixel's matte layer is doubted, (H, W) from 0 to 1; 0 outside the mask.

    By how much larger the curl of the normals is that least squares finds on it, with its confidence, than that of the normals of the
    pictures as they are: in the mean of the surroundings, from `MORE[0]` to `MORE[1]`. Both have the lights' errors, shadows and depth
    edges alike. Ours, after R. Frankot and R. Chellappa, "A method for enforcing integrability in shape from shading algorithms" (PAMI
    10(4), 1988).
    """
    factor = max(round(float(capture.mask.sum()) ** 0.5 / ACROSS), 1)
    both, inside = _fields(capture, layers, factor)
    around = float(inside.sum()) ** 0.5 / AROUND
    raw, found = (_mean(*curl(normals, inside), around) for normals in both)
    share = np.clip((found - raw - MORE[0]) / (MORE[1] - MORE[0]), 0, 1)
    H, W = capture.mask.shape
    return np.asarray(share.repeat(factor, 0).repeat(factor, 1)[:H, :W] * capture.mask, np.float32)


def curl(normals: Floats, inside: Bools) -> tuple[Floats, Bools]:
    """How far normals are from those of a surface, between every four neighbours, and where all four are inside; both (H - 1, W - 1).

    normals: (H, W, 3), x right, y up, z to the camera, any length. inside: (H, W). The curl of the slopes p = -x/z, q = -y/z,
    |dp/dy - dq/dx|, times z: a slope a pixel, by area of the surface, not of the picture; at most 1. It is 0 for every orthographic view
    of a surface, to the square of the pixel. As n . (curl n) = z^2 (dp/dy - dq/dx), without a quotient where z is small.
    """
    n = normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-6)
    a, b, c, d = n[:-1, :-1], n[:-1, 1:], n[1:, :-1], n[1:, 1:]
    middle, dx, dy = (a + b + c + d) / 4, (b + d - a - c) / 2, (a + b - c - d) / 2
    x, y, z = np.moveaxis(middle, 2, 0)
    across = x * dy[..., 2] - y * dx[..., 2] + z * (dx[..., 1] - dy[..., 0])
    whole = inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, :-1] & inside[1:, 1:]
    return np.asarray(np.minimum(np.abs(across) / np.maximum(z, STEEPEST), 1) * whole, np.float32), whole


def _fields(capture: Capture, layers: Layers, factor: int) -> tuple[list[Floats], Bools]:
    """The normals (h, w, 3) of the pictures and of the matte layer, of any length, and which lie on the object (h, w).

    They are means over factor x factor pixels of the object, and over their neighbours.
    """
    covered = _pooled(capture.mask.astype(np.float32), factor)
    means = [np.zeros((*covered.shape, 3), np.float32) for _ in range(2)]
    for rows in _strips(capture.images.shape, factor):
        below = slice(rows.start // factor, -(-rows.stop // factor))
        for mean, normals in zip(means, _normals(capture, layers, rows), strict=True):
            mean[below] = _pooled(normals * capture.mask[rows][..., None], factor)
    return [gaussian_filter(mean, (SMOOTHED, SMOOTHED, 0)) for mean in means], covered >= 0.5


def _normals(capture: Capture, layers: Layers, rows: slice) -> Iterator[Floats]:
    """Unit normals (h, W, 3) in some rows by least squares: of the pictures, and of the matte layer with its confidence."""
    import torch

    from learn.solve import unit, weighted_least_squares

    assert layers.matte is not None
    assert layers.confidence is not None
    lights = torch.from_numpy(capture.lights.astype(np.float32))[None]
    there = workable(capture, rows).astype(np.float32)
    for images, weights in ((capture.images, there), (layers.matte, layers.confidence[:, rows])):
        y = np.nan_to_num(np.maximum(capture.reflectance(images[:, rows]), 0) @ LUMA.astype(np.float32), posinf=0.0)
        with torch.inference_mode():
            found = unit(weighted_least_squares(torch.from_numpy(y)[None], lights, torch.from_numpy(weights)[None]))
        large.release(images, layers.confidence)
        yield np.moveaxis(found[0].numpy(), 0, 2)


def _strips(shape: tuple[int, ...], factor: int) -> Iterator[slice]:
    """`large.strips`, but for their height, a multiple of the factor."""
    first = next(large.strips(shape))
    step = max((first.stop - first.start) // factor, 1) * factor
    for start in range(0, shape[1], step):
        yield slice(start, min(start + step, shape[1]))


def _pooled(maps: Floats, factor: int) -> Floats:
    """Means over factor x factor pixels of maps (H, W) or (H, W, C), zeros beyond the edges."""
    H, W = maps.shape[:2]
    padded = np.pad(maps, [(0, -H % factor), (0, -W % factor), *[(0, 0)] * (maps.ndim - 2)])
    cells = padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor, *maps.shape[2:])
    return np.asarray(cells.mean((1, 3)), np.float32)


def _mean(values: Floats, whole: Bools, around: float) -> Floats:
    """The mean of (H - 1, W - 1) over the surroundings of each of (H, W) pixels."""
    wide = [np.pad(part.astype(np.float32), ((0, 1), (0, 1))) for part in (values, whole)]
    total, weight = (gaussian_filter(part, around) for part in wide)
    return np.asarray(total / np.maximum(weight, 1e-4), np.float32)
