"""From a remover's layers to the shape: find and repair the defects, solve for normals, integrate, all by name."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gen import large
from gen.capture import Capture, Fault, grey
from gen.errors import InputError
from recon.calibration import change, table_for
from recon.conditioning import leave_out, lit, lowered
from recon.defects import Defects, find_defects, require_threshold
from recon.near_light import NearFit, places_known, solve_near
from recon.registry import GLOSS, HEIGHT, NORMALS, REPAIR, Height, Layers, Normals, Repaired, Solver
from recon.suitability import require_suitable

if TYPE_CHECKING:
    import trimesh

PIXELWISE = frozenset(
    {"least-squares", "three-light", "l1", "sparse-bayesian", "thresholded-sparse-bayesian", "position-threshold", "coat"}
)
"""Solvers that look at each pixel by itself: large captures are solved part by part, and nothing shows where the parts meet."""

Progress = Callable[[str], None]
"""Called with the name of each step as it begins."""


@dataclass(frozen=True)
class Settings:
    """The choices of a measurement, by name.

    gloss, repair, normals, height: names of `recon.registry`; for gloss and repair "none" leaves the step out.
    threshold: specular reflectance (radiance over light intensity, luma) above which a sample is a defect, or "auto" or "otsu"
    (see `recon.defects.find_defects`).
    dilate: pixels by which defects grow.
    saturated: "drop" leaves clipped samples out where the other lights still determine the normal, and counts the rest of them as
    defects; "keep" uses them like all others. shadows: the same for samples under `recon.conditioning.LIT` of their pixel's
    brightest; they are kept by default, since with few lights a shadow is evidence too.
    Raises InputError for an unknown name or an impossible value.
    """

    gloss: str = "chromaticity"
    repair: str = "telea"
    normals: str = "least-squares"
    height: str = "adaptive"
    threshold: float | str = "auto"
    dilate: int = 1
    saturated: str = "drop"
    shadows: str = "keep"

    def __post_init__(self) -> None:
        for registry, name in ((GLOSS, self.gloss), (REPAIR, self.repair), (NORMALS, self.normals), (HEIGHT, self.height)):
            registry[name]
        require_threshold(self.threshold)
        if not 0 <= self.dilate <= 1000:
            raise InputError(f"--dilate {self.dilate}: must be from 0 to 1000 pixels")
        for option, value in (("--saturated", self.saturated), ("--shadows", self.shadows)):
            if value not in ("keep", "drop"):
                raise InputError(f"{option} {value}: must be keep or drop")


@dataclass(frozen=True, eq=False)
class Shape:
    """A measured surface, and how it came about.

    consumed: which pictures photometric stereo worked on: "pictures" (no gloss removed), "matte" or "diffuse".
    images: (K, H, W, 3), those pictures after repair. weights: (K, H, W), what each sample counted.
    seconds: the time each step took. near: how near lights were taken into account, None where all were taken as distant.
    """

    capture: Capture
    settings: Settings
    layers: Layers
    consumed: str
    defects: Defects
    images: NDArray[np.float32]
    weights: NDArray[np.float32]
    normals: Normals
    height: Height
    seconds: Mapping[str, float] = field(default_factory=dict)
    near: NearFit | None = None

    def mesh(self) -> trimesh.Trimesh:
        """The surface as a mesh in the camera frame, in `height.unit`, with the albedo as vertex colours; see `mesh_step`."""
        from recon.mesh import surface_mesh

        maps = (self.height.points, self.normals.normal, self.normals.albedo)
        return surface_mesh(*(values[:: self.mesh_step, :: self.mesh_step] for values in maps))

    @property
    def mesh_step(self) -> int:
        """Every which pixel is a vertex of the mesh, along rows and columns: 1, all of them, up to `recon.mesh.MOST_POINTS`."""
        from recon.mesh import MOST_POINTS

        points = np.count_nonzero(np.isfinite(self.height.height))
        return max(math.ceil(math.sqrt(points / MOST_POINTS)), 1)


def reconstruct(
    capture: Capture,
    layers: Layers,
    settings: Settings,
    progress: Progress | None = None,
    seconds: Mapping[str, float] | None = None,
) -> Shape:
    """From a remover's layers to the shape: defects, repair, normals, height. Raises InputError where nothing can be measured.

    Near lights whose places and scale are known are solved as such, normals and height in turn (see `recon.near_light`).
    seconds: times of what went before, to which those of the steps here are added.
    """
    require_suitable(capture)
    times = dict(seconds or {})
    pictures, consumed = consumed_pictures(layers, settings)
    with _timed(times, "repair", "repairing", progress):
        drop_clipped = settings.saturated == "drop"
        defects = find_defects(layers.specular, capture, settings.threshold, settings.dilate, pictures, drop_clipped)
        repaired = REPAIR.load(settings.repair)(pictures, defects.mask, capture)
    with _timed(times, "normals", "solving for normals", progress):
        weights = sample_weights(capture, layers, repaired, settings)
        solver, integrator = NORMALS.load(settings.normals), HEIGHT.load(settings.height)
        near = None
        if places_known(capture):
            normals, height, near = solve_near(capture, capture.reflectance(repaired.images), weights, solver, integrator)
        elif settings.normals in PIXELWISE:
            normals = solved_in_strips(solver, capture, repaired.images, weights)
        else:
            normals = solver(capture.reflectance(repaired.images), capture.lights, capture.mask, weights)
        if not normals.measurable.any():
            raise InputError(f"{capture.source}: not one pixel could be measured; too few usable samples a pixel")
        normals = calibrated(normals, capture, repaired.images, settings, layers.doubt)
    if near is None:
        with _timed(times, "height", "integrating", progress):
            height = integrator(normals.normal, normals.measurable, capture.scale)
    return Shape(capture, settings, layers, consumed, defects, repaired.images, weights, normals, height, times, near)


def consumed_pictures(layers: Layers, settings: Settings) -> tuple[NDArray[np.float32], str]:
    """The pictures that photometric stereo works on, (K, H, W, 3), and which they are: "pictures", "matte" or "diffuse"."""
    if layers.matte is not None:
        return layers.matte, "matte"
    return layers.diffuse, "pictures" if settings.gloss == "none" else "diffuse"


def solved_in_strips(solver: Solver, capture: Capture, images: NDArray[np.float32], weights: NDArray[np.float32]) -> Normals:
    """What a solver of `PIXELWISE` makes of pictures (K, H, W, 3) radiance, a strip of rows after another where they are large."""
    parts = list(large.strips(images.shape))
    if len(parts) == 1:
        return solver(capture.reflectance(images), capture.lights, capture.mask, weights)
    size = capture.mask.shape
    normals = Normals(
        normal=large.zeros((*size, 3), np.float32),
        albedo=large.zeros((*size, 3), np.float32),
        uncertainty=np.full(size, np.nan, np.float32),
        measurable=np.zeros(size, bool),
    )
    for rows in parts:
        if not capture.mask[rows].any():
            continue
        found = solver(capture.reflectance(images[:, rows]), capture.lights, capture.mask[rows], weights[:, rows])
        for name, part in vars(found).items():
            getattr(normals, name)[rows] = part
        large.release(images, weights, normals.normal, normals.albedo)
    return normals


def calibrated(
    normals: Normals,
    capture: Capture,
    images: NDArray[np.float32],
    settings: Settings,
    doubt: NDArray[np.float32] | None = None,
) -> Normals:
    """Normals whose uncertainty is what such pixels erred by on renders, where that was measured (see `recon.calibration`).

    images: (K, H, W, 3), the pictures that were solved. doubt: (H, W), see `Layers`: so far a pixel is as uncertain as without removal.
    """
    table, plain = (table_for(gloss, settings.normals) for gloss in (settings.gloss, "none"))
    if table is None:
        return normals
    stated = table(normals.uncertainty, change(capture, images))
    if doubt is not None and plain is not None:
        stated += doubt * (plain(normals.uncertainty, np.zeros_like(doubt)) - stated)
    return replace(normals, uncertainty=stated.astype(np.float32))


def sample_weights(capture: Capture, layers: Layers, repaired: Repaired, settings: Settings) -> NDArray[np.float32]:
    """What each sample counts, (K, H, W): the repair's weight times the remover's confidence, 0 where missing.

    Clipped samples, and shadowed ones where asked, are left out. Neither this nor the confidence goes further than the lights
    allow: a pixel whose normal the other samples would no longer determine keeps them (see `recon.conditioning.lowered`).
    """
    result = large.empty(capture.faults.shape, np.float32)
    for rows in large.strips(capture.images.shape):
        faults = capture.faults[:, rows]
        weights = np.where(faults & Fault.MISSING, 0, repaired.weights[:, rows]).astype(np.float32)
        if layers.confidence is not None:
            weights = lowered(weights, weights * layers.confidence[:, rows], capture.lights)
        if settings.shadows == "drop":
            shadow = ~lit(grey(capture.reflectance(repaired.images[:, rows]))) | ((faults & Fault.DARK) > 0)
            weights = leave_out(weights, shadow, capture.lights)
        if settings.saturated == "drop":
            weights = leave_out(weights, (faults & Fault.CLIPPED) > 0, capture.lights)
        result[:, rows] = weights
        large.release(result, layers.confidence, repaired.images)
    return result


@contextmanager
def _timed(seconds: dict[str, float], key: str, title: str, progress: Progress | None) -> Iterator[None]:
    if progress is not None:
        progress(title)
    start = time.perf_counter()
    yield
    seconds[key] = time.perf_counter() - start
