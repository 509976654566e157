"""Node graphs: arithmetic, the light that a graph is told of, and the closures at its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from blender_scenes.materials.base import Numbers, Stand
from blender_scenes.studio import blender

GAIN = 65536.0
"""Closure weights are multiplied, and the sun is divided, by this power of two, which rounds nothing: Cycles drops closures that weigh less
than 1e-5, as dark and grazing ones would."""

LEAST = 1e-6
"""The least share of Rd that the diffuse colour keeps where the point faces the camera. The matte twin is light divided by colour, and
must not vanish with the diffuse part in mirrors (Rs = 1) and at grazing angles."""


class Graph:
    """Arithmetic in a new material's node tree: each method adds one node and returns its output. Inputs are outputs, or constants."""

    def __init__(self, name: str) -> None:
        bpy = blender()
        self.item = bpy.data.materials.new(name)
        if not self.item.use_nodes:
            self.item.use_nodes = True
        # Off: Cycles would bend the glossy closure's normal, and with it the Normal pass, where it departs from the facet's at grazing
        # views.
        holders: list[Any] = [self.item, getattr(self.item, "cycles", None)]
        for holder in holders:
            if hasattr(holder, "use_bump_map_correction"):
                holder.use_bump_map_correction = False
        self.tree = self.item.node_tree
        self.tree.nodes.clear()

    def node(self, kind: str, **inputs: Any) -> Any:
        """A node of a Blender type; inputs by name (underscores for blanks), each a constant or an output of another node."""
        node = self.tree.nodes.new(kind)
        for name, value in inputs.items():
            self._put(node.inputs[name.replace("_", " ")], value)
        return node

    def math(self, operation: str, *inputs: Any) -> Any:
        return self._add("ShaderNodeMath", operation, inputs).outputs["Value"]

    def vector(self, operation: str, *inputs: Any) -> Any:
        return self._add("ShaderNodeVectorMath", operation, inputs).outputs["Vector"]

    def dot(self, a: Any, b: Any) -> Any:
        return self._add("ShaderNodeVectorMath", "DOT_PRODUCT", (a, b)).outputs["Value"]

    def finish(self, *closures: Any) -> Any:
        """Add the closures up as the surface. Returns the Blender material."""
        total = closures[0]
        for closure in closures[1:]:
            both = self.tree.nodes.new("ShaderNodeAddShader")
            self.tree.links.new(total, both.inputs[0])
            self.tree.links.new(closure, both.inputs[1])
            total = both.outputs[0]
        output = self.tree.nodes.new("ShaderNodeOutputMaterial")
        self.tree.links.new(total, output.inputs["Surface"])
        return self.item

    def _add(self, kind: str, operation: str, inputs: tuple[Any, ...]) -> Any:
        node = self.tree.nodes.new(kind)
        node.operation = operation
        for socket, value in zip(node.inputs, inputs, strict=False):
            self._put(socket, value)
        return node

    def _put(self, socket: Any, value: Any) -> None:
        if isinstance(value, int | float | tuple):
            # A number fills a vector; a colour of three is opaque.
            width = {"VECTOR": 3, "RGBA": 4}.get(socket.type, 1)
            if width > 1:
                value = value if isinstance(value, tuple) else (float(value),) * 3
                value = (*value, 1.0)[:width]
            socket.default_value = value
        else:
            self.tree.links.new(value, socket)


def diffuse_closure(graph: Graph, colour: Any) -> Any:
    """The Lambertian closure; under a light its value is colour / pi mi."""
    node = graph.node("ShaderNodeBsdfDiffuse", Color=colour)
    node.inputs["Roughness"].default_value = 0.0
    return node.outputs[0]


def glossy_closure(graph: Graph, colour: Any, roughness: Any, distribution: str = "GGX") -> Any:
    """A glossy closure of Cycles. roughness: the square root of the distribution's alpha."""
    bpy = blender()
    kind = "ShaderNodeBsdfAnisotropic" if hasattr(bpy.types, "ShaderNodeBsdfAnisotropic") else "ShaderNodeBsdfGlossy"
    node = graph.node(kind, Color=colour, Roughness=roughness)
    node.distribution = distribution
    return node.outputs[0]


@dataclass(frozen=True)
class Angles:
    """Outputs of a graph that knows its one light: vectors n, v, l, h and the cosines mi = n.l, mo = n.v (both kept at 0 from below) and
    ld = l.h (kept above 0). aim: see `Placed`."""

    n: Any
    v: Any
    l: Any  # noqa: E741
    h: Any
    mi: Any
    mo: Any
    ld: Any
    aim: Callable[[Numbers, Numbers | None], None]


def angles(graph: Graph, stand: Stand) -> Angles:
    """The angles at each point under the graph's one light, a sun or a point light.

    A sun's direction goes into the graph as a constant, so that Cycles works out once what follows from it and the view alone.
    """
    geometry = graph.node("ShaderNodeNewGeometry")
    place = graph.node("ShaderNodeCombineXYZ")
    away = graph.vector("SUBTRACT", place.outputs["Vector"], geometry.outputs["Position"])
    n, v, l = geometry.outputs["Normal"], stand.view or geometry.outputs["Incoming"], graph.vector("NORMALIZE", away)  # noqa: E741
    h = graph.vector("NORMALIZE", graph.vector("ADD", l, v))
    toward = l.node.inputs[0]

    def aim(direction: Numbers, position: Numbers | None) -> None:
        source = place.outputs["Vector"] if position is None else away
        if toward.links[0].from_socket != source:
            graph.tree.links.new(source, toward)
        for socket, value in zip(place.inputs, direction if position is None else position, strict=True):
            socket.default_value = float(value)

    return Angles(
        n,
        v,
        l,
        h,
        graph.math("MAXIMUM", graph.dot(n, l), 0.0),
        graph.math("MAXIMUM", graph.dot(n, v), 0.0),
        graph.math("MAXIMUM", graph.dot(l, h), 1e-6),
        aim,
    )
