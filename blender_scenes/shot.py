"""One shot: a job in, its layers out.

There are two ways to the pictures. In the plain one each light is rendered on its own, and shadows are Cycles'. A convex object has
attached shadows alone, so that a material which knows its lights (`blender_scenes.materials.one_light`) can write what each of them shows:
one render then serves several, where a job allows it. What the two ways show differs by rounding alone, and but for the few sub-samples
on a silhouette whose ray to the light Cycles lets start within the object. The first light of each render is rendered both ways, and
compared.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from blender_scenes import layers
from blender_scenes.camera import crop_to, object_box, put_camera
from blender_scenes.errors import JobError
from blender_scenes.job import Job, parse
from blender_scenes.light import Light, Point, Rig, Sun, aim_at, tell
from blender_scenes.materials import Material, Placed
from blender_scenes.materials.lambertian import Lambertian
from blender_scenes.materials.mirror import Mirror
from blender_scenes.materials.one_light import OneLight
from blender_scenes.passes import render, switch_on
from blender_scenes.studio import put_mesh, remove_material, sample_by, take_out

Arrays = dict[str, NDArray[Any]]

TOGETHER = 8
"""The most lights of one render."""

STRAY, STRAYS = 0.02, 16
"""The share, and number, of the object's sub-samples that may differ between the two ways."""

ROOM = 1 << 23
"""The most numbers that a render may write for its lights: three or, of materials in colour, nine for each sub-sample and light. Each is
held three times over."""


def shoot(scene: Any, job: object, route: str = "auto") -> tuple[Arrays, str]:
    """Render a job in a scene of `studio.empty_scene`, which is left empty again. Returns the layers and the route of the pixels.

    Arrays, rows top to bottom: coverage (H, W); normal (H, W, 3) unit, zero outside; depth (H, W) mm along -z from the camera, NaN
    outside; albedo (H, W, 3) of the matte twin; gloss (H, W) alpha. Of each picture, as the job's "layers" ask: combined, diffuse,
    specular, matte (the Lambertian twin), ks0 (the picture with Ks = 0), mirror (the same shape as a perfect mirror), each (K, H, W, 3);
    lit (K, H, W) share of the sub-samples that the light reaches, for pictures with one sun or point light (1 elsewhere); and always
    sum_error (K,), the largest |combined - (diffuse + specular)| of any sub-sample over the largest combined, 0 for the further lights of a
    render. With "crop" the arrays hold the pixels of box (4,): x0, y0, x1, y1, the last two exclusive. Raises JobError where the job is
    wrong.
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
        self.scene, self.job, self.route = scene, job, route
        self._width, self._height = box[2] - box[0], box[3] - box[1]
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
        job = self.job
        if job.together and isinstance(material, OneLight):
            samples = self._height * self._width * job.supersampling**2
            most = min(TOGETHER, ROOM // (samples * (9 if material.coloured else 3)))
            # To find out whether a mesh is convex takes about as long as a light of so many sub-samples.
            if most > 1 and (job.solid or samples > len(job.mesh.faces)) and job.convex:
                return self._together(material, wanted, view, most)
        return self._each(material, wanted, view)

    def _each(self, material: Material, wanted: set[str], view: bool) -> Arrays:
        """`pictures`, a light at a time where the material asks for that."""
        job, n = self.job, self.job.supersampling
        placed = material.put(job.stand)
        self._wear(placed)
        found = self._empty(wanted)
        errors = np.zeros(len(job.lights), np.float32)
        for k, lights in enumerate(job.lights):
            # What holds for one light alone is added up: light is additive.
            groups = [(light,) for light in lights] if material.one_light else [lights]
            before: Arrays = {}
            for group in groups:
                passes = self._render(placed, group)
                last, largest = group is groups[-1], np.zeros(2)
                for fine, rows in layers.strips(self._height * n, self._width, n):
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

    def _together(self, material: OneLight, wanted: set[str], view: bool, most: int) -> Arrays:
        """`pictures` of a convex object, up to `most` lights a render. Pictures are the sum of their parts, so that sum_error speaks of the
        first light of each render alone. Raises RuntimeError where Cycles' own lobes show something else there."""
        job, n = self.job, self.job.supersampling
        found = self._empty(wanted)
        for name in wanted - {"lit"}:
            found[name].fill(0)
        errors = np.zeros(len(job.lights), np.float32)
        lights = [(k, light) for k, picture in enumerate(job.lights) for light in picture if isinstance(light, Sun | Point)]
        for start in range(0, len(lights), most):
            chunk = lights[start : start + most]
            placed = material.put(job.stand, [aim_at(light) for _, light in chunk])
            self._wear(placed)
            passes = self._render(placed, (chunk[0][1],))
            differing, largest = 0, np.zeros(2)
            for fine, rows in layers.strips(self._height * n, self._width, n):
                strip = {name: values[fine] for name, values in passes.items()}
                own, *extremes = layers.radiance(strip, material, placed, {"diffuse", "specular"})
                largest = np.maximum(largest, extremes)
                differing += layers.differing(own, strip, material, chunk[0][1].intensity)
                for i, (k, light) in enumerate(chunk):
                    for name, part in layers.written(strip, material, i, light.intensity, wanted, n).items():
                        if name != "lit":
                            found[name][k, rows] += part
                        elif len(job.lights[k]) == 1:
                            found[name][k, rows] = part
            seen = int((passes["Combined"][..., 3] > 0.5).sum())
            if differing > max(STRAY * seen, STRAYS):
                raise RuntimeError(
                    f"the object counts as convex, but {differing} of its {seen} sub-samples show else than Cycles' own lobes and shadows"
                )
            off, peak = largest
            errors[chunk[0][0]] = off / peak if peak > 0 else float(off > 0)
            if view and start == 0:
                found |= layers.view(passes, material, n)
        if view:
            found["sum_error"] = errors
        return found

    def _wear(self, placed: Placed) -> None:
        """Put a material on the object, and remove the one that it wore."""
        slots = self.object.data.materials
        if not len(slots):
            slots.append(placed.item)
            return
        old = slots[0]
        slots[0] = placed.item
        remove_material(old)

    def _empty(self, wanted: set[str]) -> Arrays:
        """Arrays for the wanted layers of all pictures."""
        shape = (len(self.job.lights), self._height, self._width)
        found: Arrays = {name: np.empty((*shape, 3), np.float32) for name in wanted - {"lit"}}
        return found | ({"lit": np.ones(shape, np.float32)} if "lit" in wanted else {})

    def _render(self, placed: Placed, group: tuple[Light, ...]) -> dict[str, layers.Floats]:
        self.rig.show(group, placed.gain)
        tell(placed, group[0])
        names = switch_on(self.scene, placed.passes, indirect=self.job.bounces > 0)
        passes, self.route = render(self.scene, self.route, names)
        return passes
