"""What gloss removal is worth to the measurement: photometric stereo on each method's pictures, against the true normals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gen.capture import Capture
from gen.errors import InputError
from recon.compare import deviation, mean_error, truth_figures
from recon.metrics import gap_closed
from recon.reconstruct import Settings, Shape, reconstruct
from recon.registry import GLOSS, Layers

GLOSSY, DIFFUSE, MATTE = "glossy", "true diffuse", "true matte"
"""The rows that are there whatever the methods: where everything starts, and the two ceilings."""

REPAIRED = ", repaired"
"""Ends the name of a method's row with the repair."""

DRAWS = 2000
"""Of the bootstrap."""

Row = Mapping[str, float]


def measured(capture: Capture, layers: Mapping[str, Layers], settings: Settings) -> dict[str, dict[str, float]]:
    """The errors of one capture by row: `GLOSSY`, each method without and with the repair, `DIFFUSE` where known, `MATTE`.

    layers: of each method, by its name. settings: of the measurement; gloss and repair are set by the row. Every row has "normals" (mean
    angle to the true normals in degrees), "non-glossy" (mean angle to the non-glossy result) and "height MSE" (8-bit, against the
    non-glossy result inside the mask), all on the pixels that every row measured. Raises InputError where the capture lacks the truth,
    or does not suit photometric stereo.
    """
    truth = capture.truth
    if truth.normals is None or truth.matte is None:
        raise InputError(f"{capture.source}: has no true normals or no matte layer to measure against")
    bare = replace(settings, gloss="none", repair="none")
    shapes: dict[str, Shape] = {GLOSSY: reconstruct(capture, GLOSS.load("none")(capture), bare)}
    for name, found in layers.items():
        removed = replace(bare, gloss=name if name in GLOSS else "group")
        shapes[name] = reconstruct(capture, found, removed)
        if settings.repair != "none":
            shapes[name + REPAIRED] = reconstruct(capture, found, replace(removed, repair=settings.repair))
    for row, gloss in ((DIFFUSE, "true-diffuse"), (MATTE, "true-matte")):
        if row == MATTE or truth.diffuse is not None:
            shapes[row] = reconstruct(capture, GLOSS.load(gloss)(capture), replace(bare, gloss=gloss))
    common = np.logical_and.reduce([shape.normals.measurable for shape in shapes.values()])
    reference = shapes[MATTE]
    known = reference.height.height[np.isfinite(reference.height.height)]
    span = float(known.min()), float(known.max())
    rows: dict[str, dict[str, float]] = {}
    for name, shape in shapes.items():
        error = mean_error(truth_figures(shape, common))
        apart = deviation(shape, reference, span)
        rows[name] = {
            "normals": float("nan") if error is None else error,
            "non-glossy": apart["mean angle"],
            "height MSE": apart["height MSE"],
        }
    return rows


def pooled(captures: Sequence[Mapping[str, Row]], seed: int = 0) -> dict[str, dict[str, Any]]:
    """The rows of all captures together; only rows that every capture has.

    Each row has the means of its figures, "gap closed" = (sum e_glossy - sum e) / (sum e_glossy - sum e_matte) with its 95 % interval
    ("interval", a paired bootstrap over the captures), and "times smaller": the glossy pictures' height MSE over its own.
    seed: of the bootstrap.
    """
    if not captures:
        return {}
    names = [name for name in captures[0] if all(name in rows for rows in captures)]
    errors = {name: np.array([rows[name]["normals"] for rows in captures]) for name in names}
    mean = {name: float(values.mean()) for name, values in errors.items()}
    draws = np.random.default_rng(seed).integers(0, len(captures), (DRAWS, len(captures)))
    table: dict[str, dict[str, Any]] = {}
    height = {name: float(np.mean([rows[name]["height MSE"] for rows in captures])) for name in names}
    for name in names:
        table[name] = {
            "normals": mean[name],
            "non-glossy": float(np.mean([rows[name]["non-glossy"] for rows in captures])),
            "height MSE": height[name],
            "times smaller": height[GLOSSY] / height[name] if height[name] > 0 else None,
            "gap closed": gap_closed(mean[GLOSSY], mean[name], mean[MATTE], least=1e-9),
            "interval": _interval(errors[GLOSSY], errors[name], errors[MATTE], draws),
        }
    return table


def _interval(glossy: Any, method: Any, matte: Any, draws: Any) -> list[float] | None:
    """The middle 95 % of the gap closed over the draws of captures; None where there is one capture, or no gap in a draw."""
    top, gap = (glossy - method)[draws].sum(axis=1), (glossy - matte)[draws].sum(axis=1)
    if len(glossy) < 2 or not (gap > 0).all():
        return None
    return [float(value) for value in np.percentile(top / gap, [2.5, 97.5])]
