"""Lights: what a job says of them, and how they stand in a scene. Everywhere the intensity is irradiance / pi at the object.

    {"kind": "sun", "direction": [x, y, z], "intensity": [r, g, b]}        parallel, without width ("kind" may be left out)
    {"kind": "point", "position": [x, y, z], "intensity": ...}             mm; the intensity is that at the origin, falling with distance^2
    {"kind": "area", "position": [x, y, z], "diameter": d, "intensity": ...}   a disc that faces the origin, even radiance
    {"kind": "environment", "map": name or path, "rotation": degrees, "intensity": ...}   a panorama, y up; its radiance is multiplied
    {"kind": "ambient", "intensity": ...}                                  the same radiance from everywhere

The panorama is an equirectangular picture: its middle is what lies behind the camera, toward +z, and its right half what is on the left
of the picture, toward -x; "rotation" turns it about the y axis, from +z to +x.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from blender_scenes.entries import Entries, Numbers
from blender_scenes.errors import JobError
from blender_scenes.materials.base import Aim, Placed
from blender_scenes.studio import blender, take_out


@dataclass(frozen=True, eq=False)
class Sun:
    """direction: (3,) unit vector to the light. intensity: (3,) irradiance / pi."""

    direction: Numbers
    intensity: Numbers


@dataclass(frozen=True, eq=False)
class Point:
    """position: (3,) mm. intensity: (3,) irradiance / pi of a surface at the origin that faces the light."""

    position: Numbers
    intensity: Numbers


@dataclass(frozen=True, eq=False)
class Area:
    """A disc that faces the origin. position: (3,) mm. diameter: mm. intensity: (3,) irradiance / pi of a facing surface at the origin."""

    position: Numbers
    diameter: float
    intensity: Numbers


@dataclass(frozen=True, eq=False)
class Environment:
    """map: name of a panorama that Blender brings, or a file. rotation: degrees about y. intensity: (3,) factor on its radiance."""

    map: str
    rotation: float
    intensity: Numbers


@dataclass(frozen=True, eq=False)
class Ambient:
    """intensity: (3,) the radiance that comes from everywhere."""

    intensity: Numbers


Light = Sun | Point | Area | Environment | Ambient
KINDS = ("sun", "point", "area", "environment", "ambient")


def parse_light(entries: Entries) -> Light:
    """One light of a job. Raises JobError, one line, where an entry is wrong."""
    kind = entries.text("kind", default="sun")
    light: Light
    if kind not in KINDS:
        raise JobError(f"{entries.where}.kind {kind!r} is unknown; there are {', '.join(KINDS)}")
    intensity = entries.numbers("intensity", (3,), low=0, high=1e6)
    if kind == "sun":
        direction = entries.numbers("direction", (3,))
        length = float(np.linalg.norm(direction))
        if not abs(length - 1) < 1e-3:
            raise JobError(f"{entries.where}.direction must be a unit vector, its length is {length:g}")
        light = Sun(direction / length, intensity)
    elif kind == "environment":
        light = Environment(entries.text("map"), entries.number("rotation", low=-360, high=360, default=0.0), intensity)
    elif kind == "ambient":
        light = Ambient(intensity)
    else:
        position = entries.numbers("position", (3,), low=-1e6, high=1e6)
        if not np.linalg.norm(position) > 1e-3:
            raise JobError(f"{entries.where}.position must not be the origin, where the object is")
        if kind == "point":
            light = Point(position, intensity)
        else:
            light = Area(position, entries.number("diameter", low=1e-3, high=1e6), intensity)
    entries.close()
    return light


def aim_at(light: Sun | Point) -> Aim:
    """Where a light is, for a graph that holds for one light."""
    return (light.direction, False) if isinstance(light, Sun) else (light.position, True)


def tell(placed: Placed, light: Light) -> None:
    """Tell a graph that holds for one light, a sun or a point light, where that is."""
    if placed.aim is not None and isinstance(light, Sun | Point):
        placed.aim(aim_at(light))


class Rig:
    """The lights of a scene. `show` makes them those of a picture; `clear` takes them out."""

    def __init__(self, scene: Any) -> None:
        self.scene = scene
        self._kinds: tuple[type, ...] = ()
        self._items: list[Any] = []

    def show(self, lights: Sequence[Light], gain: float = 1.0) -> None:
        """Light the scene by these alone, their strength divided by `gain`. Raises JobError where a panorama cannot be loaded."""
        kinds = tuple(type(light) for light in lights)
        if kinds != self._kinds or Environment in kinds or Ambient in kinds:
            self.clear()
            self._items = [_put(self.scene, kind) for kind in kinds if kind in _LAMPS]
            self._kinds = kinds
        for item, lamp in zip(self._items, (light for light in lights if type(light) in _LAMPS), strict=True):
            _aim(item, lamp, gain)
        around = [light for light in lights if isinstance(light, Environment | Ambient)]
        if around:
            self.scene.world = _world(around, gain)
        # With persistent data Blender must be told that something changed.
        self.scene.update_tag()

    def clear(self) -> None:
        """Take all lights out."""
        for item in self._items:
            take_out(item)
        self._items, self._kinds = [], ()
        world = self.scene.world
        if world is not None:
            bpy = blender()
            images = [node.image for node in world.node_tree.nodes if getattr(node, "image", None)]
            self.scene.world = None
            bpy.data.worlds.remove(world, do_unlink=True)
            for image in {image.name: image for image in images}.values():
                bpy.data.images.remove(image, do_unlink=True)


_LAMPS = {Sun: "SUN", Point: "POINT", Area: "AREA"}


def _put(scene: Any, kind: type) -> Any:
    bpy = blender()
    data = bpy.data.lights.new(_LAMPS[kind].lower(), _LAMPS[kind])
    if kind is Sun:
        data.angle = 0.0
    elif kind is Point:
        data.shadow_soft_size = 0.0
    else:
        data.shape = "DISK"
    if hasattr(data, "use_soft_falloff"):
        data.use_soft_falloff = False
    item = bpy.data.objects.new(data.name, data)
    item.rotation_mode = "QUATERNION"
    scene.collection.objects.link(item)
    return item


def _aim(item: Any, light: Light, gain: float) -> None:
    """Give a lamp its place and strength in Blender's units: a sun's is its irradiance, the others' is their power."""
    from mathutils import Vector

    strongest = float(np.max(light.intensity))
    item.data.color = tuple(light.intensity / strongest) if strongest > 0 else (0.0, 0.0, 0.0)
    irradiance = math.pi * strongest / gain
    if isinstance(light, Sun):
        direction, item.data.energy = light.direction, irradiance
    elif isinstance(light, Point | Area):
        direction, item.location = light.position, tuple(light.position)
        distance2 = float(light.position @ light.position)
        if isinstance(light, Point):
            item.data.energy = irradiance * 4 * math.pi * distance2
        else:
            # A disc of radiance L and radius r at distance d on its axis: irradiance pi L r^2 / (r^2 + d^2); its power is L pi (pi r^2).
            item.data.size = light.diameter
            item.data.energy = irradiance * math.pi * (distance2 + (light.diameter / 2) ** 2)
    item.rotation_quaternion = Vector(direction).to_track_quat("Z", "Y")


