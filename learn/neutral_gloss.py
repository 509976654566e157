"""What colour says of the group network's layers: gloss of a coat has the light's own colour, and the matte twin that of the surface."""

from __future__ import annotations

import numpy as np

from gen import large
from gen.capture import LUMA, Capture
from recon.gloss.chromaticity import chromaticity
from recon.registry import Layers


def colour(capture: Capture, layers: Layers) -> None:
    """Give the layers of pictures under known lights the colours of the dichromatic model, in place. Luma of matte, and confidence, stay.

    The network says how bright matte and gloss are, and `chromaticity` what colour the surface has. The matte layer takes the colour that
    the chromaticity's diffuse layers have together at the pixel. The gloss takes the light's colour, and is the mean of what both say of
    it, as far as both say that there is gloss: metal, whose gloss has the metal's colour, has none for `chromaticity`, and keeps the
    network's. diffuse + specular stays the input. Raises ValueError where the layers have no matte layer.
    Source: S. Shafer, "Using color to separate reflection components", Color Research and Application 10(4), 1985; the mixture is ours.
    """
    if layers.matte is None:
        raise ValueError("these layers have no matte layer")
    by_colour = chromaticity(capture)
    luma = LUMA.astype(np.float32)
    intensity = capture.intensities.astype(np.float32)[:, None, None, :]
    for rows in large.strips((3 * capture.count, *capture.size)):  # of three channels each
        images, specular, matte = (maps[:, rows] / intensity for maps in (capture.images, layers.specular, layers.matte))
        colour_gloss = by_colour.specular[:, rows] / intensity
        both = [(gloss @ luma).sum(axis=0) for gloss in (colour_gloss, specular)]
        agreed = np.clip(both[0] / np.maximum(both[1], 1e-6), 0, 1)[..., None]
        neutral = np.minimum(specular @ luma, np.maximum(images.min(axis=3), 0))[..., None]
        gloss = agreed * (neutral + colour_gloss) / 2 + (1 - agreed) * specular
        surface = np.maximum(by_colour.diffuse[:, rows] / intensity, 0).sum(axis=0)
        bright = (surface @ luma)[..., None]
        tint = np.where(bright > 0, surface / np.where(bright > 0, bright, 1), 1)
        inside = capture.mask[rows][..., None]
        layers.matte[:, rows] = np.where(inside, (matte @ luma)[..., None] * tint, matte) * intensity
        layers.specular[:, rows] = np.clip(gloss * intensity, 0, np.maximum(capture.images[:, rows], 0))
        np.subtract(capture.images[:, rows], layers.specular[:, rows], out=layers.diffuse[:, rows])
        large.release(capture.images, *vars(layers).values(), by_colour.diffuse, by_colour.specular)
