"""Node graphs: arithmetic, groups of nodes that are made once, and the closures at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from blender_scenes.materials.base import Vector
from blender_scenes.studio import blender

GAIN = 65536.0
"""Closure weights are multiplied, and the sun is divided, by this power of two, which rounds nothing: Cycles drops closures that weigh less
than 1e-5, as dark and grazing ones would."""

LEAST = 1e-6
"""The least share of Rd that the diffuse colour keeps where the point faces the camera. The matte twin is light divided by colour, and
must not vanish with the diffuse part in mirrors (Rs = 1) and at grazing angles."""


class Graph:
    """Arithmetic in a node tree: each method adds one node and returns its output. Inputs are outputs, or constants."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree
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

    def calc(self, operation: str, *inputs: Any) -> Any:
        """`vector` where an input is one, else `math`."""
        return (self.vector if any(width_of(value) == 3 for value in inputs) else self.math)(operation, *inputs)

    def dot(self, a: Any, b: Any) -> Any:
        return self._add("ShaderNodeVectorMath", "DOT_PRODUCT", (a, b)).outputs["Value"]

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


class Surface(Graph):
    """The graph of a new material."""

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
        super().__init__(self.item.node_tree)

    def group(self, tree: Any, inputs: Mapping[str, Any]) -> Any:
        """A node that stands for a tree of `group_tree`, with those inputs. Returns the node."""
        node = self.tree.nodes.new("ShaderNodeGroup")
        node.node_tree = tree
        for name, value in inputs.items():
            self._put(node.inputs[name], value)
        return node

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


def group_tree(name: str, widths: Mapping[str, int], fill: Callable[[Graph, Mapping[str, Any]], Mapping[str, Any]]) -> Any:
    """The group of nodes of that name, made where Blender has none yet: adding nodes is slow, and slower the more there are.

    widths: its inputs by name, each of 1 or 3 numbers. fill: given the group's graph and its inputs, adds the nodes and returns outputs.
    """
    trees = blender().data.node_groups
    if name in trees:
        return trees[name]
    tree = trees.new(name, "ShaderNodeTree")
    graph = Graph(tree)
    for key, width in widths.items():
        tree.interface.new_socket(key, in_out="INPUT", socket_type=_socket_type(width))
    given = tree.nodes.new("NodeGroupInput")
    found = fill(graph, {key: given.outputs[key] for key in widths})
    for key, value in found.items():
        tree.interface.new_socket(key, in_out="OUTPUT", socket_type=_socket_type(width_of(value)))
    last = tree.nodes.new("NodeGroupOutput")
    for key, value in found.items():
        tree.links.new(value, last.inputs[key])
    return tree


def width_of(value: Any) -> int:
    """How many numbers an input of a graph holds, 1 or 3: a number, a tuple, or an output of a node."""
    if isinstance(value, int | float):
        return 1
    return 3 if isinstance(value, tuple) or value.type in ("VECTOR", "RGBA") else 1


def _socket_type(width: int) -> str:
    return "NodeSocketVector" if width == 3 else "NodeSocketFloat"


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
    """Outputs of a graph that is given its one light: vectors n, v, l, h and the cosines mi = n.l, mo = n.v (both kept at 0 from below) and
    ld = l.h (kept above 0). reach: what has become of the light on its way, 1 for a sun."""

    n: Any
    v: Any
    l: Any  # noqa: E741
    h: Any
    mi: Any
    mo: Any
    ld: Any
    reach: Any


def angles(graph: Graph, view: Vector | None, light: Any, near: Any, distance2: Any) -> Angles:
    """The angles at each point under one light.

    view: as in `Stand`. light: the direction of a sun, with near = 0 and distance2 = 1; or the position of a point light in mm, with near =
    1 and distance2 the square of its distance from the origin. A sun's direction being a constant, Cycles works out once what follows
    from it and the view alone.
    """
    geometry = graph.node("ShaderNodeNewGeometry")
    away = graph.vector("SUBTRACT", light, graph.vector("MULTIPLY", geometry.outputs["Position"], near))
    n, v, l = geometry.outputs["Normal"], view or geometry.outputs["Incoming"], graph.vector("NORMALIZE", away)  # noqa: E741
    h = graph.vector("NORMALIZE", graph.vector("ADD", l, v))
    return Angles(
        n,
        v,
        l,
        h,
        graph.math("MAXIMUM", graph.dot(n, l), 0.0),
        graph.math("MAXIMUM", graph.dot(n, v), 0.0),
        graph.math("MAXIMUM", graph.dot(l, h), 1e-6),
        graph.math(
            "DIVIDE", distance2, graph.math("MULTIPLY_ADD", graph.dot(away, away), near, graph.math("SUBTRACT", 1.0, near))
        ),
    )
