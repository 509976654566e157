"""From a spec to a capture: jobs for the farm, the arrays that come back (`gen.assemble` puts them together), and our folder.

A job is one light, or a few where the picture is small: so a crash costs little, progress shows, and workers share a capture. The
pixels do not depend on how lights are grouped.
"""

from __future__ import annotations

import math
import os
import struct
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.assemble import PER_VIEW, Rendered, assemble, layers_of
from gen.errors import InputError
from gen.farm import Farm, Outcome
from gen.files import writing_folder
from gen.formats.render_folder import write_files
from gen.spec import Spec
from gen.spec_parts import Orthographic

SAMPLES_PER_JOB = 1 << 21
"""Lights times sub-samples of a picture in one job: as a rule all of a capture's, so that its scene is set up once; some 200 MB at most."""

SUM_TOLERANCE = 1e-6
"""Largest |combined - (diffuse + specular)| of a render, relative to the picture's peak: float32 rounding of Cycles' own sum."""

ROUNDING = 2.0**-23
"""What each sample of a pixel may add to that, where many are summed up: a float32's step."""

Progress = Callable[[int, int], None]
"""Called with (pictures done, pictures in all)."""


class RenderFailed(InputError):
    """Blender failed although the spec is right."""


def render_capture(
    spec: Spec,
    folder: Path,
    workers: int = 1,
    blender: str | None = None,
    progress: Progress | None = None,
    farm: Farm | None = None,
) -> Rendered:
    """Render a spec into `folder` (see `gen.formats.render_folder`), which takes its place whole or not at all.

    workers, blender: see `gen.farm.Farm`; farm: one that is already open, which is used instead and left open.
    Raises MissingPart where Blender cannot be started, InputError where the spec shows nothing, RenderFailed where Blender fails.
    """
    with writing_folder(folder, "capture") as temporary:
        rendered = render(spec, workers, blender, progress, farm)
        write_files(rendered.capture, temporary, rendered.coverage, spec.half)
        (temporary / "spec.yaml").write_text(spec.yaml(), encoding="utf-8")
    return rendered


def render(
    spec: Spec, workers: int = 1, blender: str | None = None, progress: Progress | None = None, farm: Farm | None = None
) -> Rendered:
    """Render a spec to a capture in memory. See `render_capture`."""
    shots: dict[str, Mapping[str, NDArray[Any]]] = {}
    outcomes: list[Outcome] = []
    with (
        tempfile.TemporaryDirectory(prefix="degloss-") as scratch,
        nullcontext(farm) if farm is not None else Farm(workers, blender) as open_farm,
    ):
        jobs = jobs_of(spec, Path(scratch), open_farm.workers)
        done, count = 0, sum(len(job["lights"]) for job in jobs)
        for outcome in open_farm.run(jobs):
            if not outcome.ok:
                _complain(spec, outcome)
            shots[outcome.job["id"]] = load_shot(spec, outcome.job)
            outcomes.append(outcome)
            done += len(outcome.job["lights"])
            if progress is not None:
                progress(done, count)
    made_by = {"blender": outcomes[0].blender, "device": outcomes[0].device}
    return assemble(spec, [shots[job["id"]] for job in jobs], made_by, sum(outcome.seconds for outcome in outcomes))


