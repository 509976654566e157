"""From views to a mesh: each view measured by photometric stereo, matched with its neighbours, refined, and fused; and the rows to compare.

views, ball = read_views("out/ring")
model = measure_views(views, ball, Settings("group", "none"))
model.mesh
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from gen.errors import InputError
from recon.multiview.compare import compare, true_surface
from recon.multiview.depth import Surface, matching_picture, photometric, refined
from recon.multiview.fuse import fuse, voxel_of
from recon.multiview.stereo import agreement, neighbours, stereo_depths
from recon.multiview.views import Ball, Floats, View
from recon.reconstruct import Progress, Settings

if TYPE_CHECKING:
    import trimesh

INTEGRATOR = "quadratic"
"""The integrator whose equations take the stereo depth along (see `recon.multiview.depth.refined`)."""

LABELS = {"none": "with gloss", "true-matte": "matte twin"}
"""What the rows that need no remover are called in tables; the others go by the remover's name."""


@dataclass(frozen=True, eq=False)
class Model:
    """A measured object. mesh: object's frame, mm. stereo: the depth of each view before its normals refined it, (H, W) mm.

    surfaces: what each view added. voxel: mm. seconds: the time each step took.
    """

    views: Sequence[View]
    settings: Settings
    stereo: Sequence[Floats]
    surfaces: Sequence[Surface]
    mesh: trimesh.Trimesh
    voxel: float
    seconds: Mapping[str, float]


def measure_views(
    views: Sequence[View], ball: Ball, settings: Settings, voxel: float | None = None, progress: Progress | None = None
) -> Model:
    """Measure an object from all its views.

    settings: of gloss removal, repair and photometric stereo; the integrator is always `INTEGRATOR`. voxel: mm, by
    default a pixel at the object. Raises InputError where a view cannot be measured, no two match, or nothing is left to fuse.
    """
    settings = replace(settings, height=INTEGRATOR)
    seconds: dict[str, float] = {}
    start = time.perf_counter()

    def done(step: str) -> None:
        nonlocal start
        now = time.perf_counter()
        seconds[step], start = now - start, now

    normals = []
    for view in views:
        _tell(progress, f"{_label(settings.gloss)}: photometric stereo of {view.name}")
        normals.append(photometric(view, settings))
    done("photometric stereo")
    _tell(progress, f"{_label(settings.gloss)}: matching the views")
    stereo = stereo_depths(views, ball, [matching_picture(v, n.albedo) for v, n in zip(views, normals, strict=True)])
    done("matching")
    _tell(progress, f"{_label(settings.gloss)}: refining by the normals")
    depths = [refined(*each) for each in zip(views, stereo, normals, strict=True)]
    depths = agreement(views, ball, depths, neighbours(views, ball))
    surfaces = [Surface(depth, n.normal, n.albedo) for depth, n in zip(depths, normals, strict=True)]
    done("refining")
    _tell(progress, f"{_label(settings.gloss)}: fusing")
    side = voxel_of(views) if voxel is None else voxel
    mesh = fuse(views, surfaces, ball, side)
    done("fusing")
    return Model(views, settings, stereo, surfaces, mesh, side, seconds)


def compare_rows(
    views: Sequence[View],
    ball: Ball,
    wanted: Sequence[Settings],
    voxel: float | None = None,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> tuple[dict[str, Model], dict[str, Any]]:
    """The models of several settings by remover's name, and the figures of each against the true surface that the views know.

    Where the captures hold the truth, the rows "none" (with gloss) and "true-matte" join those that are wanted. A row that cannot be
    measured says why under "error", unless it is the first wanted one, whose InputError is raised. tolerance: mm, by default the voxel.
    """
    truth = true_surface(views)
    rows = {settings.gloss: settings for settings in wanted}
    if truth is not None:
        rows.setdefault("none", Settings("none", "none", wanted[0].normals))
        if all(view.capture.truth.matte is not None for view in views):
            rows.setdefault("true-matte", Settings("true-matte", "none", wanted[0].normals))
    models: dict[str, Model] = {}
    figures: dict[str, Any] = {}
    for name, settings in rows.items():
        try:
            models[name] = model = measure_views(views, ball, settings, voxel, progress)
        except InputError as error:
            if settings is wanted[0]:
                raise
            figures[name] = {"label": _label(name), "error": str(error)}
            continue
        figures[name] = {"label": _label(name), "repair": settings.repair, "triangles": len(model.mesh.faces)}
        if truth is not None:
            _tell(progress, f"{_label(name)}: comparing with the truth")
            figures[name] |= compare(model.mesh, truth, model.voxel if tolerance is None else tolerance)
        figures[name]["seconds"] = dict(model.seconds)
    return models, figures


def rows_text(figures: Mapping[str, Any]) -> str:
    """The figures as a table for the terminal."""
    compared = next((row for row in figures.values() if "accuracy" in row), None)
    if compared is None:
        return "\n".join(
            f"{row['label']}: {row.get('error') or str(row['triangles']) + ' triangles'}" for row in figures.values()
        )
    head = f"{'mm':<16}{'accuracy':>22}{'completeness':>24}{'chamfer':>9}{'F':>7}{'normals':>9}"
    unit = f"{'':<16}{'mean':>8}{'95 %':>7}{'within':>7}{'mean':>10}{'95 %':>7}{'within':>7}{'mean':>9}{'%':>7}{'degrees':>9}"
    lines = [head, unit]
    for row in figures.values():
        if "error" in row:
            lines.append(f"{row['label']:<16}  {row['error']}")
            continue
        a, c, n = row["accuracy"], row["completeness"], row["normals"]
        lines.append(
            f"{row['label']:<16}{a['mean']:>8.3f}{a['95 %']:>7.3f}{a['within']:>7.1f}{c['mean']:>10.3f}{c['95 %']:>7.3f}"
            f"{c['within']:>7.1f}{row['chamfer']:>9.3f}{row['f score']:>7.1f}{n['mean'] if n else float('nan'):>9.2f}"
        )
    return "\n".join([*lines, f"within: % of the surface within {compared['tolerance']:.3g} mm; F: harmonic mean of the two"])


def _label(gloss: str) -> str:
    return LABELS.get(gloss, gloss)


def _tell(progress: Progress | None, title: str) -> None:
    if progress is not None:
        progress(title)
