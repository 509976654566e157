"""The comparison in a report: the same measurement from glossy, gloss-removed and non-glossy pictures, side by side."""

from __future__ import annotations

import numpy as np

from recon.compare import Comparison, free_scale, true_height
from recon.metrics import angular_error, fitted_height, height_bytes, normal_bytes
from recon.page_parts import Bar, Figure, Map, Part, Row, Section
from recon.pictures import Picture, difference_picture, difference_scale, normal_picture, sphere_legend
from recon.reconstruct import Shape
from recon.report_maps import error_map, error_top, look, thinned, window_of
from recon.tables import unit_of

COMPARED_SIDE = 288
"""Longest side of the maps in pixels: they stand side by side."""


def comparison_section(comparison: Comparison) -> Section:
    """Normals, heights, and their errors, a row of maps each (Fig. 4.2 to 4.5 of the paper)."""
    rows, truth, mask = comparison.rows, comparison.capture.truth, comparison.capture.mask
    window, columns = window_of(comparison.capture, COMPARED_SIDE), columns_of(comparison)
    parts: list[Part] = []
    normals = {name: look(normal_picture(shape.normals.normal, shape.normals.measurable), mask) for name, shape in rows.items()}
    figures = [Figure(comparison.label(name), picture, legend=sphere_legend(96)) for name, picture in normals.items()]
    parts.append(Row(figures, columns=columns, title="Normal maps"))
    low, high = comparison.height_range()
    factor, unit = unit_of(next(iter(rows.values())).height.unit)
    scaled = {name: window.cut(shape.height.height) * factor for name, shape in rows.items()}
    beyond = any(np.nanmax(z) > high * factor for z in scaled.values())
    bar = Bar(low * factor, high * factor, unit, "grey", "#.3g", above=beyond)
    maps = [Map(comparison.label(name), z, bar, window) for name, z in scaled.items()]
    ruler = "true matte" if comparison.reference else next(iter(rows))
    caption = f"One scale for all: the range of the heights from the {comparison.label(ruler)}. Read together at the same pixel."
    parts.append(Row(maps, columns=columns, title="Height maps", caption=caption + thinned(window)))
    if comparison.reference is not None:
        parts += _differences(comparison)
    if truth.normals is not None:
        true_normals = window.cut(truth.normals)
        errors = {name: angular_error(window.cut(shape.normals.normal), true_normals) for name, shape in rows.items()}
        top = error_top(np.concatenate([e[np.isfinite(e)] for e in errors.values()]))
        maps = [error_map(comparison.label(name), e, window, top) for name, e in errors.items()]
        parts.append(Row(maps, columns=columns, title="Angle to the true normals", caption=thinned(window).strip()))
    true = true_height(comparison.capture)
    if true is not None:
        fits = {name: fitted_height(shape.height.height, true, mask, free_scale(shape))[0] for name, shape in rows.items()}
        gaps = {name: window.cut(fitted - true) * 1e3 for name, fitted in fits.items()}
        top = float(np.nanpercentile(np.abs(np.stack(list(gaps.values()))), 98)) or 1.0
        maps = [
            Map(comparison.label(name), gap, Bar(-top, top, "mm", "signed", "+.3g", bool(np.nanmax(np.abs(gap)) > top)), window)
            for name, gap in gaps.items()
        ]
        caption = "After the best fit. Orange is too high, blue too low." + thinned(window)
        parts.append(Row(maps, columns=columns, title="Height error", caption=caption))
    return Section("Comparison", "The same solver and integrator on different pictures of the same capture.", parts)


def columns_of(comparison: Comparison) -> int:
    """Maps a line: one for each row of the comparison, so that they stand below each other, and three at least, so that none is huge."""
    return min(max(len(comparison.rows), 3), 5)


def _differences(comparison: Comparison) -> list[Part]:
    """Difference images against the non-glossy result, as in the paper's Fig. 4.3 to 4.5."""
    reference = comparison.reference
    assert reference is not None
    span, mask = comparison.height_range(), comparison.capture.mask

    def height_rgb(shape: Shape) -> Picture:
        return np.repeat(height_bytes(shape.height.height, *span)[..., None], 3, axis=2)

    others = {name: shape for name, shape in comparison.rows.items() if shape is not reference}
    parts: list[Part] = []
    columns = columns_of(comparison)
    for title, picture in (("normal maps", lambda shape: normal_bytes(shape.normals.normal)), ("height maps", height_rgb)):
        pairs = {name: (picture(shape), picture(reference)) for name, shape in others.items()}
        scale = difference_scale(*pairs.values())
        bar = Bar(0, 255 / scale, "levels", "grey", ".3g", above=scale > 1)
        figures = [
            Figure(comparison.label(name), look(difference_picture(a, b, scale), mask), legend=bar)
            for name, (a, b) in pairs.items()
        ]
        caption = f"Absolute difference of the 8-bit pictures from the non-glossy result, channel by channel, times {scale:g}."
        parts.append(Row(figures, columns=columns, title=f"Difference of {title}", caption=caption))
    return parts
