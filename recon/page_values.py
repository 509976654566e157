"""Maps made small enough for a page: values on 16 bits, normals on two, deflated. `templates/packed.js` reads them."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError

LEVELS = 65534
"""Codes of a value; one more stands for "unknown"."""

OCTAHEDRON = 4094
"""Steps along each side of the square that normals are unfolded to: they come back within 0.06 degrees."""


@dataclass(frozen=True)
class PackedValues:
    """value = lo + (code - 1) * step; code 0 is unknown. data: deflated codes, uint16 little-endian, each as the step from the last."""

    lo: float
    step: float
    data: bytes


def pack_values(values: NDArray[Any], step: float | None = None) -> PackedValues:
    """Values (H, W) for a page. NaN is unknown.

    step: what they are rounded to; where their range takes more than `LEVELS` of it, it grows by tens. None: as fine as 16 bits allow.
    """
    known = np.isfinite(values)
    inside = values[known].astype(np.float64)
    low, high = (float(inside.min()), float(inside.max())) if inside.size else (0.0, 0.0)
    if step is None:
        lo, step = low, (high - low) / (LEVELS - 1) or 1.0
    else:
        while round(high / step) - round(low / step) >= LEVELS:
            step *= 10
        lo = round(low / step) * step
    codes = np.zeros(values.shape, np.int64)
    codes[known] = 1 + np.rint(inside / step - lo / step).astype(np.int64)
    return PackedValues(lo, step, deflated(codes))


def reading_step(lo: float, hi: float) -> float:
    """The power of ten that values of a scale from lo to hi are read to: four digits of its larger end."""
    size = max(abs(lo), abs(hi))
    if not (math.isfinite(size) and size > 0):
        raise InputError(f"a scale to read must have an end other than 0, got {lo} to {hi}")
    return 10.0 ** (math.floor(math.log10(size)) - 3)


def pack_normals(normal: NDArray[Any]) -> bytes:
    """Unit normals (H, W, 3) for a page, deflated: u, v (H W each) uint16, 1 to `OCTAHEDRON` + 1, 0 where the normal is zero.

    Source: Z. Cigolle et al., "A Survey of Efficient Representations for Independent Unit Vectors", JCGT 3(2), 2014 (octahedral).
    """
    n = np.asarray(normal, dtype=np.float64)
    size = np.abs(n).sum(axis=-1)
    known = np.isfinite(size) & (size > 0)
    x, y, z = np.moveaxis(np.where(known[..., None], n, (0.0, 0.0, 1.0)) / np.where(known, size, 1)[..., None], -1, 0)
    folded = [(1 - np.abs(b)) * np.where(a < 0, -1.0, 1.0) for a, b in ((x, y), (y, x))]
    planes = [np.where(z < 0, over, plain) for over, plain in zip(folded, (x, y), strict=True)]
    return deflated(np.stack([np.where(known, 1 + np.rint((p + 1) / 2 * OCTAHEDRON), 0) for p in planes]).astype(np.int64))


def deflated(codes: NDArray[np.int64]) -> bytes:
    """Whole numbers below 65536, each as the step from the last along its row, first rows as the step from the row above.

    Low bytes come before high bytes: smooth maps then hardly have any high byte to store.
    """
    rows = codes.reshape(-1, codes.shape[-1])
    steps = np.diff(rows, axis=1, prepend=0)
    steps[:, 0] = np.diff(rows[:, 0], prepend=0)
    flat = steps.astype("<u2").ravel()
    return zlib.compress((flat & 255).astype(np.uint8).tobytes() + (flat >> 8).astype(np.uint8).tobytes(), 9)
