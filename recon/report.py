"""What a report says: the page of a measurement, composed of the parts of `recon.page`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen import large
from recon.calibration import table_for
from recon.compare import Comparison, free_scale, mean_error, true_height
from recon.metrics import angular_error, fitted_height
from recon.page_parts import Bar, Figure, Gallery, Map, NormalMap, Note, Page, Part, Profile, Row, Section, Table
from recon.pictures import Picture, height_range, overlay, relief_picture, tone, white_of
from recon.reconstruct import Shape
from recon.report_comparison import comparison_section
from recon.report_maps import MAX_SIDE, error_map, look, thinned, window_of
from recon.tables import PAPER_COLUMNS, TRUTH_COLUMNS, Column, figure_table, length_text, unit_of

Metrics = Mapping[str, Any]

MAX_FRAMES = 12
"""The most frames that the page leafs through, spread evenly over the capture: the files beside it hold them all."""


def report_page(shape: Shape, comparison: Comparison, metrics: Metrics) -> Page:
    """The page of one measurement: pictures, layers, normals, heights and, where there is truth, the comparison (Fig. 4.2 to 4.5)."""
    capture, height = shape.capture, shape.height
    sections = [_results(comparison, metrics), _pictures(shape), _maps(shape)]
    if len(comparison.rows) > 1:
        sections.append(comparison_section(comparison))
    sections.append(_method(shape, metrics))
    s = shape.settings
    span = metrics["height"]["high"] - metrics["height"]["low"]
    facts = {
        "pictures": f"{capture.count} of {capture.size[1]} x {capture.size[0]}",
        "measured": f"{metrics['pixels']:,} pixels, {metrics['measured percent']:.1f} %",
        "gloss": s.gloss,
        "repair": s.repair,
        "normals": f"{s.normals}, on the {shape.consumed}",
        "height": s.height,
        "height range": length_text(span, height.unit),
    }
    lead = f"{capture.count} pictures of one view under {capture.count} known lights, measured by photometric stereo."
    lead += _outcome(metrics["comparison"])
    lead = " ".join([lead, *metrics["notes"]])
    return Page(
        title=Path(capture.source).name or capture.source,
        lead=lead,
        sections=sections,
        mesh=shape.mesh(),
        facts=facts,
        mesh_unit=height.unit,
        mesh_caption=_of_mesh(shape.mesh_step),
        footer="Normals: x right, y up, z to the viewer. Radiance is linear; pictures are shown as sRGB at one exposure.",
    )


def _of_mesh(step: int) -> str:
    """What the page says of its mesh. step: see `Shape.mesh_step`."""
    if step == 1:
        return "The measured surface. mesh.ply and mesh.glb beside this page hold every triangle."
    return f"The measured surface. mesh.ply and mesh.glb beside this page have one vertex for {step} x {step} pixels."


def _outcome(rows: Metrics) -> str:
    """What came out, in a sentence: the error of the normals, and what the glossy and the non-glossy pictures give."""
    mean = {name: error for name, row in rows.items() if (error := mean_error(row)) is not None}
    best = next((name for name in ("repaired", "removed", "glossy") if name in mean), None)
    if best is None:
        return ""
    text = f" The normals err by {mean[best]:.2f} degrees on average"
    others = [
        f"{mean[name]:.2f} from the {rows[name]['label']}" for name in ("glossy", "true matte") if name in mean and name != best
    ]
    return text + (f"; {' and '.join(others)}." if others else ".")


def _results(comparison: Comparison, metrics: Metrics) -> Section:
    rows = metrics["comparison"]
    names = list(rows)
    highlight = [names.index(name) for name in ("repaired", "removed") if name in names][:1]
    reference = [names.index(name) for name in ("true diffuse", "true matte") if name in names]
    captions = {
        "Errors against the true shape": "Mean angle to the true normals: over the mask, less its rim, and where every light reaches. "
        "Gap closed: 0 is as bad as the glossy pictures, 1 as good as the non-glossy ones; a dash where there is less than one "
        "degree to gain. Height: root mean square error after the best shift, and the best scale where no scale is known or the view is "
        "perspective. All rows are judged on the pixels that every row measured.",
        "Deviation from the non-glossy result": "The paper's protocol (Fig. 4.2 to 4.5): mean angle to the normals from the non-glossy "
        "pictures, and mean squared errors of 8-bit normal maps and of heights scaled by the non-glossy result's range, inside "
        "the mask and over the full frame.",
    }
    tables: list[Part] = []
    for (title, caption), wanted in zip(captions.items(), (TRUTH_COLUMNS, PAPER_COLUMNS), strict=True):
        columns, cells = figure_table(rows, wanted)
        if len(columns) > 1:
            tables.append(Table(title, columns, cells, caption, highlight, reference))
    return Section("Result", "", tables or [Note("This capture holds no truth to compare with, so no errors are given.")])


def _pictures(shape: Shape) -> Section:
    from gen.sets.set_spec import evenly  # with specs comes pydantic, which a measurement needs not

    capture, layers, mask = shape.capture, shape.layers, shape.capture.mask
    white = white_of(capture.images, mask)
    frames = evenly(capture.count, MAX_FRAMES)
    names = [capture.names[k] for k in frames]

    def shown(stack: NDArray[np.float32]) -> list[Picture]:
        pictures = [look(tone(stack[k], white), mask) for k in frames]
        large.release(stack)
        return pictures

    tabs: dict[str, list[Picture]] = {"input": shown(capture.images)}
    notes = {"input": "the pictures as they came"}
    if shape.settings.gloss != "none":
        tabs |= {"gloss removed": shown(layers.diffuse), "specular": shown(layers.specular)}
        notes |= {
            "gloss removed": f"what the remover {shape.settings.gloss} leaves: the diffuse layer",
            "specular": "what it takes away",
        }
        if layers.matte is not None:
            tabs["matte"] = shown(layers.matte)
            notes["matte"] = "the predicted gloss-free twin, which photometric stereo works on"
    if shape.settings.repair != "none":
        tabs["defects"] = [look(overlay(tone(capture.images[k], white), shape.defects.mask[k]), mask) for k in frames]
        tabs["repaired"] = shown(shape.images)
        notes |= {"defects": "samples that are to be repaired", "repaired": f"after {shape.settings.repair}"}
    for name in ("diffuse", "specular", "matte"):
        stack = getattr(capture.truth, name)
        if stack is not None:
            tabs[f"true {name}"] = shown(stack)
            notes[f"true {name}"] = "rendered truth"
    caption = "Tabs choose the layer, the slider or a press on the disc the light; the divider wipes to the layer beside it."
    if len(names) < capture.count:
        caption += f" {len(names)} of {capture.count} pictures are shown."
    after = next((name for name in ("gloss removed", "repaired") if name in tabs), "")
    gallery = Gallery("Layer by layer", tabs, names, caption, notes, capture.lights[frames], after, "Light")
    return Section("Pictures", "", [gallery])


def _maps(shape: Shape) -> Section:
    capture, window, (factor, unit) = shape.capture, window_of(shape.capture, MAX_SIDE), unit_of(shape.height.unit)
    normal, albedo, spread, measurable = (
        window.cut(getattr(shape.normals, name)) for name in ("normal", "albedo", "uncertainty", "measurable")
    )
    height = window.cut(shape.height.height) * factor
    low, high = height_range(height)
    painted = tone(albedo, white_of(albedo[None], measurable))
    lit = NormalMap(
        "Normals",
        np.where(measurable[..., None], normal, 0),
        window,
        painted,
        "Red is to the right, green up, blue to the viewer. Lit: Lambert's law with the measured normals, in white or with the measured "
        "albedo, without cast shadows; the light follows the pointer." + thinned(window),
    )
    figures: list[Figure | Map] = [
        Map("Height", height, Bar(low, high, unit, "height", "#.3g", above=bool(np.nanmax(height) > high)), window)
    ]
    known = spread[np.isfinite(spread)]
    if known.size:
        top = max(float(np.percentile(known, 95)), 0.1)
        bar = Bar(0, top, "°", "error", ".1f", bool(known.max() > top))
        figures.append(Map("Uncertainty", spread, bar, window, f"One standard deviation of the normal, {_known_from(shape)}."))
    if capture.truth.normals is not None:
        error = angular_error(normal, window.cut(capture.truth.normals))
        figures.append(error_map("Angle to the true normals", error, window))
    figures.append(Figure("Albedo", painted, "Scaled to its 99th percentile."))
    return Section("Shape", "", [lit, Row(figures, columns=min(len(figures), 4)), _profile(shape)])


def _profile(shape: Shape) -> Profile:
    """Measured and, where it is known, true height along a line, in the unit that people read."""
    capture, height, window = shape.capture, shape.height.height, window_of(shape.capture, MAX_SIDE)
    caption = (
        "Drag over the picture to draw a line, or move its ends by the arrow keys (with Shift by ten pixels). The surface is lit from the "
        "upper left, its colours rise with height. Heights count from the surface's mean."
    )
    factor, unit = unit_of(shape.height.unit)
    shown, truth = window.cut(height) * factor, true_height(capture)
    true = None
    if truth is not None:
        fitted, _ = fitted_height(height, truth, capture.mask, free_scale(shape))
        level = float(np.nanmean(fitted[capture.mask]))  # the truth counts from the camera, the profile from the surface's mean
        shown, true, unit = 1e3 * (window.cut(fitted) - level), 1e3 * (window.cut(truth) - level), "mm"
        caption += " The measured surface is laid on the true one by the best shift" + (
            " and scale." if free_scale(shape) else "."
        )
    step = window.rows.step * (1e3 * (capture.scale.metres_per_pixel or 1e-3) if unit == "mm" else 1.0)
    low, high = height_range(shown)
    bar = Bar(low, high, unit, "height", "#.3g", above=bool(np.nanmax(shown) > high))
    return Profile("Height along a line", shown, relief_picture(shown, low, high, step), window, unit, bar, true, caption)


def _known_from(shape: Shape) -> str:
    """What the stated uncertainty rests on."""
    if table_for(shape.settings.gloss, shape.settings.normals) is None:
        return "from the fit's residual"
    return "as such pixels erred on renders"


def _method(shape: Shape, metrics: Metrics) -> Section:
    rows: list[list[object]] = [[name, str(value)] for name, value in metrics["settings"].items()]
    rows += [["encoding", metrics["encoding"]]]
    rows += [["clipped samples", f"{metrics['clipped percent']:.2f} %"], ["defects", f"{metrics['defects']['percent']:.2f} %"]]
    rows += [[f"time: {name}", f"{value:.2f} s"] for name, value in metrics["seconds"].items()]
    lights = [
        [name, *light, *power]
        for name, light, power in zip(shape.capture.names, shape.capture.lights, shape.capture.intensities, strict=True)
    ]
    columns = [Column("frame"), *(Column(c, ".4f") for c in "xyz"), *(Column(f"intensity {c}", ".3f") for c in "RGB")]
    return Section(
        "How it was measured", "", [Table("Settings", ["", ""], rows), Table("Lights", columns, lights, folded=len(lights) > 12)]
    )
