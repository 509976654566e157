"""Tables of a benchmark of views: means over objects of the figures of each mesh, and what could not be measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from recon.benchmark.cells import Row
from recon.benchmark.spec import Combination
from recon.benchmark.summary import counted
from recon.multiview.measure import LABELS
from recon.tables import Column

FIGURES: dict[str, tuple[tuple[str, ...], Column]] = {
    "accuracy": (("accuracy", "mean"), Column("accuracy", ".3f", "mm")),
    "completeness": (("completeness", "mean"), Column("completeness", ".3f", "mm")),
    "chamfer": (("chamfer",), Column("chamfer", ".3f", "mm")),
    "f score": (("f score",), Column("F", ".1f", "%")),
    "normals": (("normals", "mean"), Column("normals", ".2f", "°")),
    "seconds": (("seconds",), Column("time", ".1f", "s")),
    "accuracy 95 %": (("accuracy", "95 %"), Column("accuracy 95 %", ".3f", "mm")),
    "completeness 95 %": (("completeness", "95 %"), Column("completeness 95 %", ".3f", "mm")),
    "accurate": (("accuracy", "within"), Column("accurate", ".1f", "%")),
    "complete": (("completeness", "within"), Column("complete", ".1f", "%")),
}
"""Name in a summary -> where a row holds it (see `recon.multiview.compare.compare`; seconds are added up), and its column."""

EXPLAINED = (
    "Accuracy: mean distance from the mesh to the true surface; completeness: from the true surface, as far as the views show it, to the "
    "mesh; 95 %: the 95th percentile of these. Chamfer: the mean of the two means. Accurate and complete: the shares of the mesh and of "
    "the true surface within a pixel at the object of each other; F: the harmonic mean of the two. Normals: mean angle between the true "
    "faces and those of the mesh nearest to them."
)


def summarise_views(rows: Sequence[Row], combinations: Sequence[Combination]) -> dict[str, Any]:
    """The summary of a run.

    "objects": their names; "views": of all; "tolerance": the pixel of each, in mm. "ranking": for each combination that measured every
    object, by chamfer distance: its methods, the means of `FIGURES` over the objects (a figure is missing where an object has none).
    "left out": combinations that failed for an object, with the first reason and how often. "chamfer": of each
    combination of the ranking, its methods and the distance in mm by object.
    """
    by: dict[Combination, list[Row]] = {c: [] for c in combinations}
    for row in rows:
        by[(row["gloss"], row["repair"], row["normals_by"], row["height_by"])].append(row)
    failed = {c: [row for row in found if "failed" in row] for c, found in by.items()}
    whole = {c: found for c, found in by.items() if found and not failed[c]}
    ranking = sorted((_ranked(found) for found in whole.values()), key=lambda entry: float(entry["chamfer"]))
    return {
        "objects": list(dict.fromkeys(row["object"] for row in rows)),
        "views": sum({row["object"]: row["views"] for row in rows}.values()),
        "tolerance": {row["object"]: row["tolerance"] for row in rows if "tolerance" in row},
        "ranking": ranking,
        "left out": [
            {**_methods(found[0]), "failed": len(found), "why": found[0]["failed"]} for found in failed.values() if found
        ],
        "chamfer": sorted(
            ({**_methods(found[0]), "objects": {row["object"]: row["chamfer"] for row in found}} for found in whole.values()),
            key=lambda entry: float(np.mean(list(entry["objects"].values()))),
        ),
    }


def _ranked(found: Sequence[Row]) -> dict[str, Any]:
    entry: dict[str, Any] = _methods(found[0])
    for name, (path, _) in FIGURES.items():
        values = [value for row in found if (value := _at(row, path)) is not None]
        if len(values) == len(found):
            entry[name] = float(np.mean(values))
    return entry


def _methods(row: Row) -> dict[str, str]:
    return {key: row[key] for key in ("gloss", "repair", "normals_by", "height_by")}


def _at(row: Row, path: Sequence[str]) -> float | None:
    value: Any = row
    for key in path:
        value = None if value is None else value[key]
    return sum(value.values()) if isinstance(value, Mapping) else value


def views_label(entry: Mapping[str, Any], entries: Sequence[Mapping[str, Any]]) -> str:
    """A combination's name: the remover or what stands for it, the repair if there is one, the solver where several are compared."""
    parts = [LABELS.get(entry["gloss"], entry["gloss"])]
    parts += [entry["repair"]] if entry["repair"] != "none" else []
    parts += [entry["normals_by"]] if len({e["normals_by"] for e in entries}) > 1 else []
    return ", ".join(parts)


def views_markdown(name: str, summary: Mapping[str, Any]) -> str:
    """The summary as Markdown tables."""
    ranking, objects = summary["ranking"], summary["objects"]
    columns = [column for _, column in FIGURES.values()]
    lines = [
        f"# {name}",
        "",
        f"{counted(summary['views'], 'view')} of {counted(len(objects), 'object')}; means over objects, time an object",
        "",
        _line(["methods", *(f"{column.title}, {column.unit}" for column in columns)]),
        "|---|" + "---|" * len(columns),
    ]
    for entry in ranking:
        lines.append(
            _line([views_label(entry, ranking), *(_text(entry.get(name), column) for name, (_, column) in FIGURES.items())])
        )
    if summary["tolerance"]:
        lines += ["", f"Accurate, complete: within a pixel at the object, {pixels(summary)}."]
    if len(objects) > 1:
        lines += ["", _line(["chamfer, mm", *objects]), "|---|" + "---|" * len(objects)]
        chamfer = FIGURES["chamfer"][1]
        for entry in summary["chamfer"]:
            cells = [_text(entry["objects"][o], chamfer) for o in objects]
            lines.append(_line([views_label(entry, summary["chamfer"]), *cells]))
    for entry in summary["left out"]:
        lines += ["", f"Left out: {views_label(entry, [entry, *ranking])}: {entry['why']}"]
    return "\n".join(lines) + "\n"


def pixels(summary: Mapping[str, Any]) -> str:
    """The tolerances of a summary in words: "0.3 mm", or "0.2 to 0.3 mm" where objects differ."""
    low, high = (f"{f(summary['tolerance'].values()):.3g}" for f in (min, max))
    return f"{low} mm" if low == high else f"{low} to {high} mm"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _text(value: float | None, column: Column) -> str:
    return "-" if value is None else format(value, column.format)
