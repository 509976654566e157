"""From Cycles' raw passes to the layers of a shot, and from sub-samples to pixels."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blender_scenes.materials import Material, Placed

Floats = NDArray[np.float32]

AGREES = 1e-4
"""By how much of the peak a light's parts, written as they stand, may depart from those that Cycles rendered."""

CACHED = 1 << 14
"""Sub-samples of a strip: a few layers of it take less than a megabyte."""


def radiance(
    passes: Mapping[str, Floats], material: Material, placed: Placed, wanted: Collection[str]
) -> tuple[dict[str, Floats], float, float]:
    """The wanted ones of combined, diffuse, specular and matte, each (H, W, 3), of one light from its passes; the largest
    |combined - (diffuse + specular)|, and the largest combined.

    combined is Cycles' own; diffuse and specular are each light times colour. Cycles divides its light pass by the colour, so
    DiffDir is what a white Lambertian surface would show, shadows included (under a light divided by the gain), and the matte twin is
    albedo * gain * DiffDir: exactly so at one surface point, which is why pixels are averaged afterwards (`block_mean`).
    """
    combined = _colour(passes["Combined"])
    parts = {"combined": combined, "diffuse": _times(passes, "Diff"), "specular": _times(passes, "Gloss")}
    rest = combined - parts["diffuse"]
    rest -= parts["specular"]
    off, peak = max(float(rest.max()), -float(rest.min())), float(combined.max())
    if "matte" in wanted:
        if "albedo" in placed.passes:
            albedo = _colour(passes["albedo"]) * np.float32(placed.gain)
        else:  # a row of it: numpy is slow where it has but three numbers in a go
            albedo = np.tile((placed.gain * material.albedo).astype(np.float32), (rest.shape[1], 1))
        parts["matte"] = np.multiply(passes["DiffDir"], albedo, out=rest)
    return {name: part for name, part in parts.items() if name in wanted}, off, peak


def written(
    strip: Mapping[str, Floats], material: Material, i: int, intensity: Any, wanted: Collection[str], n: int
) -> dict[str, NDArray[np.float64]]:
    """The wanted ones of combined, diffuse, specular, matte (H, W, 3) and lit (H, W), means over blocks of n x n sub-samples, of the
    i-th light that `OneLight.put` was given. intensity: (3,)."""
    found = {
        name: block_mean(strip[f"{name}_{i}"], n)[..., :3] * _scale(strip, name, material, intensity) for name in _lobes(strip)
    }
    if "combined" in wanted:
        found["combined"] = sum(found.values(), np.zeros_like(found["specular"]))
    if "diffuse" in wanted and "diffuse" not in found:
        found["diffuse"] = np.zeros_like(found["specular"])
    received = strip[f"received_{i}"]
    if "matte" in wanted and "albedo" in strip:
        found["matte"] = block_mean(received * _colour(strip["albedo"]), n) * intensity
    elif "matte" in wanted:
        found["matte"] = block_mean(received, n) * (material.albedo * intensity)
    if "lit" in wanted:
        found["lit"] = block_mean(received[..., 0] > 0, n)
    return {name: values for name, values in found.items() if name in wanted}


def differing(own: Mapping[str, Floats], strip: Mapping[str, Floats], material: Material, intensity: Any) -> int:
    """How many sub-samples under the first light, the one that was rendered, show else than Cycles' own lobes (H, W, 3), by more than
    `AGREES` of the strip's peak."""
    peak = max(float(values.max()) for values in own.values())
    differ = np.zeros(own["specular"].shape[:2], np.bool_)
    for name in _lobes(strip):
        scale = np.tile(_scale(strip, name, material, intensity).astype(np.float32), (differ.shape[1], 1))
        off = _colour(strip[f"{name}_0"]) * scale
        off -= own[name]
        differ |= (np.abs(off, out=off) > AGREES * peak).any(axis=-1)
    return int(differ.sum())


def _lobes(strip: Mapping[str, Floats]) -> list[str]:
    return [name for name in ("diffuse", "specular") if f"{name}_0" in strip]


