"""A bare Cycles loop over the shots of jobs, with the results thrown away: what a benchmark holds the whole product against.

python -m blender_scenes.bare JOBS.json [--threads N]     prints the seconds of the loop, start-up left out, as the last line

Scene, material, lights, crop and samples are those of the jobs; nothing is fetched from Blender, averaged, checked or written.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from blender_scenes.camera import crop_to, object_box, put_camera
from blender_scenes.job import parse
from blender_scenes.light import Rig, tell
from blender_scenes.passes import switch_on
from blender_scenes.studio import blender, empty_scene, put_mesh, sample_by, take_out


def loop(scene: Any, jobs: Sequence[object]) -> float:
    """Render every picture of the jobs. Returns the seconds it took. Raises JobError where a job is wrong."""
    bpy = blender()
    began = time.perf_counter()
    for given in jobs:
        job = parse(given)
        placed = job.material.put(job.stand)
        item, camera = put_mesh(scene, job.posed_mesh), put_camera(scene, job)
        item.data.materials.append(placed.item)
        crop_to(scene, job, object_box(job) if job.crop else (0, 0, job.width, job.height))
        sample_by(scene, job.samples, job.bounces, job.seed)
        switch_on(scene, placed.passes, indirect=job.bounces > 0)
        rig = Rig(scene)
        for lights in job.lights:
            rig.show(lights, placed.gain)
            tell(placed, lights[0])
            bpy.ops.render.render()
        rig.clear()
        take_out(camera)
        take_out(item)
    return time.perf_counter() - began


def main(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(prog="blender_scenes.bare", description="A bare Cycles loop over the shots of jobs.")
    parser.add_argument("jobs", type=Path, help="a JSON list of jobs")
    parser.add_argument("--threads", type=int, default=0, help="Cycles' threads (default: all cores)")
    options = parser.parse_args(arguments)
    jobs = json.loads(options.jobs.read_text(encoding="utf-8"))
    scene = empty_scene(options.threads)
    loop(scene, jobs[:1])
    seconds = loop(scene, jobs)
    print(f"\n{seconds:.4f}")


if __name__ == "__main__":
    main(sys.argv[1:])
