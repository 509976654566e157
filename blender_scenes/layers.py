"""From Cycles' raw passes to the layers of a shot, and from sub-samples to pixels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blender_scenes.job import Substrate
from blender_scenes.substrate import GAIN

Floats = NDArray[np.float32]


def radiance(passes: Mapping[str, Floats], albedo: NDArray[np.float64]) -> dict[str, Floats]:
    """combined, diffuse, specular and matte, each (H, W, 3), of one light from its passes at one sample a pixel.

    combined is Cycles' own; diffuse and specular are each light times colour. Cycles divides its light pass by the colour, so
    DiffDir is what a white Lambertian surface would show, shadows included (under a sun divided by GAIN), and the matte twin is
    albedo * GAIN * DiffDir: exactly so at one sample a pixel, which is why pixels are averaged afterwards (`block_mean`). albedo: (3,).
    """
    return {
        "combined": np.ascontiguousarray(passes["Combined"][..., :3]),
        "diffuse": passes["DiffDir"] * passes["DiffCol"],
        "specular": passes["GlossDir"] * passes["GlossCol"],
        "matte": passes["DiffDir"] * (GAIN * albedo).astype(np.float32),
    }


def view(passes: Mapping[str, Floats], material: Substrate, n: int) -> dict[str, Floats]:
    """What does not depend on the light: coverage, normal, depth, albedo and gloss, over blocks of n x n sub-samples.

    coverage: (H, W) share of the sub-samples that hit. normal: (H, W, 3) the normalised mean of the hit ones, zero where none did.
    depth: (H, W) mm along -z from the camera, their mean, NaN where none hit. albedo: (H, W, 3) Rd and gloss: (H, W) alpha, zero
    where none hit.
    """
    hit = passes["Combined"][..., 3] > 0.5
    share = block_mean(hit.astype(np.float64), n)
    covered = share > 0
    safe = np.where(covered, share, 1)
    normal = block_mean(np.where(hit[..., None], passes["Normal"], 0).astype(np.float64), n)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    depth = block_mean(np.where(hit, passes["Depth"][..., 0], 0).astype(np.float64), n) / safe
    return {
        "coverage": share.astype(np.float32),
        "normal": np.where(length > 0, normal / np.where(length > 0, length, 1), 0).astype(np.float32),
        "depth": np.where(covered, depth, np.nan).astype(np.float32),
        "albedo": (covered[..., None] * material.diffuse).astype(np.float32),
        "gloss": (covered * material.alpha).astype(np.float32),
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
