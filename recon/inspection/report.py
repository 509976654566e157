"""The page of an inspection, composed of the parts of `recon.page`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.inspection.inspection import Inspection
from recon.inspection.maps import COLOURS, deviation_map, look, uncertainty_map, verdict_map
from recon.mesh import surface_mesh
from recon.page_parts import Figure, Key, Map, Note, Page, Part, Plot, Profile, Row, Section, Series, Table, Window
from recon.tables import Column

BINS = 101
"""Of the histogram, over three tolerances to each side."""

MAX_SIDE = 512
"""Longest side of a picture in the page, in pixels."""


def inspection_page(inspection: Inspection) -> Page:
    """The verdict in words, the maps, the histogram, and how it was aligned."""
    measured, v, f, unit = inspection.measured, inspection.verdict, inspection.factor, inspection.unit
    scale = 1e-3 if measured.unit == "mm" else 1.0
    facts = {
        "features": v.features,
        "form": "not measurable",
        "tolerance": f"±{v.tolerance * f:.3g} {unit}",
        "guard band": f"{v.guard:g} u, median {v.provable * f:.2g} {unit}"
        if np.isfinite(v.provable)
        else f"{v.guard:g} u, u unknown",
        "wavelengths judged": f"{inspection.deviation.shortest:.3g} to {inspection.deviation.cutoff:.3g} mm",
        "judged": f"{100 * v.judged:.1f} % of what is in view",
        "nominal": f"{Path(inspection.nominal.source).name}, {inspection.nominal.size:.4g} mm long",
    }
    return Page(
        title=f"Inspection of {Path(measured.source).name or measured.source}",
        lead=inspection.sentence(),
        sections=[_verdict(inspection), _maps(inspection), _distribution(inspection), _alignment(inspection)],
        mesh=surface_mesh((measured.points * scale).astype(np.float32), measured.normal.astype(np.float32)),
        mesh_colours=deviation_map(inspection, "raw")[0][np.isfinite(measured.points).all(axis=2)],
        mesh_painted="Deviation",
        facts=facts,
        mesh_unit="m" if measured.unit == "mm" else "px",
        mesh_caption="The surface as measured, with the drift of its form. Deviation: the colours of the raw map.",
        footer="Deviations are along the nominal's normal: positive (orange) is too much material, negative (blue) too little.",
    )


def _verdict(inspection: Inspection) -> Section:
    v, f, unit = inspection.verdict, inspection.factor, inspection.unit
    columns = [Column("pixels judged", "s"), Column("share", ".3g", "%")]
    parts: list[Part] = [
        Figure(
            "Verdict by pixel",
            look(inspection, verdict_map(inspection), MAX_SIDE),
            "Not judged are edges, steep flanks, and what stands alone.",
            Key(COLOURS),
        ),
        Table("How much of it", columns, [[name, 100 * share] for name, share in v.shares.items()]),
    ]
    if v.places:
        places = [
            Column("place", ".0f"),
            Column("deviation", "+.3g", unit),
            Column("uncertainty u", ".2g", unit),
            Column("out of tolerance", ".3g", "mm²"),
            Column("column", ".0f", "px"),
            Column("row", ".0f", "px"),
        ]
        rows = [[i, p.deviation * f, p.uncertainty * f, p.area, p.column + 1, p.row + 1] for i, p in enumerate(v.places[:20], 1)]
        caption = "Where the deviation exceeds the tolerance by more than the guard band, largest first."
        if len(v.places) > 20:
            caption += f" The first 20 of {len(v.places)}; inspection.json holds them all."
        parts.append(Table("Places that fail", places, rows, caption))
    text = (
        "A pixel passes where its deviation and the guard band lie within the tolerance, fails where the deviation exceeds the "
        "tolerance by more than the guard band, and is not decided between the two (ISO 14253-1)."
    )
    return Section("Verdict", text, [*(Note(note) for note in inspection.notes()), *parts])


def _maps(inspection: Inspection) -> Section:
    d = inspection.deviation

    there = inspection.measured.known | inspection.alignment.nominal.inside
    window = Window.around(there, MAX_SIDE, inspection.pixel, margin=6)

    def deviation(title: str, name: str, caption: str) -> Map:
        return Map(title, window.cut(getattr(d, name)) * inspection.factor, deviation_map(inspection, name)[1], window, caption)

    maps = [
        deviation("Raw deviation", "raw", "As aligned, with the drift of the form: not judged."),
        deviation("Form removed", "features", f"What lies between {d.shortest:.3g} and {d.cutoff:.3g} mm: this is judged."),
        deviation("The form that was removed", "form", f"Longer than {d.cutoff:.3g} mm: not measurable."),
    ]
    for title, name, caption in (
        ("Uncertainty, form removed", "uncertainty", "One standard deviation, from the normals' uncertainty."),
        ("Uncertainty of the raw map", "raw_uncertainty", "Random errors alone; a drift that all normals share comes on top."),
    ):
        found = uncertainty_map(inspection, name)
        if found is not None:
            maps.append(Map(title, window.cut(getattr(d, name)) * inspection.factor, found[1], window, caption))
    text = (
        "The form is removed by a robust Gaussian regression filter of the second order with a cut-off of "
        f"{d.cutoff:.3g} mm, inside each connected area (L-filter, ISO 16610-31), which halves a wave of that length; what is finer "
        f"than {d.shortest:.3g} mm, three pixels, is smoothed (S-filter). The uncertainty is the spread of seeded errors of the normals "
        "that were integrated, aligned and filtered the same way."
    )
    picture, bar = deviation_map(inspection, "features")
    along = Profile(
        "Deviation along a line",
        window.cut(d.features) * inspection.factor,
        window.cut(picture),
        window,
        inspection.unit,
        bar,
        caption="Form removed. Drag over the picture to draw a line, or move its ends by the arrow keys (with Shift by ten pixels).",
        quantity="deviation",
    )
    parts: list[Part] = [Row(maps, columns=3, caption="Read together at the same pixel.")]
    return Section("Deviation", text, [*parts, *([along] if np.isfinite(along.height).any() else [])])


def _distribution(inspection: Inspection) -> Section:
    d, v, f, unit = inspection.deviation, inspection.verdict, inspection.factor, inspection.unit
    values = d.features[d.judged] * f
    if not values.size:
        return Section("Distribution", "", [Note("Not one pixel was judged.")])
    limit = v.tolerance * f
    edges = np.linspace(-3 * limit, 3 * limit, BINS + 1)
    share = 100 * np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0] / values.size
    series = [_steps("form removed", edges, share), _walls("tolerance", limit, float(share.max()))]
    band = limit - v.provable * f
    if np.isfinite(band) and band > 0:
        series.append(_walls("tolerance less the median guard band", band, float(share.max())))
    caption = "Over the judged pixels; what is beyond three tolerances stands in the outermost bins."
    plot = Plot(
        "Distribution of the deviation", series, f"deviation with the form removed, {unit}", "share of pixels, %", caption
    )
    rows = [[name, *(figures.get(key) for key in _KEYS)] for name, figures in inspection.figures()["deviation"].items()]
    columns = [Column("map", "s"), *(Column(title, form, unit) for title, form in _KEYS.items())]
    return Section("Distribution", "", [plot, Table("Deviation over the judged pixels", columns, rows)])


_KEYS = {"rms": ".3g", "median absolute": ".3g", "lowest": "+.3g", "highest": "+.3g", "median uncertainty": ".2g"}
"""The figures of `Inspection.figures` and their formats."""


def _steps(name: str, edges: np.ndarray, share: np.ndarray) -> Series:  # type: ignore[type-arg]
    """A histogram as a line with steps."""
    return Series(name, edges.repeat(2)[1:-1].tolist(), share.repeat(2).tolist())


def _walls(name: str, at: float, top: float) -> Series:
    """Two upright lines at -at and +at."""
    return Series(name, [-at, -at, -at, at, at], [0.0, top, float("nan"), 0.0, top], dashed=True)


def _alignment(inspection: Inspection) -> Section:
    a, nominal = inspection.alignment, inspection.nominal
    rows: list[list[object]] = [
        ["nominal", nominal.source],
        ["its unit", nominal.unit],
        ["residual along the normals, rms", f"{a.residual / a.pose.scale:.3g} mm"],
        ["residual of the outlines, rms", f"{a.outline:.2f} px"],
        ["measured pixels that correspond", f"{100 * a.inliers:.1f} %"],
        ["of the visible side measured", f"{100 * a.covered:.1f} %"],
        ["likeness (normals and silhouette, 1 is equal)", f"{a.likeness:.3f}"],
        ["millimetres a pixel", f"{inspection.pixel:.4g}" + (", from the nominal" if a.free_scale else "")],
    ]
    matrix = Table(
        f"Pose: from the nominal (mm) to the camera's frame ({inspection.measured.unit})",
        [Column(c, ".5g") for c in ("x", "y", "z", "shift")],
        [[float(value) for value in row] for row in a.pose.matrix()[:3]],
    )
    text = "Heights were brought together along the nominal's normals, outlines in the picture. The place along the view is not measured."
    return Section("Alignment", text, [Table("How it was aligned", ["", ""], rows), matrix])
