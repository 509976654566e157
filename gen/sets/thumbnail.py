"""The small picture of a capture that stands in its folder in a set, for people who look through many: preview.png."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gen.errors import InputError
from gen.srgb import linear_to_srgb

THUMBNAIL = "preview.png"
SIDE = 128
"""Its longest side in pixels."""

STEPS = 4096
"""Of the table that encodes to sRGB: one step is .80 of an 8-bit one where the curve is steepest."""


def thumbnail(picture: NDArray[Any]) -> bytes:
    """PNG of a linear picture (H, W, 3), shrunk by area to `SIDE` and encoded as sRGB; white where it exceeds 1."""
    import cv2

    H, W = picture.shape[:2]
    scale = min(1.0, SIDE / max(H, W))
    size = (max(1, round(W * scale)), max(1, round(H * scale)))
    small = cv2.resize(np.minimum(picture, 1).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    encoded = _table()[np.rint(np.maximum(np.nan_to_num(small), 0) * (STEPS - 1)).astype(np.intp)]
    done, png = cv2.imencode(".png", encoded[..., ::-1])
    if not done:
        raise InputError(f"a thumbnail of {size[0]}x{size[1]} pixels cannot be written as PNG")
    return bytes(png)


def frontal(lights: ArrayLike) -> int:
    """Of lights (K, 3) the one that stands nearest to the camera, whose picture shows most of a surface; the first of equal ones."""
    return int(np.asarray(lights, np.float64)[:, 2].argmax())


@lru_cache(maxsize=1)
def _table() -> NDArray[Any]:
    return np.rint(255 * linear_to_srgb(np.linspace(0, 1, STEPS))).astype(np.uint8)
