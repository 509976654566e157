"""The Lambertian surface: what the matte twin is, where it is rendered on its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from blender_scenes.entries import Entries
from blender_scenes.materials.base import Material, Placed, Stand
from blender_scenes.materials.graph import Surface, diffuse_closure
from blender_scenes.materials.texture import painted, publish, value_or_texture


@dataclass(frozen=True, eq=False)
class Lambertian(Material):
    """diffuse: (3,) reflectance in [0, 1], or a texture."""

    diffuse: Any

    @property
    def albedo(self) -> Any:
        return self.diffuse

    @property
    def gloss(self) -> float:
        return 0.0

    def put(self, stand: Stand) -> Placed:
        graph = Surface("lambertian")
        base = painted(graph, stand, self.diffuse)
        passes = publish(graph, albedo=base)
        return Placed(graph.finish(diffuse_closure(graph, base)), passes=passes)


def parse(entries: Entries) -> Lambertian:
    """The material of a job's entry."""
    return Lambertian(value_or_texture(entries, "diffuse", (3,), 0, 1))