def jobs_of(spec: Spec, scratch: Path, workers: int = 1) -> list[dict[str, Any]]:
    """The jobs of a spec, every value resolved: keys as in `blender_scenes.job`. scratch: the folder for their output. workers: how many
    share them; where they have other captures to share, that is one.
    """
    W, H = spec.resolution
    camera: dict[str, Any] = {"kind": spec.camera.kind, "distance": spec.camera.distance_mm}
    if isinstance(spec.camera, Orthographic):
        camera["width"] = spec.camera.width_mm
    else:
        camera["K"] = spec.camera.intrinsics(W, H).tolist()
    common = {
        "resolution": [W, H],
        "supersampling": spec.supersampling,
        "camera": camera,
        "shape": _shape_job(spec, scratch),
        "pose": {"rotation": spec.pose.matrix().tolist(), "translation": list(spec.pose.translation_mm)},
        "material": spec.material.job(),
        "samples": spec.draws(),
        "bounces": spec.bounces,
        "seed": spec.seed % 2**31,
        "layers": layers_of(spec),
        "crop": spec.crop,
    }
    lights = [light.job() for light in spec.pictures()]
    # Said of the capture, not of each job: the bits do not depend on how the lights are shared out.
    common["together"] = len(lights) > 2
    share = min(math.ceil(len(lights) / workers), max(1, SAMPLES_PER_JOB // (W * H * spec.supersampling**2)))
    return [
        {"id": f"{k + 1:03d}", "out": str(scratch / f"{k + 1:03d}.npz"), **common, "lights": lights[k : k + share]}
        for k in range(0, len(lights), share)
    ]


def _shape_job(spec: Spec, scratch: Path) -> dict[str, Any]:
    """The shape of a spec's jobs. A mesh is written into `scratch` as plain arrays; its file must still be what the spec names."""
    shape: dict[str, Any] = {"name": spec.shape.name, "parameters": spec.shape.parameters}
    if spec.shape.name == "mesh":
        from gen.meshes import mesh_file, write_mesh

        shape = {"file": str(write_mesh(mesh_file(spec.shape.parameters), scratch))}
    return {**shape, "detail": list(spec.shape.detail)} if spec.shape.detail else shape


def load_shot(spec: Spec, job: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """A worker's arrays, checked: shapes, finite radiance, and that the picture is the sum of its parts."""
    path, lights = Path(job["out"]), _numbers(job)
    found = _stored_arrays(path)
    shot = {name: found[name] for name in (*PER_VIEW, *job["layers"], "sum_error")}
    shot["box"] = found["box"] if job["crop"] else np.array([0, 0, *spec.resolution])
    path.unlink()
    where = f"{spec.name}: {lights}"
    x0, y0, x1, y1 = (int(v) for v in shot["box"])
    W, H = spec.resolution
    if not (0 <= x0 < x1 <= W and 0 <= y0 < y1 <= H):
        raise RenderFailed(f"{where}: the worker's box {x0}, {y0}, {x1}, {y1} does not lie in the picture")
    for name in job["layers"]:
        shape = (len(job["lights"]), y1 - y0, x1 - x0, *(() if name == "lit" else (3,)))
        if shot[name].shape != shape or not np.isfinite(shot[name]).all():
            raise RenderFailed(f"{where}: the worker's layer '{name}' is not {shape} of finite numbers")
    off = float(shot["sum_error"].max())
    if off > max(SUM_TOLERANCE, ROUNDING * job["samples"]):
        raise RenderFailed(f"{where}: the picture differs from diffuse + specular by {off:g} of its peak")
    return shot


def _stored_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an uncompressed .npz, straight from the file: `numpy.load` copies each twice and sums it up."""
    arrays = {}
    with zipfile.ZipFile(path) as archive, path.open("rb") as file:
        for member in archive.infolist():
            file.seek(member.header_offset + 26)  # of the member's own header, what follows is as long as it says here
            file.seek(sum(struct.unpack("<HH", file.read(4))), os.SEEK_CUR)
            arrays[member.filename.removesuffix(".npy")] = np.lib.format.read_array(file, allow_pickle=False)  # type: ignore[no-untyped-call]
    return arrays


def _numbers(job: Mapping[str, Any]) -> str:
    first, count = int(job["id"]), len(job["lights"])
    return f"light {first}" if count == 1 else f"lights {first} to {first + count - 1}"


def _complain(spec: Spec, outcome: Outcome) -> None:
    if outcome.kind == "input":
        raise InputError(f"{spec.name}: {outcome.error}")
    raise RenderFailed(f"{spec.name}: {_numbers(outcome.job)} could not be rendered in {outcome.tries} tries: {outcome.error}")
