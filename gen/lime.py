"""LIME's factors of a rendered capture: what its networks learn to find, from the truth's layers.

Source: Meka, Maximov, Zollhoefer, Chatterjee, Seidel, Richardt and Theobalt, "LIME: Live Intrinsic Material Estimation" (CVPR 2018):
picture = m_d D + m_s S, with D and S the diffuse and the specular shading.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Bools, Capture, Floats
from gen.errors import InputError

NEEDED = ("diffuse", "specular", "albedo", "specular_albedo", "gloss")


@dataclass(frozen=True, eq=False)
class Factors:
    """diffuse = m_d D and specular = m_s S, with the highlight's exponent and the mirror image. What is undefined is 0.

    D, S: (K, H, W, 3). m_d, m_s: (H, W, 3), m_d = Kd and m_s = Ks of the substrate. exponent: (H, W), that of Blinn and Phong, above 0
    where it is defined. mirror: (K, H, W, 3), None where it was not rendered.
    D_valid, S_valid: (H, W, 3), where on the object D and S are defined. valid: (H, W, 3), both.
    """

    D: Floats
    S: Floats
    m_d: Floats
    m_s: Floats
    exponent: Floats
    mirror: Floats | None
    D_valid: Bools
    S_valid: Bools

    @property
    def valid(self) -> Bools:
        """(H, W, 3): where on the object both D and S are defined."""
        return self.D_valid & self.S_valid


def lime_factors(capture: Capture) -> Factors:
    """LIME's factors: D = diffuse / m_d, S = specular / m_s, and exponent = 2 / alpha^2 - 2 where alpha is below 1.

    They come from the clean layers of the truth, whatever happened to the pictures. The substrate's S still depends on its Ks through
    Schlick's term; that of the Blinn-Phong material does not. D and S are undefined in the channels where their divisor is 0.
    Raises InputError where the capture lacks a layer.
    """
    truth = capture.truth
    missing = [name for name in NEEDED if getattr(truth, name) is None]
    if missing:
        raise InputError(f"{capture.source}: LIME's factors need the truth's {', '.join(missing)}; render with lime: true")
    inside = capture.mask
    D, D_valid = _over(truth.diffuse, truth.albedo, inside)
    S, S_valid = _over(truth.specular, truth.specular_albedo, inside)
    return Factors(
        D=D,
        S=S,
        m_d=_on(inside, truth.albedo),
        m_s=_on(inside, truth.specular_albedo),
        exponent=exponent_of(_on(inside, truth.gloss)),
        mirror=truth.mirror,
        D_valid=D_valid,
        S_valid=S_valid,
    )


def exponent_of(alpha: NDArray[Any]) -> Floats:
    """The Blinn-Phong exponent 2 / alpha^2 - 2 whose half-vector distribution is as wide as alpha says, 0 where alpha is not in (0, 1).

    Source: Walter, Marschner, Li and Torrance, "Microfacet models for refraction through rough surfaces" (EGSR 2007), section 5.2.
    """
    wide = np.asarray(alpha, np.float64)
    defined = (wide > 0) & (wide < 1)
    exponent: Floats = np.where(defined, 2 / np.where(defined, wide, 1) ** 2 - 2, 0).astype(np.float32)
    return exponent


def _over(layer: Any, divisor: Any, inside: Bools) -> tuple[Floats, Bools]:
    """(quotient, where it is defined). A divisor so small that the quotient is no float32 counts as 0."""
    defined = inside[..., None] & (divisor > 0)
    with np.errstate(over="ignore"):
        quotient = (layer / np.where(defined, divisor, 1).astype(np.float64)).astype(np.float32)
    defined &= np.isfinite(quotient).all(axis=0)
    return np.where(defined, quotient, np.float32(0)), defined


def _on(inside: Bools, layer: Any) -> Floats:
    wide = inside[..., None] if layer.ndim == 3 else inside
    kept: Floats = np.where(wide, layer, np.float32(0)).astype(np.float32)
    return kept
