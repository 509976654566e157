"""The page of a benchmark: the ranking, the objects, and for each object the maps of every method as the paper shows them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon.benchmark.summary import counted, label
from recon.benchmark.units import Unit
from recon.page_parts import Bar, Figure, Gallery, Map, Note, Page, Part, Plot, Row, Section, Series, Table, Window
from recon.page_plot import MAX_SERIES
from recon.pictures import OUTSIDE, Picture, colour_strip, sphere_legend
from recon.tables import Column

TOP = 30.0
"""Degrees at the end of the error maps' scale."""

RELIABILITY = (
    "Every pixel states one standard deviation of its normal's angle. Pixels are put together by what they state, and their true root mean "
    "square error is drawn above it: on the dashed line the two agree, above it a method is worse than it says. Apart is the mean distance."
)

METHODS = {"gloss": "gloss", "repair": "repair", "normals_by": "normals", "height_by": "height"}
"""The four choices as rows name them -> as the page's table does."""

MAX_OBJECTS = 40
"""Objects whose maps are shown."""

MAX_MAPS = 30
"""Methods whose maps are shown of an object, the best first."""


def benchmark_page(name: str, summary: Mapping[str, Any], maps: Iterable[tuple[Unit, Mapping[str, NDArray[Any]]]]) -> Page:
    """The page of a summary (see `recon.benchmark.summary.summarise`) and the maps of its captures."""
    ranking = summary["ranking"]
    lead = "Nothing could be measured by every combination."
    asked = [e for e in ranking if not e["gloss"].startswith("true-")]
    if asked:
        best = asked[0]
        lead = (
            f"{counted(summary['units'], 'measurement')} of {counted(summary['captures'], 'capture')}. Of the methods that need no truth, "
            f"{', '.join(best[k] for k in ('gloss', 'repair', 'normals_by', 'height_by'))} errs least: {best['normals']:.2f}° on average."
        )
    sections = [Section("Ranking", _explained(), [_ranking(ranking), *_left_out(summary)])]
    if len(summary["groups"]) > 1 or summary["published"]:
        sections.append(
            Section("Objects", "Mean angular error in degrees of each object or kind of object.", [_objects(summary)])
        )
    judged = [e for e in ranking if "reliability" in e]
    if judged:
        sections.append(Section("Uncertainty", RELIABILITY, _reliability(judged, ranking)))
    order = {tuple(e[k] for k in METHODS): i for i, e in enumerate(ranking)}
    shown = 0
    for unit, held in maps:
        if shown < MAX_OBJECTS and "names" in held:
            sections.append(_object(unit, held, order, ranking))
            shown += 1
    return Page(
        f"Benchmark {name}", lead, sections, facts={"captures": str(summary["captures"]), "measurements": str(summary["units"])}
    )


def _explained() -> str:
    return (
        "Errors are mean angles between measured and true normals, in degrees, over the pixels that all combinations measured, then over "
        "captures and draws of lights (± standard deviation). The gap closed is 1 where a method is as good as the non-glossy pictures "
        "and 0 where it is as bad as the glossy ones. Intervals are 95 %, by a paired bootstrap."
    )


def _ranking(ranking: list[Mapping[str, Any]]) -> Table:
    named = [k for k in METHODS if len({e[k] for e in ranking}) > 1] or ["gloss"]
    columns = [
        *(Column(METHODS[k], "s") for k in named),
        Column("error", ".2f", "deg"), Column("±", ".2f", "deg"), Column("median", ".2f", "deg"), Column("lit by all", ".2f", "deg"),
        Column("against glossy", "+.2f", "deg"), Column("from", "+.2f"), Column("to", "+.2f"), Column("gap closed", ".2f"),
        Column("height error", ".2f", "% of range"), Column("height MSE", ".1f", "8-bit"), Column("picture MSE", ".1f", "8-bit"),
        Column("measured", ".1f", "%"), Column("time", ".2f", "s"),
    ]  # fmt: skip
    rows = []
    for e in ranking:
        low, high = e.get("interval") or (None, None)
        rows.append([
            *(e[k] for k in named), e["normals"], e.get("sd"), e.get("median"), e.get("lit by all"),
            e.get("difference"), low, high, e.get("gap closed"), e.get("of range"), e.get("height MSE"), e.get("picture MSE"),
            e.get("measured"), e["seconds"],
        ])  # fmt: skip
    used = [j for j in range(len(columns)) if any(row[j] is not None for row in rows)]
    return Table(
        "All combinations, the best first",
        [columns[j] for j in used],
        [[row[j] for j in used] for row in rows],
        reference=[i for i, e in enumerate(ranking) if e["gloss"].startswith("true-")],
    )


