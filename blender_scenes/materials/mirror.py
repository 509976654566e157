"""The perfect mirror: what the mirror image of the surroundings is rendered with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from blender_scenes.entries import Entries
from blender_scenes.materials.base import Material, Numbers, Placed, Stand
from blender_scenes.materials.graph import Surface, glossy_closure


@dataclass(frozen=True, eq=False)
class Mirror(Material):
    """Reflects everything, from the mirrored direction alone."""

    @property
    def albedo(self) -> Numbers:
        return np.zeros(3)

    @property
    def gloss(self) -> float:
        return 0.0

    def put(self, stand: Stand) -> Placed:
        graph = Surface("mirror")
        return Placed(graph.finish(glossy_closure(graph, (1.0, 1.0, 1.0, 1.0), 0.0)))


def parse(entries: Entries) -> Mirror:
    """The material of a job's entry."""
    return Mirror()
