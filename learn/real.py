"""The test that counts: photographs of real things under few lights, `python -m learn.real [--weights W] [--json]` (part of `make bench`).

Every DiLiGenT object of the reference data, many seeded draws of a few of its lights, and all of them: the mean angular error of least
squares on the raw photographs, on what a remover makes of them, and the ratio of the two. Draws whose lights do not determine normals well
are drawn again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gen.capture import Capture, read_capture
from gen.errors import InputError
from gen.files import dumps
from gen.parts import PARTS, data_folder
from recon.compare import mean_error, truth_figures
from recon.light_draws import CORRUPT, draws
from recon.progress import steps
from recon.reconstruct import Progress, Settings, reconstruct
from recon.registry import GLOSS, Remover

DRAWS, LIGHTS = 20, 5
"""Draws an object, and lights a draw."""


def errors(capture: Capture, remover: Remover | None, repair: str = "none") -> float:
    """Mean angular error in degrees of least squares against the capture's true normals, inside the mask, raw (None) or after a remover.

    Raises InputError where the capture has no true normals or cannot be measured.
    """
    layers = (remover or GLOSS.load("none"))(capture)
    # The height is not looked at: the quickest integrator will do.
    settings = Settings(gloss="none" if remover is None else "group", repair=repair, height="quadratic")
    shape = reconstruct(capture, layers, settings)
    error = mean_error(truth_figures(shape))
    if error is None:
        raise InputError(f"{capture.source}: has no true normals to measure against")
    return error


def photographs(
    folder: Path, remover: Remover, count: int = DRAWS, size: int = LIGHTS, whole: bool = True, progress: Progress | None = None
) -> dict[str, Any]:
    """Of every DiLiGenT object in a folder: the errors of each draw raw and after the remover, their means and the means' ratio.

    count: draws an object. size: lights a draw. "harmed" counts the draws that the remover made worse; "all" has the errors with all
    lights, but for those that are corrupt in the original; None where whole is False. Errors in degrees. Raises InputError where the folder
    holds no object, a capture cannot be read or has no true normals, and as `draws`.
    """
    figures: dict[str, Any] = {}
    places = sorted(p for p in folder.iterdir() if p.is_dir())
    if not places:
        raise InputError(f"{folder}: holds no DiLiGenT object")
    for place in places:
        capture = read_capture(place)
        capture = capture.select(list(range(CORRUPT.get(place.name, 0), capture.count)))
        rows: list[tuple[list[int], float, float]] = []
        for i, chosen in enumerate(draws(capture.lights, count, size)):
            if progress is not None:
                progress(f"{place.name}: draw {i + 1} of {count}")
            part = capture.select(chosen)
            rows.append((chosen, errors(part, None), errors(part, remover)))
        every = None
        if whole:
            if progress is not None:
                progress(f"{place.name}: all {capture.count} lights")
            every = {"lights": capture.count, "raw": errors(capture, None), "removed": errors(capture, remover)}
        raw, removed = (float(np.mean([row[column] for row in rows])) for column in (1, 2))
        figures[place.name] = {
            "raw": raw,
            "removed": removed,
            "ratio": removed / raw,
            "harmed": sum(after > before for _, before, after in rows),
            "all": every,
            "draws": [{"lights": lights, "raw": before, "removed": after} for lights, before, after in rows],
        }
    return figures


def main(arguments: Sequence[str] | None = None) -> None:
    """Work out the figures and print them."""
    from learn.removers import remover

    parser = argparse.ArgumentParser(prog="python -m learn.real", description=__doc__)
    parser.add_argument("--method", default="group", help="the method of the weights (default: group)")
    parser.add_argument("--weights", help="a weight file or the folder of a training (default: the shipped ones)")
    parser.add_argument("--draws", type=int, default=DRAWS, help=f"draws an object (default: {DRAWS})")
    parser.add_argument("--lights", type=int, default=LIGHTS, help=f"lights a draw (default: {LIGHTS})")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    given = parser.parse_args(arguments)
    folder = data_folder() / "diligent"
    if not folder.is_dir():
        print(f"left out: {PARTS['reference data'].line}", file=sys.stderr)
        return
    try:
        if min(given.draws, given.lights - 2) < 1:
            raise InputError("--draws must be at least 1 and --lights at least 3")
        chosen = remover(given.method, given.weights)
        with steps() as step:
            step.expect((given.draws + 1) * sum(p.is_dir() for p in folder.iterdir()))
            figures = photographs(folder, chosen, given.draws, given.lights, progress=step)
    except InputError as error:
        print(f"learn.real: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    if given.json:
        print(dumps(figures, indent=2))
        return
    print(f"mean angular error in degrees, {given.draws} draws of {given.lights} lights\n")
    print("| object | raw | removed | ratio | draws that got worse |\n|---|---|---|---|---|")
    for name, row in figures.items():
        print(f"| {name} | {row['raw']:.2f} | {row['removed']:.2f} | {row['ratio']:.3f} | {row['harmed']} |")
    print("\nall lights\n\n| object | lights | raw | removed |\n|---|---|---|---|")
    for name, row in figures.items():
        print(f"| {name} | {row['all']['lights']} | {row['all']['raw']:.2f} | {row['all']['removed']:.2f} |")


if __name__ == "__main__":
    main()