def _scale(strip: Mapping[str, Floats], name: str, material: Material, intensity: Any) -> NDArray[np.float64]:
    """(3,) what a lobe that `OneLight.put` wrote must be multiplied by."""
    whole = name == "diffuse" and "albedo" not in strip
    return np.asarray(intensity * material.albedo if whole else intensity, np.float64)


def strips(height: int, width: int, n: int) -> Iterator[tuple[slice, slice]]:
    """Rows of sub-samples, whole pixels high, that a processor's cache holds, and the rows of pixels which they make."""
    high = max(CACHED // (width * n), 1)
    for top in range(0, height // n, high):
        end = min(top + high, height // n)
        yield slice(top * n, end * n), slice(top, end)


def _colour(array: Floats) -> Floats:
    """The first three channels of (H, W, 1 to 4), as an array of its own where there are four: copied a pixel at a time, not a number."""
    if array.shape[-1] < 4:
        return array
    pixel = np.dtype({"names": ["colour"], "formats": ["V12"], "offsets": [0], "itemsize": 16})
    colour = np.empty((*array.shape[:-1], 3), np.float32)
    colour.view("V12")[..., 0] = array.view(pixel)["colour"][..., 0]
    return colour


def _times(passes: Mapping[str, Floats], name: str) -> Floats:
    light = passes[f"{name}Dir"]
    if f"{name}Ind" in passes:
        light = light + passes[f"{name}Ind"]
    # Into an array whose rows lie in order, which the passes' do not.
    product: Floats = np.multiply(light, passes[f"{name}Col"], out=np.empty(light.shape, np.float32))
    return product


def lit(passes: Mapping[str, Floats], n: int) -> Floats:
    """(H, W) share of each block of n x n sub-samples that the light reaches. Where the surface reflects nothing diffusely it counts as
    unlit."""
    red, green, blue = np.moveaxis(passes["DiffDir"], -1, 0)
    return block_mean((red > 0) | (green > 0) | (blue > 0), n).astype(np.float32)


def view(passes: Mapping[str, Floats], material: Material, n: int) -> dict[str, Floats]:
    """What does not depend on the light: coverage, normal, depth, albedo and gloss, over blocks of n x n sub-samples.

    coverage: (H, W) share of the sub-samples that hit. normal: (H, W, 3) the normalised mean of the hit ones, zero where none did.
    depth: (H, W) mm along -z from the camera, their mean, NaN where none hit. albedo: (H, W, 3) of the matte twin and gloss: (H, W) alpha,
    the hit ones' means, zero where none hit.
    """
    hit = passes["Combined"][..., 3] > 0.5
    share = block_mean(hit, n)
    covered = share > 0
    safe = np.where(covered, share, 1)
    normal = block_mean(np.where(hit[..., None], passes["Normal"], 0), n)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    depth = block_mean(np.where(hit, passes["Depth"][..., 0], 0), n) / safe
    if "albedo" in passes:
        albedo = block_mean(np.where(hit[..., None], _colour(passes["albedo"]), 0), n) / safe[..., None]
    else:
        albedo = covered[..., None] * material.albedo
    gloss = block_mean(np.where(hit, passes["gloss"][..., 0], 0), n) / safe if "gloss" in passes else covered * material.gloss
    return {
        "coverage": share.astype(np.float32),
        "normal": np.where(length > 0, normal / np.where(length > 0, length, 1), 0).astype(np.float32),
        "depth": np.where(covered, depth, np.nan).astype(np.float32),
        "albedo": albedo.astype(np.float32),
        "gloss": gloss.astype(np.float32),
    }


def block_mean(array: NDArray[Any], n: int) -> NDArray[np.float64]:
    """Means over blocks of n x n of an array (n H, n W) or (n H, n W, C), formed in double precision."""
    if n == 1:
        return array.astype(np.float64)
    rows, columns = array.shape[0] // n, array.shape[1] // n
    lines = array.reshape(rows, n, -1).sum(axis=1, dtype=np.float64).reshape(rows, columns, n, *array.shape[2:])
    total: NDArray[np.float64] = lines[:, :, 0].copy()
    for j in range(1, n):
        total += lines[:, :, j]
    return total / n**2
