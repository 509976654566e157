"""Several lights of a convex object by one render, against a render for each light; and what happens when the object is not convex."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from blender_scenes.entries import Entries
from blender_scenes.job import parse as parse_job
from blender_scenes.materials import parse
from blender_scenes.shapes import CONVEX as CONVEX_BY_NAME
from blender_scenes.shapes import SHAPES, build
from blender_scenes.shot import TOGETHER
from tests.blender_scenes.test_materials import CASES, EXAMPLES

pytestmark = pytest.mark.render

CONVEX = ("capsule", "cone", "cylinder", "ellipsoid", "rounded_box", "sphere", "superquadric", "truncated_cone")
"""The shapes that are convex with their defaults; `tests.blender_scenes.shapes.test_convex` has the proof."""

NEAR = {"kind": "point", "position": [60.0, 80.0, 100.0], "intensity": [1.0, 1.0, 2.0]}
SUNS = [
    {"direction": [0.6, 0.0, 0.8], "intensity": [1.0, 0.8, 0.5]},
    {"direction": [-0.48, 0.64, 0.6], "intensity": [1.0, 2.0, 0.5]},
    {"direction": [0.0, -0.96, -0.28], "intensity": [1.0, 1.0, 1.0]},
]
PICTURES: list[Any] = [SUNS[0], NEAR, [SUNS[1], {**NEAR, "position": [-70.0, 20.0, 90.0]}], SUNS[2]]
"""A sun, a light that is near, both at once, and one from behind, which grazes."""

ONE_LIGHT = [(kind, i) for kind, i in CASES if parse(Entries("material", {"kind": kind, **EXAMPLES[kind][i]})).one_light]
LAYERS = ["combined", "diffuse", "specular", "matte", "lit"]


def one_by_one(worker: Any, job: dict[str, Any]) -> dict[str, np.ndarray]:
    """The layers of a job whose pictures are rendered each in a job of its own; no picture holds more than two lights."""
    alone = [worker.render({**job, "lights": [picture], "together": False}) for picture in job["lights"]]
    assert "coverage" in alone[0]
    return {
        name: np.concatenate([layers[name] for layers in alone]) if layers_of_pictures(name) else values
        for name, values in alone[0].items()
    }


def layers_of_pictures(name: str) -> bool:
    return name in (*LAYERS, "ks0", "sum_error")


def assert_same(together: dict[str, np.ndarray], alone: dict[str, np.ndarray]) -> None:
    """To 1e-6 of each layer's peak (measured: 4e-7), but for a few pixels on the silhouette, where Cycles' ray to the light may start
    within the object."""
    # Only the first light of a render has a sum of Cycles' own to be compared with.
    assert (together["sum_error"] == 0).any()
    assert together.keys() == alone.keys()
    for name, values in alone.items():
        if name == "sum_error":
            continue
        peak = float(np.nanmax(np.abs(values)))
        off = np.nan_to_num(np.abs(together[name].astype(float) - values)) > 1e-6 * max(peak, 1e-9)
        assert off.sum() <= 2e-4 * off.size, (name, off.sum())


@pytest.mark.parametrize("camera", ["orthographic", "perspective"])
@pytest.mark.parametrize("shape", CONVEX)
def test_every_convex_shape_is_what_its_lights_show_one_by_one(worker, job, shape: str, camera: str) -> None:
    # A mesh is looked at where it has fewer faces than the picture has sub-samples.
    size = (48, 40) if shape in CONVEX_BY_NAME else (256, 260)
    asked = job(shape, camera, size=size, n=2, lights=PICTURES, layers=[*LAYERS, "ks0"], together=True)
    assert_same(worker.render(asked), one_by_one(worker, asked))


@pytest.mark.parametrize(("kind", "example"), ONE_LIGHT)
def test_every_material_is_what_its_lights_show_one_by_one(worker, job, kind: str, example: int) -> None:
    material = {"kind": kind, **EXAMPLES[kind][example]}
    asked = job("rounded_box", "perspective", size=(40, 40), material=material, lights=PICTURES, layers=LAYERS, together=True)
    assert_same(worker.render(asked), one_by_one(worker, asked))


@pytest.mark.parametrize("grey", [False, True])
def test_textures_and_grey_gloss_are_kept(worker, job, grey: bool) -> None:
    """Where the gloss has no colour it is written as one number; a textured albedo as three."""
    low, high = [0.1, 0.1, 0.3], [0.8, 0.5, 0.3]
    material = {
        "kind": "substrate",
        "diffuse": {"texture": "noise", "scale": 6.0, "low": low, "high": high},
        "specular": [0.3, 0.3, 0.3] if grey else {"texture": "cells", "scale": 9.0, "low": high, "high": low},
        "alpha": {"texture": "cells", "scale": 8.0, "low": 0.05, "high": 0.4},
    }
    asked = job("sphere", "orthographic", size=(48, 40), n=2, material=material, lights=PICTURES, layers=LAYERS, together=True)
    assert_same(worker.render(asked), one_by_one(worker, asked))


def test_more_lights_than_one_render_takes(worker, job) -> None:
    turns = np.linspace(0, 2 * np.pi, 2 * TOGETHER + 3, endpoint=False)
    lights = [{"direction": [0.6 * np.cos(a), 0.6 * np.sin(a), 0.8], "intensity": [1.0, 1.0, 1.0]} for a in turns]
    asked = job("cylinder", "orthographic", size=(40, 32), lights=lights, layers=LAYERS, together=True)
    together = worker.render(asked)
    assert len(together["combined"]) == len(lights)
    assert_same(together, one_by_one(worker, asked))
    # The sum and both parts are each rounded once.
    np.testing.assert_allclose(together["combined"], together["diffuse"] + together["specular"], rtol=3e-7)


def test_the_file_gives_the_same_bits(worker, start, job) -> None:
    by_file = start("--route", "exr")
    try:
        asked = job("cylinder", "orthographic", size=(40, 32), lights=PICTURES, layers=LAYERS, together=True)
        layers = by_file.render(asked)
        for name, array in worker.render(asked).items():
            assert array.tobytes() == layers[name].tobytes(), name
    finally:
        by_file.close()


FOOLED = """
import json, sys
from blender_scenes.shapes.mesh import Mesh
from blender_scenes.shot import shoot
from blender_scenes.studio import empty_scene

