"""What a measurement from several views leaves on disk: meshes, the depth of each view, metrics.json, report.html, all or nothing."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gen.exr import unstack, write_exr
from gen.files import write_json
from gen.images import write_png
from recon.mesh import write_mesh
from recon.multiview.measure import Model
from recon.multiview.report import multiview_page
from recon.multiview.views import Ball
from recon.page import write_report
from recon.pictures import height_range, relief_picture

if TYPE_CHECKING:
    import trimesh


def write_models(
    source: Path, ball: Ball, models: Mapping[str, Model], figures: Mapping[str, Any], main: str, folder: Path
) -> dict[str, Any]:
    """Write the models into a folder that is there already. Returns the metrics. main: the model that the folder is about.

    mesh.ply, mesh.glb of the main one, compared/NAME.ply of the others, in metres, object's frame; depth/001.exr, numbered as the views
    are listed in metrics.json: depth.Z and stereo.Z (before its normals refined it) in metres along the optical axis, normal.XYZ in the
    camera's frame, NaN and zero where unknown; depth/001.png to look at; report.html (left out, with a line on stderr, where its package
    is missing). Raises InputError where the folder cannot be written.
    """
    model = models[main]
    mesh = in_metres(model.mesh)
    for name in ("mesh.ply", "mesh.glb"):
        write_mesh(mesh, folder / name, "m")
    for name, other in models.items():
        if name != main:
            write_mesh(in_metres(other.mesh), folder / "compared" / f"{name}.ply", "m")
    header = {"degloss.frame": "camera: x right, y up, z to the viewer", "degloss.unit": "m"}
    listed = []
    for k, (view, stereo, surface) in enumerate(zip(model.views, model.stereo, model.surfaces, strict=True)):
        channels = {"depth.Z": surface.depth / 1000, "stereo.Z": stereo / 1000} | unstack("normal", "XYZ", surface.normal)
        write_exr(folder / "depth" / f"{k + 1:03d}.exr", channels, header=header)
        near = -surface.depth / 1000
        picture = relief_picture(near, *height_range(near), view.capture.scale.metres_per_pixel or 1.0)
        write_png(folder / "depth" / f"{k + 1:03d}.png", picture)
        inside = view.capture.mask
        listed.append(
            {
                "name": view.name,
                "object_to_camera": view.pose,
                "stereo percent": 100 * float(np.isfinite(stereo[inside]).mean()),
                "measured percent": 100 * float(np.isfinite(surface.depth[inside]).mean()),
            }
        )
    metrics: dict[str, Any] = {
        "source": str(source),
        "gloss": main,
        "settings": vars(model.settings),
        "views": listed,
        "ball": {"centre_mm": ball.centre, "radius_mm": ball.radius},
        "voxel_mm": model.voxel,
        "mesh": {"vertices": len(mesh.vertices), "triangles": len(mesh.faces), "unit": "m"},
        "rows": dict(figures),
    }
    metrics["report"] = write_report(folder, lambda: multiview_page(source.name or str(source), model, metrics))
    write_json(folder / "metrics.json", metrics)
    return metrics


def in_metres(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy of a mesh in millimetres, in metres, as all our meshes are stored."""
    scaled: trimesh.Trimesh = mesh.copy()
    scaled.apply_scale(1e-3)
    return scaled
