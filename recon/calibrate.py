"""Measures what stated uncertainties are worth, on captures with true normals and their matte twins.

python -m recon.calibrate FOLDER... -o calibration.json

The shipped table is of the preset `zoo` (degloss gen render zoo -o zoo): every remover before least squares, and no removal,
`chromaticity` and `group` before every other solver.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, read_capture
from gen.errors import InputError
from gen.files import read_json, write_json
from gen.sets.set_spec import evenly
from recon.calibration import FILE, change, fit
from recon.metrics import angular_error
from recon.progress import steps
from recon.reconstruct import Settings, consumed_pictures, sample_weights
from recon.registry import GLOSS, NORMALS, REPAIR

Doubles = NDArray[np.float64]

PIXELS = 1500
"""Pixels that a capture contributes to a table at most."""

CAPTURES = 72
"""Captures that are used, evenly over what is there."""

PLAIN = "least-squares"


def pairs() -> list[tuple[str, str]]:
    """(remover, solver) of every table."""
    removers = [name for name in GLOSS if not name.startswith("true-")]
    solvers = [name for name in NORMALS if name not in (PLAIN, "three-light")]  # three lights leave no residual to go by
    return [(g, PLAIN) for g in removers] + [(g, s) for g in ("none", "chromaticity", "group") for s in solvers]


def samples(capture: Capture, wanted: Sequence[tuple[str, str]], rng: np.random.Generator) -> Iterator[tuple[str, str, Doubles]]:
    """(remover, solver, columns of stated angle, change and true error in degrees, (3, N)) of one capture."""
    assert capture.truth.normals is not None
    removed = {}
    for gloss, normals in wanted:
        settings = Settings(gloss=gloss, repair="none", normals=normals)
        if gloss not in removed:
            layers = GLOSS.load(gloss)(capture)
            pictures = consumed_pictures(layers, settings)[0]
            repaired = REPAIR.load("none")(pictures, np.zeros(capture.faults.shape, bool), capture)
            weights = sample_weights(capture, layers, repaired, settings)
            removed[gloss] = capture.reflectance(pictures), weights, change(capture, pictures)
        reflectance, weights, changed = removed[gloss]
        try:
            found = NORMALS.load(normals)(reflectance, capture.lights, capture.mask, weights)
        except InputError:  # a solver may refuse what others measure
            continue
        rows = np.stack([found.uncertainty, changed, angular_error(found.normal, capture.truth.normals)])[:, capture.mask]
        rows = rows[:, np.isfinite(rows).all(0)].astype(np.float64)
        yield gloss, normals, rows[:, rng.permutation(rows.shape[1])[:PIXELS]]


def calibrate(places: Sequence[Path], wanted: Sequence[tuple[str, str]], seed: int = 0) -> list[dict[str, object]]:
    """The tables, as they are written, of captures that have true normals. Raises InputError where one has none."""
    rng = np.random.default_rng(seed)
    gathered: dict[tuple[str, str], list[Doubles]] = {}
    with steps() as step:
        step.expect(len(places))
        for place in places:
            step(place.name)
            capture = read_capture(place)
            if capture.truth.normals is None:
                raise InputError(f"{place}: has no true normals to compare with; choose renders or captures with truth")
            # The matte twin too: a part without gloss, or whose gloss is gone, must not be stated as if it had some.
            twins = [capture] if capture.truth.matte is None else [capture, capture.with_images(capture.truth.matte)]
            for gloss, normals, rows in chain.from_iterable(samples(twin, wanted, rng) for twin in twins):
                gathered.setdefault((gloss, normals), []).append(rows)
    result: list[dict[str, object]] = []
    for (gloss, normals), parts in gathered.items():
        sigma, changed, error = np.concatenate(parts, axis=1)
        result.append({"gloss": gloss, "normals": normals, "pixels": len(sigma), **asdict(fit(sigma, changed, error))})
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the tables. Returns the exit code: 2 for a bad input, with one line on stderr."""
    from recon.benchmark.spec import Source
    from recon.benchmark.units import places

    parser = argparse.ArgumentParser(prog="python -m recon.calibrate", description=__doc__)
    parser.add_argument("folders", nargs="+", metavar="FOLDER", help="a rendered set, a folder of captures, or a capture")
    parser.add_argument("-o", "--output", type=Path, default=FILE, help="where the tables go (default: the shipped ones' place)")
    parser.add_argument(
        "--gloss", nargs="+", metavar="NAME", help="measure these removers' tables alone, and keep the others that are there"
    )
    parser.add_argument("--normals", nargs="+", metavar="NAME", help="the same for solvers")
    parser.add_argument("--captures", type=int, default=CAPTURES, help=f"captures that are used (default: {CAPTURES})")
    parser.add_argument("--seed", type=int, default=0, help="of the choice of pixels (default: 0)")
    given = parser.parse_args(arguments)
    try:
        if given.captures < 1:
            raise InputError("--captures must be at least 1")
        there = [path for _, _, path in places([Source(path=folder) for folder in given.folders], Path(), Path())]
        chosen = [there[i] for i in evenly(len(there), given.captures)]
        wanted = [p for p in pairs() if p[0] in (given.gloss or [p[0]]) and p[1] in (given.normals or [p[1]])]
        if not wanted:
            raise InputError("--gloss and --normals leave nothing to measure; see degloss recon methods")
        kept = []
        if given.output.is_file():
            said = read_json(given.output, "tables of calibration")["tables"]
            kept = [t for t in said if (t["gloss"], t["normals"]) in set(pairs()) - set(wanted)]
        found = [*kept, *calibrate(chosen, wanted, given.seed)]
        write_json(given.output, {"tables": sorted(found, key=lambda t: (t["gloss"], t["normals"]))})
    except InputError as error:
        print(f"recon.calibrate: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
