"""The two cameras, at (0, 0, distance) looking along -z, x right, y up."""

from __future__ import annotations

import math
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


def object_box(job: Job) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 of the pixels that can show the object, a pixel to spare on each side, the last two exclusive; the whole frame
    where it is out of sight."""
    points = job.posed_mesh.vertices
    if isinstance(job.camera, Orthographic):
        scale = job.width / job.camera.width
        x, y = points[:, 0] * scale + job.width / 2, job.height / 2 - points[:, 1] * scale
    else:
        depth = job.camera.distance - points[:, 2]
        K = job.camera.K
        x, y = K[0, 0] * points[:, 0] / depth + K[0, 2] + 0.5, K[1, 2] + 0.5 - K[1, 1] * points[:, 1] / depth
    x0, y0 = max(0, math.floor(x.min()) - 1), max(0, math.floor(y.min()) - 1)
    x1, y1 = min(job.width, math.ceil(x.max()) + 1), min(job.height, math.ceil(y.max()) + 1)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else (0, 0, job.width, job.height)


def crop_to(scene: Any, job: Job, box: tuple[int, int, int, int]) -> None:
    """Render the pixels of a box only (see `object_box`)."""
    render, n = scene.render, job.supersampling
    x0, y0, x1, y1 = box
    width, height = render.resolution_x, render.resolution_y
    render.use_border = render.use_crop_to_border = box != (0, 0, job.width, job.height)
    # Blender cuts the products off to whole pixels, and counts rows from below.
    render.border_min_x, render.border_max_x = (n * x0 + 0.25) / width, (n * x1 + 0.25) / width
    render.border_min_y, render.border_max_y = (height - n * y1 + 0.25) / height, (height - n * y0 + 0.25) / height


def _range(job: Job) -> tuple[float, float]:
    """Distances along -z from the camera to the nearest and the farthest vertex."""
    depth = job.camera.distance - job.posed_mesh.vertices[:, 2]
    return float(depth.min()), float(depth.max())
