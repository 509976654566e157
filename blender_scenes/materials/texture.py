"""Textures: values that vary over the surface, solid in the object's frame, evaluated by Blender's nodes at every shading point.

    {"texture": "noise", "scale": mm, "seed": n, "low": value, "high": value, "detail": octaves}
    {"texture": "stripes", "scale": mm, "seed": n, "low": value, "high": value, "share": part of the stripes that is high}

The value is low + (high - low) f with f in [0, 1] by the pattern; low and high are numbers or colours, as the entry that the texture
stands for. Every seed turns and shifts the pattern in its own way. The same outputs that shade the surface are written as shader outputs
("albedo", "gloss"), so that the truth is what was shaded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from blender_scenes.entries import Entries
from blender_scenes.errors import JobError
from blender_scenes.materials.base import Numbers, Stand
from blender_scenes.materials.graph import Graph, width_of


@dataclass(frozen=True, eq=False)
class Texture:
    """A pattern between two values.

    pattern: a name in `PATTERNS`. scale: mm of one feature (the largest of noise, a cell, a period of stripes, a checker's square).
    low, high: () or (3,), where f is 0 and 1. detail: octaves of noise. share: of high in stripes and, nearly, in spots.
    """

    pattern: str
    scale: float
    seed: int
    low: Numbers
    high: Numbers
    detail: float = 2.0
    share: float = 0.5

    def output(self, graph: Graph, stand: Stand) -> Any:
        """The value at the shading point: an output of the graph, a number or a vector."""
        field = PATTERNS[self.pattern](graph, self._place(graph, stand), self)
        span = self.high - self.low
        if self.low.shape == ():
            return graph.math("MULTIPLY_ADD", field, float(span), float(self.low))
        return graph.vector("MULTIPLY_ADD", field, tuple(span), tuple(self.low))

    def _place(self, graph: Graph, stand: Stand) -> Any:
        """The shading point in the texture's own frame, in features."""
        rng = np.random.default_rng(self.seed)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        shift = rng.uniform(-100, 100, 3)
        point = graph.node("ShaderNodeNewGeometry").outputs["Position"]
        point = graph.vector("SUBTRACT", point, tuple(stand.translation))
        rows = turn @ stand.rotation.T / self.scale
        turned = graph.node(
            "ShaderNodeCombineXYZ", **{x: graph.dot(point, tuple(row)) for x, row in zip("XYZ", rows, strict=True)}
        )
        return graph.vector("ADD", turned.outputs["Vector"], tuple(shift))


def _noise(graph: Graph, place: Any, texture: Texture) -> Any:
    """Fractal noise, stretched about its mean: Blender's own keeps to the middle of [0, 1]."""
    node = graph.node("ShaderNodeTexNoise", Vector=place, Scale=1.0, Detail=texture.detail, Roughness=0.5, Distortion=0.0)
    stretched = graph.math("MULTIPLY_ADD", node.outputs[0], 2.5, -0.75)
    return graph.math("MINIMUM", graph.math("MAXIMUM", stretched, 0.0), 1.0)


def _voronoi(graph: Graph, place: Any) -> Any:
    return graph.node("ShaderNodeTexVoronoi", Vector=place, Scale=1.0, Randomness=1.0)


def _cells(graph: Graph, place: Any, texture: Texture) -> Any:
    """Voronoi cells, each of a value of its own."""
    return graph.node("ShaderNodeSeparateXYZ", Vector=_voronoi(graph, place).outputs["Color"]).outputs["X"]


def _spots(graph: Graph, place: Any, texture: Texture) -> Any:
    """Balls about scattered points. Were the points wholly at random, they would fill `share` of space."""
    radius = (-math.log(1 - texture.share) * 3 / (4 * math.pi)) ** (1 / 3)
    return graph.math("LESS_THAN", _voronoi(graph, place).outputs["Distance"], radius)


def _stripes(graph: Graph, place: Any, texture: Texture) -> Any:
    along = graph.node("ShaderNodeSeparateXYZ", Vector=place).outputs["X"]
    return graph.math("LESS_THAN", graph.math("FRACT", along), texture.share)


def _checker(graph: Graph, place: Any, texture: Texture) -> Any:
    cell = graph.vector("FLOOR", place)
    half = graph.math("MULTIPLY", graph.dot(cell, (1.0, 1.0, 1.0)), 0.5)
    return graph.math("GREATER_THAN", graph.math("FRACT", half), 0.25)


PATTERNS: dict[str, Callable[[Graph, Any, Texture], Any]] = {
    "noise": _noise,
    "cells": _cells,
    "stripes": _stripes,
    "checker": _checker,
    "spots": _spots,
}
"""Each pattern and the function that adds it to a graph: (graph, place, texture) to f in [0, 1]."""


def value_or_texture(entries: Entries, key: str, shape: tuple[int, ...], low: float, high: float) -> Any:
    """The entry as numbers of that shape between low and high, or as a texture of such. Raises JobError as `Entries` does."""
    if not isinstance(entries.value(key), Mapping):
        return entries.numbers(key, shape, low, high) if shape else entries.number(key, low, high)
    given = entries.entry(key)
    pattern = given.text("texture")
    if pattern not in PATTERNS:
        raise JobError(f"{given.where}.texture {pattern!r} is unknown; there are {', '.join(PATTERNS)}")
    own: dict[str, float] = {}
    if pattern == "noise":
        own["detail"] = given.number("detail", low=0, high=8, default=2.0)
    if pattern in ("stripes", "spots"):
        own["share"] = given.number("share", low=0.01, high=0.99, default=0.5)
    texture = Texture(
        pattern,
        given.number("scale", low=1e-3, high=1e6),
        int(given.number("seed", low=0, high=2**31 - 1, whole=True, default=0)),
        given.numbers("low", shape, low, high),
        given.numbers("high", shape, low, high),
        **own,
    )
    given.close()
    return texture


def painted(graph: Graph, stand: Stand, value: Any) -> Any:
    """A value as an input of the graph: an output where it is a texture, else a number or a tuple."""
    if isinstance(value, Texture):
        return value.output(graph, stand)
    return tuple(float(v) for v in value) if np.ndim(value) else float(value)


def publish(graph: Graph, **values: Any) -> dict[str, str]:
    """Write those that are outputs of the graph, not constants, as shader outputs. Returns their names and channels, as `Placed.passes`."""
    names = {}
    for name, value in values.items():
        if not isinstance(value, float | tuple):
            colour = width_of(value) == 3
            graph.node("ShaderNodeOutputAOV", **{"Color" if colour else "Value": value}).aov_name = name
            names[name] = "RGBA" if colour else "X"
    return names
