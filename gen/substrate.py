"""The reference BRDFs: the substrate (pbrt-v3's FresnelBlend) and the Lambertian twin, over numpy or torch arrays alike.

This is the oracle of the render tests and the relighting used in training. The node graphs in `blender_scenes` are the
independent implementation that is tested against it. All functions return radiance / light intensity, that is pi * f * mi, with
f the BRDF and mi the cosine of the light's angle: the light intensity is irradiance / pi.

Source: Ashikhmin and Shirley, "An anisotropic Phong BRDF model" (2000), in the form of Pharr, Jakob and Humphreys,
"Physically Based Rendering", 3rd edition, section 8.5 (FresnelBlend) and section 8.4 (Trowbridge-Reitz).
"""

from __future__ import annotations

import math
from typing import Any

from gen.errors import InputError

Array = Any
"""A numpy array, a torch tensor or a float; everything broadcasts."""


def alpha_from_roughness(roughness: float) -> float:
    """pbrt's remapped roughness as alpha of the Trowbridge-Reitz distribution (pbrt-v3, RoughnessToAlpha).

    roughness: in (0, 1]. Values under 1e-3 count as 1e-3, so alpha never goes under 0.047. Raises InputError where not a positive
    number.
    """
    if not (math.isfinite(roughness) and roughness > 0):
        raise InputError(f"roughness must be a positive number, got {roughness}")
    x = math.log(max(roughness, 1e-3))
    return 1.62142 + x * (0.819955 + x * (0.1734 + x * (0.0171201 + x * 0.000640711)))


def trowbridge_reitz(cos_h: Array, alpha: Array, sin2_h: Array = None) -> Array:
    """D(h) of the isotropic Trowbridge-Reitz (GGX) distribution; 0 below the horizon.

    cos_h: n.h. alpha: width. sin2_h: 1 - cos_h^2, if it is known better than that difference gives it, which for a narrow lobe in float32
    loses all digits (see `cosines`). Source: PBR 3rd edition, Eq. 8.11.
    """
    c2 = cos_h * cos_h
    d = c2 * (alpha * alpha) + ((1.0 - c2) if sin2_h is None else sin2_h)
    # A truth value times a plain number would be float32 in torch: it comes last, here and below.
    return (alpha * alpha) / (math.pi * d * d) * (cos_h > 0)


def schlick(specular: Array, cos_d: Array) -> Array:
    """Schlick's Fresnel term Rs + (1 - Rs) (1 - cos)^5. specular: Rs. cos_d: wi.h."""
    return specular + (1.0 - specular) * (1.0 - cos_d) ** 5


def substrate_diffuse(cos_i: Array, cos_o: Array, diffuse: Array, specular: Array) -> Array:
    """The substrate's diffuse radiance over light intensity: 28/23 Rd (1-Rs) [1-(1-mi/2)^5] [1-(1-mo/2)^5] mi.

    cos_i, cos_o: mi = n.l and mo = n.v, any shape; 0 where either is not positive. diffuse, specular: Rd, Rs.
    Source: PBR 3rd edition, Eq. 8.20.
    """
    lit = (cos_i > 0) & (cos_o > 0)
    dim = (1.0 - (1.0 - 0.5 * cos_i) ** 5) * (1.0 - (1.0 - 0.5 * cos_o) ** 5)
    return dim * cos_i * (28.0 / 23.0) * diffuse * (1.0 - specular) * lit


def substrate_specular(
    cos_i: Array, cos_o: Array, cos_h: Array, cos_d: Array, specular: Array, alpha: Array, sin2_h: Array = None
) -> Array:
    """The substrate's specular radiance over light intensity: pi D(h) F mi / (4 |wi.h| max(mi, mo)); no shadowing term.

    cos_i, cos_o, cos_h, cos_d: n.l, n.v, n.h and l.h, any shape; 0 where n.l or n.v is not positive. sin2_h: see `trowbridge_reitz`.
    Source: PBR 3rd edition, Eq. 8.21.
    """
    lit = (cos_i > 0) & (cos_o > 0)
    larger = _maximum(cos_i, cos_o)
    divisor = 4.0 * abs(cos_d) * larger
    safe = divisor + (divisor <= 0) * 1.0
    return trowbridge_reitz(cos_h, alpha, sin2_h) * math.pi * schlick(specular, cos_d) * cos_i / safe * lit


def lambertian(cos_i: Array, albedo: Array) -> Array:
    """The matte twin over light intensity: albedo * max(n.l, 0)."""
    return albedo * cos_i * (cos_i > 0)


def cosines(normal: Array, light: Array, view: Array) -> tuple[Array, Array, Array, Array, Array]:
    """(n.l, n.v, n.h, l.h, 1 - (n.h)^2), each with a trailing axis of one so that it broadcasts over colour.

    normal, light, view: unit vectors (..., 3), the latter two from the surface. h is the half vector of light and view. The last one comes
    from |n - h|, so that it keeps its digits where n and h nearly agree.
    """
    half = light + view
    half = half / ((half * half).sum(-1)[..., None] ** 0.5)

    def dot(a: Array, b: Array) -> Array:
        return (a * b).sum(-1)[..., None]

    apart = dot(normal - half, normal - half)
    return dot(normal, light), dot(normal, view), dot(normal, half), dot(light, half), apart * (1.0 - 0.25 * apart)


def shade(normal: Array, light: Array, view: Array, diffuse: Array, specular: Array, alpha: Array) -> tuple[Array, Array, Array]:
    """(diffuse, specular, matte) radiance of the substrate over light intensity, each (..., 3), attached shadows only.

    normal, light, view: unit (..., 3) that broadcast together. diffuse, specular: Rd, Rs, broadcasting with (..., 3). alpha:
    (..., 1) or a float.
    """
    mi, mo, mh, md, sh2 = cosines(normal, light, view)
    return (
        substrate_diffuse(mi, mo, diffuse, specular),
        substrate_specular(mi, mo, mh, md, specular, alpha, sh2),
        lambertian(mi, diffuse) * (mo > 0),
    )


def _maximum(a: Array, b: Array) -> Array:
    return 0.5 * (a + b + abs(a - b))
