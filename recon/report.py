"""What a report says: the page of a measurement, composed of the parts of `recon.page`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon.calibration import table_for
from recon.compare import Comparison, free_scale, mean_error, true_height
from recon.metrics import angular_error, fitted_height, height_bytes, normal_bytes
from recon.page_parts import Bar, Figure, Gallery, Note, Page, Part, Plot, Row, Section, Series, Table, Wipe
from recon.pictures import (
    Picture,
    crop_to_mask,
    difference_picture,
    difference_scale,
    error_picture,
    fit,
    height_picture,
    height_range,
    normal_picture,
    overlay,
    relief_picture,
    signed_picture,
    sphere_legend,
    tone,
    white_of,
)
from recon.reconstruct import Shape
from recon.tables import PAPER_COLUMNS, TRUTH_COLUMNS, Column, figure_table, length_text, unit_of

Metrics = Mapping[str, Any]

MAX_SIDE = 512
"""Longest side of a picture in the page, in pixels."""

MAX_FRAMES = 12
"""The most frames that the page leafs through, spread evenly over the capture: the files beside it hold them all."""


def report_page(shape: Shape, comparison: Comparison, metrics: Metrics) -> Page:
    """The page of one measurement: pictures, layers, normals, heights and, where there is truth, the comparison (Fig. 4.2 to 4.5)."""
    capture, height = shape.capture, shape.height
    sections = [_results(comparison, metrics), _pictures(shape), _maps(shape)]
    if len(comparison.rows) > 1:
        sections.append(_comparison(comparison))
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
        mesh_caption="The measured surface. mesh.ply and mesh.glb beside this page hold every triangle.",
        footer="Normals: x right, y up, z to the viewer. Radiance is linear; pictures are shown as sRGB at one exposure.",
    )


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
    capture, layers, mask = shape.capture, shape.layers, shape.capture.mask
    white = white_of(capture.images, mask)
    frames = np.unique(np.linspace(0, capture.count - 1, min(capture.count, MAX_FRAMES)).round().astype(int))
    names = [capture.names[k] for k in frames]

    def shown(stack: NDArray[np.float32]) -> list[Picture]:
        return [_look(tone(stack[k], white), mask) for k in frames]

    tabs: dict[str, list[Picture]] = {"input": shown(capture.images)}
    notes = {"input": "the pictures as they came"}
    if shape.settings.gloss != "none":
        tabs |= {"gloss removed": shown(layers.diffuse), "specular": shown(layers.specular)}
        notes |= {"gloss removed": f"what the remover {shape.settings.gloss} leaves", "specular": "what it takes away"}
        if layers.matte is not None:
            tabs["matte"] = shown(layers.matte)
            notes["matte"] = "the predicted gloss-free twin, which photometric stereo works on"
    if shape.settings.repair != "none":
        tabs["defects"] = [_look(overlay(tone(capture.images[k], white), shape.defects.mask[k]), mask) for k in frames]
        tabs["repaired"] = shown(shape.images)
        notes |= {"defects": "samples that are to be repaired", "repaired": f"after {shape.settings.repair}"}
    for name in ("diffuse", "specular", "matte"):
        stack = getattr(capture.truth, name)
        if stack is not None:
            tabs[f"true {name}"] = shown(stack)
            notes[f"true {name}"] = "rendered truth"
    first = [Figure(name, picture) for name, picture in zip(names, tabs["input"], strict=True)]
    caption = "Tabs choose the layer, the slider the light."
    if len(names) < capture.count:
        caption += f" {len(names)} of {capture.count} pictures are shown."
    parts: list[Part] = [Row(first, columns=5, title="The pictures"), Gallery("Layer by layer", tabs, names, caption, notes)]
    if shape.settings.gloss != "none":
        after = shown(shape.images)[0]
        parts.append(Wipe("Before and after", tabs["input"][0], after, ("input", "what was measured"), f"Picture {names[0]}."))
    return Section("Pictures", "", parts)


def _maps(shape: Shape) -> Section:
    normals, height, mask = shape.normals, shape.height.height, shape.capture.mask
    factor, unit = unit_of(shape.height.unit)
    low, high = height_range(height)
    step = (shape.capture.scale.metres_per_pixel or 1.0) if shape.height.unit == "m" else 1.0
    spread = normals.uncertainty[np.isfinite(normals.uncertainty)]
    figures = [
        Figure("Normals", _look(normal_picture(normals.normal, normals.measurable), mask), legend=sphere_legend(96)),
        Figure(
            "Height",
            _look(height_picture(height, low, high, "height"), mask),
            legend=Bar(low * factor, high * factor, unit, "height", above=True),
        ),
        Figure("Shaded relief", _look(relief_picture(height, low, high, step), mask), "Lit from the upper left."),
    ]
    white = white_of(normals.albedo[None], normals.measurable)
    figures.append(Figure("Albedo", _look(tone(normals.albedo, white), mask), "Scaled to its 99th percentile."))
    if spread.size:
        top = max(float(np.percentile(spread, 95)), 0.1)
        picture = _look(error_picture(normals.uncertainty, top=top), mask)
        figures.append(
            Figure(
                "Uncertainty",
                picture,
                f"One standard deviation of the normal, {_known_from(shape)}.",
                Bar(0, top, "deg", "error", ".1f", True),
            )
        )
    true = true_height(shape.capture)
    if true is None:
        series = [Series("measured", *_profile(height, mask, factor))]
    else:
        fitted, _ = fitted_height(height, true, mask, free_scale(shape))
        unit, level = (
            "mm",
            float(np.nanmean(fitted[mask])),
        )  # the truth counts from the camera, the profile from the surface's mean
        curves = {"measured": fitted - level, "true": true - level}
        series = [Series(name, *_profile(curve, mask, 1e3), dashed=name == "true") for name, curve in curves.items()]
    row = int(np.median(np.nonzero(shape.capture.mask)[0]))
    plot = Plot(f"Height along row {row + 1}", series, "column, px", f"height, {unit}")
    return Section("Shape", "", [Row(figures, columns=3), plot])


def _known_from(shape: Shape) -> str:
    """What the stated uncertainty rests on."""
    if table_for(shape.settings.gloss, shape.settings.normals) is None:
        return "from the fit's residual"
    return "as such pixels erred on renders"


def _comparison(comparison: Comparison) -> Section:
    rows, truth, mask = comparison.rows, comparison.capture.truth, comparison.capture.mask
    parts: list[Part] = []
    normals = {name: _look(normal_picture(shape.normals.normal, shape.normals.measurable), mask) for name, shape in rows.items()}
    parts.append(
        Row([Figure(comparison.label(name), picture) for name, picture in normals.items()], columns=3, title="Normal maps")
    )
    low, high = comparison.height_range()
    factor, unit = unit_of(next(iter(rows.values())).height.unit)
    heights = {name: height_picture(shape.height.height, low, high) for name, shape in rows.items()}
    bar = Bar(low * factor, high * factor, unit, "grey")
    figures = [Figure(comparison.label(name), _look(picture, mask), legend=bar) for name, picture in heights.items()]
    ruler = "true matte" if comparison.reference else next(iter(rows))
    caption = f"One scale for all: the range of the heights from the {comparison.label(ruler)}."
    parts.append(Row(figures, columns=3, title="Height maps", caption=caption))
    if comparison.reference is not None:
        parts += _differences(comparison)
    if truth.normals is not None:
        errors = {name: angular_error(shape.normals.normal, truth.normals) for name, shape in rows.items()}
        known = np.concatenate([e[np.isfinite(e)] for e in errors.values()])
        top = float(np.clip(np.ceil(np.percentile(known, 95)), 1, 90))
        scale = Bar(0, top, "deg", "error", ".0f", True)
        figures = [
            Figure(comparison.label(name), _look(error_picture(e, comparison.capture.mask, top), mask), legend=scale)
            for name, e in errors.items()
        ]
        parts.append(Row(figures, columns=3, title="Angle to the true normals"))
    true = true_height(comparison.capture)
    if true is not None:
        fits = {name: fitted_height(shape.height.height, true, mask, free_scale(shape))[0] for name, shape in rows.items()}
        gaps = {name: (fitted - true) * 1e3 for name, fitted in fits.items()}
        top = float(np.nanpercentile(np.abs(np.stack(list(gaps.values()))), 98)) or 1.0
        scale = Bar(-top, top, "mm", "signed", "+.2f")
        figures = [
            Figure(comparison.label(name), _look(signed_picture(gap, top=top), mask), legend=scale) for name, gap in gaps.items()
        ]
        parts.append(
            Row(figures, columns=3, title="Height error", caption="After the best fit. Orange is too high, blue too low.")
        )
    return Section("Comparison", "The same solver and integrator on different pictures of the same capture.", parts)


def _differences(comparison: Comparison) -> list[Part]:
    """Difference images against the non-glossy result, as in the paper's Fig. 4.3 to 4.5."""
    reference = comparison.reference
    assert reference is not None
    span, mask = comparison.height_range(), comparison.capture.mask

    def height_rgb(shape: Shape) -> Picture:
        return np.repeat(height_bytes(shape.height.height, *span)[..., None], 3, axis=2)

    others = {name: shape for name, shape in comparison.rows.items() if shape is not reference}
    parts: list[Part] = []
    for title, picture in (("normal maps", lambda shape: normal_bytes(shape.normals.normal)), ("height maps", height_rgb)):
        pairs = {name: (picture(shape), picture(reference)) for name, shape in others.items()}
        scale = difference_scale(*pairs.values())
        figures = [Figure(comparison.label(name), _look(difference_picture(a, b, scale), mask)) for name, (a, b) in pairs.items()]
        caption = f"Absolute difference of the 8-bit pictures from the non-glossy result, times {scale:g}."
        parts.append(Row(figures, columns=4, title=f"Difference of {title}", caption=caption))
    return parts


