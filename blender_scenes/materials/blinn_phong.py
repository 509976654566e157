"""Blinn-Phong, LIME's material and the paper's Eq. 2 to 5: radiance m_d (l.n) + m_s (h.n)^s per unit of light intensity.

Source: Meka et al., "LIME: Live intrinsic material estimation", CVPR 2018. The lobe has no cosine of its own: it ends at once where n.l
or n.v turns negative. Two kinds share this module and these values:

- `blinn-phong` holds exactly under suns and point lights (`one_light`). In narrow lobes, where n.h has no digits left, ln (h.n) is taken
  as -2 atanh(t) with t = |n x h|^2 / (1 + n.h)^2.
- `blinn-phong-lobe` holds under any light, interreflection too, by Cycles' Ashikhmin-Shirley lobe. That one's value, checked under a sun,
  is (s+1) / (8 pi) (h.n)^s mi / (l.h max(mi, mo)), so the colour 8 / (s+1) m_s mo leaves m_s (h.n)^s min(mi, mo) / (l.h): the
  definition itself in the mirrored direction, less than it where min(mi, mo) < l.h, away from the highlight's middle. Its relative RMS
  error under suns at 0 to 70 degrees is 19, 8, 3 and 1 % at s = 5, 20, 100 and 1000 (`python -m gen.deviation`). Cycles raises n.h to
  the power in single precision: 1e-7 s of relative error. Its sampling is biased where the lobe is broad: under the same light from
  everywhere, at mo from .2 to .35, both parts come out 4 % too bright at s = 3 and 2 % at s = 6 (m_s = 1), nothing from s = 30 on. So
  the twin is rendered on its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from blender_scenes.entries import Entries
from blender_scenes.errors import JobError
from blender_scenes.materials.base import Coated, Placed, Stand
from blender_scenes.materials.graph import Angles, Graph, Surface, diffuse_closure, glossy_closure
from blender_scenes.materials.microfacet import seen, sine2
from blender_scenes.materials.one_light import OneLight
from blender_scenes.materials.texture import painted, publish, value_or_texture

EXPONENTS = (1.0, 1e5)
"""The least and the largest exponent."""


def alpha_of(exponent: float) -> float:
    """Alpha of a half-vector distribution (h.n)^exponent: exponent = 2 / alpha^2 - 2."""
    return math.sqrt(2 / (exponent + 2))


@dataclass(frozen=True, eq=False)
class _Values(Coated):
    """diffuse: (3,) m_d in [0, 1]. specular: (3,) m_s, which may exceed 1. alpha: names the exponent s = 2 / alpha^2 - 2. All three may be
    textures. normalised: whether the lobe is multiplied by (s+8)/8."""

    normalised: bool = False

    def values(self, graph: Graph, stand: Stand) -> tuple[Any, Any, Any, Any]:
        """m_d, m_s (times (s+8)/8 where normalised), alpha and s."""
        base, shine, alpha = (painted(graph, stand, value) for value in (self.diffuse, self.specular, self.alpha))
        exponent: Any = 2 / alpha**2 - 2 if isinstance(alpha, float) else _exponent(graph, alpha)
        if self.normalised and isinstance(shine, tuple) and isinstance(exponent, float):
            shine = tuple(value * (exponent + 8) / 8 for value in shine)
        elif self.normalised:
            shine = graph.vector("MULTIPLY", shine, graph.math("MULTIPLY_ADD", exponent, 0.125, 1.0))
        return base, shine, alpha, exponent


@dataclass(frozen=True, eq=False)
class BlinnPhong(_Values, OneLight):
    """The lobe in the colour of Cycles' GGX closure."""

    def inputs(self, graph: Graph, stand: Stand) -> dict[str, Any]:
        base, shine, alpha, exponent = self.values(graph, stand)
        return {"albedo": base, "shine": shine, "gloss": alpha, "exponent": exponent}

    @staticmethod
    def lobes(graph: Graph, at: Angles, given: Mapping[str, Any]) -> tuple[Any, Any]:
        base, shine = given["albedo"], given["shine"]
        lobe = graph.math("EXPONENT", graph.math("MULTIPLY", given["exponent"], _log_cosine(graph, at)))
        lobe = graph.math("DIVIDE", graph.math("MULTIPLY", lobe, seen(graph, at)), graph.math("MAXIMUM", at.mi, 1e-6))
        return graph.calc("MULTIPLY", base, seen(graph, at)), graph.calc("MULTIPLY", shine, lobe)


@dataclass(frozen=True, eq=False)
class BlinnPhongLobe(_Values):
    """The same values on Cycles' Ashikhmin-Shirley lobe, for any light."""

    own_twin: ClassVar[bool] = True

    def put(self, stand: Stand) -> Placed:
        graph = Surface("blinn-phong-lobe")
        base, shine, alpha, exponent = self.values(graph, stand)
        geometry = graph.node("ShaderNodeNewGeometry")
        mo = graph.math("MAXIMUM", graph.dot(geometry.outputs["Normal"], geometry.outputs["Incoming"]), 0.0)
        unit = graph.math("DIVIDE", 8.0, graph.math("ADD", exponent, 1.0))
        specular = graph.vector("MULTIPLY", shine, graph.math("MULTIPLY", unit, mo))
        passes = publish(graph, albedo=base, gloss=alpha)
        lobe = glossy_closure(graph, specular, graph.math("SQRT", alpha), "ASHIKHMIN_SHIRLEY")
        return Placed(graph.finish(diffuse_closure(graph, base), lobe), passes=passes)


def _exponent(graph: Graph, alpha: Any) -> Any:
    return graph.math("SUBTRACT", graph.math("DIVIDE", 2.0, graph.math("MULTIPLY", alpha, alpha)), 2.0)


def _log_cosine(graph: Graph, at: Angles) -> Any:
    """ln (n.h)."""
    cosine = graph.math("MAXIMUM", graph.dot(at.n, at.h), 1e-6)
    more = graph.math("ADD", cosine, 1.0)
    t = graph.math("DIVIDE", sine2(graph, at), graph.math("MULTIPLY", more, more))
    t2 = graph.math("MULTIPLY", t, t)
    series = graph.math("MULTIPLY_ADD", graph.math("MULTIPLY_ADD", t2, 1 / 5, 1 / 3), t2, 1.0)
    small = graph.math("MULTIPLY", graph.math("MULTIPLY", t, -2.0), series)
    narrow = graph.math("LESS_THAN", t, 0.1)
    large = graph.math("LOGARITHM", cosine, math.e)
    return graph.math("MULTIPLY_ADD", graph.math("SUBTRACT", small, large), narrow, large)


def parse(entries: Entries) -> BlinnPhong | BlinnPhongLobe:
    """The material of a job's entry, of either kind. It has one of "exponent" (a number) and "alpha" (a number or a texture)."""
    if ("exponent" in entries.given) == ("alpha" in entries.given):
        raise JobError(f"{entries.where} needs one of exponent and alpha")
    if "exponent" in entries.given:
        alpha: Any = alpha_of(entries.number("exponent", *EXPONENTS))
    else:
        alpha = value_or_texture(entries, "alpha", (), alpha_of(EXPONENTS[1]), alpha_of(EXPONENTS[0]))
    kind = BlinnPhongLobe if entries.text("kind") == "blinn-phong-lobe" else BlinnPhong
    return kind(
        diffuse=value_or_texture(entries, "diffuse", (3,), 0, 1),
        specular=value_or_texture(entries, "specular", (3,), 0, 1e4),
        alpha=alpha,
        normalised=entries.flag("normalised", default=False),
    )
