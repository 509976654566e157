"""Reference BRDFs of the other materials, over numpy or torch arrays alike, and the table of all of them by kind.

Each entry of `BRDFS` is shade(normal, light, view, **parameters) -> (diffuse, specular, matte): radiance over light intensity, each
broadcasting with (..., 3), attached shadows only, with the parameters of the studio's material entry. normal, light, view: unit vectors
(..., 3) that broadcast together, the latter two from the surface; colours (3,) or (..., 3); widths a float or (..., 1). Surfaces that turn
from the light or the viewer are black. The substrate is `gen.substrate`'s; see there for the conventions.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from gen.substrate import Array, cosines, lambertian, schlick, shade, trowbridge_reitz

Parts = tuple[Array, Array, Array]


def shade_lambertian(normal: Array, light: Array, view: Array, diffuse: Array) -> Parts:
    """The Lambertian surface of reflectance `diffuse`."""
    mi, mo, *_ = cosines(normal, light, view)
    matte = lambertian(mi, diffuse) * (mo > 0)
    return matte, 0.0 * matte, matte


def shade_blinn_phong(
    normal: Array,
    light: Array,
    view: Array,
    diffuse: Array,
    specular: Array,
    exponent: Array = None,
    alpha: Array = None,
    normalised: bool = False,
) -> Parts:
    """m_d (l.n) + m_s (h.n)^s, times (s+8)/8 where normalised. One of exponent s and alpha, s = 2 / alpha^2 - 2.

    (h.n)^s has a relative error of s times the arrays' precision. Source: Meka et al., "LIME: Live intrinsic material estimation",
    CVPR 2018.
    """
    mi, mo, mh, _, _ = cosines(normal, light, view)
    s = 2.0 / (alpha * alpha) - 2.0 if exponent is None else exponent
    lit = (mi > 0) & (mo > 0)
    lobe = (mh * lit) ** s * ((s + 8.0) / 8.0 if normalised else 1.0)
    matte = lambertian(mi, diffuse) * (mo > 0)
    return matte, specular * lobe, matte


def shade_blinn_phong_lobe(
    normal: Array,
    light: Array,
    view: Array,
    diffuse: Array,
    specular: Array,
    exponent: Array = None,
    alpha: Array = None,
    normalised: bool = False,
) -> Parts:
    """Blinn-Phong as the studio's kind for any light has it: the lobe times min(mi, mo) / (l.h), which is 1 in the mirrored direction."""
    base, lobe, matte = shade_blinn_phong(normal, light, view, diffuse, specular, exponent, alpha, normalised)
    mi, mo, _, md, _ = cosines(normal, light, view)
    return base, lobe * 0.5 * (mi + mo - abs(mi - mo)) / (md + (md <= 0) * 1.0), matte


def ggx_lobe(cos_i: Array, cos_o: Array, cos_h: Array, alpha: Array, sin2_h: Array = None) -> Array:
    """pi D G / (4 mo): the GGX lobe without Fresnel term, over light intensity; 0 where n.l or n.v is not positive.

    G = 2 mi mo / (mo s(mi) + mi s(mo)), s(m) = sqrt(alpha^2 + (1 - alpha^2) m^2): Smith's height-correlated masking [Heitz,
    "Understanding the masking-shadowing function", JCGT 2014, Eq. 99], which is Cycles' own.
    """
    lit = (cos_i > 0) & (cos_o > 0)
    mi, mo = cos_i * lit, cos_o * lit
    a2 = alpha * alpha

    def root(m: Array) -> Array:
        return (a2 + (1.0 - a2) * m * m) ** 0.5

    divisor = mo * root(mi) + mi * root(mo)
    return trowbridge_reitz(cos_h, alpha, sin2_h) * math.pi * mi / (2.0 * (divisor + (divisor <= 0) * 1.0)) * lit


def shade_two_lobe(
    normal: Array, light: Array, view: Array, diffuse: Array, specular: Array, alpha: Array, alpha2: Array, mix: Array
) -> Parts:
    """A Lambertian base under (1 - mix) of a GGX lobe of alpha and mix of one of alpha2, Schlick's term of `specular` on both."""
    mi, mo, mh, md, sh2 = cosines(normal, light, view)
    lobes = (1.0 - mix) * ggx_lobe(mi, mo, mh, alpha, sh2) + mix * ggx_lobe(mi, mo, mh, alpha2, sh2)
    matte = lambertian(mi, diffuse) * (mo > 0)
    return matte, schlick(specular, md) * lobes, matte


def shade_oren_nayar(
    normal: Array, light: Array, view: Array, diffuse: Array, specular: Array, alpha: Array, sigma: Array
) -> Parts:
    """Oren and Nayar's qualitative model of roughness sigma (radians) under one GGX lobe.

    Source: "Generalization of Lambert's reflectance model", SIGGRAPH 1994, Eq. 30, with max(0, cos dphi) sin a tan b written as
    max(0, l.v - mi mo) / max(mi, mo).
    """
    mi, mo, mh, md, sh2 = cosines(normal, light, view)
    s2 = sigma * sigma
    a, b = 1.0 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)
    lv = (light * view).sum(-1)[..., None]
    back = lv - mi * mo
    larger = 0.5 * (mi + mo + abs(mi - mo))
    rough = a + b * back * (back > 0) / (larger + (larger <= 0) * 1.0)
    matte = lambertian(mi, diffuse) * (mo > 0)
    return matte * rough, schlick(specular, md) * ggx_lobe(mi, mo, mh, alpha, sh2), matte


def shade_metal(normal: Array, light: Array, view: Array, specular: Array, alpha: Array) -> Parts:
    """One GGX lobe of F0 `specular`, no diffuse part; the matte twin is Lambertian of albedo F0."""
    mi, mo, mh, md, sh2 = cosines(normal, light, view)
    matte = lambertian(mi, specular) * (mo > 0)
    return 0.0 * matte, schlick(specular, md) * ggx_lobe(mi, mo, mh, alpha, sh2), matte


BRDFS: dict[str, Callable[..., Parts]] = {
    "blinn-phong": shade_blinn_phong,
    "blinn-phong-lobe": shade_blinn_phong_lobe,
    "lambertian": shade_lambertian,
    "metal": shade_metal,
    "oren-nayar": shade_oren_nayar,
    "substrate": shade,
    "two-lobe": shade_two_lobe,
}
"""Kind of material and its `shade`. Kinds of the studio that are missing here have no closed form."""
