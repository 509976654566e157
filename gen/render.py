"""From a spec to a capture: jobs for the farm, the layers that come back, one exposure, and our folder.

A job is one light, or a few where the picture is small: so a crash costs little, progress shows, and workers share a capture. The
pixels do not depend on how lights are grouped.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Fault, Floats, Scale, Truth, grey
from gen.errors import InputError
from gen.farm import Farm, Outcome
from gen.files import writing_folder
from gen.formats.render_folder import write_files
from gen.spec import Spec
from gen.spec_parts import AutoExposure, Orthographic

SAMPLES_PER_JOB = 1 << 18
PER_VIEW = ("coverage", "normal", "depth", "albedo", "gloss")
PER_LIGHT = ("combined", "diffuse", "specular", "matte")
SUM_TOLERANCE = 1e-6
"""Largest |combined - (diffuse + specular)| of a render, relative to the picture's peak: float32 rounding of Cycles' own sum."""

Progress = Callable[[int, int], None]
"""Called with (pictures done, pictures in all)."""


class RenderFailed(InputError):
    """Blender failed although the spec is right."""


@dataclass(frozen=True, eq=False)
class Rendered:
    """A rendered capture, and the (H, W) share of each pixel that the object fills. seconds: the workers' time, all pictures."""

    capture: Capture
    coverage: Floats
    seconds: float


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
        write_files(rendered.capture, temporary, rendered.coverage)
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
            shots[outcome.job["id"]] = _load(spec, outcome.job)
            outcomes.append(outcome)
            done += len(outcome.job["lights"])
            if progress is not None:
                progress(done, count)
    made_by = {"blender": outcomes[0].blender, "device": outcomes[0].device}
    return assemble(spec, [shots[job["id"]] for job in jobs], made_by, sum(outcome.seconds for outcome in outcomes))


