"""The explanation that the solver of the same name finds for every sample, as layers: gloss, what is under it, and the matte twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gen.capture import Capture, grey
from recon.gloss import remove, workable
from recon.normals.explain import explained
from recon.registry import Layers


def explain(capture: Capture) -> Layers:
    """A reflectance of the whole object, matte under a coat with a lobe, fitted to all pictures; the matte twin is what it says.

    The gloss of a sample is the lobe's luma, and whatever lies above the base where the sample was explained as a highlight of its own;
    it never exceeds the smallest channel. matte: albedo * max(n.l, 0), as if nothing stood in the light: cast shadows are filled in.
    Every pixel's matte samples are consistent, so no confidence is stated. Up to three lights the pictures are handed back as they are,
    with no gloss. Assumes an orthographic view along -z.
    Raises InputError for lights in one plane.
    Source: see `recon.normals.explain.explain`.
    """
    usable = workable(capture)
    if capture.count <= 3:
        return remove(capture, np.zeros(usable.shape, np.float32))
    samples = np.maximum(capture.reflectance(), 0)
    found = explained(samples, capture.lights, capture.mask, usable.astype(np.float32), "--gloss explain")
    normals, luma = found.normals, grey(samples)
    base = found.shading * grey(normals.albedo)
    gloss = found.gloss * found.share + np.maximum(luma - base, 0) * (1 - found.share) * normals.measurable
    layers = remove(capture, gloss)
    cosines = np.maximum(np.einsum("kc,hwc->khw", capture.lights, normals.normal), 0)
    model = normals.albedo * cosines[..., None] * capture.intensities[:, None, None]
    known = normals.measurable[..., None]
    return replace(layers, matte=np.where(known, model, layers.diffuse).astype(np.float32))
