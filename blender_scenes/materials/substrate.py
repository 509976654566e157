"""The substrate (pbrt-v3's FresnelBlend) as a node graph that Cycles renders exactly under one sun.

Source of the BRDF: Ashikhmin and Shirley, "An anisotropic Phong BRDF model" (2000), in the form of Pharr, Jakob and Humphreys,
"Physically Based Rendering", 3rd edition, sections 8.4 and 8.5.

Cycles has no such material, but under a single light of known direction L every angle is known to the node graph, so the colours of two
plain closures can carry the whole BRDF. With mi = n.l, mo = n.v, h the half vector:

- Diffuse: its own value is 1/pi mi; the colour is 28/23 Rd (1-Rs) [1-(1-mi/2)^5] [1-(1-mo/2)^5].
- Glossy, GGX of alpha 1: its own value is D_1 G_1 / (4 mo), where D_1 = 1/pi whatever the direction and, by Smith's correlated
  shadowing at alpha 1, G_1 = 2 mi mo / (mi + mo). The colour F pi D_alpha (mi + mo) / (2 max(mi, mo) (l.h)) turns this into
  D_alpha F mi / (4 (l.h) max(mi, mo)). The distribution is thus evaluated here for every alpha, below and above 1, from |n x h|
  and so without the cancellation that n.h near 1 suffers in single precision: a narrow lobe of alpha 0.01 keeps all its digits.

Shadows, attached and cast, remain Cycles' own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from blender_scenes.entries import Entries
from blender_scenes.materials.base import Coated, Placed, Stand
from blender_scenes.materials.graph import GAIN, LEAST, Graph, angles, diffuse_closure, glossy_closure
from blender_scenes.materials.microfacet import distribution, fifth, schlick, seen
from blender_scenes.materials.texture import painted, publish, value_or_texture


@dataclass(frozen=True, eq=False)
class Substrate(Coated):
    """diffuse, specular: (3,) Rd, Rs in [0, 1]. alpha: width of the Trowbridge-Reitz distribution. Each may be a texture."""

    one_light: ClassVar[bool] = True

    def put(self, stand: Stand) -> Placed:
        graph = Graph("substrate")
        at = angles(graph, stand)
        base, shine, alpha = (painted(graph, stand, value) for value in (self.diffuse, self.specular, self.alpha))
        larger = graph.math("MAXIMUM", graph.math("MAXIMUM", at.mi, at.mo), 1e-6)
        both = graph.math("ADD", at.mi, at.mo)
        shape = graph.math("DIVIDE", both, graph.math("MULTIPLY", graph.math("MULTIPLY", larger, 2.0), at.ld))
        strength = graph.math("MULTIPLY", distribution(graph, at, alpha), shape)
        specular = graph.vector("MULTIPLY", schlick(graph, shine, at.ld), strength)

        dim = graph.math(
            "MULTIPLY",
            graph.math("SUBTRACT", 1.0, fifth(graph, at.mi, 0.5)),
            graph.math("SUBTRACT", 1.0, fifth(graph, at.mo, 0.5)),
        )
        under = graph.vector("MULTIPLY", graph.vector("SUBTRACT", 1.0, shine), graph.math("MULTIPLY", dim, GAIN * 28 / 23))
        diffuse = graph.vector(
            "MAXIMUM",
            graph.vector("MULTIPLY", under, base),
            graph.vector("MULTIPLY", graph.math("MULTIPLY", seen(graph, at), GAIN * LEAST), base),
        )
        passes = publish(graph, albedo=base, gloss=alpha)
        return Placed(graph.finish(diffuse_closure(graph, diffuse), glossy_closure(graph, specular, 1.0)), at.aim, GAIN, passes)


def parse(entries: Entries) -> Substrate:
    """The material of a job's entry."""
    return Substrate(
        diffuse=value_or_texture(entries, "diffuse", (3,), 0, 1),
        specular=value_or_texture(entries, "specular", (3,), 0, 1),
        alpha=value_or_texture(entries, "alpha", (), 1e-3, 10),
    )
