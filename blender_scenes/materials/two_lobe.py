"""A Lambertian base under two GGX lobes, a narrow one over a wide one, as measured paints and plastics often need.

Radiance per unit of light intensity: Rd mi + F(l.h) [(1 - mix) D G(alpha) + mix D G(alpha2)] pi / (4 mo), F Schlick's term of Rs and G
Smith's height-correlated masking, which is Cycles' own for its GGX. Sources: Walter et al., "Microfacet models for refraction through
rough surfaces", EGSR 2007; Ngan, Durand and Matusik, "Experimental analysis of BRDF models", EGSR 2005 (two lobes).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from blender_scenes.entries import Entries
from blender_scenes.materials.base import Coated, Placed, Stand
from blender_scenes.materials.graph import GAIN, Graph, angles, diffuse_closure, glossy_closure
from blender_scenes.materials.microfacet import ggx, schlick, seen
from blender_scenes.materials.texture import painted, publish, value_or_texture


@dataclass(frozen=True, eq=False)
class TwoLobe(Coated):
    """diffuse, specular: (3,) Rd, Rs in [0, 1]. alpha, alpha2: widths of the lobes; the first is the one that counts as the gloss. mix: the
    second's share. All but mix may be textures."""

    alpha2: Any
    mix: float

    one_light: ClassVar[bool] = True

    def put(self, stand: Stand) -> Placed:
        graph = Graph("two-lobe")
        at = angles(graph, stand)
        values = (self.diffuse, self.specular, self.alpha, self.alpha2)
        base, shine, alpha, alpha2 = (painted(graph, stand, value) for value in values)
        lobe = graph.math("MULTIPLY", ggx(graph, at, alpha), 1 - self.mix)
        lobe = graph.math("MULTIPLY_ADD", ggx(graph, at, alpha2), self.mix, lobe)
        lobe = graph.math("MULTIPLY", lobe, seen(graph, at))
        specular = graph.vector("MULTIPLY", schlick(graph, shine, at.ld), lobe)
        diffuse = graph.vector("MULTIPLY", base, graph.math("MULTIPLY", seen(graph, at), GAIN))
        passes = publish(graph, albedo=base, gloss=alpha)
        return Placed(graph.finish(diffuse_closure(graph, diffuse), glossy_closure(graph, specular, 1.0)), at.aim, GAIN, passes)


def parse(entries: Entries) -> TwoLobe:
    """The material of a job's entry."""
    return TwoLobe(
        diffuse=value_or_texture(entries, "diffuse", (3,), 0, 1),
        specular=value_or_texture(entries, "specular", (3,), 0, 1),
        alpha=value_or_texture(entries, "alpha", (), 1e-3, 10),
        alpha2=value_or_texture(entries, "alpha2", (), 1e-3, 10),
        mix=entries.number("mix", low=0, high=1),
    )
