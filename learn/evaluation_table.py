"""An evaluation as text for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from learn.evaluate import ALL, Evaluation

PICTURE_COLUMNS = {"mse": ".2f", "mse mask": ".2f", "psnr": ".2f", "psnr mask": ".2f", "psnr highlight": ".2f", "ssim": ".4f"}
MEASUREMENT_COLUMNS = {"normals": ".2f", "gap closed": ".3f", "non-glossy": ".2f", "height MSE": ".1f", "times smaller": ".1f"}


def text_of(evaluation: Evaluation) -> str:
    """Tables of the pictures' errors (all, then the error inside the mask by slice) and of the measurement, and the notes."""
    counts = evaluation.counts
    lines = [f"{counts['pictures']} pictures of {counts['captures']} captures, {counts['captures measured']} of them measured"]
    for layer, against in (("diffuse", "the true diffuse layer"), ("matte", "the non-glossy pictures")):
        rows = {name: row[layer] for name, row in evaluation.pictures.get(ALL, {}).get(ALL, {}).items() if layer in row}
        if rows:
            lines += ["", f"{layer}, against {against}, on 8-bit values", *table(rows, PICTURE_COLUMNS)]
    for kind, values in evaluation.pictures.items():
        if kind != ALL:
            lines += ["", f"diffuse by {kind}: mse inside the mask", *_slices(values)]
    if evaluation.measurement:
        lines += [
            "",
            "photometric stereo: mean angle to the true normals and to the non-glossy result in degrees, height against that result",
            *_measurement(evaluation.measurement),
        ]
        if len(evaluation.by_material) > 1:
            for kind, measured in evaluation.by_material.items():
                lines += ["", f"photometric stereo, {kind}", *_measurement(measured)]
    return "\n".join([*lines, *([""] if evaluation.notes else []), *evaluation.notes])


def table(rows: Mapping[str, Mapping[str, Any]], columns: Mapping[str, str]) -> list[str]:
    """Aligned lines: a title line, then one a row. columns: key of a figure -> Python's format of it."""
    text = [["", *columns]]
    text += [[name, *(cell(row.get(key), form) for key, form in columns.items())] for name, row in rows.items()]
    return aligned(text)


def aligned(text: Sequence[Sequence[str]]) -> list[str]:
    """Rows of cells as lines: the first cell to the left, the others to the right."""
    widths = [max(len(row[c]) for row in text) for c in range(len(text[0]))]
    return [
        "  ".join(
            [row[0].ljust(widths[0]), *(value.rjust(width) for value, width in zip(row[1:], widths[1:], strict=True))]
        ).rstrip()
        for row in text
    ]


def cell(value: Any, form: str) -> str:
    """A figure in its format, "-" where there is none."""
    return "-" if value is None else format(value, form)


def _measurement(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The table of rows of `learn.end_to_end.pooled`."""
    found = {name: {**row, "interval": _interval(row["interval"])} for name, row in rows.items()}
    return table(found, {**MEASUREMENT_COLUMNS, "interval": "s"})


def _slices(values: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float | None]]]]) -> list[str]:
    """Values of a slice as columns, methods as rows."""
    names = list(dict.fromkeys(name for rows in values.values() for name in rows))
    text = [["", *values]]
    for name in names:
        text.append(
            [name, *(cell(rows[name]["diffuse"]["mse mask"] if name in rows else None, ".2f") for rows in values.values())]
        )
    return aligned(text)


def _interval(ends: Sequence[float] | None) -> str | None:
    return None if ends is None else f"{ends[0]:.3f} to {ends[1]:.3f}"
