"""The samples of a solver's pixels in rows for the compiled loops, checked and scaled, and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gen.capture import grey
from gen.errors import InputError
from recon.conditioning import MAX_CONDITION, condition_numbers, require_spanning_lights
from recon.normals.compiled import in_parts, robust_angles
from recon.normals.least_squares import assemble
from recon.registry import Normals

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Rows:
    """The pixels inside a mask.

    samples: (K, P, 3) reflectance. weights: (K, P). y, w: (P, K), grey reflectance over the pixel's brightest (of weight), and weights.
    top: (P,) that brightest. usable: (P,), whether the lights that carry weight determine the normal and there is any light at all.
    L: (3, K) the lights. lights: (K, 3). mask: (H, W).
    """

    samples: Floats
    weights: Floats
    y: Floats
    w: Floats
    top: Floats
    usable: Bools
    L: Doubles
    lights: Doubles
    mask: Bools

    def normals(self, b: Doubles, efficiency: float, w: Floats | None = None) -> Normals:
        """Maps from b (P, 3), in the scale of y. efficiency: see `robust_angles`. w: (P, K), the weights b was fitted with, if others."""
        length = np.linalg.norm(b, axis=1)
        found = self.usable & np.isfinite(length) & (length > 0)
        angle = np.full(len(b), np.nan)
        in_parts(robust_angles, (self.y, self.w if w is None else w, found, b, angle), self.L, efficiency)
        weights = self.weights if w is None else w.T
        return assemble(
            np.where(found[:, None], b, 0) * self.top[:, None], self.samples, self.lights, weights, angle, found, self.mask
        )


def rows(reflectance: Floats, lights: Doubles, mask: Bools, weights: Floats, where: str) -> Rows:
    """Check a solver's input and lay it out in rows.

    reflectance: (K, H, W, 3). lights: (K, 3) unit. mask: (H, W). weights: (K, H, W), not negative. where: the option, for messages.
    Raises InputError where shapes disagree, lights do not span space, weights are negative, or a sample of weight is not finite.
    """
    require_spanning_lights(lights, where)
    if reflectance.shape != (len(lights), *mask.shape, 3) or weights.shape != reflectance.shape[:3]:
        raise InputError(
            f"{where}: got reflectance {reflectance.shape} and weights {weights.shape} for {len(lights)} lights and a mask of"
            f" {mask.shape}; they must be (K, H, W, 3), (K, H, W), K and (H, W)"
        )
    samples = reflectance[:, mask]
    kept = np.asarray(weights[:, mask], np.float32)
    if not (kept >= 0).all() or not np.isfinite(kept).all():
        raise InputError(f"{where}: a weight is negative or not finite; weights must be from 0 up")
    luma = np.asarray(grey(samples), np.float32)
    carries = kept > 0
    if not np.isfinite(luma[carries]).all():
        raise InputError(f"{where}: a sample inside the mask is not finite; give it weight 0 or mend the picture")
    if not carries.all():
        luma = np.where(carries, luma, np.float32(0))
        samples = np.where(carries[..., None], samples, np.float32(0))
    top = luma.max(axis=0, initial=0)
    usable = (condition_numbers(lights, kept) <= MAX_CONDITION) & (top > 0)
    y = np.ascontiguousarray((luma / np.where(top > 0, top, np.float32(1))).T)
    return Rows(
        samples=samples,
        weights=kept,
        y=y,
        w=np.ascontiguousarray(kept.T),
        top=top,
        usable=usable,
        L=np.ascontiguousarray(lights.T, dtype=np.float64),
        lights=lights,
        mask=mask,
    )
