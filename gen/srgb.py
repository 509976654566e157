"""The sRGB transfer function, IEC 61966-2-1, both ways."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray


def srgb_to_linear(encoded: NDArray[Any]) -> NDArray[Any]:
    """Linear values of sRGB-encoded ones in [0, 1] (IEC 61966-2-1), odd about 0, endless above 1; float32 stays float32."""
    v = np.asarray(encoded, dtype=np.float64)
    size = np.abs(v)
    linear = np.copysign(np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4), v)
    return _as_given(linear, encoded)


def linear_to_srgb(linear: NDArray[Any]) -> NDArray[Any]:
    """The inverse of `srgb_to_linear` (IEC 61966-2-1)."""
    v = np.asarray(linear, dtype=np.float64)
    size = np.abs(v)
    encoded = np.copysign(np.where(size <= 0.0031308, size * 12.92, 1.055 * size ** (1 / 2.4) - 0.055), v)
    return _as_given(encoded, linear)


@cache
def table(bits: int, encoding: str) -> NDArray[np.float32]:
    """The linear value of every number of that many bits."""
    values = np.arange(1 << bits) / ((1 << bits) - 1)
    return (srgb_to_linear(values) if encoding == "srgb" else values).astype(np.float32)


def _as_given(values: NDArray[np.float64], given: Any) -> NDArray[Any]:
    return values.astype(np.float32) if getattr(given, "dtype", None) == np.float32 else values
