"""Distribution, masking and Fresnel term in a graph that knows its light."""

from __future__ import annotations

from typing import Any

from blender_scenes.materials.graph import Angles, Graph


def fifth(graph: Graph, cosine: Any, factor: float) -> Any:
    """(1 - factor cosine)^5, kept at 0 from below."""
    x = graph.math("MULTIPLY_ADD", cosine, -factor, 1.0)
    if factor > 0.9:  # a cosine may exceed 1 by rounding
        x = graph.math("MAXIMUM", x, 0.0)
    x2 = graph.math("MULTIPLY", x, x)
    return graph.math("MULTIPLY", graph.math("MULTIPLY", x2, x2), x)


def schlick(graph: Graph, specular: Any, cosine: Any) -> Any:
    """Schlick's Fresnel term Rs + (1 - Rs) (1 - cosine)^5, a vector where Rs is one."""
    return graph.calc("MULTIPLY_ADD", fifth(graph, cosine, 1.0), graph.calc("SUBTRACT", 1.0, specular), specular)


def sine2(graph: Graph, at: Angles) -> Any:
    """|n x h|^2, which near the highlight's middle keeps the digits that 1 - (n.h)^2 loses in single precision."""
    across = graph.vector("CROSS_PRODUCT", at.n, at.h)
    return graph.dot(across, across)


def distribution(graph: Graph, at: Angles, alpha: Any, divided_by: Any) -> Any:
    """pi D(h) / divided_by, D the Trowbridge-Reitz (GGX) distribution, for every alpha below and above 1."""
    cosine = graph.dot(at.n, at.h)
    a2 = graph.math("MULTIPLY", alpha, alpha)
    divisor = graph.math("MULTIPLY_ADD", graph.math("MULTIPLY", cosine, cosine), a2, sine2(graph, at))
    return graph.math("DIVIDE", a2, graph.math("MULTIPLY", graph.math("MULTIPLY", divisor, divisor), divided_by))


def ggx(graph: Graph, at: Angles, alpha: Any) -> Any:
    """pi D G / (4 mi mo) of the lobe of `alpha`, without a Fresnel term.

    Smith's height-correlated masking is G = 2 mi mo / (mo s(mi) + mi s(mo)) with s(m) = sqrt(alpha^2 + (1 - alpha^2) m^2) [Heitz,
    "Understanding the masking-shadowing function", JCGT 2014, Eq. 99], so this is pi D / (2 (mo s(mi) + mi s(mo))).
    """
    a2 = graph.math("MULTIPLY", alpha, alpha)
    rest = graph.math("SUBTRACT", 1.0, a2)

    def root(m: Any) -> Any:
        return graph.math("SQRT", graph.math("MULTIPLY_ADD", graph.math("MULTIPLY", m, m), rest, a2))

    divisor = graph.math("MULTIPLY_ADD", at.mo, root(at.mi), graph.math("MULTIPLY", at.mi, root(at.mo)))
    return distribution(graph, at, alpha, graph.math("MULTIPLY", graph.math("MAXIMUM", divisor, 1e-12), 2.0))


def seen(graph: Graph, at: Angles) -> Any:
    """1 where the normal faces the viewer, else 0."""
    return graph.math("GREATER_THAN", at.mo, 0.0)
