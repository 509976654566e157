"""Faults of a set-up and its sensor, put into a clean capture: what is said of the lights, and what happens to the pictures.

In the order of nature: ambient light, shot noise, read noise, black level, the sensor's top, whole numbers.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Fault, Floats
from gen.capture_lights import TRUE_INTENSITIES, TRUE_LIGHTS, TRUE_POSITIONS, WITHOUT_DIRECTION
from gen.errors import InputError
from gen.spec_faults import Faults
from gen.srgb import linear_to_srgb, table

Array = NDArray[np.float64]

MANY = 1e6
"""Electrons from which on shot noise is drawn as Gaussian: its skew is under 0.001 there."""

LOST = 3.0
"""A sample is dark where no channel stands out of the black level by more than so many standard deviations of the read noise."""

STREAM = 0xFA17
"""Sets the draws of faults apart from all else that is drawn by a spec's seed."""


def rng_of(seed: int) -> np.random.Generator:
    """The generator that draws the faults of the spec of that seed."""
    return np.random.default_rng([seed, STREAM])


def with_faults(capture: Capture, faults: Faults, rng: np.random.Generator, clip: bool = False) -> Capture:
    """The capture as a faulty set-up would have taken it; the same object where nothing is asked for.

    capture: clean, exposed, full scale at 1, with its albedo where `faults.ambient` asks for it. rng: see `rng_of`; every fault draws from
    a stream of its own, so that one does not change another. clip: cut the pictures at full scale, as whole numbers always are.

    The stated directions (and places of near lights) and intensities get the errors, the true ones go into the provenance
    (`gen.capture_lights.true_lights`), and so do the faults and the black level, which the pictures contain. Ambient light is that of
    the matte twin without anything in its way: albedo * ambient * mean intensity, inside the mask. Truth stays as it is. Flags are what
    a sensor knows: CLIPPED where a channel is at the top, DARK where none stands out of the black level and its noise (see `LOST`).
    Raises InputError where ambient light is asked for and the albedo is not known.
    """
    if faults == Faults() and not clip:
        return capture
    directions, intensities, shot, read = rng.spawn(4)
    changed = _with_ambient(capture, faults.ambient) if faults.ambient else capture
    images = changed.images
    if faults.noise.photons is not None:
        images = np.stack([shot_noise(picture, faults.noise.photons, shot) for picture in images])
    if faults.noise.read:
        images = images + np.float32(faults.noise.read) * read.standard_normal(images.shape, dtype=np.float32)
    if faults.black_level:
        images = images + np.float32(faults.black_level)
    top = math.inf
    if clip or faults.bits is not None:
        top = 1.0
        images = np.minimum(images, np.float32(1))
    if faults.bits is not None:
        images = np.stack([quantised(picture, faults.bits, faults.encoding or "linear") for picture in images])
    record: dict[str, Any] = {}
    if faults != Faults():
        record["faults"] = faults.model_dump(mode="json", exclude_defaults=True)
    if faults.black_level:
        record["black_level"] = faults.black_level
    changed = replace(
        changed,
        images=images,
        faults=_flags(capture, images, faults, top),
        encoding=faults.encoding or capture.encoding,
        provenance={**capture.provenance, **record},
    )
    if faults.light_direction_degrees:
        changed = _misdirected(changed, faults.light_direction_degrees, directions)
    return _misjudged(changed, faults.light_intensity, intensities) if faults.light_intensity else changed


def shot_noise(images: Floats, photons: float, rng: np.random.Generator) -> Floats:
    """Pictures counted in electrons: each sample is Poisson's of mean images * photons, over photons; its variance is images / photons.

    images: any shape; what is negative counts as 0. photons: electrons of a full well, where the picture is 1.
    """
    mean = np.maximum(images.astype(np.float64), 0) * photons
    counts = mean + np.sqrt(mean) * rng.standard_normal(mean.shape)
    few = mean < MANY
    counts[few] = rng.poisson(mean[few])
    noisy: Floats = (counts / photons).astype(np.float32)
    return noisy


def quantised(images: Floats, bits: int, encoding: str) -> Floats:
    """What a file of whole numbers of that many bits holds of linear pictures, as linear values again. encoding: "linear" or "srgb"."""
    within = np.clip(images.astype(np.float64), 0, 1)
    encoded = linear_to_srgb(within) if encoding == "srgb" else within
    return table(bits, encoding)[np.round(encoded * ((1 << bits) - 1)).astype(np.int64)]


def turned(directions: Array, rms_degrees: float, rng: np.random.Generator) -> Array:
    """Unit vectors (K, 3), each turned toward a random side by a random angle of that root mean square (Rayleigh's distribution)."""
    angle = np.radians(rms_degrees) * rng.rayleigh(math.sqrt(0.5), len(directions))
    around = rng.uniform(0, 2 * np.pi, len(directions))
    # Two axes across each direction, from the coordinate axis that it has least of.
    least = np.eye(3)[np.abs(directions).argmin(axis=1)]
    across = np.cross(directions, least)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    side = np.cos(around)[:, None] * across + np.sin(around)[:, None] * np.cross(directions, across)
    result: Array = np.cos(angle)[:, None] * directions + np.sin(angle)[:, None] * side
    return result


def _with_ambient(capture: Capture, share: float) -> Capture:
    albedo = capture.truth.albedo
    if albedo is None:
        raise InputError(f"{capture.source}: ambient light needs the true albedo, which is not there")
    glow = albedo * (share * capture.intensities.mean(axis=0)) * capture.mask[..., None]
    return replace(capture, images=(capture.images + glow).astype(np.float32))


def _misdirected(capture: Capture, rms_degrees: float, rng: np.random.Generator) -> Capture:
    single = np.array([kind not in WITHOUT_DIRECTION for kind in capture.light_kinds])
    lights = np.where(single[:, None], turned(capture.lights, rms_degrees, rng), capture.lights)
    record: dict[str, Any] = {TRUE_LIGHTS: capture.lights.tolist()}
    positions = capture.positions
    if positions is not None:
        record[TRUE_POSITIONS] = [None if np.isnan(row).any() else row.tolist() for row in positions]
        positions = positions + np.linalg.norm(positions, axis=1, keepdims=True) * (lights - capture.lights)
    return replace(capture, lights=lights, positions=positions, provenance={**capture.provenance, **record})


def _misjudged(capture: Capture, relative: float, rng: np.random.Generator) -> Capture:
    """Log-normal factors of mean 1: no light comes out dark."""
    spread = math.sqrt(math.log1p(relative**2))
    factors = np.exp(spread * rng.standard_normal(capture.count) - spread**2 / 2)
    record = {TRUE_INTENSITIES: capture.intensities.tolist()}
    return replace(capture, intensities=capture.intensities * factors[:, None], provenance={**capture.provenance, **record})


def _flags(capture: Capture, images: Floats, faults: Faults, top: float) -> NDArray[np.uint8]:
    floor = np.array(faults.black_level, np.float32)
    if faults.bits is not None:
        floor = quantised(floor, faults.bits, faults.encoding or "linear")
    dark = (images <= floor + np.float32(LOST * faults.noise.read)).all(axis=3)
    clipped = (images >= top).any(axis=3)
    flags: NDArray[np.uint8] = capture.faults & np.uint8(Fault.MISSING)
    return flags | (dark * np.uint8(Fault.DARK)) | (clipped * np.uint8(Fault.CLIPPED))
