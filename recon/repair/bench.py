"""Repairs and thresholds side by side: `python -m recon.repair.bench [--draws N] [--json]`.

Two tables, over the paper's cylinder at five levels of gloss (rendered here; left out without Blender) and draws of five lights of the
DiLiGenT photographs. First, holes cut at random into pictures whose truth is known, the diffuse layers and the photographs themselves:
the error inside them and the normals'. Then the whole measurement: each remover, threshold and repair by the normals' mean angular error.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gen.capture import Bools, Capture, read_capture
from gen.errors import InputError
from gen.files import dumps
from gen.parts import PARTS, data_folder
from recon.bench import removers_here
from recon.defects import find_defects
from recon.light_draws import CORRUPT, draws
from recon.metrics import angular_error
from recon.reconstruct import Settings, sample_weights
from recon.registry import GLOSS, NORMALS, REPAIR, Layers, Repaired

DRAWS, LIGHTS, SEED = 4, 5, 3
"""Draws of a photographed object's lights, lights of each, and the seed of draws and holes."""

HOLES, RADII = 0.06, (3.0, 14.0)
"""Share of the object that the holes of a picture cover, and the radii of their disks in pixels."""

REMOVERS = ("chromaticity", "bilateral", "group")
THRESHOLDS: tuple[str | float, ...] = ("auto", "otsu", 0.1)


def captures(folder: Path, count: int = DRAWS) -> Iterator[tuple[str, Capture]]:
    """(kind, capture): the rendered cylinders, where Blender is there, and draws of the photographs, where they are.

    folder: where the renders go. count: of draws an object. What is left out is named on stderr.
    """
    from recon.benchmark.spec import Source
    from recon.benchmark.units import places

    if PARTS["bpy"].look().state == "ok":
        for _, _, place in places([Source(set="paper-stack")], folder, folder):
            yield "cylinder", read_capture(place)
    else:
        print(f"left out: {PARTS['bpy'].line}", file=sys.stderr)
    photographs = data_folder() / "diligent"
    if not photographs.is_dir():
        print(f"left out: {PARTS['reference data'].line}", file=sys.stderr)
        return
    for place in sorted(p for p in photographs.iterdir() if p.is_dir()):
        whole = read_capture(place)
        sound = whole.select(list(range(CORRUPT.get(place.name, 0), whole.count)))
        for chosen in draws(sound.lights, count, LIGHTS, seed=SEED):
            yield place.name, sound.select(chosen)


def cut_holes(capture: Capture, seed: int = SEED) -> Bools:
    """Random disks in every picture, (K, H, W), inside the mask, until they cover `HOLES` of it."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices(capture.mask.shape)
    inside = np.argwhere(capture.mask)
    holes = np.zeros(capture.faults.shape, dtype=bool)
    for hole in holes:
        while hole[capture.mask].mean() < HOLES:
            row, column = inside[rng.integers(len(inside))]
            hole |= capture.mask & ((rows - row) ** 2 + (columns - column) ** 2 < rng.uniform(*RADII) ** 2)
    return holes


def hole_figures(capture: Capture, seed: int = SEED) -> dict[str, dict[str, float]]:
    """Of each repair: the root mean square error in the holes (in thousandths of white), the normals' error, and the seconds.

    Raises InputError where the capture has no true normals.
    """
    truth = capture.images if capture.truth.diffuse is None else np.ascontiguousarray(capture.truth.diffuse)
    whole = capture.with_images(truth)
    holes = cut_holes(whole, seed)
    figures = {}
    for name in REPAIR:
        start = time.process_time()
        repaired = REPAIR.load(name)(np.where(holes[..., None], np.float32(0), truth), holes, whole)
        seconds = time.process_time() - start
        wrong = whole.reflectance(repaired.images - truth)[holes]
        error = normals_error(whole, Layers(diffuse=truth, specular=np.zeros_like(truth)), repaired, Settings("none", "none"))
        figures[name] = {"rms": 1000 * float(np.sqrt(np.square(wrong).mean())), "normals": error, "seconds": seconds}
    return figures


def threshold_figures(capture: Capture) -> dict[str, float]:
    """Mean angular error of every remover of `REMOVERS` that is there, threshold and repair, by "remover, threshold, repair"."""
    figures = {}
    for gloss in (name for name in REMOVERS if name in removers_here()):
        layers = GLOSS.load(gloss)(capture)
        pictures = layers.diffuse if layers.matte is None else layers.matte
        untouched = REPAIR.load("none")(pictures, np.zeros(capture.faults.shape, dtype=bool), capture)
        figures[f"{gloss}, -, none"] = normals_error(capture, layers, untouched, Settings(gloss, "none"))
        for threshold in THRESHOLDS:
            defects = find_defects(layers.specular, capture, threshold, Settings.dilate, pictures).mask
            for repair in ("telea", "stack", "drop"):
                repaired = REPAIR.load(repair)(pictures, defects, capture)
                figures[f"{gloss}, {threshold}, {repair}"] = normals_error(capture, layers, repaired, Settings(gloss, repair))
    return figures


def normals_error(capture: Capture, layers: Layers, repaired: Repaired, settings: Settings) -> float:
    """Mean angular error in degrees inside the mask of what the solver makes of repaired pictures.

    Raises InputError where the capture has no true normals.
    """
    if capture.truth.normals is None:
        raise InputError(f"{capture.source}: has no true normals to measure against")
    weights = sample_weights(capture, layers, repaired, settings)
    found = NORMALS.load(settings.normals)(capture.reflectance(repaired.images), capture.lights, capture.mask, weights)
    return float(np.nanmean(angular_error(found.normal, capture.truth.normals)[capture.mask]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Work out the figures and print them."""
    parser = argparse.ArgumentParser(prog="python -m recon.repair.bench", description=__doc__)
    parser.add_argument("--draws", type=int, default=DRAWS, help=f"draws of {LIGHTS} lights an object (default: {DRAWS})")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    given = parser.parse_args(arguments)
    if given.draws < 1:
        print("recon.repair.bench: --draws must be at least 1", file=sys.stderr)
        raise SystemExit(2)
    holes: dict[str, list[Any]] = {}
    thresholds: dict[str, list[Any]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for kind, capture in captures(Path(scratch), given.draws):
            print(f"{kind}: {capture.source}", file=sys.stderr)
            holes.setdefault(kind, []).append(hole_figures(capture))
            thresholds.setdefault(kind, []).append(threshold_figures(capture))
    if given.json:
        print(dumps({"holes": holes, "thresholds": thresholds}, indent=2))
    elif holes:
        print_tables(holes, thresholds)


def print_tables(holes: dict[str, list[Any]], thresholds: dict[str, list[Any]]) -> None:
    """The means over the captures of each kind as Markdown tables."""
    kinds = list(holes)
    head = f"{' | '.join(kinds)} |\n|{'---|' * (len(kinds) + 1)}"
    print(f"holes: root mean square error in thousandths of white, normals in degrees, seconds\n\n| repair | {head}")
    for name in REPAIR:
        cells = [
            [float(np.mean([row[name][key] for row in holes[kind]])) for key in ("rms", "normals", "seconds")] for kind in kinds
        ]
        print(f"| {name} | {' | '.join('{:.1f}, {:.2f}, {:.2f}'.format(*cell) for cell in cells)} |")
    print(f"\nremover, threshold, repair: normals in degrees\n\n| measurement | {head}")
    for name in next(iter(thresholds.values()))[0]:
        print(f"| {name} | {' | '.join(f'{np.mean([row[name] for row in thresholds[kind]]):.2f}' for kind in kinds)} |")


if __name__ == "__main__":
    main()
