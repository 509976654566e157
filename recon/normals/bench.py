"""Error and time of every registered solver on real photographs: `python -m recon.normals.bench [--draws N] [--json]`.

DiLiGenT's bear and cat, or whatever objects the reference data has: all lights, bear also without its corrupt photographs, and seeded
draws of five lights, each beside least squares on the same draws. Beside the solvers, least squares and L1 written plainly in numpy.
Other work on the machine shows in the seconds by the clock, less so in those of the processor.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Truth, grey, read_capture
from gen.errors import InputError
from gen.files import dumps
from gen.parts import PARTS, data_folder
from recon.light_draws import CORRUPT, draws
from recon.metrics import angular_error
from recon.registry import NORMALS, Normals, Solver

DRAWS, LIGHTS, SEED, RUNS = 20, 5, 0, 3
"""Draws an object, lights a draw, the seed of all, and runs of which the fastest counts."""

LARGE_FRAME = (96, 512, 612)
"""Lights, rows and columns of the frame that least squares is timed on: all of a DiLiGenT photograph's pixels."""

BASELINE = "least-squares"


def plain_least_squares(
    reflectance: NDArray[np.float32], lights: NDArray[np.float64], mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """Least squares as anyone would write it in numpy: no weights, no albedo's colour, no uncertainty."""
    b = np.linalg.lstsq(lights, grey(reflectance[:, mask]).astype(np.float64), rcond=None)[0].T
    return _bare(b, mask)


def plain_l1(
    reflectance: NDArray[np.float32], lights: NDArray[np.float64], mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """L1 by 30 rounds of reweighting, all pixels at once in numpy: no weights, no albedo's colour, no uncertainty."""
    y = grey(reflectance[:, mask]).astype(np.float64)
    y /= np.maximum(y.max(axis=0), 1e-12)
    products = (lights[:, :, None] * lights[:, None, :]).reshape(len(lights), 9)
    w = np.ones_like(y)
    for _ in range(30):
        A = (w.T @ products).reshape(-1, 3, 3)
        b = np.linalg.solve(A, ((w * y).T @ lights)[..., None])[..., 0]
        w = 1 / np.maximum(np.abs(y - lights @ b.T), 1e-6)
    return _bare(b, mask)


def _bare(b: NDArray[np.float64], mask: NDArray[np.bool_]) -> Normals:
    normal = np.zeros((*mask.shape, 3), np.float32)
    normal[mask] = b / np.maximum(np.linalg.norm(b, axis=1, keepdims=True), 1e-12)
    nothing = np.zeros_like(normal)
    return Normals(normal=normal, albedo=nothing, uncertainty=nothing[..., 0], measurable=mask)


PLAIN: Mapping[str, Solver] = {"least squares, plain numpy": plain_least_squares, "l1, plain numpy": plain_l1}


def measured(solver: Solver, capture: Capture, runs: int = 1) -> dict[str, float]:
    """Mean angular error in degrees inside the mask, and the fastest of `runs`: seconds by the clock and seconds of processor.

    Raises InputError where the capture has no true normals, or the solver refuses it.
    """
    if capture.truth.normals is None:
        raise InputError(f"{capture.source}: has no true normals to measure against")
    reflectance, ones = capture.reflectance(), np.ones(capture.images.shape[:3], np.float32)
    best = {"seconds": np.inf, "processor": np.inf}
    for _ in range(runs):
        clock, busy = time.perf_counter(), time.process_time()
        result = solver(reflectance, capture.lights, capture.mask, ones)
        best["seconds"] = min(best["seconds"], time.perf_counter() - clock)
        best["processor"] = min(best["processor"], time.process_time() - busy)
    error = angular_error(result.normal, capture.truth.normals)[capture.mask]
    return {"error": float(np.nanmean(error)), "measurable": 100 * float(result.measurable[capture.mask].mean()), **best}


def figures(
    folder: Path, solvers: Mapping[str, Solver], count: int = DRAWS, progress: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """Of every object in a folder: each solver under all lights, without the corrupt photographs, and over `count` draws of few.

    solvers: by name, `BASELINE` among them. Returns object -> {"all lights": rows, "without the corrupt": rows, "draws": rows}. A row
    of the draws has the mean and the standard deviation of the error, and the mean difference from the baseline with its 95 %
    bootstrap interval.
    """
    tables: dict[str, Any] = {}
    for place in sorted(p for p in folder.iterdir() if p.is_dir()):
        capture = read_capture(place)
        sound = capture.select(list(range(CORRUPT.get(place.name, 0), capture.count)))
        stacks = {"all lights": capture} | ({"without the corrupt": sound} if sound.count < capture.count else {})
        tables[place.name] = {
            label: {name: _row(solver, stack, place.name, name, progress) for name, solver in {**solvers, **PLAIN}.items()}
            for label, stack in stacks.items()
        }
        few: dict[str, list[float]] = {}
        for i, chosen in enumerate(draws(sound.lights, count, LIGHTS, seed=SEED)):
            if progress is not None:
                progress(f"{place.name}: draw {i + 1} of {count}")
            part = sound.select(chosen)
            for name, solver in solvers.items():
                few.setdefault(name, []).append(measured(solver, part)["error"])
        tables[place.name]["draws"] = {name: _against(errors, few[BASELINE]) for name, errors in few.items()}
    return tables


def large_frame() -> dict[str, dict[str, float]]:
    """Least squares of a whole frame of random matte pixels (`LARGE_FRAME`) beside the same in plain numpy: rows as in `figures`."""
    size = LARGE_FRAME
    rng = np.random.default_rng(SEED)
    lights = rng.normal(size=(size[0], 3)) * [1, 1, 0.3] + [0, 0, 1.5]
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    normal = rng.normal(size=(*size[1:], 3)) * 0.4 + [0, 0, 1]
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    albedo = rng.uniform(0.2, 1, (*size[1:], 3)).astype(np.float32)
    shading = np.maximum(np.einsum("kc,hwc->khw", lights, normal), 0).astype(np.float32)
    capture = Capture(
        images=shading[..., None] * albedo,
        lights=lights,
        intensities=np.ones((size[0], 3)),
        mask=np.ones(size[1:], dtype=bool),
        truth=Truth(normals=normal.astype(np.float32)),
    )
    solvers = {BASELINE: NORMALS.load(BASELINE), "least squares, plain numpy": plain_least_squares}
    return {name: _row(solver, capture, "large frame", name, None) for name, solver in solvers.items()}


def _row(solver: Solver, capture: Capture, place: str, name: str, progress: Callable[[str], None] | None) -> dict[str, float]:
    if progress is not None:
        progress(f"{place}: {name}, {capture.count} lights")
    measured(solver, capture)  # compiles, and fills what caches there are
    return measured(solver, capture, RUNS)


def _against(errors: Sequence[float], baseline: Sequence[float]) -> dict[str, float]:
    """Mean and standard deviation of the draws' errors, and the mean paired difference with its bootstrap interval."""
    difference = np.array(errors) - np.array(baseline)
    again = np.random.default_rng(SEED).integers(0, len(difference), (10000, len(difference)))
    low, high = np.quantile(difference[again].mean(axis=1), [0.025, 0.975])
    return {
        "error": float(np.mean(errors)),
        "deviation": float(np.std(errors)),
        "difference": float(difference.mean()),
        "low": float(low),
        "high": float(high),
    }


def registered() -> dict[str, Solver]:
    """The registered solvers that take any number of lights."""
    return {name: NORMALS.load(name) for name in NORMALS if name != "three-light"}


def main(arguments: Sequence[str] | None = None) -> None:
    """Work out the figures and print them."""
    parser = argparse.ArgumentParser(prog="python -m recon.normals.bench", description=__doc__)
    parser.add_argument("--draws", type=int, default=DRAWS, help=f"draws of {LIGHTS} lights an object (default: {DRAWS})")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    given = parser.parse_args(arguments)
    folder = data_folder() / "diligent"
    if not folder.is_dir():
        print(f"left out: {PARTS['reference data'].line}", file=sys.stderr)
        return
    if given.draws < 1:
        print("recon.normals.bench: --draws must be at least 1", file=sys.stderr)
        raise SystemExit(2)
    tables = figures(folder, registered(), given.draws, lambda step: print(step, file=sys.stderr))
    frame = large_frame()
    if given.json:
        print(dumps({**tables, "large frame": frame}, indent=2))
        return
    for name, table in tables.items():
        print_tables(name, table)
    print_rows("a whole frame of {} lights, {} x {} pixels".format(*LARGE_FRAME), frame)


def print_tables(name: str, table: Mapping[str, Any]) -> None:
    """One object's figures as Markdown tables."""
    for label in (label for label in table if label != "draws"):
        print_rows(f"{name}, {label}", table[label])
    print(f"\n{name}, draws of {LIGHTS} lights\n\n| solver | degrees | less than {BASELINE} by | 95 % |\n|---|---|---|---|")
    for solver, row in table["draws"].items():
        interval = f"{-row['high']:+.2f} to {-row['low']:+.2f}"
        print(f"| {solver} | {row['error']:.2f} +- {row['deviation']:.2f} | {-row['difference']:+.2f} | {interval} |")


def print_rows(title: str, rows: Mapping[str, Mapping[str, float]]) -> None:
    """Rows of solvers as a Markdown table."""
    print(f"\n{title}\n\n| solver | degrees | seconds | of processor |\n|---|---|---|---|")
    for solver, row in rows.items():
        print(f"| {solver} | {row['error']:.2f} | {row['seconds']:.3f} | {row['processor']:.3f} |")


if __name__ == "__main__":
    main()
