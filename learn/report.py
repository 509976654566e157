"""The pages of `degloss learn eval` and `degloss learn table1`, composed of the parts of `recon.page`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from learn.evaluate import ALL, CLASSICAL, NOTHING, Evaluation
from learn.evaluation_table import MEASUREMENT_COLUMNS, PICTURE_COLUMNS
from learn.table1 import LEARNING, METHODS, TEST, Table1
from recon.page_parts import Bar, Gallery, Map, Note, Page, Part, Row, Section, Table, Window
from recon.pictures import Picture, fit
from recon.tables import Column

MAX_SIDE = 400
"""Longest side of a picture in the page, in pixels."""

MAP_SIDE = 160
"""The same of the maps of errors."""

MAP_SCENES = 3
"""Scenes whose maps of errors are shown."""

INPUT, TRUTH = "input", "true diffuse"

FIGURES = (
    "Errors are of 8-bit sRGB values. mse and psnr: over the full frame, as in the paper; mask: inside the mask; highlight: where the true "
    "specular layer exceeds a tenth of display white. ssim: the mean over the pictures, 1 is equal."
)
UNITS = {"psnr": "dB", "psnr mask": "dB", "psnr highlight": "dB", "mse": "8-bit", "mse mask": "8-bit"}
MEASURED_UNITS = {"normals": "°", "non-glossy": "°", "height MSE": "8-bit"}


def evaluation_page(method: str, name: str, evaluation: Evaluation) -> Page:
    """The page of an evaluation. method: the row of the network that is judged. name: of the data."""
    counts = evaluation.counts
    lead = f"The network {method} on {name}: {counts['pictures']} pictures of {counts['captures']} captures."
    row, gap = evaluation.measurement.get(method), evaluation.measurement.get("glossy")
    if row is not None and gap is not None:
        lead += (
            f" {counts['captures measured']} captures were measured by photometric stereo: the normals err by {gap['normals']:.2f} degrees "
            f"from the glossy pictures and by {row['normals']:.2f} from the network's."
        )
    sections = [_pictures(evaluation), _errors(evaluation, highlight=method)]
    if evaluation.measurement:
        sections.append(_measurement(evaluation, method))
    sections.append(_slices(evaluation, method))
    facts = {key: str(value) for key, value in counts.items()}
    return Page(f"Evaluation of {method}", lead, sections, facts=facts)


def table1_page(table: Table1) -> Page:
    """The page of the paper's Table 1 and Fig. 3.3."""
    columns = [Column("method", "s")]
    for data in table.data:
        columns += [
            Column(data, ".2f", "mse, 8-bit"),
            Column("in the mask", ".2f", "mse, 8-bit"),
            Column("the paper's", ".2f", "mse, 8-bit"),
        ]
    rows: list[list[object]] = []
    for name, row in table.rows().items():
        cells = [(row[data]["mse"], row[data]["mse mask"], row.get("paper", {}).get(data)) for data in table.data]
        title = f"{row['letter']} {name}" if row["letter"] else name
        rows.append([title, *(value for three in cells for value in three)])
    caption = (
        "Mean squared error of 8-bit values over the full frame, as in the paper, and inside the mask. The paper's own figures are of "
        "other data: context, not a bar. A dash: the method does not apply, or the paper has no figure. Every method is given one "
        "picture at a time, the group network too, unless the data is of views with several."
    )
    parts: list[Part] = [Note(f"{data}: {note}.") for data, evaluation in table.data.items() for note in evaluation.notes]
    named = list(table.rows())
    reference = [named.index(name) for name in (NOTHING, *CLASSICAL)]
    sections = [Section("Table 1", "", [Table("Errors of the methods", columns, rows, caption, reference=reference), *parts])]
    for data in (TEST, LEARNING):
        evaluation = table.data.get(data)
        if evaluation is not None:
            sections.append(_pictures(evaluation, f"Pictures of the {data} data"))
            sections.append(_slices(evaluation, None, f"By slice, {data} data"))
    facts = {f"{data} pictures": str(evaluation.counts["pictures"]) for data, evaluation in table.data.items()}
    lead = "Gloss removal from single pictures: the paper's methods (a), (b) and (c), our group network (d), and the classical removers."
    return Page("The paper's Table 1 and Fig. 3.3", lead, sections, facts=facts)


