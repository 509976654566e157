"""What colour says of the group network's layers: gloss of a coat has the light's own colour, and the matte twin that of the surface."""

from __future__ import annotations

import numpy as np

from gen import large
from gen.capture import LUMA, Bools, Capture, Floats
from learn.models.evidence import GREY, LIT
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
        gloss = agreed * (_neutral(images, specular) + colour_gloss) / 2 + (1 - agreed) * specular
        surface = np.maximum(by_colour.diffuse[:, rows] / intensity, 0).sum(axis=0)
        bright = (surface @ luma)[..., None]
        tint = np.where(bright > 0, surface / np.where(bright > 0, bright, 1), 1)
        inside = capture.mask[rows][..., None]
        layers.matte[:, rows] = np.where(inside, (matte @ luma)[..., None] * tint, matte) * intensity
        layers.specular[:, rows] = np.clip(gloss * intensity, 0, np.maximum(capture.images[:, rows], 0))
        np.subtract(capture.images[:, rows], layers.specular[:, rows], out=layers.diffuse[:, rows])
        large.release(capture.images, *vars(layers).values(), by_colour.diffuse, by_colour.specular)


def colour_alone(images: Floats, intensities: Floats, inside: Bools, layers: Layers) -> None:
    """Give the gloss of one or two pictures, where there is nothing else to hold it to, the colour of the light, in place.

    images: (K, H, W, 3) radiance. intensities: (K, 3). inside: (H, W), the object. The gloss is as bright as the network says, but no
    brighter than the darkest channel; of what has no such part, a saturated surface, nothing is taken. From one picture of a grey object
    (by the saturations `learn.models.evidence.GREY`) nothing is taken either: neither colour nor another light says what of it is gloss.
    diffuse + specular stays the input. Source: as for `colour`; the limits are ours.
    """
    for k, intensity in enumerate(intensities.astype(np.float32)):
        picture = np.maximum(images[k], 0) / intensity
        told = np.float32(1 if len(images) > 1 else _told_by_colour(picture[inside]))
        gloss = told * _neutral(picture, layers.specular[k] / intensity) * intensity
        layers.specular[k] = np.clip(gloss, 0, np.maximum(images[k], 0))
        np.subtract(images[k], layers.specular[k], out=layers.diffuse[k])
        large.release(images, layers.diffuse, layers.specular)


def _told_by_colour(object_: Floats) -> float:
    """How far an object (N, 3) of one picture is coloured, from 0 to 1, by the upper quartile of the saturation of what is not dark."""
    top = object_.max(axis=1, initial=0)
    shown = np.isfinite(top) & (top > 0)
    if not shown.any():
        return 0.0
    lit = shown & (top > LIT * np.median(top[shown]))
    saturation = np.percentile(1 - object_[lit].min(axis=1) / top[lit], 75)
    return float(np.clip((saturation - GREY[0]) / (GREY[1] - GREY[0]), 0, 1))


def _neutral(images: Floats, specular: Floats) -> Floats:
    """Gloss (..., 1) of the light's colour, as bright as given, but no brighter than the darkest channel; all (..., 3) reflectance."""
    return np.minimum(specular @ LUMA.astype(np.float32), np.maximum(images.min(axis=-1), 0))[..., None]
