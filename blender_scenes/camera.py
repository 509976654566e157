"""The two cameras, at (0, 0, distance) looking along -z, x right, y up."""

from __future__ import annotations

from typing import Any

from blender_scenes.job import Job, Orthographic
from blender_scenes.studio import blender

SENSOR = 36.0
"""Blender's sensor width in mm. Only its ratio to the focal length matters."""


def put_camera(scene: Any, job: Job) -> Any:
    """Place the job's camera and set the picture's size, supersampling included. Returns the camera object.

    Perspective: OpenCV's K has y down and pixel centres at integers, so the principal point lies cx + 1/2 pixels from the picture's
    left edge; Blender's shifts are in picture widths (sensor_fit HORIZONTAL), and its pixel aspect carries fx / fy.
    """
    bpy = blender()
    data = bpy.data.cameras.new("camera")
    item = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(item)
    scene.camera = item
    item.location = (0.0, 0.0, job.camera.distance)
    nearest, farthest = _range(job)
    data.clip_start = 0.5 * nearest
    data.clip_end = 2.0 * farthest
    data.sensor_fit = "HORIZONTAL"
    render = scene.render
    render.resolution_x = job.width * job.supersampling
    render.resolution_y = job.height * job.supersampling
    aspect = 1.0
    if isinstance(job.camera, Orthographic):
        data.type = "ORTHO"
        data.ortho_scale = job.camera.width
    else:
        K = job.camera.K
        data.type = "PERSP"
        data.sensor_width = SENSOR
        data.lens = float(K[0, 0]) * SENSOR / job.width
        aspect = float(K[0, 0] / K[1, 1])
        data.shift_x = (job.width / 2 - float(K[0, 2]) - 0.5) / job.width
        data.shift_y = (float(K[1, 2]) + 0.5 - job.height / 2) / job.width * aspect
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1 / aspect), max(1.0, aspect)
    return item


def _range(job: Job) -> tuple[float, float]:
    """Distances along -z from the camera to the nearest and the farthest vertex."""
    depth = job.camera.distance - job.posed_mesh().vertices[:, 2]
    return float(depth.min()), float(depth.max())
