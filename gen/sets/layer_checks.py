"""What has to hold in the pixels of a rendered capture: the identities that its layers promise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Bools, Capture, Fault, Floats, Truth
from gen.capture_lights import true_lights
from gen.exr import read_exr, stack
from gen.srgb import linear_to_srgb

UNIT = 1e-3
"""How far from 1 the length of a normal may be: half precision's rounding of three components, twice."""

FLAT_COS = np.cos(np.radians(10.0))
"""Matte is tested where a pixel and its eight neighbours have normals within 10 degrees: elsewhere it may be a mean over an edge."""

MATTE = 0.02
"""How far matte may be from albedo * intensity * max(n.l, 0) there, relative to albedo * intensity."""

OUTLIERS = 0.005
"""The share of tested pixels that may be off: features thinner than a pixel."""


def overexposed(images: Floats) -> list[int]:
    """Pixels of each picture (K, H, W, 3) whose R, G and B are all 255 in 8-bit sRGB."""
    eight_bit = np.round(255 * linear_to_srgb(np.clip(images.astype(np.float64), 0, 1)))
    return [int(n) for n in (eight_bit == 255).all(axis=3).sum(axis=(1, 2))]


def faults_of(capture: Capture, frames: list[Path]) -> Iterator[str]:
    """The faults of a capture, one line each, named by layer and picture. frames: its EXR files, for what is stored in R, G, B."""
    yield from _range(capture)
    for k, path in enumerate(frames):
        yield from _picture(capture, k, path)
    yield from _view(capture)
    yield from _matte(capture)


def _range(capture: Capture) -> Iterator[str]:
    if (capture.faults & Fault.MISSING).any():
        yield f"pictures: {int(((capture.faults & Fault.MISSING) > 0).sum())} samples are not finite"
    layers = {"pictures": capture.images, **{name: getattr(capture.truth, name) for name in Truth.PER_LIGHT}}
    if _has_a_sensor(capture):
        del layers["pictures"]  # noise reaches below zero
    for name in ("albedo", "gloss", "specular_albedo"):
        layers[name] = getattr(capture.truth, name)
    for name, layer in layers.items():
        if layer is None:
            continue
        bad = int((~np.isfinite(layer)).sum())
        if bad:
            yield f"{name}: {bad} values are not finite"
        least = float(np.nanmin(layer))
        if least < 0:
            yield f"{name}: is negative, down to {least:g}"


def _picture(capture: Capture, k: int, path: Path) -> Iterator[str]:
    """picture = diffuse + specular, as read and as stored; where the picture was cut at 1 as a sensor does, the sum is at least that.

    What a sensor was asked to do to the pictures ends that.
    """
    truth = capture.truth
    if truth.diffuse is None or truth.specular is None or _has_a_sensor(capture):
        return
    total = truth.diffuse[k].astype(np.float64) + truth.specular[k]
    cut = ((capture.faults[k] & Fault.CLIPPED) > 0)[..., None]
    expected = np.where(cut, np.minimum(total, 1), total)
    stored = stack(read_exr(path), "", "RGB")
    for found, how in ((capture.images[k], "as read"), (stored, "as stored")):
        if found is None:
            yield f"{path.name}: has no R, G, B"
            continue
        parts = np.abs(truth.diffuse[k]) + np.abs(truth.specular[k])
        off = np.abs(found - expected) - _rounding(found, parts)
        wrong = int((off > 0).any(axis=2).sum())
        if wrong:
            y, x = np.unravel_index(int(off.max(axis=2).argmax()), off.shape[:2])
            apart = float(np.abs(found - expected)[y, x].max())
            yield f"{path.name}: the picture {how} differs from diffuse + specular in {wrong} pixels, by {apart:.3g} at column {x}, row {y}"


def _rounding(found: NDArray[Any], parts: NDArray[Any]) -> NDArray[np.float64]:
    """What rounding allows: of one float32 sum, or, where all values are halves, of the three halves."""
    with np.errstate(over="ignore"):
        half = bool((found.astype(np.float16).astype(np.float32) == found).all())
    step, least = (2.0**-11, 2.0**-25) if half else (2.0**-23, 2.0**-149)
    return 2 * step * parts.astype(np.float64) + 3 * least


