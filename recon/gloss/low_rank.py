"""Low rank over the whole stack: shading is of rank three, shadows are missing entries, highlights are sparse errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Floats, grey
from recon.completion import complete
from recon.gloss import remove, workable
from recon.gloss.geometry import SHADOW, fit, half_vectors, smoothstep
from recon.registry import Layers

SPARSITY = 1.25
"""lambda of the paper times the square root of the number of pixels; 1 is its theory's value."""

MIRROR = (0.70, 0.90)
"""n.h between which a sparse error turns into gloss: the surface mirrors the light toward the camera."""

MISFIT = (0.02, 0.06)
"""Residual of a plain Lambertian fit, over the pixel's largest sample, between which a pixel counts as not matte."""

CONVERGED = 1e-4


def low_rank(capture: Capture) -> Layers:
    """Robust rank-3 shading by low-rank matrix completion and recovery; gloss is the sparse, positive rest.

    The pictures' luma over the light intensity is a matrix of one row a light and one column a pixel, D = A + E: A of rank three, E sparse
    and not negative, shadowed and missing entries of D unknown. Minimises |A|_* + lambda |E|_1 (`complete`). Each column is divided by its
    largest sample first, so that dark pixels count like bright ones. What exceeds A counts as gloss as far as the normal of A and the
    half vector make a mirror reflection plausible. Beyond the paper, for few lights: the known directions' subspace pulls the one
    that the samples span, since with five lights three free dimensions can swallow a highlight whole.
    Up to three lights every matrix has rank three: the pictures are handed back as they are, with no gloss.

    Colour is not looked at but for its bound: gloss never exceeds the smallest channel. Confidence: 1 less the share of the luma that was
    taken away; 0 where missing. Assumes an orthographic view along -z.
    Source: L. Wu, A. Ganesh, B. Shi, Y. Matsushita, Y. Wang and Y. Ma, "Robust photometric stereo via low-rank matrix completion and
    recovery" (ACCV 2010); the solver is the inexact augmented Lagrangian of Z. Lin, M. Chen and Y. Ma (2010).
    """
    mask = capture.mask
    usable = workable(capture)[:, mask]
    gloss = np.zeros(capture.faults.shape, np.float32)
    confidence = workable(capture).astype(np.float32)
    if capture.count <= 3:
        return remove(capture, gloss, confidence)
    samples = np.maximum(capture.reflectance()[:, mask], 0)
    luma = grey(samples)
    top = np.where(usable, luma, 0).max(axis=0)
    scaled = luma / np.where(top > 0, top, 1)
    known = usable & (scaled > SHADOW)
    shading = complete(scaled, known, capture.lights, SPARSITY, both_signs=False, converged=CONVERGED)
    b = np.linalg.pinv(capture.lights).astype(np.float32) @ shading
    mirror = half_vectors(capture.lights) @ (b / np.maximum(np.sqrt(np.square(b).sum(axis=0)), 1e-9))
    excess = np.maximum(scaled - np.maximum(shading, 0), 0) * top
    found = np.where(known, excess * smoothstep(mirror, *MIRROR) * disagreement(scaled, known, capture.lights), 0)
    found = np.minimum(found, samples.min(axis=2))
    gloss[:, mask] = found
    confidence[:, mask] *= np.clip(1 - found / np.where(luma > 0, luma, 1), 0, 1)
    return remove(capture, gloss, confidence)


def disagreement(scaled: Floats, known: NDArray[np.bool_], lights: NDArray[np.float64]) -> Floats:
    """How far each pixel departs from a Lambertian one, 0 to 1: the residual of a plain fit to its known samples, through `MISFIT`.

    scaled, known: (K, P), scaled to a largest sample of 1. Returns (P,). Shrinking singular values biases A toward 0, which would call part
    of a perfectly matte pixel gloss; a pixel that fits as it is has none.
    """
    weight = known.astype(np.float32)
    L = lights.astype(np.float32)
    residual = weight * (scaled - L @ fit(scaled, weight, L))
    return smoothstep(np.sqrt(np.square(residual).sum(axis=0)), *MISFIT)
