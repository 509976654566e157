"""Materials that hold exactly under one light, a sun or a point light, because their graph is told where that is.

With mi = n.l and mo = n.v, a lobe's worth d or s is its radiance per unit of light intensity and of mi, pi times its BRDF. It goes into
the colours of two plain closures, so that shadows, attached and cast, are Cycles' own:

- Diffuse: the Lambertian closure is worth 1, so the colour is d.
- Glossy: Cycles' GGX of alpha 1 is worth pi D_1 G_1 / (4 mi mo), where D_1 = 1/pi whatever the direction and, by Smith's height-correlated
  masking at alpha 1, G_1 = 2 mi mo / (mi + mo). That is 1 / (2 (mi + mo)), so the colour is 2 s (mi + mo).

The same d mi and s mi, and what is left of the light at each point, can be written as they stand, for as many lights as are named, by a
render that shows one. Shadows are then the attached ones alone, which is all that a convex object has (`blender_scenes.shot`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from blender_scenes.materials.base import Aim, Material, Placed, Stand
from blender_scenes.materials.graph import (
    GAIN,
    LEAST,
    Angles,
    Graph,
    Surface,
    angles,
    diffuse_closure,
    glossy_closure,
    group_tree,
    width_of,
)
from blender_scenes.materials.microfacet import seen
from blender_scenes.materials.texture import Texture, publish


class OneLight(Material):
    """Subclasses say what their graph is given (`inputs`) and what it makes of that under a light (`lobes`)."""

    one_light: ClassVar[bool] = True

    specular: Any
    """The lobe's reflectance: (3,) numbers, or a texture."""

    @property
    def coloured(self) -> bool:
        """Whether a light is written in three channels and not in one."""
        textured = isinstance(self.specular, Texture) or isinstance(self.albedo, Texture)
        return textured or len(set(self.specular)) > 1

    def inputs(self, graph: Graph, stand: Stand) -> dict[str, Any]:
        """What `lobes` is given by name: numbers, tuples of three, or outputs of the graph. They hold the lobe's "shine" and "gloss" (its
        alpha) and, where there is a base, its "albedo", to which the diffuse lobe is proportional."""
        raise NotImplementedError

    @staticmethod
    def lobes(graph: Graph, at: Angles, given: Mapping[str, Any]) -> tuple[Any, Any]:
        """What the diffuse lobe is worth, or None where there is none, and the specular one: vectors, or numbers where what they are made
        of is."""
        raise NotImplementedError

    def put(self, stand: Stand, lights: Sequence[Aim] = ()) -> Placed:
        """The material as a Blender material. lights: those whose parts are written as shader outputs, for each i

        diffuse_i, specular_i: radiance under unit intensity, without cast shadows, one number where all channels are the same; the diffuse
        one divided by the albedo where that is the same everywhere. received_i: irradiance / pi, n.l of a sun.
        """
        graph = Surface(type(self).__name__)
        inputs = self.inputs(graph, stand)
        first = graph.group(self._tree(stand, inputs), inputs)
        values = {"albedo": inputs.get("albedo", inputs["shine"]), "gloss": inputs["gloss"]}
        plain = inputs | _without_colour(inputs)
        for i, aim in enumerate(lights):
            node = graph.group(self._tree(stand, plain), plain)
            _point(node, aim)
            values |= {f"{name}_{i}": node.outputs[name] for name in ("diffuse", "specular", "received") if name in node.outputs}
        closures = [glossy_closure(graph, first.outputs["specular colour"], 1.0)]
        if "diffuse colour" in first.outputs:
            closures.insert(0, diffuse_closure(graph, first.outputs["diffuse colour"]))
        passes = publish(graph, **values)
        return Placed(graph.finish(*closures), lambda aim: _point(first, aim), GAIN, passes)

    def _tree(self, stand: Stand, inputs: Mapping[str, Any]) -> Any:
        """The group that makes colours and radiances of such inputs and a light."""

        def fill(graph: Graph, given: Mapping[str, Any]) -> dict[str, Any]:
            at = angles(graph, stand.view, given["light"], given["near"], given["distance2"])
            diffuse, specular = self.lobes(graph, at, given)
            received = graph.math("MULTIPLY", at.mi, at.reach)
            both = graph.math("MULTIPLY", graph.math("ADD", at.mi, at.mo), 2 * GAIN)
            found = {
                "specular colour": graph.calc("MULTIPLY", specular, both),
                "specular": graph.calc("MULTIPLY", specular, received),
                "received": received,
            }
            if diffuse is not None:
                least = graph.calc("MULTIPLY", given["albedo"], graph.math("MULTIPLY", seen(graph, at), GAIN * LEAST))
                found["diffuse colour"] = graph.calc("MAXIMUM", graph.calc("MULTIPLY", diffuse, GAIN), least)
                found["diffuse"] = graph.calc("MULTIPLY", diffuse, received)
            return found

        widths = {name: width_of(value) for name, value in inputs.items()}
        # Short, since Blender cuts names off at 63 letters.
        view = "perspective" if stand.view is None else "orthographic"
        name = f"{type(self).__name__} {view} {''.join(map(str, widths.values()))}"
        return group_tree(name, {**widths, "light": 3, "near": 1, "distance2": 1}, fill)


def _without_colour(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Those of albedo and shine that can be one number, as that: less to work out and to write."""
    found: dict[str, Any] = {}
    if isinstance(inputs.get("albedo"), tuple):
        found["albedo"] = 1.0
    if isinstance(inputs["shine"], tuple) and len(set(inputs["shine"])) == 1:
        found["shine"] = inputs["shine"][0]
    return found


def _point(node: Any, aim: Aim) -> None:
    """Tell a group of `OneLight` its light."""
    where, near = aim
    node.inputs["light"].default_value = tuple(float(v) for v in where)
    node.inputs["near"].default_value = float(near)
    node.inputs["distance2"].default_value = float(where @ where) if near else 1.0