def jobs_of(spec: Spec, scratch: Path, workers: int = 1) -> list[dict[str, Any]]:
    """The jobs of a spec, every value resolved: keys as in `blender_scenes.job`. scratch: the folder for their output."""
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
        "shape": {"name": spec.shape.name, "parameters": spec.shape.parameters},
        "pose": {"rotation": spec.pose.matrix().tolist(), "translation": list(spec.pose.translation_mm)},
        "material": {
            "kind": spec.material.kind,
            "diffuse": list(spec.material.albedo),
            "specular": list(spec.material.specular),
            "alpha": spec.material.width(),
        },
    }
    given = zip(spec.light_directions().tolist(), spec.light_intensities().tolist(), strict=True)
    lights = [{"direction": direction, "intensity": intensity} for direction, intensity in given]
    # Setting up a scene takes as long as a small picture: a job then holds several lights, as long as no worker goes idle.
    share = min(math.ceil(len(lights) / workers), max(1, SAMPLES_PER_JOB // (W * H * spec.supersampling**2)))
    return [
        {"id": f"{k + 1:03d}", "out": str(scratch / f"{k + 1:03d}.npz"), **common, "lights": lights[k : k + share]}
        for k in range(0, len(lights), share)
    ]


def assemble(spec: Spec, shots: list[Mapping[str, NDArray[Any]]], made_by: Mapping[str, Any], seconds: float = 0.0) -> Rendered:
    """The capture of the workers' arrays, one mapping a job (`PER_VIEW` and `PER_LIGHT`), at the spec's exposure.

    The pictures are diffuse + specular; exposure multiplies pictures, layers and light intensities alike, so reflectance does not
    depend on it. Raises InputError where the object is not in view or unlit.
    """
    view = {name: shots[0][name] for name in PER_VIEW}
    mask = view["coverage"] >= 0.5
    if not mask.any():
        raise InputError(f"{spec.name}: the object is not in the picture; check pose.translation_mm, camera and the shape's size")
    diffuse, specular, matte = (np.concatenate([shot[name] for shot in shots]) for name in ("diffuse", "specular", "matte"))
    exposure = exposure_of(spec, diffuse + specular, mask)
    diffuse, specular, matte = (layer * np.float32(exposure) for layer in (diffuse, specular, matte))
    images = diffuse + specular
    faults = np.where((images <= 0).all(axis=3), int(Fault.DARK), 0).astype(np.uint8)
    if spec.clip:
        faults |= np.where((images >= 1).any(axis=3), int(Fault.CLIPPED), 0).astype(np.uint8)
        images = np.minimum(images, np.float32(1))
    W, H = spec.resolution
    middle = spec.camera.distance_mm - spec.pose.translation_mm[2]
    if isinstance(spec.camera, Orthographic):
        scale = Scale(mm_per_pixel=spec.camera.width_mm / W, distance_mm=middle if middle > 0 else None)
    else:
        scale = Scale(camera=spec.camera.intrinsics(W, H), distance_mm=middle if middle > 0 else None)
    truth = Truth(
        normals=np.where(mask[..., None], view["normal"], 0).astype(np.float32),
        depth=np.where(mask, view["depth"] / 1000, np.nan).astype(np.float32),
        albedo=np.where(mask[..., None], view["albedo"], 0).astype(np.float32),
        gloss=np.where(mask, view["gloss"], 0).astype(np.float32),
        diffuse=diffuse,
        specular=specular,
        matte=matte,
    )
    capture = Capture(
        images=images,
        lights=spec.light_directions(),
        intensities=spec.light_intensities() * exposure,
        mask=mask,
        faults=faults,
        scale=scale,
        truth=truth,
        source=f"render of {spec.name}",
        provenance={
            "exposure": exposure,
            "spec": spec.plain(),
            "spec_sha256": spec.digest(),
            **made_by,
            "versions": {"degloss": _version("degloss"), "numpy": np.__version__},
        },
    )
    return Rendered(capture, view["coverage"].astype(np.float32), seconds)


def exposure_of(spec: Spec, images: Floats, mask: NDArray[np.bool_]) -> float:
    """The factor on radiance and light alike. images: (K, H, W, 3) before exposure; mask: (H, W).

    An automatic one is rounded to three digits, so that another machine's last bit does not change every pixel. Raises InputError
    where the percentile is black.
    """
    if not isinstance(spec.exposure, AutoExposure):
        return float(spec.exposure)
    bright = float(np.percentile(grey(images)[:, mask], spec.exposure.percentile))
    if not bright > 0:
        raise InputError(
            f"{spec.name}: exposure: the object is black at the {spec.exposure.percentile:g}th percentile; move the lights, "
            "or give exposure as a number"
        )
    return float(f"{spec.exposure.level / bright:.3g}")


def _load(spec: Spec, job: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """A worker's arrays, checked: shapes, finite radiance, and that the picture is the sum of its parts."""
    path, lights = Path(job["out"]), _numbers(job)
    with np.load(path, allow_pickle=False) as file:
        shot = {name: file[name] for name in (*PER_VIEW, *PER_LIGHT)}
    path.unlink()
    W, H = spec.resolution
    where = f"{spec.name}: {lights}"
    K = len(job["lights"])
    for name in PER_LIGHT:
        if shot[name].shape != (K, H, W, 3) or not np.isfinite(shot[name]).all():
            raise RenderFailed(f"{where}: the worker's layer '{name}' is not ({K}, {H}, {W}, 3) of finite numbers")
    combined = shot["combined"]
    off = float(np.abs(combined - (shot["diffuse"] + shot["specular"])).max())
    if off > SUM_TOLERANCE * max(float(combined.max()), 1e-30):
        raise RenderFailed(f"{where}: the picture differs from diffuse + specular by {off:g} (peak {combined.max():g})")
    return shot


def _numbers(job: Mapping[str, Any]) -> str:
    first, count = int(job["id"]), len(job["lights"])
    return f"light {first}" if count == 1 else f"lights {first} to {first + count - 1}"


def _complain(spec: Spec, outcome: Outcome) -> None:
    if outcome.kind == "input":
        raise InputError(f"{spec.name}: {outcome.error}")
    raise RenderFailed(f"{spec.name}: {_numbers(outcome.job)} could not be rendered in {outcome.tries} tries: {outcome.error}")


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
