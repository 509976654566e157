"""A rough diffuse base under one GGX lobe: clay, plaster, unglazed and half-glazed ware, dusty plastic.

The base is Oren and Nayar's qualitative model ("Generalization of Lambert's reflectance model", SIGGRAPH 1994, Eq. 30): radiance per unit
of light intensity Rd mi (A + B max(0, l.v - mi mo) / max(mi, mo)), where max(0, cos dphi) sin a tan b has been written in cosines, with
A = 1 - 0.5 s^2 / (s^2 + 0.33) and B = 0.45 s^2 / (s^2 + 0.09). The lobe is that of `two_lobe`, alone. The matte twin is the Lambertian
surface of the same Rd: the base itself is flatter than that, and brighter toward the light.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from blender_scenes.entries import Entries
from blender_scenes.materials.base import Coated, Stand
from blender_scenes.materials.graph import Angles, Graph
from blender_scenes.materials.microfacet import ggx, schlick, seen
from blender_scenes.materials.one_light import OneLight
from blender_scenes.materials.texture import painted, value_or_texture


@dataclass(frozen=True, eq=False)
class OrenNayar(Coated, OneLight):
    """diffuse, specular: (3,) Rd, Rs in [0, 1]. alpha: width of the lobe. Each may be a texture. sigma: standard deviation of the slope of
    the base's facets, radians."""

    sigma: float

    def inputs(self, graph: Graph, stand: Stand) -> dict[str, Any]:
        s2 = self.sigma**2
        return {
            "albedo": painted(graph, stand, self.diffuse),
            "shine": painted(graph, stand, self.specular),
            "gloss": painted(graph, stand, self.alpha),
            "A": 1 - 0.5 * s2 / (s2 + 0.33),
            "B": 0.45 * s2 / (s2 + 0.09),
        }

    @staticmethod
    def lobes(graph: Graph, at: Angles, given: Mapping[str, Any]) -> tuple[Any, Any]:
        base, shine, alpha = given["albedo"], given["shine"], given["gloss"]
        larger = graph.math("MAXIMUM", graph.math("MAXIMUM", at.mi, at.mo), 1e-6)
        same_side = graph.math("SUBTRACT", graph.dot(at.l, at.v), graph.math("MULTIPLY", at.mi, at.mo))
        back = graph.math("DIVIDE", graph.math("MAXIMUM", same_side, 0.0), larger)
        rough = graph.math("MULTIPLY_ADD", back, given["B"], given["A"])
        diffuse = graph.calc("MULTIPLY", base, graph.math("MULTIPLY", rough, seen(graph, at)))
        lobe = graph.math("MULTIPLY", ggx(graph, at, alpha), seen(graph, at))
        specular = graph.calc("MULTIPLY", schlick(graph, shine, at.ld), lobe)
        return diffuse, specular


def parse(entries: Entries) -> OrenNayar:
    """The material of a job's entry."""
    return OrenNayar(
        diffuse=value_or_texture(entries, "diffuse", (3,), 0, 1),
        specular=value_or_texture(entries, "specular", (3,), 0, 1),
        alpha=value_or_texture(entries, "alpha", (), 1e-3, 10),
        sigma=entries.number("sigma", low=0, high=1.5),
    )
