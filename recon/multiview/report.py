"""The page of a measurement from several views, composed of the parts of `recon.page`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gen.sets.set_spec import evenly
from recon.metrics import angular_error
from recon.multiview.measure import Model
from recon.multiview.views import View
from recon.page_parts import Bar, Gallery, Map, Note, Page, Part, Row, Section, Table, Window
from recon.pictures import Picture, crop_to_mask, fit, height_range, normal_picture, relief_picture, tone, white_of
from recon.tables import Column

MAX_SIDE = 400
"""Longest side of a picture in the page, in pixels."""

MAP_SIDE = 224
"""The same of the maps that stand side by side."""

MAX_MAPS = 8
"""Views whose maps of errors are shown, spread evenly over the ring."""

Metrics = Mapping[str, Any]


def multiview_page(title: str, model: Model, metrics: Metrics) -> Page:
    """The mesh to turn, the figures of every row, the views and, where there is truth, the errors of their depth and normals.

    model: the one that the page is about. metrics: as `recon.multiview.output.write_models` returns them.
    """
    row = metrics["rows"][model.settings.gloss]
    count = len(model.views)
    lead = f"{count} views, each measured by photometric stereo, tied together by stereo between neighbours, fused into one mesh."
    if "accuracy" in row:
        lead += (
            f" On average the mesh is {row['accuracy']['mean']:.3f} mm from the true surface, and the true surface "
            f"{row['completeness']['mean']:.3f} mm from the mesh."
        )
    facts = {
        "views": str(count),
        "pictures": str(sum(view.capture.count for view in model.views)),
        "gloss": model.settings.gloss,
        "repair": model.settings.repair,
        "normals": model.settings.normals,
        "voxel": f"{model.voxel:.3g} mm",
        "triangles": f"{metrics['mesh']['triangles']:,}",
    }
    sections = [_results(metrics), _views(model)]
    if all(view.capture.truth.depth is not None for view in model.views):
        sections.append(_errors(model))
    sections.append(_method(model, metrics))
    return Page(
        title,
        lead,
        sections,
        model.mesh,
        facts,
        mesh_unit="mm",
        mesh_caption="The fused mesh in the object's frame: x right, y up, z to the viewer. Where no view saw the surface it is open. "
        "mesh.ply and mesh.glb beside this page hold every triangle.",
    )


def _results(metrics: Metrics) -> Section:
    columns = [
        Column("pictures", "s"), Column("accuracy", ".3f", "mm"), Column("95 %", ".3f", "mm"), Column("within", ".1f", "%"),
        Column("completeness", ".3f", "mm"), Column("95 %", ".3f", "mm"), Column("within", ".1f", "%"), Column("chamfer", ".3f", "mm"),
        Column("F", ".1f", "%"), Column("normals", ".2f", "°"), Column("triangles", ".0f"),
    ]  # fmt: skip
    rows: list[list[object]] = []
    notes: list[Part] = []
    tolerance = None
    for row in metrics["rows"].values():
        if "error" in row:
            notes.append(Note(f"Left out: {row['label']}. {row['error']}"))
            continue
        cells: list[object] = [None] * 9
        if "accuracy" in row:
            a, c, n, tolerance = row["accuracy"], row["completeness"], row["normals"], row["tolerance"]
            cells = [a["mean"], a["95 %"], a["within"], c["mean"], c["95 %"], c["within"], row["chamfer"], row["f score"]]
            cells.append(n["mean"] if n else None)
        rows.append([row["label"], *cells, row["triangles"]])
    if tolerance is None:
        text = "The captures hold no truth to compare the mesh with, so no errors are given."
        return Section("Result", "", [Note(text), *notes])
    caption = (
        "Accuracy: distance from the mesh to the true surface; completeness: from the true surface, as far as the views show it, to the "
        f"mesh; mean and 95th percentile, and the share within {tolerance:.3g} mm. Chamfer: the mean of the two means. F: the harmonic "
        "mean of the two shares. Normals: mean angle between the true faces and those of the mesh nearest to them."
    )
    gloss = [row["label"] for row in metrics["rows"].values() if "error" not in row]
    main, twin = metrics["rows"][metrics["gloss"]]["label"], metrics["rows"].get("true-matte", {}).get("label")
    highlight, reference = ([i for i, label in enumerate(gloss) if label == wanted] for wanted in (main, twin))
    return Section(
        "Result", "", [Table("The mesh against the true surface", columns, rows, caption, highlight, reference), *notes]
    )


def _views(model: Model) -> Section:
    def look(view: View, picture: Picture) -> Picture:
        return fit(crop_to_mask(picture, view.capture.mask, 8), MAX_SIDE)

    layers: dict[str, list[Picture | None]] = {"input": [], "relief": [], "normals": []}
    for view, surface in zip(model.views, model.surfaces, strict=True):
        capture, near = view.capture, -surface.depth
        brightest = capture.images[int(np.argmax(capture.images[:, capture.mask].mean(axis=(1, 2))))]
        step = 1e3 * (capture.scale.metres_per_pixel or 1e-3)
        layers["input"].append(look(view, tone(brightest, white_of(brightest, capture.mask))))
        layers["relief"].append(look(view, relief_picture(near, *height_range(near), step)))
        layers["normals"].append(look(view, normal_picture(surface.normal, capture.mask)))
    notes = {
        "input": "the brightest picture of the view",
        "relief": "its depth after the normals refined it, lit from the upper left; lighter is nearer, by a scale of each view's own",
        "normals": "red to the right, green up, blue to the viewer, in the view's own camera frame",
    }
    names = [view.name for view in model.views]
    caption = "Tabs choose the layer, the slider the view; the divider wipes to the layer beside it."
    return Section("Views", "", [Gallery("View by view", layers, names, caption, notes, against="relief", slider="View")])


def _errors(model: Model) -> Section:
    """Depth and normals of some views against the truth, one scale for all."""
    chosen = evenly(len(model.views), MAX_MAPS)
    depths, angles = {}, {}
    for k in chosen:
        view, surface = model.views[k], model.surfaces[k]
        true = view.capture.truth
        assert true.depth is not None
        depths[k] = surface.depth - 1e3 * true.depth
        if true.normals is not None:
            angles[k] = np.where(np.isfinite(surface.depth), angular_error(surface.normal, true.normals), np.nan)
    parts: list[Part] = []
    for title, errors, signed, unit, caption in (
        ("Depth less the true depth", depths, True, "mm", "Along the optical axis. Orange is too far, blue too near."),
        ("Angle to the true normals", angles, False, "°", "Of photometric stereo, where the view has a depth."),
    ):
        known = np.abs(np.concatenate([e[np.isfinite(e)] for e in errors.values()])) if errors else np.empty(0)
        if not known.size:
            continue
        top = float(np.percentile(known, 98)) or 1.0
        bar = Bar(-top if signed else 0, top, unit, "signed" if signed else "error", ".3g", bool(known.max() > top))
        maps = []
        for k, e in errors.items():
            inside = np.abs(e[np.isfinite(e)])
            said = f"mean size {inside.mean():.3g} {unit}".replace(" °", "°") if inside.size else "nothing measured"
            window = Window.around(model.views[k].capture.mask, MAP_SIDE)
            maps.append(Map(model.views[k].name, window.cut(e), bar, window, said))
        parts.append(Row(maps, columns=4, title=title, caption=caption))
    return Section("Errors", "", parts)


def _method(model: Model, metrics: Metrics) -> Section:
    rows: list[list[object]] = [[name, str(value)] for name, value in vars(model.settings).items()]
    rows += [[f"time: {name}", f"{value:.1f} s"] for name, value in model.seconds.items()]
    columns = [Column("view", "s"), Column("by stereo", ".1f", "% of the mask"), Column("measured", ".1f", "% of the mask")]
    listed = [[view["name"], view["stereo percent"], view["measured percent"]] for view in metrics["views"]]
    return Section(
        "How it was measured", "", [Table("Settings", ["", ""], rows), Table("Views", columns, listed, folded=len(listed) > 12)]
    )