def panoramas() -> dict[str, Path]:
    """The panoramas that Blender brings (CC0, from Poly Haven), name and file."""
    bpy = blender()
    folder = Path(bpy.utils.system_resource("DATAFILES", path="studiolights/world"))
    return {path.stem: path for path in sorted(folder.glob("*.exr"))}


def _world(lights: Sequence[Light], gain: float) -> Any:
    """A world that shines as all of these together."""
    bpy = blender()
    world = bpy.data.worlds.new("world")
    if not world.use_nodes:
        world.use_nodes = True
    # Left to itself Cycles tabulates the panorama four times as finely, which takes a second a render and changes nothing.
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = 1024
    tree = world.node_tree
    tree.nodes.clear()
    total = None
    for light in lights:
        shine = tree.nodes.new("ShaderNodeBackground")
        shine.inputs["Color"].default_value = (*(float(c) / gain for c in light.intensity), 1.0)
        if isinstance(light, Environment):
            product = tree.nodes.new("ShaderNodeVectorMath")
            product.operation = "MULTIPLY"
            product.inputs[1].default_value = tuple(light.intensity / gain)
            tree.links.new(_panorama(tree, light), product.inputs[0])
            tree.links.new(product.outputs["Vector"], shine.inputs["Color"])
        if total is None:
            total = shine.outputs[0]
        else:
            both = tree.nodes.new("ShaderNodeAddShader")
            tree.links.new(total, both.inputs[0])
            tree.links.new(shine.outputs[0], both.inputs[1])
            total = both.outputs[0]
    output = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(total, output.inputs["Surface"])
    return world


def _panorama(tree: Any, light: Environment) -> Any:
    bpy = blender()
    known = panoramas()
    path = known.get(light.map, Path(light.map))
    if not path.is_file():
        raise JobError(f"job: lights: map {light.map!r} is no file; Blender brings {', '.join(known)}")
    try:
        image = bpy.data.images.load(str(path), check_existing=False)
        empty = image.size[0] * image.size[1] == 0
    except RuntimeError:
        empty = True
    if empty:
        raise JobError(f"job: lights: map {light.map!r} is no picture that Blender can read")
    # Blender's panoramas have z up and their middle toward +x; ours have y up and their middle toward +z.
    place = tree.nodes.new("ShaderNodeTexCoord")
    turn = tree.nodes.new("ShaderNodeMapping")
    turn.inputs["Rotation"].default_value = (math.pi / 2, 0.0, math.pi / 2 - math.radians(light.rotation))
    picture = tree.nodes.new("ShaderNodeTexEnvironment")
    picture.image = image
    tree.links.new(place.outputs["Generated"], turn.inputs["Vector"])
    tree.links.new(turn.outputs["Vector"], picture.inputs["Vector"])
    return picture.outputs["Color"]
