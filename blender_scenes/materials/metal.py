"""Bare metal: one GGX lobe with a coloured F0 under Schlick's term, Smith's height-correlated masking, and no diffuse part.

Its matte twin is a Lambertian surface of albedo F0, rendered on its own: what the same part would look like painted in the metal's colour.
Radiance per unit of light intensity: pi D F(l.h) G / (4 mo); see `two_lobe` for the sources.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from blender_scenes.entries import Entries
from blender_scenes.materials.base import Stand
from blender_scenes.materials.graph import Angles, Graph
from blender_scenes.materials.microfacet import ggx, schlick, seen
from blender_scenes.materials.one_light import OneLight
from blender_scenes.materials.texture import painted, value_or_texture


@dataclass(frozen=True, eq=False)
class Metal(OneLight):
    """specular: (3,) F0 in [0, 1], also the twin's albedo. alpha: width of the lobe. Either may be a texture."""

    specular: Any
    alpha: Any

    own_twin: ClassVar[bool] = True

    @property
    def albedo(self) -> Any:
        return self.specular

    @property
    def gloss(self) -> Any:
        return self.alpha

    def inputs(self, graph: Graph, stand: Stand) -> dict[str, Any]:
        return {"shine": painted(graph, stand, self.specular), "gloss": painted(graph, stand, self.alpha)}

    @staticmethod
    def lobes(graph: Graph, at: Angles, given: Mapping[str, Any]) -> tuple[Any, Any]:
        lobe = graph.math("MULTIPLY", ggx(graph, at, given["gloss"]), seen(graph, at))
        return None, graph.calc("MULTIPLY", schlick(graph, given["shine"], at.ld), lobe)


def parse(entries: Entries) -> Metal:
    """The material of a job's entry."""
    return Metal(
        specular=value_or_texture(entries, "specular", (3,), 0, 1), alpha=value_or_texture(entries, "alpha", (), 1e-3, 10)
    )
