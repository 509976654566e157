"""The sun: parallel light from a unit direction, without any width, so that shading under it holds no noise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from blender_scenes.job import Sun
from blender_scenes.studio import blender


def put_sun(scene: Any) -> Any:
    """A sun of angle 0 in the scene; `aim` gives it direction and strength. Returns the light object."""
    bpy = blender()
    data = bpy.data.lights.new("sun", "SUN")
    data.angle = 0.0
    item = bpy.data.objects.new("sun", data)
    item.rotation_mode = "QUATERNION"
    scene.collection.objects.link(item)
    return item


def aim(item: Any, sun: Sun, gain: float = 1.0) -> None:
    """Turn the light object to a sun and set its strength.

    Blender's strength of a sun is its irradiance, pi times the project's intensity. gain: divides the strength (see
    `blender_scenes.substrate.GAIN`).
    """
    from mathutils import Vector

    item.rotation_quaternion = Vector(sun.direction).to_track_quat("Z", "Y")
    strongest = float(np.max(sun.intensity))
    item.data.energy = math.pi * strongest / gain
    item.data.color = tuple(sun.intensity / strongest) if strongest > 0 else (0.0, 0.0, 0.0)