Mesh.is_convex = lambda self: True
scene = empty_scene(2)
try:
    shoot(scene, json.loads(sys.argv[1]))
except RuntimeError as error:
    assert "counts as convex" in str(error)
else:
    raise SystemExit("not found out")
"""


def test_an_object_that_is_not_convex_after_all_is_found_out(python, job) -> None:
    """Were a shaft with steps taken for convex, the first light's own render would show its cast shadow."""
    lights = [{**SUNS[0], "direction": [-0.48, 0.84, 0.2528]}, *SUNS]
    python(
        FOOLED, json.dumps(job("stepped_shaft", "orthographic", size=(48, 40), n=2, lights=lights, layers=LAYERS, together=True))
    )


def test_lights_that_are_shared_out_give_the_same_bits(worker, job) -> None:
    """However the lights of a capture are split into jobs."""
    asked = job("cylinder", "perspective", size=(40, 32), n=2, lights=PICTURES, layers=LAYERS, together=True)
    whole = worker.render(asked)
    for k, picture in enumerate(PICTURES):
        alone = worker.render({**asked, "lights": [picture]})
        for name in LAYERS:
            assert alone[name][0].tobytes() == whole[name][k].tobytes(), (name, k)


GROUPS = """
import json, sys
from blender_scenes.shot import shoot
from blender_scenes.studio import blender, empty_scene

scene, counts = empty_scene(2), []
for _ in range(2):
    for job in json.loads(sys.argv[1]):
        shoot(scene, job)
    data = blender().data
    counts.append([len(data.node_groups), len(data.materials), len(data.meshes), len(data.lights)])
assert counts[0] == counts[1], counts
assert counts[0][1:] == [0, 0, 0], counts
"""


def test_graphs_are_made_once(python, job) -> None:
    """A second job of the same kind, with other values, finds the groups of the first."""
    jobs = [
        job("cylinder", "orthographic", size=(16, 16), lights=SUNS, layers=LAYERS[:3], together=together, material=material)
        for kind, i in ONE_LIGHT
        for together in (False, True)
        for material in [{"kind": kind, **EXAMPLES[kind][i]}]
    ]
    python(GROUPS, json.dumps(jobs))


def test_every_convex_shape_is_looked_at() -> None:
    assert set(CONVEX) == {name for name in SHAPES if build(name).is_convex()}


def test_a_job_knows_whether_its_object_is_convex(job) -> None:
    assert parse_job(job("cylinder", "orthographic")).convex
    grooved = {"name": "cylinder", "parameters": {}, "detail": [{"kind": "grooves", "pitch": 3.0}]}
    assert not parse_job(job("cylinder", "orthographic", shape=grooved)).convex
    assert not parse_job(job("gear", "orthographic")).convex
