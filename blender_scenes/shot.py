"""One shot: a job in, its layers out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from blender_scenes import layers
from blender_scenes.camera import put_camera
from blender_scenes.job import Job, Orthographic, parse
from blender_scenes.light import aim, put_sun
from blender_scenes.passes import render
from blender_scenes.studio import put_mesh, take_out
from blender_scenes.substrate import GAIN, set_light, substrate

RADIANCE = ("combined", "diffuse", "specular", "matte")


def shoot(scene: Any, job: object, route: str = "auto") -> tuple[dict[str, NDArray[np.float32]], str]:
    """Render a job in a scene of `studio.empty_scene`, which is left empty again. Returns the layers and the route of the pixels.

    Arrays, rows top to bottom: coverage (H, W); normal (H, W, 3) unit, zero outside; depth (H, W) mm along -z from the camera, NaN
    outside; albedo (H, W, 3); gloss (H, W); and of each light combined, diffuse, specular, matte (K, H, W, 3). Raises JobError where
    the job is wrong.
    """
    checked = parse(job)
    view = (0.0, 0.0, 1.0) if isinstance(checked.camera, Orthographic) else None
    material, light = substrate(checked.material, view)
    items = [put_mesh(scene, checked.posed_mesh(), material)]
    try:
        items.append(put_camera(scene, checked))
        items.append(put_sun(scene))
        return _lights(scene, checked, items[-1], light, route)
    finally:
        for item in reversed(items):
            take_out(item)


def _lights(scene: Any, job: Job, item: Any, node: Any, route: str) -> tuple[dict[str, NDArray[np.float32]], str]:
    """The shot's arrays: only the light changes from render to render, so what belongs to the view is taken from the first."""
    n, (height, width) = job.supersampling, (job.height, job.width)
    shot = {name: np.empty((len(job.lights), height, width, 3), np.float32) for name in RADIANCE}
    for k, sun in enumerate(job.lights):
        aim(item, sun, GAIN)
        set_light(node, sun.direction)
        # With persistent data Blender must be told that something changed.
        scene.update_tag()
        passes, route = render(scene, route)
        for name, array in layers.radiance(passes, job.material.diffuse).items():
            shot[name][k] = layers.block_mean(array, n)
        if k == 0:
            shot.update(layers.view(passes, job.material, n))
    return shot, route
