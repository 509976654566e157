"""What a measurement leaves on disk: maps, layers, defects, mesh, metrics.json and report.html, all or nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen import large
from gen.exr import unstack, write_exr
from gen.files import write_json, writing_folder
from gen.images import write_png
from recon.compare import compare, shape_metrics
from recon.mesh import write_mesh
from recon.overview import overview
from recon.page import write_report
from recon.pictures import normal_picture, tone, white_of
from recon.reconstruct import Progress, Shape
from recon.report import report_page

Floats = NDArray[np.float32]


def write_shape(shape: Shape, folder: Path, progress: Progress | None = None) -> dict[str, Any]:
    """Write everything that a shape holds into `folder` (made whole under a temporary name, then renamed). Returns the metrics.

    normal.exr (X Y Z and the uncertainty in degrees), normal.png; height.exr (Z, and the points), height.png (16-bit, its range
    in metrics.json); albedo.exr; overview.png; diffuse/, specular/, matte/ (EXR and a PNG to look at, numbered like the capture's frames);
    defects/; mesh.ply, mesh.glb (of large pictures not every pixel, see `recon.mesh.MOST_POINTS`);
    metrics.json; report.html (left out, with a line on stderr, where its package is missing).
    Raises InputError where the folder cannot be written.
    """
    with writing_folder(folder, "measurement") as temporary:
        return write_into(shape, temporary, progress)


def write_into(shape: Shape, folder: Path, progress: Progress | None = None) -> dict[str, Any]:
    """`write_shape` into a folder that is there already; for callers that put more beside it."""
    comparison = compare(shape, progress)
    if progress is not None:
        progress("writing")
    _write_maps(shape, folder)
    _write_layers(shape, folder)
    mesh = shape.mesh()
    for name in ("mesh.ply", "mesh.glb"):
        write_mesh(mesh, folder / name, shape.height.unit)
    write_png(folder / "overview.png", overview(comparison))
    metrics = shape_metrics(shape, comparison)
    counts = {"vertices": len(mesh.vertices), "triangles": len(mesh.faces)}
    metrics["mesh"] = counts | {"unit": shape.height.unit, "pixels from point to point": shape.mesh_step}
    del mesh
    metrics["report"] = write_report(folder, lambda: report_page(shape, comparison, metrics))
    write_json(folder / "metrics.json", metrics)
    return metrics


def _write_maps(shape: Shape, folder: Path) -> None:
    normals, height = shape.normals, shape.height
    frame = {"degloss.frame": "x right, y up, z to the viewer"}
    lengths = frame | {"degloss.unit": height.unit}
    write_exr(
        folder / "normal.exr", unstack("normal", "XYZ", normals.normal) | {"uncertainty.V": normals.uncertainty}, header=frame
    )
    write_png(folder / "normal.png", normal_picture(normals.normal, normals.measurable))
    write_exr(folder / "height.exr", {"height.Z": height.height} | unstack("points", "XYZ", height.points), header=lengths)
    known = np.isfinite(height.height)
    low, high = float(height.height[known].min()), float(height.height[known].max())
    scaled = np.where(known, (height.height - low) / max(high - low, 1e-30), 0)
    write_png(folder / "height.png", np.rint(scaled * 65535).astype(np.uint16))
    write_exr(folder / "albedo.exr", unstack("", "RGB", normals.albedo))


def _write_layers(shape: Shape, folder: Path) -> None:
    """The remover's layers, where there was one, and the defects."""
    capture, layers = shape.capture, shape.layers
    white = white_of(capture.images, capture.mask)
    large.release(capture.images)
    found = {"diffuse": layers.diffuse, "specular": layers.specular, "matte": layers.matte}
    for name, stack in found.items() if shape.settings.gloss != "none" else ():
        for k, picture in enumerate(stack if stack is not None else ()):
            write_exr(folder / name / f"{k + 1:03d}.exr", unstack("", "RGB", picture))
            write_png(folder / name / f"{k + 1:03d}.png", tone(picture, white))
            large.release(stack)
    for k in range(capture.count):
        write_png(folder / "defects" / f"{k + 1:03d}.png", shape.defects.mask[k].astype(np.uint8) * 255)