def _method(shape: Shape, metrics: Metrics) -> Section:
    rows: list[list[object]] = [[name, str(value)] for name, value in metrics["settings"].items()]
    rows += [["frames", ", ".join(metrics["frames"])], ["encoding", metrics["encoding"]]]
    rows += [["clipped samples", f"{metrics['clipped percent']:.2f} %"], ["defects", f"{metrics['defects']['percent']:.2f} %"]]
    rows += [[f"time: {name}", f"{value:.2f} s"] for name, value in metrics["seconds"].items()]
    lights = [
        [name, *light, *power]
        for name, light, power in zip(shape.capture.names, shape.capture.lights, shape.capture.intensities, strict=True)
    ]
    columns = [Column("frame"), *(Column(c, ".4f") for c in "xyz"), *(Column(f"intensity {c}", ".3f") for c in "RGB")]
    return Section("How it was measured", "", [Table("Settings", ["", ""], rows), Table("Lights", columns, lights)])


def _look(picture: Picture, mask: NDArray[np.bool_]) -> Picture:
    """The part of a picture that shows the object, small enough for the page."""
    return fit(crop_to_mask(picture, mask, 8), MAX_SIDE)


def _profile(height: NDArray[np.float32], mask: NDArray[np.bool_], factor: float) -> tuple[list[float], list[float]]:
    row = int(np.median(np.nonzero(mask)[0]))
    columns = np.flatnonzero(mask[row])
    chosen = np.arange(columns[0], columns[-1] + 1)
    return [float(c) + 1 for c in chosen], [float(v) for v in height[row, chosen] * factor]