def _view(capture: Capture) -> Iterator[str]:
    truth, mask = capture.truth, capture.mask
    if truth.normals is not None:
        length = np.linalg.norm(np.nan_to_num(truth.normals.astype(np.float64), nan=9.0), axis=2)
        wrong = int((np.abs(length - 1) > UNIT)[mask].sum())
        if wrong:
            yield f"normals: {wrong} are not unit vectors inside the mask"
        outside = int((length > 0)[~mask].sum())
        if outside:
            yield f"normals: {outside} are not zero outside the mask"
    if truth.depth is not None:
        holes = int((~np.isfinite(truth.depth))[mask].sum())
        if holes:
            yield f"depth: {holes} values inside the mask are not finite"
        elif float(truth.depth[mask].min()) <= 0:
            yield "depth: reaches zero or less inside the mask"


def _matte(capture: Capture) -> Iterator[str]:
    """matte = albedo * intensity * max(n.l, 0) where the light reaches; see `FLAT_COS`, `MATTE`, `OUTLIERS`.

    A pixel may be darker where it or a neighbour is in shadow (by the layer of shadows, or, without one, black): there a shadow ends within
    it. Fine detail under supersampling makes a pixel darker than its mean normal says.
    """
    truth = capture.truth
    if truth.matte is None or truth.albedo is None or truth.normals is None:
        return
    flat, distant = _flat(truth.normals, capture.mask), _distant(capture)
    for k, (light, intensity) in enumerate(zip(*true_lights(capture), strict=True)):
        if not distant[k]:
            continue
        white = (truth.albedo * intensity).astype(np.float64)
        bright = white.max(axis=2)
        facing = np.maximum(truth.normals @ light, 0)
        tested = flat & (bright > 0) & (facing > MATTE)
        share = (truth.matte[k] - white * facing[..., None]) / np.where(bright > 0, bright, 1)[..., None]
        black = truth.matte[k].max(axis=2) <= MATTE * bright * facing
        lit = ~_spread(black if truth.shadow is None else truth.shadow[k] > 0)
        above = tested & (share > MATTE).any(axis=2)
        below = np.logical_and(tested & lit, not _fine(capture)) & (share < -MATTE).any(axis=2)
        for wrong, word in ((above, "brighter"), (below, "darker")):
            if wrong.sum() > OUTLIERS * tested.sum():
                y, x = np.argwhere(wrong)[0]
                yield (
                    f"matte: picture {k + 1} is {word} than albedo * intensity * max(n.l, 0) in {int(wrong.sum())} of "
                    f"{int(tested.sum())} pixels tested, such as column {x}, row {y}"
                )


def _has_a_sensor(capture: Capture) -> bool:
    """Whether faults were asked for that change the pictures, not only what is said of their lights."""
    faults = capture.provenance.get("faults")
    return isinstance(faults, dict) and not faults.keys() <= {"light_direction_degrees", "light_intensity"}


def _distant(capture: Capture) -> list[bool]:
    """Of each picture, whether its light comes straight from one distant light: so unless the capture's own spec says something else."""
    spec = capture.provenance.get("spec")
    if not isinstance(spec, dict):
        return [True] * capture.count
    lights = spec.get("lights")
    given = lights if isinstance(lights, list) and len(lights) == capture.count else [lights] * capture.count
    return [not spec.get("bounces") and (not isinstance(light, dict) or _is_sun(light)) for light in given]


def _is_sun(light: Mapping[str, Any]) -> bool:
    return light.get("kind", "sun") == "sun" and light.get("distance_mm") is None and light.get("position_mm") is None


def _fine(capture: Capture) -> bool:
    """Whether the surface may turn within a pixel of a flat neighbourhood: surface detail, averaged over sub-samples."""
    spec = capture.provenance.get("spec")
    shape = spec.get("shape") if isinstance(spec, dict) else None
    return isinstance(spec, dict) and isinstance(shape, dict) and bool(shape.get("detail")) and spec.get("supersampling") != 1


def _flat(normals: Floats, mask: Bools) -> Bools:
    """(H, W): the pixel and its eight neighbours are on the object and within 10 degrees of its normal."""
    padded, inside = np.pad(normals, ((1, 1), (1, 1), (0, 0))), np.pad(mask, 1)
    H, W = mask.shape
    flat = mask.copy()
    for dy in range(3):
        for dx in range(3):
            near = padded[dy : dy + H, dx : dx + W]
            flat &= inside[dy : dy + H, dx : dx + W] & ((near * normals).sum(axis=2) >= FLAT_COS)
    return flat


def _spread(flags: Bools) -> Bools:
    """(H, W): true where it or one of the eight neighbours is."""
    padded, (H, W) = np.pad(flags, 1), flags.shape
    return np.logical_or.reduce([padded[dy : dy + H, dx : dx + W] for dy in range(3) for dx in range(3)])
