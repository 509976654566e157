"""Photometric stereo for five lights: every sample is explained as matte, highlight or shadow, and none is dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon.normals.explain_reflectance import estimate
from recon.normals.explain_search import Found, Pixels, explanations, rig, search_coarse_to_fine, smooth
from recon.normals.least_squares import assemble, least_squares, solve
from recon.normals.rows import rows
from recon.registry import Normals

Doubles = NDArray[np.float64]

SMOOTHINGS = 1
"""Rounds in which neighbours have a say."""

COMMON = 2.0
"""How many equations of its own outweigh what all pixels together say of a pixel's noise."""

GLOSSY = 2.5
"""What the stated angle is multiplied by where the object has a lobe, whose shape is known but from the same samples: measured on
renders of the substrate, Blinn-Phong's and Cycles' Principled materials."""

SCALE_FLOOR = 0.05
"""Least scale of a pixel over its brightest sample: where only one or two lights reach it, the rest is noise."""


def explain(
    reflectance: NDArray[np.float32], lights: NDArray[np.float64], mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """A matte base under a coat with a lobe of the object's own, fitted to every pixel with highlights and shadows at a price.

    The luma of a sample is albedo * base(n.l, n.v) + lobe(n.h) + noise, seen along +z: the base Lambert's, dimmed by the substrate's coat
    or flattened by roughness; the lobe the substrate's. Width and strength of the lobe, coat and roughness are four numbers of the whole
    object, the ones with which a sample of its pixels is explained at least cost. A pixel then has its normal and albedo to find: from
    every triplet of lights, its least squares normal, the half vectors and its neighbours, by descent. A light below the horizon gives
    exactly nothing. What is brighter still may be a highlight of its own, and what is nearly black a cast shadow, each at a price that is
    bounded; nothing else may be left out. Where the samples hardly decide, the least squares normal and then the neighbours' do.

    Made for 4 to some 20 lights. With three, or where fewer than four carry weight anywhere, it is least squares. Objects of several
    gloss levels are measured with the one that explains most.

    reflectance: (K, H, W, 3) radiance over light intensity. lights: (K, 3) unit. mask: (H, W). weights: (K, H, W), not negative; a
    remover's confidence multiplies what its sample costs.
    Returns Normals; the albedo is that of the base, by channel, without lobe, highlights and shadows. Pixels whose weighted lights have
    a condition number above `recon.conditioning.MAX_CONDITION` are not measurable. Uncertainty: from the curvature of the cost, scaled by
    the residuals, and from the distance of other normals that explain nearly as well.
    Raises InputError for lights in one plane and unusable input.
    Source: worked out here; the reflectance is that of `gen.substrate` and `recon.normals.coat`.
    """
    return explained(reflectance, lights, mask, weights, "--normals explain").normals


@dataclass(frozen=True, eq=False)
class Explanation:
    """How `explain` accounts for the samples; all but the normals are zero outside the mask and where nothing is measurable.

    gloss: (K, H, W) luma of the object's lobe, in reflectance. shading: (K, H, W) of the base over its albedo. share: (K, H, W) in [0, 1],
    how far base and lobe account for the sample: the rest is a highlight of its own, or a cast shadow, and of no weight.
    """

    normals: Normals
    gloss: NDArray[np.float32]
    shading: NDArray[np.float32]
    share: NDArray[np.float32]


def explained(
    reflectance: NDArray[np.float32], lights: Doubles, mask: NDArray[np.bool_], weights: NDArray[np.float32], where: str
) -> Explanation:
    """The normals of `explain`, and how each sample came about. where: the option, for messages. Arguments and errors as there."""
    r = rows(reflectance, lights, mask, weights, where)
    gloss, shading, share_map = (np.zeros(weights.shape, np.float32) for _ in range(3))
    if ((r.w > 0).sum(axis=1) <= 3).all():
        normals = least_squares(reflectance, lights, mask, weights)
        cosines = np.maximum(np.einsum("kc,hwc->khw", lights, normals.normal), 0) * normals.measurable
        return Explanation(normals, gloss, cosines.astype(np.float32), ((weights > 0) & normals.measurable).astype(np.float32))
    fit, _, solved = solve(np.ascontiguousarray(r.y.T), lights, r.weights)
    usable = r.usable & solved
    there = np.zeros_like(mask)
    there[mask] = usable
    y = r.y[usable].astype(np.float64)
    length = np.linalg.norm(fit[usable], axis=1, keepdims=True)
    # Rows are over the brightest sample, which a highlight may have made: the third brightest is matte where no more than two are not.
    scale = np.maximum(np.sort(np.where(r.w[usable] > 0, y, 0), axis=1)[:, -3], SCALE_FLOOR)
    pixels = Pixels(
        y=y / scale[:, None], w=r.w[usable].astype(np.float64), scale=scale * r.top[usable], plain=fit[usable] / length
    )
    b = np.zeros((len(r.y), 3))
    angle = np.full(len(r.y), np.nan)
    samples, kept = r.samples, r.weights
    if len(pixels):
        material = estimate(pixels, of := rig(lights))
        optics, strength = material.optics(), material.strength
        found = search_coarse_to_fine(pixels, there, of, optics, strength)
        smooth(pixels, there, found, of, optics, strength, SMOOTHINGS)
        lobe, base, share, variance = explanations(pixels, found, of, optics, strength)
        b[usable] = found.n
        angle[usable] = _angle(found, variance, (pixels.w > 0).sum(axis=1) - 3, GLOSSY if strength > 0 else 1.0)
        samples, kept = r.samples.copy(), r.weights.copy()
        cosine = np.maximum(found.n @ lights.T, 0)
        undimmed = np.where(base > 0, cosine / np.where(base > 0, base, 1), 0)
        matte = (r.samples[:, usable] - (lobe * pixels.scale[:, None]).T[..., None]) * undimmed.T[..., None]
        samples[:, usable] = matte
        kept[:, usable] *= share.T
        gloss[:, there], shading[:, there], share_map[:, there] = (lobe * pixels.scale[:, None]).T, base.T, share.T
    return Explanation(assemble(b, samples, lights, kept, angle, usable, mask), gloss, shading, share_map)


def _angle(found: Found, variance: Doubles, freedom: NDArray[np.int64], factor: float) -> Doubles:
    """One standard deviation of the normal's angle in degrees (P,), from the variance that the curvature of the cost leaves.

    The cost takes the noise as `recon.normals.explain_pixel.NOISE`. What a pixel's own equations too many say of it, `freedom` (P,) of
    them, is joined by what all pixels say, which counts as `COMMON` equations. factor: what the deviation is multiplied by.
    """
    finite = np.isfinite(found.cost)
    common = float(np.median(found.cost[finite] / np.maximum(freedom[finite], 1))) if finite.any() else np.inf
    excess = (found.cost + COMMON * common) / (freedom + COMMON)
    with np.errstate(invalid="ignore"):
        angle: Doubles = np.degrees(np.arctan(factor * np.sqrt(variance * excess + found.variance)))
    return np.where(finite, angle, np.nan)
