"""Colour over the whole stack: the robust diffuse chromaticity of each pixel; where the surface is grey, the lights' geometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gen import large
from gen.capture import Capture, Fault, Floats
from recon.gloss import remove
from recon.gloss.geometry import gloss_from_geometry, smoothstep
from recon.registry import Layers

SATURATION = (0.2, 0.5)
"""Chromatic over achromatic part of the diffuse colour: below the first it says nothing, above the second it can be believed alone."""

AGREEMENT = (4.0, 12.0)
"""Chromatic signal over its scatter off the pixel's own hue: the other condition of the same hand-over."""

NOISE = 2.0
"""Standard deviations of the noise that are given to every decision."""

LIT = 0.2
"""Samples whose chromatic part is under this share of the pixel's largest say nothing reliable on its saturation."""


def chromaticity(capture: Capture) -> Layers:
    """Per-pixel robust diffuse chromaticity over all lights; on grey surfaces the lights' geometry instead.

    With the light's colour divided out, a sample is a * c + b * (1, 1, 1): c the pixel's diffuse chromaticity, b the gloss. The part of it
    perpendicular to white is free of gloss, so its direction (the hue) is the same under every light and its length is the diffuse
    shading; the saturation of c is that of the pixel's most saturated well-lit sample, noise allowed for, which has the
    least gloss. Each sample is then split by non-negative least squares in (a, b), in closed form. Gloss below twice
    the noise, which the scatter of the colours off the hue shows, is left alone.
    Where the diffuse colour is too close to the light's, or the colours scatter, that says nothing: `gloss_from_geometry` takes over,
    smoothly, pixel by pixel. It assumes an orthographic view along -z and needs four lights.

    If every sample of a pixel has gloss, the least glossy one's stays in the diffuse layer as a constant factor, which normals do not feel.
    Confidence: 1 less the share of the sample that was taken away, where geometry decided; 1 where colour did; 0 where missing.
    Source: G. Klinker, S. Shafer and T. Kanade, "The measurement of highlights in color images" (1988); Y. Sato and K. Ikeuchi,
    "Temporal-color space analysis of reflection" (1994); S. Mallick et al., "Beyond Lambert: reconstructing specular
    surfaces using color" (CVPR 2005).
    """
    gloss, confidence = (large.zeros(capture.faults.shape, np.float32) for _ in range(2))
    parts = [rows for rows in large.strips(capture.images.shape) if capture.mask[rows].any()]
    common = (
        float(np.median(np.concatenate([_by_hue(*_samples(capture, rows)).scatter for rows in parts])))
        if len(parts) > 1
        else None
    )
    for rows in parts:
        mask = capture.mask[rows]
        samples, usable, clipped = _samples(capture, rows)
        by_colour, trust = split_by_colour(samples, usable, clipped, common)
        found = by_colour * trust
        grey = np.flatnonzero(trust < 1)
        by_geometry = gloss_from_geometry(samples[:, grey].mean(axis=2), usable[:, grey], capture.lights)
        found[:, grey] += (1 - trust[grey]) * by_geometry

        brightness = samples.mean(axis=2)
        taken = np.minimum(found, samples.min(axis=2)) / np.where(brightness > 0, brightness, 1)
        gloss[:, rows][:, mask] = found
        confidence[:, rows][:, mask] = np.where(usable, 1 - (1 - trust) * np.clip(taken, 0, 1), 0)
        large.release(capture.images, gloss, confidence)
    return remove(capture, gloss, confidence)


def _samples(capture: Capture, rows: slice) -> tuple[Floats, NDArray[np.bool_], NDArray[np.bool_]]:
    """Of the object's pixels in some rows: reflectance (K, P, 3), not negative; which samples are there, and which are clipped, (K, P)."""
    mask, faults = capture.mask[rows], capture.faults[:, rows]
    samples = np.maximum(capture.reflectance(capture.images[:, rows])[:, mask], 0)
    return samples, ((faults & Fault.MISSING) == 0)[:, mask], (faults & Fault.CLIPPED)[:, mask] != 0


@dataclass(frozen=True, eq=False)
class _Hue:
    """white, a: (K, P) mean of the channels, and the part along the pixel's hue (P, 3). good: (K, P). scatter: (P,) of what lies off it."""

    white: Floats
    a: Floats
    hue: Floats
    good: Floats
    scatter: Floats


def _by_hue(samples: Floats, usable: NDArray[np.bool_], clipped: NDArray[np.bool_]) -> _Hue:
    white = samples.mean(axis=2)
    chromatic = samples - white[..., None]
    good = (usable & ~clipped).astype(np.float32)
    total = np.einsum("kp,kpc->pc", good, chromatic)
    hue = total / np.maximum(np.sqrt(np.square(total).sum(axis=1)), 1e-12)[:, None]
    a = np.maximum(np.einsum("kpc,pc->kp", chromatic, hue), 0)
    off = chromatic - a[..., None] * hue
    scatter = np.sqrt((np.square(off).sum(axis=2) * good).sum(axis=0) / np.maximum(good.sum(axis=0) - 1, 1))
    return _Hue(white, a, hue, good, scatter)


def split_by_colour(
    samples: Floats, usable: NDArray[np.bool_], clipped: NDArray[np.bool_], common: float | None = None
) -> tuple[Floats, Floats]:
    """Gloss of each sample from its colour, and how far each pixel's colour can be believed.

    samples: (K, P, 3) reflectance, not negative. usable, clipped: (K, P); clipped samples have a false colour and do not shape the
    chromaticity. common: the median scatter of all pixels, where these are only some. Returns gloss (K, P) >= 0 and trust (P,) in [0, 1].
    """
    found = _by_hue(samples, usable, clipped)
    white, a, hue, good, scatter = found.white, found.a, found.hue, found.good, found.scatter
    # A handful of samples may agree by luck: no pixel is believed to be less noisy than the common one.
    noise = np.maximum(scatter, np.median(scatter) if common is None else np.float32(common))
    # Saturation of the diffuse colour, as white = ratio * chromatic: the least ratio is that of the most saturated sample. Each sample
    # gets the benefit of its noise, since the least of several noisy ratios would be too small.
    reliable = (good > 0) & (a > LIT * (a * good).max(axis=0)) & (a > 0)
    ratio = np.where(reliable, white / np.where(a > 0, a, 1), np.inf)
    error = NOISE * noise * np.sqrt(1 / 3 + np.square(np.where(reliable, ratio, 0)))
    ratio = np.where(reliable, ratio + error / np.where(a > 0, a, 1), np.inf).min(axis=0)
    known = np.isfinite(ratio)
    ratio = np.maximum(np.where(known, ratio, 1), -hue.min(axis=1))  # a diffuse colour has no negative channel
    gloss = np.maximum(white - ratio * a - NOISE * noise * np.sqrt(1 / 3 + ratio**2), 0)
    signal = np.sqrt((np.square(a) * good).sum(axis=0) / np.maximum(good.sum(axis=0), 1))
    saturation = 1 / np.maximum(ratio, 1e-6)
    trust = smoothstep(saturation, *SATURATION) * smoothstep(signal / np.maximum(noise, 1e-9), *AGREEMENT) * known
    return gloss.astype(np.float32), trust.astype(np.float32)
