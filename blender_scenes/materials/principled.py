"""Cycles' own Principled BSDF, its opaque part: what many renderers and assets are made with, and a family that no other here resembles.

Diffuse base, metal, dielectric specular layer, coat and sheen. Sheen's passes count as diffuse, coat's as glossy, so the picture is
the sum of both. Cycles dims the base by what the layers above reflect and adds sheen to it, so the matte twin, a Lambertian surface of
the base colour, is rendered on its own (a metal's too). Holds under any light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from blender_scenes.entries import Entries
from blender_scenes.materials.base import Material, Placed, Stand
from blender_scenes.materials.graph import Surface
from blender_scenes.materials.texture import painted, publish, value_or_texture


@dataclass(frozen=True, eq=False)
class Principled(Material):
    """diffuse: (3,) base colour in [0, 1]. alpha: the square of Blender's roughness. Both may be textures. metallic: 0 to 1. ior: of the
    specular layer. coat, coat_alpha: its weight and width. sheen, sheen_roughness: its weight and spread (Blender's roughness).
    """

    diffuse: Any
    alpha: Any
    metallic: float
    ior: float
    coat: float
    coat_alpha: float
    sheen: float
    sheen_roughness: float

    own_twin: ClassVar[bool] = True

    @property
    def albedo(self) -> Any:
        return self.diffuse

    @property
    def gloss(self) -> Any:
        return self.alpha

    def put(self, stand: Stand) -> Placed:
        graph = Surface("principled")
        base, alpha = painted(graph, stand, self.diffuse), painted(graph, stand, self.alpha)
        inputs: dict[str, Any] = {
            "Base Color": base,
            "Roughness": graph.math("SQRT", alpha),
            "Metallic": self.metallic,
            "IOR": self.ior,
            "Coat Weight": self.coat,
            "Coat Roughness": math.sqrt(self.coat_alpha),
            "Sheen Weight": self.sheen,
            "Sheen Roughness": self.sheen_roughness,
            "Transmission Weight": 0.0,
            "Subsurface Weight": 0.0,
            "Emission Strength": 0.0,
        }
        passes = publish(graph, albedo=base, gloss=alpha)
        return Placed(graph.finish(graph.node("ShaderNodeBsdfPrincipled", **inputs).outputs[0]), passes=passes)


def parse(entries: Entries) -> Principled:
    """The material of a job's entry."""
    return Principled(
        diffuse=value_or_texture(entries, "diffuse", (3,), 0, 1),
        alpha=value_or_texture(entries, "alpha", (), 1e-3, 1),
        metallic=entries.number("metallic", low=0, high=1, default=0.0),
        ior=entries.number("ior", low=1, high=4, default=1.5),
        coat=entries.number("coat", low=0, high=1, default=0.0),
        coat_alpha=entries.number("coat_alpha", low=1e-3, high=1, default=0.001),
        sheen=entries.number("sheen", low=0, high=1, default=0.0),
        sheen_roughness=entries.number("sheen_roughness", low=0.05, high=1, default=0.5),
    )
