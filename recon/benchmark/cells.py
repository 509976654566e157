"""One unit measured by every combination of methods: a row of figures for each, and small maps of the first draw for the page."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture
from gen.errors import InputError, MissingPart
from recon.benchmark.spec import Combination
from recon.benchmark.units import Unit
from recon.compare import deviation, truth_figures
from recon.metrics import angular_error, height_bytes, mse, normal_bytes
from recon.normals.reliability import tally
from recon.pictures import crop_box, tone, white_of
from recon.reconstruct import Settings, Shape, reconstruct
from recon.registry import GLOSS, Layers

SIDE = 192
"""Pixels of the longer side of a map on the page."""

YARDSTICK = "true-matte"

PART_MISSING = "part missing"
"""The key of rows that failed since something is not installed: a run that is gone on with tries them again."""

Row = dict[str, Any]


def measure_unit(unit: Unit, combinations: Sequence[Combination]) -> tuple[list[Row], dict[str, NDArray[Any]]]:
    """The rows of a unit, in the order of the combinations, and maps of its first draw.

    A row holds the unit's and the methods' names, "seconds" of gloss removal and of the rest, and either "failed", a sentence, or the
    figures: "normals" (mean angle to the true normals in degrees), "median", "eroded", "lit by all"; "height" (rmse in metres) and "of
    range" (in percent) where depth is known; "non-glossy" (mean angle), "normal MSE" and "height MSE" (8-bit), against the non-glossy
    result, where that is known; "picture MSE" (8-bit sRGB inside the mask, against the true diffuse layer) where that is; "measured",
    percent of the mask; "reliability", the tally of stated uncertainty against error (`recon.normals.reliability.tally`).
    All rows of a unit are judged on the pixels that each of them measured; those that measured less than half of the mask are judged on
    their own pixels, and do not narrow the others'. Maps: see `maps_of`.
    """
    capture = unit.capture()
    removed: dict[str, tuple[Layers, float]] = {}
    shapes: dict[Combination, Shape] = {}
    rows: dict[Combination, Row] = {}
    for combination in combinations:
        gloss, repair, normals, height = combination
        row: Row = {"capture": unit.name, "group": unit.group, "draw": unit.draw, "lights": [i + 1 for i in unit.lights]}
        row |= {"gloss": gloss, "repair": repair, "normals_by": normals, "height_by": height}
        rows[combination] = row
        try:
            if gloss not in removed:
                start = time.perf_counter()
                removed[gloss] = (GLOSS.load(gloss)(capture), time.perf_counter() - start)
            layers, seconds = removed[gloss]
            start = time.perf_counter()
            shape = reconstruct(capture, layers, Settings(gloss, repair, normals, height))
            row["seconds"] = {"gloss": seconds, "rest": time.perf_counter() - start}
            # Only the maps are judged; with a hundred pictures the rest of every shape would fill the memory.
            shapes[combination] = replace(shape, images=shape.images[:0], weights=shape.weights[:0])
        except InputError as error:
            row["failed"] = str(error).removeprefix(capture.source).lstrip(": ")
            row |= {PART_MISSING: True} if isinstance(error, MissingPart) else {}
    _judge(capture, shapes, rows, {name: layers for name, (layers, _) in removed.items()})
    maps = maps_of(capture, shapes) if unit.draw == 0 else {}
    return list(rows.values()), maps


def _judge(
    capture: Capture,
    shapes: Mapping[Combination, Shape],
    rows: Mapping[Combination, Row],
    layers: Mapping[str, Layers],
) -> None:
    """Fill in the figures of the rows that have a shape."""
    pixels = int(capture.mask.sum())
    share = {c: float(shape.normals.measurable[capture.mask].mean()) for c, shape in shapes.items()}
    common = capture.mask.copy()
    for combination, shape in shapes.items():
        if share[combination] >= 0.5:
            common &= shape.normals.measurable
    picture = {gloss: picture_error(capture, found) for gloss, found in layers.items()}
    for combination, shape in shapes.items():
        row, (gloss, _, normals, height) = rows[combination], combination
        figures = truth_figures(shape, common & shape.normals.measurable)
        angles = figures.get("normals", {})
        row["normals"] = angles.get("mask", {}).get("mean")
        row["median"] = angles.get("mask", {}).get("median")
        row["eroded"] = angles.get("eroded", {}).get("mean")
        row["lit by all"] = angles.get("lit by all", {}).get("mean")
        row["measured"] = 100 * share[combination]
        row["pixels"] = pixels
        if capture.truth.normals is not None:
            error = angular_error(shape.normals.normal, capture.truth.normals)
            judged = common & shape.normals.measurable
            row["reliability"] = tally(shape.normals.uncertainty[judged], error[judged]).tolist()
        if "height" in figures:
            row["height"], row["of range"] = figures["height"]["rmse"], figures["height"]["percent"]
        if picture[gloss] is not None:
            row["picture MSE"] = picture[gloss]
        reference = shapes.get((YARDSTICK, "none", normals, height))
        if reference is not None:
            known = reference.height.height[np.isfinite(reference.height.height)]
            apart = deviation(shape, reference, (float(known.min()), float(known.max())))
            row |= {"non-glossy": apart["mean angle"], "normal MSE": apart["normal MSE"], "height MSE": apart["height MSE"]}


def picture_error(capture: Capture, layers: Layers) -> float | None:
    """Mean squared error of 8-bit values of the diffuse layer inside the mask (the paper's Table 1), None where the truth is not known."""
    if capture.truth.diffuse is None:
        return None
    return mse(tone(layers.diffuse[:, capture.mask]), tone(capture.truth.diffuse[:, capture.mask]))


def maps_of(capture: Capture, shapes: Mapping[Combination, Shape]) -> dict[str, NDArray[Any]]:
    """Small maps for the page, cut to the object and thinned to `SIDE` pixels.

    mask (h, w) bool; picture (h, w, 3), the brightest; and of each combination, by its number, "n0" normals and "z0" heights as bytes
    (h, w, 3) and (h, w), "e0" the angular error in degrees (h, w) float16, NaN where unknown.
    """
    rows, columns = crop_box(capture.mask, margin=0)
    stride = max(1, -(-max(rows.stop - rows.start, columns.stop - columns.start) // SIDE))
    box = (slice(rows.start, rows.stop, stride), slice(columns.start, columns.stop, stride))
    brightest = capture.images[int(np.argmax(capture.images[:, capture.mask].mean((1, 2))))]
    white = white_of(brightest, capture.mask)
    maps: dict[str, NDArray[Any]] = {"mask": capture.mask[box], "picture": tone(brightest[box], white)}
    reference = next((shape for c, shape in shapes.items() if c[0] == YARDSTICK), next(iter(shapes.values()), None))
    if reference is None:
        return maps
    known = reference.height.height[np.isfinite(reference.height.height)]
    for i, shape in enumerate(shapes.values()):
        maps[f"n{i}"] = normal_bytes(shape.normals.normal)[box]
        maps[f"z{i}"] = height_bytes(shape.height.height, float(known.min()), float(known.max()))[box]
        if capture.truth.normals is not None:
            maps[f"e{i}"] = angular_error(shape.normals.normal, capture.truth.normals)[box].astype(np.float16)
    maps["names"] = np.array(["\x1f".join(c) for c in shapes], np.str_)
    return maps
