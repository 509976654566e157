"""The substrate as nearly as Cycles' own closures come to it, for light from many directions: area lights, surroundings, interreflection.

The exact `substrate` needs to know the light's direction. Here a Lambertian and a GGX closure are weighed by what is known without it, the
view's angle, so that the light which each part reflects in all, its directional albedo, is the exact substrate's: under the same radiance
from everywhere every pixel is exact.

- Diffuse: 28/23 Rd (1-Rs) [1-(1-mo/2)^5] c, where c, the cosine-weighted hemispherical mean of [1-(1-mi/2)^5], is 23/28.
- Glossy: Cycles' GGX under Rs A(mo) + (1-Rs) B(mo). With D the distribution and G Smith's masking, over the directions of light,
  A = mean of D mi / max(mi, mo) / (4 l.h) over that of D G / (4 mo), B the same with (1 - l.h)^5 in the first one. Both are integrated
  once a material and kept in a colour ramp of mo. Alpha is at most 1, where Cycles' GGX ends.

Against the exact one on a sphere under suns at 0 to 70 degrees, relative RMS error (`python -m gen.deviation` makes the whole table):
diffuse part 13 %, 15 % of the peak; specular part, at alpha .05, .1, .2, .4618, .7, 1: 2, 5, 12, 36, 53, 63 % where Ks = .05 and
2, 5, 10, 16, 19, 21 % where Ks = .5; the whole picture 1 to 13 %. A Schlick weight of the view's angle alone errs more in broad lobes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from blender_scenes.entries import Entries
from blender_scenes.materials.base import Coated, Numbers, Placed, Stand
from blender_scenes.materials.graph import Graph, Surface, diffuse_closure, glossy_closure
from blender_scenes.materials.microfacet import fifth
from blender_scenes.materials.texture import painted, publish, value_or_texture

STOPS = 32
"""Entries of the ramp, the most that Blender has, at mo = (i / 31)^2."""


@dataclass(frozen=True, eq=False)
class ApproximateSubstrate(Coated):
    """diffuse, specular: (3,) Rd, Rs in [0, 1], or textures. alpha: width of the distribution, at most 1."""

    own_twin: ClassVar[bool] = True

    def put(self, stand: Stand) -> Placed:
        graph = Surface("approximate-substrate")
        base, shine = painted(graph, stand, self.diffuse), painted(graph, stand, self.specular)
        geometry = graph.node("ShaderNodeNewGeometry")
        mo = graph.math("MAXIMUM", graph.dot(geometry.outputs["Normal"], geometry.outputs["Incoming"]), 0.0)
        rest = graph.vector("SUBTRACT", 1.0, shine)
        under = graph.vector("MULTIPLY", rest, graph.math("SUBTRACT", 1.0, fifth(graph, mo, 0.5)))
        weights = graph.node("ShaderNodeSeparateXYZ", Vector=_ramp(graph, mo, self.alpha)).outputs
        specular = graph.vector("MULTIPLY_ADD", shine, weights["X"], graph.vector("MULTIPLY", rest, weights["Y"]))
        passes = publish(graph, albedo=base)
        lobe = glossy_closure(graph, specular, self.alpha**0.5)
        return Placed(graph.finish(diffuse_closure(graph, graph.vector("MULTIPLY", under, base)), lobe), passes=passes)


def _ramp(graph: Graph, mo: Any, alpha: float) -> Any:
    """A and B of mo, as the first two channels of a colour."""
    node = graph.node("ShaderNodeValToRGB", Fac=mo)
    ramp = node.color_ramp
    ramp.interpolation = "LINEAR"
    places = np.linspace(0, 1, STOPS) ** 2
    stops = weights(np.maximum(places, 1e-3), alpha)
    for i, (place, (a, b)) in enumerate(zip(places, stops, strict=True)):
        stop = ramp.elements[0] if i == 0 else ramp.elements[-1] if i == STOPS - 1 else ramp.elements.new(float(place))
        stop.position, stop.color = float(place), (float(a), float(b), 0.0, 1.0)
    return node.outputs["Color"]


def weights(mo: Numbers, alpha: float, n: int = 96) -> Numbers:
    """(N, 2): A and B at cosines mo (N,) > 0 of the view's angle. n: directions of the half vector in each of its two angles.

    The integrals are taken over half vectors drawn by D(h) cos(h): tan^2 = alpha^2 u / (1-u) for u in (0, 1), and d wi = 4 (l.h) d wh.
    """
    u, share = np.polynomial.legendre.leggauss(n)  # type: ignore[no-untyped-call]
    u, share = (u + 1) / 2, share / 2
    turn = (np.arange(n) + 0.5) * np.pi / n
    ch = 1 / np.sqrt(1 + alpha**2 * u / (1 - u))
    across = np.sqrt(1 - mo**2)[:, None, None] * np.sqrt(1 - ch**2)[:, None] * np.cos(turn)
    ld = across + mo[:, None, None] * ch[:, None]
    mi = 2 * ld * ch[:, None] - mo[:, None, None]
    lit = (ld > 0) & (mi > 0)
    mi, ld, mv = np.where(lit, mi, 1.0), np.where(lit, ld, 1.0), mo[:, None, None]
    measure = lit * (share / ch)[:, None] / n

    def root(m: Numbers) -> Numbers:
        s: Numbers = np.sqrt(alpha**2 + (1 - alpha**2) * m**2)
        return s

    exact = mi / np.maximum(mi, mv)
    smith = 2 * mi * ld / (mv * root(mi) + mi * root(mv))
    parts = [(measure * part).sum(axis=(1, 2)) for part in (exact, exact * (1 - ld) ** 5, smith)]
    return np.stack([parts[0] / parts[2], parts[1] / parts[2]], axis=1)


def parse(entries: Entries) -> ApproximateSubstrate:
    """The material of a job's entry."""
    return ApproximateSubstrate(
        diffuse=value_or_texture(entries, "diffuse", (3,), 0, 1),
        specular=value_or_texture(entries, "specular", (3,), 0, 1),
        alpha=entries.number("alpha", low=1e-3, high=1),
    )
