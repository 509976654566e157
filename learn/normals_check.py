"""The group network checked by the normals it leads to: where they are those of no surface, or hardly new, the pictures stay."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from gen import large
from gen.capture import LUMA, Bools, Capture, Floats
from recon.gloss import workable
from recon.metrics import angular_error
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

WORTH = ((0.0, 3.0, 5.0), (AROUND, 6.0, 9.0), (24.0, 10.0, 15.0))
"""By how many degrees the network has to turn the normals to be used at all, and wholly, in the mean over the object (0) and over
surroundings of this part of it; one of the three is enough. Its own errors on photographs are of the first size. Chosen on the same
captures and the grey ball of the reference data: glossy things are turned by more than 5 in the mean, small glossy spots by over 15."""

STEEPEST = 0.15
"""Least z of a normal: the slopes of steeper ones are taken as of this."""


def check(capture: Capture, layers: Layers, lit: Bools) -> Layers:
    """The layers with the pictures in place of matte where the network is doubted (`doubt`) or hardly changes the normals (`needless`).

    Of metal that mirrors more than it scatters there is hardly a matte layer to be found, and what the network takes for one has the
    normals of no surface: there all samples count alike again. What is nearly matte is measured best as it is; the confidence stays there,
    for it knows the shadows. In between both are mixed. lit: (H, W), the pixels of the mask that are looked at: what is black in all
    pictures would count as what hardly changes. matte and confidence are changed in place, `doubt` and `kept` of the layers are set,
    diffuse and specular stay. Raises ValueError where the layers have no matte layer or no confidence.
    """
    if layers.matte is None or layers.confidence is None:
        raise ValueError("these layers have no matte layer with a confidence")
    fields = CoarseNormals.of(capture, layers, lit)
    doubted = doubt(fields)
    kept = np.maximum(doubted, needless(fields, doubted))
    doubted, kept = fields.full(doubted), fields.full(kept)
    for rows in large.strips((3 * capture.count, *capture.size)):  # of three channels each
        if kept[rows].any():
            trust, matte, there = layers.confidence[:, rows], layers.matte[:, rows], workable(capture, rows)
            trust += doubted[rows] * (trust.max(axis=0) * there - trust)
            matte += np.where(there, kept[rows], 0)[..., None] * (np.maximum(capture.images[:, rows], 0) - matte)
        large.release(capture.images, layers.matte, layers.confidence)
    return replace(layers, doubt=doubted, kept=kept)


@dataclass(frozen=True, eq=False)
class CoarseNormals:
    """Normals before and after, coarse. raw, found: (h, w, 3) unit, or 0 where none is, of the pictures as they are and of the matte layer
    with its confidence, by least squares. inside: (h, w), what is of the object. lit: (H, W), the same. factor: pixels a side that are one.
    """

    raw: Floats
    found: Floats
    inside: Bools
    lit: Bools
    factor: int

    @classmethod
    def of(cls, capture: Capture, layers: Layers, lit: Bools) -> CoarseNormals:
        """Means over factor x factor pixels of the object, and over their neighbours, at about `ACROSS` pixels an object."""
        factor = max(round(float(lit.sum()) ** 0.5 / ACROSS), 1)
        covered = _pooled(lit.astype(np.float32), factor)
        means = [np.zeros((*covered.shape, 3), np.float32) for _ in range(2)]
        for rows in _strips(capture.images.shape, factor):
            below = slice(rows.start // factor, -(-rows.stop // factor))
            for mean, normals in zip(means, _normals(capture, layers, rows), strict=True):
                mean[below] = _pooled(normals * lit[rows][..., None], factor)
        smooth = (gaussian_filter(mean, (SMOOTHED, SMOOTHED, 0)) for mean in means)
        raw, found = (mean / np.maximum(np.linalg.norm(mean, axis=2, keepdims=True), 1e-6) for mean in smooth)
        return cls(raw, found, covered >= min(0.5, float(covered.max())), lit, factor)

    def around(self, part: float) -> float:
        """The standard deviation, in pixels, of surroundings that are a part of the object."""
        return float(self.inside.sum()) ** 0.5 / part

    def full(self, share: Floats) -> Floats:
        """A map (h, w) as (H, W); 0 outside the object."""
        H, W = self.lit.shape
        return np.asarray(share.repeat(self.factor, 0).repeat(self.factor, 1)[:H, :W] * self.lit, np.float32)


def doubt(fields: CoarseNormals) -> Floats:
    """How far each coarse pixel's matte layer is doubted, (h, w) from 0 to 1.

    By how much larger the curl of the normals is that least squares finds on it, with its confidence, than that of the normals of the
    pictures as they are: in the mean of the surroundings, from `MORE[0]` to `MORE[1]`. Both have the lights' errors, shadows and depth
    edges alike. Ours, after R. Frankot and R. Chellappa, "A method for enforcing integrability in shape from shading algorithms" (PAMI
    10(4), 1988).
    """
    raw, found = (_curl_around(normals, fields) for normals in (fields.raw, fields.found))
    return _between(found - raw, *MORE)


def needless(fields: CoarseNormals, doubted: Floats) -> Floats:
    """How far each coarse pixel's matte layer is left out as not worth it, (h, w) from 0 to 1: its normals are nearly the pictures'.

    doubted: (h, w), see `doubt`; what is doubted turns no normal. The angle between both, in the mean over the object, over the
    surroundings and over the nearest pixels, against `WORTH`. Ours.
    """
    angle = np.nan_to_num(angular_error(fields.found, fields.raw)) * fields.inside * (1 - doubted)
    used = np.zeros(angle.shape, np.float32)
    for part, least, wholly in WORTH:
        mean = _mean(angle, fields.inside, fields.around(part)) if part else angle.sum() / max(int(fields.inside.sum()), 1)
        used = np.maximum(used, _between(mean, least, wholly))
    return 1 - used


def _between(values: Floats | float, low: float, high: float) -> Floats:
    """0 up to low, 1 from high on."""
    return np.asarray(np.clip((values - low) / (high - low), 0, 1), np.float32)


def _curl_around(normals: Floats, fields: CoarseNormals) -> Floats:
    """The curl (h, w) of coarse normals, in the mean of the surroundings."""
    values, whole = curl(normals, fields.inside)
    return _mean(np.pad(values, ((0, 1), (0, 1))), np.pad(whole, ((0, 1), (0, 1))), fields.around(AROUND))


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
    """The mean (h, w) of values where they are whole, over surroundings of that standard deviation."""
    total, weight = (gaussian_filter(part.astype(np.float32), around) for part in (values, whole))
    return np.asarray(total / np.maximum(weight, 1e-4), np.float32)
