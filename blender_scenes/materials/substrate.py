"""The substrate (pbrt-v3's FresnelBlend) as a node graph that Cycles renders exactly under one sun.

Source of the BRDF: Ashikhmin and Shirley, "An anisotropic Phong BRDF model" (2000), in the form of Pharr, Jakob and Humphreys,
"Physically Based Rendering", 3rd edition, sections 8.4 and 8.5.

With mi = n.l, mo = n.v, h the half vector, per unit of light intensity and of mi (`one_light`):

- Diffuse: 28/23 Rd (1-Rs) [1-(1-mi/2)^5] [1-(1-mo/2)^5].
- Specular: pi D_alpha F / (4 (l.h) max(mi, mo)). The distribution is evaluated here for every alpha, below and above 1, from |n x h| and
  so without the cancellation that n.h near 1 suffers in single precision: a narrow lobe of alpha 0.01 keeps all its digits.

Shadows, attached and cast, remain Cycles' own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from blender_scenes.entries import Entries
from blender_scenes.materials.base import Coated, Stand
from blender_scenes.materials.graph import Angles, Graph
from blender_scenes.materials.microfacet import distribution, fifth, schlick
from blender_scenes.materials.one_light import OneLight
from blender_scenes.materials.texture import painted, value_or_texture


@dataclass(frozen=True, eq=False)
class Substrate(Coated, OneLight):
    """diffuse, specular: (3,) Rd, Rs in [0, 1]. alpha: width of the Trowbridge-Reitz distribution. Each may be a texture."""

    def inputs(self, graph: Graph, stand: Stand) -> dict[str, Any]:
        return {
            "albedo": painted(graph, stand, self.diffuse),
            "shine": painted(graph, stand, self.specular),
            "gloss": painted(graph, stand, self.alpha),
        }

    @staticmethod
    def lobes(graph: Graph, at: Angles, given: Mapping[str, Any]) -> tuple[Any, Any]:
        base, shine, alpha = given["albedo"], given["shine"], given["gloss"]
        larger = graph.math("MAXIMUM", at.mi, graph.math("MAXIMUM", at.mo, 1e-6))
        shape = graph.math("MULTIPLY", larger, graph.math("MULTIPLY", at.ld, 4.0))
        specular = graph.calc("MULTIPLY", schlick(graph, shine, at.ld), distribution(graph, at, alpha, shape))

        dim = graph.math(
            "MULTIPLY",
            graph.math("SUBTRACT", 1.0, fifth(graph, at.mi, 0.5)),
            graph.math("SUBTRACT", 1.0, fifth(graph, at.mo, 0.5)),
        )
        under = graph.calc("MULTIPLY", graph.calc("SUBTRACT", 1.0, shine), base)
        diffuse = graph.calc("MULTIPLY", graph.calc("MULTIPLY", under, 28 / 23), dim)
        return diffuse, specular


def parse(entries: Entries) -> Substrate:
    """The material of a job's entry."""
    return Substrate(
        diffuse=value_or_texture(entries, "diffuse", (3,), 0, 1),
        specular=value_or_texture(entries, "specular", (3,), 0, 1),
        alpha=value_or_texture(entries, "alpha", (), 1e-3, 10),
    )