def _pictures(evaluation: Evaluation, title: str = "Pictures") -> Section:
    """The scenes that were kept to look at, and their errors side by side."""
    if not evaluation.lines:
        return Section(title, "", [Note("There is no true diffuse layer, so there are no pictures to compare.")])

    def shown(column: int) -> list[Picture | None]:
        return [None if picture is None else fit(picture, MAX_SIDE) for picture in (line[column] for line in evaluation.lines)]

    layers = {name: shown(c) for c, name in enumerate(evaluation.titles) if any(line[c] is not None for line in evaluation.lines)}
    notes = {INPUT: "the picture as it came; of a view, its brightest", TRUTH: "the diffuse layer as it was rendered"}
    notes |= {name: f"the diffuse layer by {METHODS[name]} {name}" for name in layers if name in METHODS}
    frames = [f"scene {i + 1}" for i in range(len(evaluation.lines))]
    last = list(layers)[-1]
    caption = "Tabs choose the picture, the slider the scene; the divider wipes to the picture beside it."
    parts: list[Part] = [Gallery("Side by side", layers, frames, caption, notes, against=last, slider="Scene")]
    maps = [_error_maps(evaluation.titles, line) for line in evaluation.lines[:MAP_SCENES]]
    known = np.concatenate([values.ravel() for found in maps for values in found.values()])
    top = float(np.ceil(max(np.percentile(known, 99), 1.0)))
    bar = Bar(0, top, "levels", "error", ".3g", bool(known.max() > top))
    for frame, found in zip(frames, maps, strict=False):
        row = []
        for name, values in found.items():
            window = Window.around(np.ones(values.shape, bool), MAP_SIDE, margin=0)
            row.append(Map("do nothing" if name == INPUT else name, window.cut(values), bar, window))
        parts.append(Row(row, columns=min(max(len(row), 3), 6), title=f"Error of {frame}"))
    text = "Errors are absolute differences from the true diffuse layer, the mean of the three channels, of 255 levels; one scale for all."
    return Section(title, text, parts)


def _error_maps(titles: Sequence[str], line: Sequence[Picture | None]) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """The absolute difference from the truth, mean over the channels, of every picture of a line that is there: (H, W) levels."""
    pictures = {name: picture.astype(np.float64) for name, picture in zip(titles, line, strict=True) if picture is not None}
    truth = pictures.pop(TRUTH)
    return {name: np.abs(picture - truth).mean(axis=2) for name, picture in pictures.items()}


def _errors(evaluation: Evaluation, highlight: str) -> Section:
    parts: list[Part] = []
    columns = [Column("pictures", "s"), *(Column(key, form, UNITS.get(key, "")) for key, form in PICTURE_COLUMNS.items())]
    for layer, against in (("diffuse", "the true diffuse layer"), ("matte", "the non-glossy pictures")):
        found = {name: row[layer] for name, row in evaluation.pictures.get(ALL, {}).get(ALL, {}).items() if layer in row}
        if found:
            rows = [[name, *(row.get(key) for key in PICTURE_COLUMNS)] for name, row in found.items()]
            chosen = [i for i, name in enumerate(found) if name == highlight]
            parts.append(Table(f"{layer.capitalize()}, against {against}", columns, rows, highlight=chosen))
    return Section("Errors of the pictures", FIGURES, [*parts, *(Note(f"Left out: {note}.") for note in evaluation.notes)])


def _measurement(evaluation: Evaluation, method: str) -> Section:
    parts = [_measured("Photometric stereo", evaluation.measurement, method)]
    if len(evaluation.by_material) > 1:
        parts += [_measured(f"Photometric stereo, {kind}", rows, method) for kind, rows in evaluation.by_material.items()]
    text = (
        "Normals: mean angle to the true normals. Gap closed: 0 is as bad as the glossy pictures, 1 as good as the non-glossy ones, over "
        "all captures together, with a 95 % interval by a paired bootstrap. Non-glossy: mean angle to the normals from the non-glossy "
        "pictures; height MSE: of heights against that result's, and how many times smaller it is than that of the glossy pictures."
    )
    return Section("What they are worth to the measurement", text, parts)


def _measured(title: str, rows: Mapping[str, Mapping[str, Any]], method: str) -> Table:
    columns = [
        Column("pictures", "s"),
        *(Column(key, form, MEASURED_UNITS.get(key, "")) for key, form in MEASUREMENT_COLUMNS.items()),
    ]
    columns += [Column("gap from", ".3f"), Column("gap to", ".3f")]
    cells = [
        [name, *(row.get(key) for key in MEASUREMENT_COLUMNS), *(row["interval"] or (None, None))] for name, row in rows.items()
    ]
    names = list(rows)
    ceilings = [i for i, name in enumerate(names) if name.startswith("true ")]
    return Table(title, columns, cells, highlight=[i for i, name in enumerate(names) if name == method], reference=ceilings)


def _slices(evaluation: Evaluation, method: str | None, title: str = "By slice") -> Section:
    parts: list[Part] = []
    for kind, values in evaluation.pictures.items():
        if kind == ALL:
            continue
        names = list(dict.fromkeys(name for rows in values.values() for name in rows))
        columns = [Column("pictures", "s"), *(Column(value, ".2f", "mse") for value in values)]
        rows = [
            [name, *(found[name]["diffuse"]["mse mask"] if name in found else None for found in values.values())]
            for name in names
        ]
        parts.append(Table(f"By {kind}", columns, rows, highlight=[i for i, name in enumerate(names) if name == method]))
    return Section(title, "Mean squared error of the diffuse layer inside the mask, 8-bit values.", parts)
