"""One shot: a job in, its layers out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from blender_scenes import layers
from blender_scenes.camera import crop_to, object_box, put_camera
from blender_scenes.errors import JobError
from blender_scenes.job import Job, parse
from blender_scenes.light import Light, Point, Rig, Sun, tell
from blender_scenes.materials import Material, Placed
from blender_scenes.materials.lambertian import Lambertian
from blender_scenes.materials.mirror import Mirror
from blender_scenes.passes import render, switch_on
from blender_scenes.studio import put_mesh, remove_material, sample_by, take_out

Arrays = dict[str, NDArray[Any]]


def shoot(scene: Any, job: object, route: str = "auto") -> tuple[Arrays, str]:
    """Render a job in a scene of `studio.empty_scene`, which is left empty again. Returns the layers and the route of the pixels.

    Arrays, rows top to bottom: coverage (H, W); normal (H, W, 3) unit, zero outside; depth (H, W) mm along -z from the camera, NaN
    outside; albedo (H, W, 3) of the matte twin; gloss (H, W) alpha. Of each picture, as the job's "layers" ask: combined, diffuse,
    specular, matte (the Lambertian twin), ks0 (the picture with Ks = 0), mirror (the same shape as a perfect mirror), each (K, H, W, 3);
    lit (K, H, W) share of the sub-samples that the light reaches, for pictures with one sun or point light (1 elsewhere); and always
    sum_error (K,), the largest |combined - (diffuse + specular)| of any sub-sample over the largest combined. With "crop" the arrays hold
    the pixels of box (4,): x0, y0, x1, y1, the last two exclusive. Raises JobError where the job is wrong.
    """
    checked = parse(job)
    asked = set(checked.layers)
    if "lit" in asked and "matte" not in asked:
        raise JobError("job: layers: lit needs matte")
    box = object_box(checked) if checked.crop else (0, 0, checked.width, checked.height)
    studio = _Studio(scene, checked, box, route)
    try:
        separate = checked.material.own_twin or checked.bounces > 0
        main = asked & {"combined", "diffuse", "specular"} | (set() if separate else asked & {"matte", "lit"})
        shot = studio.pictures(checked.material, main, view=True)
        if separate and "matte" in asked:
            twin = studio.pictures(Lambertian(checked.material.albedo), {"diffuse"} | asked & {"lit"})
            shot |= {"matte": twin.pop("diffuse"), **{key: twin[key] for key in asked & {"lit"}}}
        if "ks0" in asked:
            bare = checked.material.without_gloss()
            if bare is None:
                raise JobError("job: layers: ks0 means nothing for this material")
            shot["ks0"] = studio.pictures(bare, {"combined"})["combined"]
        if "mirror" in asked:
            # One direction is reflected: far fewer samples do.
            sample_by(scene, max(1, checked.samples // 8), checked.bounces, checked.seed)
            # Compressed environment maps hold values a little below 0.
            shot["mirror"] = np.maximum(studio.pictures(Mirror(), {"combined"})["combined"], 0)
    finally:
        studio.close()
    if checked.crop:
        shot["box"] = np.array(box, np.int32)
    return shot, studio.route


class _Studio:
    """The scene while one job is shot: the object in it, and the lights."""

    def __init__(self, scene: Any, job: Job, box: tuple[int, int, int, int], route: str) -> None:
        self.scene, self.job, self.box, self.route = scene, job, box, route
        self.items: list[Any] = []
        self.rig = Rig(scene)
        try:
            self.object = put_mesh(scene, job.posed_mesh)
            self.items.append(self.object)
            self.items.append(put_camera(scene, job))
            crop_to(scene, job, box)
            sample_by(scene, job.samples, job.bounces, job.seed)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Leave the scene empty."""
        self.rig.clear()
        for item in reversed(self.items):
            take_out(item)

    def pictures(self, material: Material, wanted: set[str], view: bool = False) -> Arrays:
        """The wanted layers of every picture in one material. view: also what does not depend on the light, and sum_error."""
        job, n = self.job, self.job.supersampling
        placed = material.put(job.stand)
        slots = self.object.data.materials
        old = slots[0] if len(slots) else None
        if old is None:
            slots.append(placed.item)
        else:
            slots[0] = placed.item
            remove_material(old)
        x0, y0, x1, y1 = self.box
        found: Arrays = {name: np.empty((len(job.lights), y1 - y0, x1 - x0, 3), np.float32) for name in wanted - {"lit"}}
        if "lit" in wanted:
            found["lit"] = np.ones((len(job.lights), y1 - y0, x1 - x0), np.float32)
        errors = np.zeros(len(job.lights), np.float32)
        for k, lights in enumerate(job.lights):
            # What holds for one light alone is added up: light is additive.
            groups = [(light,) for light in lights] if material.one_light else [lights]
            before: Arrays = {}
            for group in groups:
                passes = self._render(placed, group)
                last, largest = group is groups[-1], np.zeros(2)
                for fine, rows in layers.strips((y1 - y0) * n, x1 - x0, n):
                    strip = {name: values[fine] for name, values in passes.items()}
                    parts, *extremes = layers.radiance(strip, material, placed, wanted)
                    largest = np.maximum(largest, extremes)
                    for name, part in parts.items():
                        if name in before:
                            part += before[name][fine]
                        if last:
                            found[name][k, rows] = layers.block_mean(part, n)
                        else:
                            before.setdefault(name, np.zeros((*passes["Combined"].shape[:2], 3), np.float32))[fine] = part
                off, peak = largest
                errors[k] = max(errors[k], off / peak if peak > 0 else float(off > 0))
                if view and k == 0 and "coverage" not in found:
                    found |= layers.view(passes, material, n)
            if "lit" in wanted and len(lights) == 1 and isinstance(lights[0], Sun | Point):
                found["lit"][k] = layers.lit(passes, n)
        if view:
            found["sum_error"] = errors
        return found

    def _render(self, placed: Placed, group: tuple[Light, ...]) -> dict[str, layers.Floats]:
        self.rig.show(group, placed.gain)
        tell(placed, group[0])
        names = switch_on(self.scene, placed.passes, indirect=self.job.bounces > 0)
        passes, self.route = render(self.scene, self.route, names)
        return passes