def _reliability(entries: list[Mapping[str, Any]], ranking: list[Mapping[str, Any]]) -> list[Part]:
    """The reliability plot of the best combinations, and the figures of all."""
    shown = [e for e in entries if len(e["reliability"]["bins"]) > 1 and not e["gloss"].startswith("true-")][: MAX_SERIES - 1]
    parts: list[Part] = []
    if shown:
        top = max(b["predicted"] for e in shown for b in e["reliability"]["bins"])
        curves = [
            Series(
                label(e, ranking),
                [b["predicted"] for b in e["reliability"]["bins"]],
                [b["actual"] for b in e["reliability"]["bins"]],
            )
            for e in shown
        ]
        parts.append(
            Plot(
                "Stated and true errors",
                [*curves, Series("as stated", [0.0, top], [0.0, top], dashed=True)],
                "stated, °",
                "RMS error, °",
            )
        )
    columns = [
        Column("methods", "s"),
        Column("stated", ".2f", "deg"),
        Column("true", ".2f", "deg"),
        Column("apart", ".2f", "deg"),
        Column("not stated", ".1f", "%"),
    ]
    rows = [
        [
            label(e, ranking),
            e["reliability"]["predicted"],
            e["reliability"]["actual"],
            e["reliability"]["calibration_error"],
            100 * e["reliability"]["unknown"],
        ]
        for e in entries
    ]
    parts.append(Table("Uncertainty of all combinations", columns, rows))
    return parts


def _left_out(summary: Mapping[str, Any]) -> list[Part]:
    return [
        Note(f"Left out: {', '.join(e[k] for k in ('gloss', 'repair', 'normals_by', 'height_by'))}. {e['why']}")
        for e in summary["left out"]
    ]


def _objects(summary: Mapping[str, Any]) -> Table:
    groups, entries = summary["groups"], summary["objects"]
    rows: list[list[object]] = [[label(e, entries), *(e["errors"][g] for g in groups)] for e in entries]
    rows += [[f"{row}, published, 96 lights", *(values.get(g) for g in groups)] for row, values in summary["published"].items()]
    ours = len(entries)
    return Table(
        "By object",
        [Column("methods", "s"), *(Column(g, ".2f", "deg") for g in groups)],
        rows,
        caption="Published rows use all 96 pictures of an object." if summary["published"] else "",
        reference=list(range(ours, len(rows))),
    )


def _object(
    unit: Unit, held: Mapping[str, NDArray[Any]], order: Mapping[tuple[str, ...], int], ranking: list[Mapping[str, Any]]
) -> Section:
    """The maps of one capture: a gallery of normals, heights and errors with a frame a method, and the errors side by side."""
    mask = held["mask"]
    numbered = [(tuple(str(text).split("\x1f")), i) for i, text in enumerate(held["names"])]
    numbered = sorted((c for c in numbered if c[0] in order), key=lambda c: order[c[0]])[:MAX_MAPS]
    frames = [label(ranking[order[c]], ranking) for c, _ in numbered]
    layers: dict[str, list[Picture | None]] = {"normals": [], "height": []}
    errors: list[Map] = []
    window = Window.whole(mask)
    for (_, i), frame in zip(numbered, frames, strict=True):
        layers["normals"].append(_outside(held[f"n{i}"], mask))
        layers["height"].append(_outside(colour_strip("height")[0][held[f"z{i}"]], mask))
        if f"e{i}" in held:
            error = np.where(mask, held[f"e{i}"].astype(np.float32), np.nan)
            known = error[np.isfinite(error)]
            title = f"{frame}: {known.mean():.2f}°" if known.size else frame
            errors.append(Map(title, error, Bar(0, TOP, "°", format=".3g", above=bool((known > TOP).any())), window))
    parts: list[Part] = [
        Row([Figure("brightest picture", held["picture"]), Figure("legend of normals", sphere_legend())], columns=4)
    ]
    if frames:
        notes = {
            "normals": "red to the right, green up, blue to the viewer",
            "height": "dark is low, light is high: one scale for all methods, the range of heights from the non-glossy pictures or, "
            "without them, of the first method; beyond it, the end's colour",
        }
        caption = "The slider goes through the methods, the best first."
        parts.append(Gallery(f"Maps of {unit.name}", layers, frames, caption, notes, slider="Method"))
    if errors:
        caption = "Maps are thinned: rows, columns and ruler are of the map. The tables use every pixel."
        parts.append(Row(errors[:12], columns=4, title="Angular error", caption=caption))
    return Section(unit.name, f"{unit.group}, {len(unit.lights)} lights.", parts)


def _outside(picture: NDArray[Any], mask: NDArray[np.bool_]) -> Picture:
    return np.where(mask[..., None], picture, np.array(OUTSIDE, np.uint8)).astype(np.uint8)
