"""The tables of a measurement: which figures stand in which column, for the terminal and for the page alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Metrics = Mapping[str, Any]


@dataclass(frozen=True)
class Column:
    """A column of a table. format: Python's format of its numbers, such as ".2f". unit: shown under the title."""

    title: str
    format: str = ".2f"
    unit: str = ""


def text_report(metrics: Metrics) -> str:
    """The short table for the terminal: how it was measured and, where there is truth, a row of figures for each set of pictures."""
    s, h = metrics["settings"], metrics["height"]
    size = "x".join(str(n) for n in metrics["size"])
    lines = [
        f"{metrics['source']}: {metrics['lights']} pictures of {size} read as {metrics['encoding']}, "
        f"{metrics['pixels']:,} pixels, {metrics['measured percent']:.1f} % measured",
        f"gloss {s['gloss']}, repair {s['repair']} ({metrics['defects']['percent']:.1f} % of samples), "
        f"normals {s['normals']} on the {metrics['consumed']}, height {s['height']}",
        f"height range {length_text(h['high'] - h['low'], h['unit'])}",
    ]
    lines += metrics["notes"]
    rows = metrics.get("comparison") or (
        {"this": {"label": "this measurement", **metrics["truth"]}} if "truth" in metrics else {}
    )
    for title, wanted in (
        ("error against the truth", TRUTH_COLUMNS),
        ("deviation from the non-glossy result", PAPER_COLUMNS),
    ):
        columns, cells = figure_table(rows, wanted)
        if len(columns) > 1:
            text = [[title, *(column.title for column in columns[1:])], [column.unit for column in columns]]
            text += [[_cell(value, column.format) for value, column in zip(row, columns, strict=True)] for row in cells]
            widths = [max(len(row[c]) for row in text) for c in range(len(columns))]
            lines.append("")
            lines += [_aligned(row, widths) for row in text]
    return "\n".join(lines)


@dataclass(frozen=True)
class Wanted:
    """A figure of a comparison's row: its column, its place in the tree of `Comparison.figures`, a factor to the column's unit."""

    column: Column
    path: tuple[str, ...]
    factor: float = 1.0


TRUTH_COLUMNS = [
    Wanted(Column("normals", ".2f", "deg"), ("normals", "mask", "mean")),
    Wanted(Column("median", ".2f", "deg"), ("normals", "mask", "median")),
    Wanted(Column("eroded 2 px", ".2f", "deg"), ("normals", "eroded", "mean")),
    Wanted(Column("lit by all", ".2f", "deg"), ("normals", "lit by all", "mean")),
    Wanted(Column("gap closed", ".2f"), ("gap closed",)),
    Wanted(Column("height", ".3f", "mm"), ("height", "rmse"), 1e3),
    Wanted(Column("of range", ".2f", "%"), ("height", "percent")),
]
"""The figures against the true geometry."""

PAPER_COLUMNS = [
    Wanted(Column("normals", ".2f", "deg"), ("non-glossy", "mean angle")),
    Wanted(Column("normal MSE", ".1f", "8-bit"), ("non-glossy", "normal MSE")),
    Wanted(Column("normal MSE", ".1f", "full frame"), ("non-glossy", "normal MSE full frame")),
    Wanted(Column("height MSE", ".1f", "8-bit"), ("non-glossy", "height MSE")),
    Wanted(Column("height MSE", ".1f", "full frame"), ("non-glossy", "height MSE full frame")),
]
"""The figures of the paper's protocol: the deviation from the non-glossy result."""


def figure_table(rows: Mapping[str, Metrics], wanted: Sequence[Wanted]) -> tuple[list[Column], list[list[Any]]]:
    """Columns and rows of a table of figures, leaving out the columns that no row has a value for (then only the labels are left)."""
    columns = [Column("pictures", "s")]
    cells: list[list[Any]] = [[row["label"]] for row in rows.values()]
    for figure in wanted:
        values = [_at(row, figure.path) for row in rows.values()]
        if any(value is not None for value in values):
            columns.append(figure.column)
            for cell, value in zip(cells, values, strict=True):
                cell.append(None if value is None else value * figure.factor)
    return columns, cells


def _cell(value: Any, form: str) -> str:
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return "-"
    return value if isinstance(value, str) else format(value, form)


def _aligned(row: list[str], widths: list[int]) -> str:
    """The first cell to the left, the others to the right."""
    first, *others = (
        cell.ljust(width) if c == 0 else cell.rjust(width) for c, (cell, width) in enumerate(zip(row, widths, strict=True))
    )
    return "  ".join([first, *others]).rstrip()


def _at(row: Metrics, path: tuple[str, ...]) -> float | None:
    value: Any = row
    for key in path:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def unit_of(unit: str) -> tuple[float, str]:
    """The factor to the unit that people read, and its name: metres are shown in millimetres."""
    return (1e3, "mm") if unit == "m" else (1.0, unit)


def length_text(value: float, unit: str) -> str:
    """A height or a range of heights with its unit, four digits."""
    factor, shown = unit_of(unit)
    return f"{value * factor:.4g} {shown}"
