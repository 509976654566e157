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

from typing import Any

from blender_scenes.job import Substrate
from blender_scenes.studio import blender

GAIN = 65536.0
"""Closure weights are multiplied, and the sun is divided, by this power of two, which rounds nothing: Cycles drops closures that weigh less
than 1e-5, as dark and grazing ones would."""

LEAST = 1e-6
"""The least share of Rd that the diffuse colour keeps where the point faces the camera. The matte twin is light divided by colour, and
must not vanish with the diffuse part in mirrors (Rs = 1) and at grazing angles."""


def substrate(material: Substrate, view: tuple[float, float, float] | None) -> tuple[Any, Any]:
    """The Blender material and the node whose vector is the light's direction; set it with `set_light` before each render.

    view: the unit vector to an orthographic camera, None for a perspective one (each point then has its own).
    """
    bpy = blender()
    item = bpy.data.materials.new("substrate")
    if not item.use_nodes:
        item.use_nodes = True
    # Off: Cycles would bend the glossy closure's normal, and with it the Normal pass, where it departs from the facet's at grazing views.
    holders: list[Any] = [item, getattr(item, "cycles", None)]
    for holder in holders:
        if hasattr(holder, "use_bump_map_correction"):
            holder.use_bump_map_correction = False
    tree = item.node_tree
    tree.nodes.clear()
    graph = _Graph(tree)
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    light = tree.nodes.new("ShaderNodeCombineXYZ")
    n, v, l = geometry.outputs["Normal"], geometry.outputs["Incoming"] if view is None else view, light.outputs["Vector"]  # noqa: E741
    h = graph.vector("NORMALIZE", graph.vector("ADD", l, v))
    mi = graph.math("MAXIMUM", graph.dot(n, l), 0.0)
    mo = graph.math("MAXIMUM", graph.dot(n, v), 0.0)
    ld = graph.math("MAXIMUM", graph.dot(l, h), 1e-6)

    shine = graph.vector("CROSS_PRODUCT", n, h)
    sine2 = graph.dot(shine, shine)
    cosine = graph.dot(n, h)
    a2 = material.alpha**2
    divisor = graph.math("MULTIPLY_ADD", graph.math("MULTIPLY", cosine, cosine), a2, sine2)
    distribution = graph.math("DIVIDE", a2 * GAIN, graph.math("MULTIPLY", divisor, divisor))
    larger = graph.math("MAXIMUM", graph.math("MAXIMUM", mi, mo), 1e-6)
    shape = graph.math("DIVIDE", graph.math("ADD", mi, mo), graph.math("MULTIPLY", graph.math("MULTIPLY", larger, 2.0), ld))
    fresnel = graph.vector("MULTIPLY_ADD", _fifth(graph, ld, 1.0), tuple(1 - material.specular), tuple(material.specular))
    specular = graph.vector("MULTIPLY", fresnel, graph.math("MULTIPLY", distribution, shape))

    dim = graph.math(
        "MULTIPLY",
        graph.math("SUBTRACT", 1.0, _fifth(graph, mi, 0.5)),
        graph.math("SUBTRACT", 1.0, _fifth(graph, mo, 0.5)),
    )
    seen = graph.math("GREATER_THAN", mo, 0.0)
    diffuse = graph.vector(
        "MAXIMUM",
        graph.vector("MULTIPLY", dim, tuple(GAIN * 28 / 23 * material.diffuse * (1 - material.specular))),
        graph.vector("MULTIPLY", seen, tuple(GAIN * LEAST * material.diffuse)),
    )

    under = tree.nodes.new("ShaderNodeBsdfDiffuse")
    under.inputs["Roughness"].default_value = 0.0
    over = tree.nodes.new(
        "ShaderNodeBsdfAnisotropic" if hasattr(bpy.types, "ShaderNodeBsdfAnisotropic") else "ShaderNodeBsdfGlossy"
    )
    over.distribution = "GGX"
    over.inputs["Roughness"].default_value = 1.0
    both = tree.nodes.new("ShaderNodeAddShader")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(diffuse, under.inputs["Color"])
    tree.links.new(specular, over.inputs["Color"])
    tree.links.new(under.outputs[0], both.inputs[0])
    tree.links.new(over.outputs[0], both.inputs[1])
    tree.links.new(both.outputs[0], output.inputs["Surface"])
    return item, light


def set_light(node: Any, direction: Any) -> None:
    """Give the graph's light node the unit vector to the light."""
    for socket, value in zip(node.inputs, direction, strict=True):
        socket.default_value = float(value)


def _fifth(graph: _Graph, cosine: Any, factor: float) -> Any:
    """(1 - factor cosine)^5, kept at 0 from below."""
    x = graph.math("MAXIMUM", graph.math("MULTIPLY_ADD", cosine, -factor, 1.0), 0.0)
    x2 = graph.math("MULTIPLY", x, x)
    return graph.math("MULTIPLY", graph.math("MULTIPLY", x2, x2), x)


class _Graph:
    """Arithmetic in a node tree: each method adds one node and returns its output. Inputs are outputs of others, or constants."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree

    def math(self, operation: str, *inputs: Any) -> Any:
        return self._add("ShaderNodeMath", operation, inputs).outputs["Value"]

    def vector(self, operation: str, *inputs: Any) -> Any:
        return self._add("ShaderNodeVectorMath", operation, inputs).outputs["Vector"]

    def dot(self, a: Any, b: Any) -> Any:
        return self._add("ShaderNodeVectorMath", "DOT_PRODUCT", (a, b)).outputs["Value"]

    def _add(self, kind: str, operation: str, inputs: tuple[Any, ...]) -> Any:
        node = self.tree.nodes.new(kind)
        node.operation = operation
        for socket, value in zip(node.inputs, inputs, strict=False):
            if isinstance(value, int | float | tuple):
                socket.default_value = value
            else:
                self.tree.links.new(value, socket)
        return node
