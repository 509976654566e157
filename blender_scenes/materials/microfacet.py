"""Distribution, masking and Fresnel term in a graph that knows its light, and the colour that turns Cycles' lobe into another.

Cycles' GGX closure of alpha 1 has, under one light, the value D_1 G_1 / (4 mo) with D_1 = 1/pi whatever the direction and, by Smith's
height-correlated masking at alpha 1, G_1 = 2 mi mo / (mi + mo): that is mi / (2 pi (mi + mo)). A colour of pi s (mi + mo) 2 / (pi mi)
on it shows the radiance s of a light of unit intensity. All colours here carry the factor GAIN.
"""

from __future__ import annotations

from typing import Any

from blender_scenes.materials.graph import GAIN, Angles, Graph


def fifth(graph: Graph, cosine: Any, factor: float) -> Any:
    """(1 - factor cosine)^5, kept at 0 from below."""
    x = graph.math("MAXIMUM", graph.math("MULTIPLY_ADD", cosine, -factor, 1.0), 0.0)
    x2 = graph.math("MULTIPLY", x, x)
    return graph.math("MULTIPLY", graph.math("MULTIPLY", x2, x2), x)


def schlick(graph: Graph, specular: Any, cosine: Any) -> Any:
    """Schlick's Fresnel term Rs + (1 - Rs) (1 - cosine)^5, a vector."""
    return graph.vector("MULTIPLY_ADD", fifth(graph, cosine, 1.0), graph.vector("SUBTRACT", 1.0, specular), specular)


def sine2(graph: Graph, at: Angles) -> Any:
    """|n x h|^2, which near the highlight's middle keeps the digits that 1 - (n.h)^2 loses in single precision."""
    across = graph.vector("CROSS_PRODUCT", at.n, at.h)
    return graph.dot(across, across)


def distribution(graph: Graph, at: Angles, alpha: Any) -> Any:
    """GAIN pi D(h) of the Trowbridge-Reitz (GGX) distribution, for every alpha below and above 1."""
    cosine = graph.dot(at.n, at.h)
    a2 = graph.math("MULTIPLY", alpha, alpha)
    divisor = graph.math("MULTIPLY_ADD", graph.math("MULTIPLY", cosine, cosine), a2, sine2(graph, at))
    return graph.math("DIVIDE", graph.math("MULTIPLY", a2, GAIN), graph.math("MULTIPLY", divisor, divisor))


def ggx(graph: Graph, at: Angles, alpha: Any) -> Any:
    """The colour on Cycles' lobe of alpha 1 that makes it the lobe D G / (4 mi mo) of `alpha`, without a Fresnel term.

    Smith's height-correlated masking is G = 2 mi mo / (mo s(mi) + mi s(mo)) with s(m) = sqrt(alpha^2 + (1 - alpha^2) m^2) [Heitz,
    "Understanding the masking-shadowing function", JCGT 2014, Eq. 99], so the colour is pi D (mi + mo) / (mo s(mi) + mi s(mo)).
    """
    a2 = graph.math("MULTIPLY", alpha, alpha)
    rest = graph.math("SUBTRACT", 1.0, a2)

    def root(m: Any) -> Any:
        return graph.math("SQRT", graph.math("MULTIPLY_ADD", graph.math("MULTIPLY", m, m), rest, a2))

    divisor = graph.math("MULTIPLY_ADD", at.mo, root(at.mi), graph.math("MULTIPLY", at.mi, root(at.mo)))
    shape = graph.math("DIVIDE", graph.math("ADD", at.mi, at.mo), graph.math("MAXIMUM", divisor, 1e-12))
    return graph.math("MULTIPLY", distribution(graph, at, alpha), shape)


def seen(graph: Graph, at: Angles) -> Any:
    """1 where the normal faces the viewer, else 0."""
    return graph.math("GREATER_THAN", at.mo, 0.0)
