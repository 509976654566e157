"""Figures of merit: angles between normals, heights after the best shift, and the paper's errors of 8-bit pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture
from gen.errors import InputError

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

SHARES = (1.0, 2.0, 5.0, 11.25, 22.5, 30.0)
"""Angles in degrees under which a share of the pixels is reported."""


def angular_error(normal: Floats, true: Floats) -> Floats:
    """Angle between two unit normal maps in degrees.

    normal, true: (H, W, 3). Returns (H, W) float32, NaN where either has no length. The angle is 2 atan2(|a-b|, |a+b|), exact for
    small ones.
    """
    a, b = normal.astype(np.float64), true.astype(np.float64)
    apart, together = np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)
    known = ((a * a).sum(-1) > 0.25) & ((b * b).sum(-1) > 0.25)
    return np.where(known, np.degrees(2 * np.arctan2(apart, together)), np.nan).astype(np.float32)


def angle_summary(error: Floats, region: Bools) -> dict[str, float]:
    """Mean, median and the shares (in percent) under each of `SHARES` degrees, over the known pixels of a region.

    error: (H, W) degrees, NaN where unknown. region: (H, W). "known" is the percentage of the region that has a value.
    """
    values = error[region]
    known = values[np.isfinite(values)]
    if not known.size:
        return {"pixels": 0.0}
    summary = {"mean": float(known.mean()), "median": float(np.median(known)), "known": 100 * known.size / values.size}
    summary |= {f"under {angle:g}": 100 * float((known < angle).mean()) for angle in SHARES}
    summary["pixels"] = float(known.size)
    return summary


def eroded(mask: Bools, pixels: int = 2) -> Bools:
    """The mask less a rim of `pixels` (8-neighbourhood); the frame's edge is no rim."""
    from scipy.ndimage import binary_erosion

    result: Bools = binary_erosion(mask, np.ones((3, 3), bool), iterations=pixels, border_value=1)
    return result


def regions(capture: Capture, true: Floats) -> dict[str, Bools]:
    """The regions that errors are given on: the full mask, the mask eroded by 2 px, and the pixels that every light reaches.

    true: (H, W, 3) true normals. A light reaches a pixel where the matte truth is above 0 or, without it, where the normal faces the light:
    then cast shadows are not known of.
    """
    matte = capture.truth.matte
    reached = (true.astype(np.float64) @ capture.lights.T > 0).all(axis=-1)
    if matte is not None:
        reached &= (matte.max(axis=-1) > 0).all(axis=0)
    return {"mask": capture.mask, "eroded": eroded(capture.mask), "lit by all": capture.mask & reached}


def fitted_height(height: Floats, true: Floats, mask: Bools, scaled: bool) -> tuple[Floats, float]:
    """Heights after the shift, and the scale where `scaled`, that brings them nearest to the true ones (least squares).

    height: (H, W), NaN where unknown. true: (H, W) in metres, NaN where unknown; so is height unless `scaled`. mask: (H, W), the pixels
    that count. Returns the fitted heights (H, W) in metres, and the scale. Raises InputError where no pixel has both.
    """
    both = mask & np.isfinite(height) & np.isfinite(true)
    if not both.any():
        raise InputError("no pixel has both a measured and a true height")
    a, b = height[both].astype(np.float64), true[both].astype(np.float64)
    spread = a - a.mean()
    power = float(spread @ spread)
    scale = float(spread @ (b - b.mean())) / power if scaled and power > 0 else 1.0
    return (scale * (height - a.mean()) + b.mean()).astype(np.float32), scale


def height_error(height: Floats, true: Floats, mask: Bools, scaled: bool) -> dict[str, float]:
    """Errors of heights after the fit of `fitted_height`, whose arguments and errors these are.

    Returns rmse (root mean square) and mae (mean absolute) in metres, percent (rmse in % of the true range) and the scale.
    """
    fitted, scale = fitted_height(height, true, mask, scaled)
    difference = (fitted - true)[mask & np.isfinite(fitted) & np.isfinite(true)].astype(np.float64)
    spread = float(np.ptp(true[mask & np.isfinite(height) & np.isfinite(true)]))
    rmse = float(np.sqrt((difference**2).mean()))
    return {
        "rmse": rmse,
        "mae": float(np.abs(difference).mean()),
        "percent": 100 * rmse / spread if spread > 0 else float("nan"),
        "scale": scale,
    }


def mse(a: NDArray[Any], b: NDArray[Any], region: Bools | None = None) -> float:
    """Mean squared error of two pictures of 8-bit values (H, W) or (H, W, 3), over a region (H, W) or the full frame."""
    difference = a.astype(np.float64) - b.astype(np.float64)
    return float((difference[region] ** 2).mean() if region is not None else (difference**2).mean())


def normal_bytes(normal: Floats) -> NDArray[np.uint8]:
    """A normal map as the 8-bit picture (n + 1) / 2, rounded, 128 where there is none: the form of the paper's Fig. 4.2 to 4.5."""
    return np.clip(np.rint((normal + 1) * 127.5), 0, 255).astype(np.uint8)


def height_bytes(height: Floats, low: float, high: float) -> NDArray[np.uint8]:
    """Heights (H, W) scaled to 8 bits by one range for all methods, black where unknown (the paper's Fig. 4.5)."""
    span = high - low if high > low else 1.0
    scaled = np.nan_to_num((height - low) / span, nan=0.0)
    return np.clip(np.rint(scaled * 255), 0, 255).astype(np.uint8)


def gap_closed(glossy: float, method: float, matte: float, least: float = 1.0) -> float | None:
    """(glossy - method) / (glossy - matte) of mean angular errors in degrees: 1 is as good as matte, 0 as bad as glossy.

    None where the gap glossy - matte is under `least` degrees: there is nothing to close.
    """
    gap = glossy - matte
    return (glossy - method) / gap if gap >= least else None
