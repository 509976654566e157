"""A Lambertian base under two GGX lobes, a narrow one over a wide one, as measured paints and plastics often need.

Radiance per unit of light intensity: Rd mi + F(l.h) [(1 - mix) D G(alpha) + mix D G(alpha2)] pi / (4 mo), F Schlick's term of Rs and G
Smith's height-correlated masking, which is Cycles' own for its GGX. Sources: Walter et al., "Microfacet models for refraction through
rough surfaces", EGSR 2007; Ngan, Durand and Matusik, "Experimental analysis of BRDF models", EGSR 2005 (two lobes).
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
class TwoLobe(Coated, OneLight):
    """diffuse, specular: (3,) Rd, Rs in [0, 1]. alpha, alpha2: widths of the lobes; the first is the one that counts as the gloss. mix: the
    second's share. All but mix may be textures."""

    alpha2: Any
    mix: float

    def inputs(self, graph: Graph, stand: Stand) -> dict[str, Any]:
        return {
            "albedo": painted(graph, stand, self.diffuse),
            "shine": painted(graph, stand, self.specular),
            "gloss": painted(graph, stand, self.alpha),
            "second": painted(graph, stand, self.alpha2),
            "share": 1 - self.mix,
            "mix": self.mix,
        }

    @staticmethod
    def lobes(graph: Graph, at: Angles, given: Mapping[str, Any]) -> tuple[Any, Any]:
        base, shine = given["albedo"], given["shine"]
        lobe = graph.math("MULTIPLY", ggx(graph, at, given["gloss"]), given["share"])
        lobe = graph.math("MULTIPLY_ADD", ggx(graph, at, given["second"]), given["mix"], lobe)
        lobe = graph.math("MULTIPLY", lobe, seen(graph, at))
        specular = graph.calc("MULTIPLY", schlick(graph, shine, at.ld), lobe)
        diffuse = graph.calc("MULTIPLY", base, seen(graph, at))
        return diffuse, specular


def parse(entries: Entries) -> TwoLobe:
    """The material of a job's entry."""
    return TwoLobe(
        diffuse=value_or_texture(entries, "diffuse", (3,), 0, 1),
        specular=value_or_texture(entries, "specular", (3,), 0, 1),
        alpha=value_or_texture(entries, "alpha", (), 1e-3, 10),
        alpha2=value_or_texture(entries, "alpha2", (), 1e-3, 10),
        mix=entries.number("mix", low=0, high=1),
    )
