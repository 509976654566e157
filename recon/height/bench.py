"""Integration in figures: `python -m recon.height.bench [--size MEGAPIXELS] [--json]`.

Depth from the true normals of the reference objects for every registered integrator, and a large relief of known height with the
time and memory that it takes. Where the reference data is missing its table is left out, with a line that says so.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Scale
from gen.errors import InputError
from gen.files import dumps
from gen.parts import data_folder
from recon.registry import HEIGHT, Height

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

DISTANCE = 1500.0
"""Millimetres that the reference objects are taken to be away. The error is measured after the best scale, so it does not matter."""


def depth_errors(folder: Path) -> dict[str, dict[str, dict[str, float]]]:
    """Mean absolute depth error in mm after the median scale, and times in s, by integrator and object ("dct, slopes" beside)."""
    from recon.height.poisson import dct

    integrators: dict[str, Callable[..., Height]] = {name: HEIGHT.load(name) for name in HEIGHT}
    if "dct" in integrators:
        integrators["dct, slopes"] = partial(dct, slopes=True)
    objects = {place.name: read_object(place) for place in sorted(p for p in folder.iterdir() if p.is_dir())}
    figures: dict[str, dict[str, dict[str, float]]] = {}
    for name, integrate in integrators.items():
        for thing, (normal, mask, camera, depth) in objects.items():
            start = time.perf_counter(), time.process_time()
            height = integrate(normal, mask, Scale(camera=camera, distance_mm=DISTANCE)).height
            seconds = time.perf_counter() - start[0], time.process_time() - start[1]
            error = depth_error(DISTANCE - 1000 * height.astype(np.float64), depth, mask)
            figures.setdefault(name, {})[thing] = {"mm": error, "seconds": seconds[0], "cpu_seconds": seconds[1]}
    return figures


def read_object(folder: Path) -> tuple[Floats, NDArray[np.bool_], Doubles, Doubles]:
    """The true normals, the mask, the camera K and the true depth in mm of one reference object."""
    from gen.images import read_image

    mask = read_image(folder / "mask.png").linear[..., 0] > 0.5
    normal = read_image(folder / "normal_map.png", "linear").linear * 2 - 1
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    with np.load(folder / "depth_gt.npz") as arrays:
        depth = arrays["depth_gt"].astype(np.float64)
    return (normal * mask[..., None]).astype(np.float32), mask, np.loadtxt(folder / "K.txt"), depth


def depth_error(depth: Doubles, true: Doubles, mask: NDArray[np.bool_]) -> float:
    """Mean absolute error in the unit of `true` over the mask, after the scale that is the median of true over measured."""
    found, known = depth[mask], true[mask]
    return float(np.nanmean(np.abs(np.nanmedian(known / found) * found - known)))


def relief(size: int) -> tuple[Floats, Doubles]:
    """Normals (size, size, 3) and height of a wavy sheet with a flap cut into its right half and bent up, in pixels.

    The flap starts from the sheet at the middle and its two long sides are steps in height, growing to the right.
    """
    row, column = np.mgrid[:size, :size].astype(np.float64)
    x, y = (column - (size - 1) / 2) / size, ((size - 1) / 2 - row) / size
    flap = (x > 0) & (np.abs(y) < 0.15)
    a, b, rise = 0.1 * size, 0.01 * size, 0.4 * size
    z = a * np.sin(6 * x) * np.cos(5 * y) + b * np.sin(14 * x + 3 * y) + rise * np.where(flap, x, 0)
    along = 6 * a * np.cos(6 * x) * np.cos(5 * y) + 14 * b * np.cos(14 * x + 3 * y) + rise * flap
    up = -5 * a * np.sin(6 * x) * np.sin(5 * y) + 3 * b * np.cos(14 * x + 3 * y)
    normal = np.stack([-along / size, -up / size, np.ones_like(x)], axis=-1).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return normal, z


def at_size(where: str, megapixels: float) -> dict[str, float]:
    """One integrator on `relief`, alone in its process: errors in % of the range, times in s, peak memory in GB.

    where: "module:function" of the integrator. megapixels: of the square frame.
    """
    size = round(np.sqrt(megapixels * 1e6))
    normal, z = relief(size)
    module, function = where.split(":")
    integrate = getattr(import_module(module), function)
    start = time.perf_counter(), time.process_time()
    height = integrate(normal, np.ones(z.shape, bool), Scale()).height
    seconds = time.perf_counter() - start[0], time.process_time() - start[1]
    z -= z.mean()
    error = np.abs(height - z) / np.ptp(z) * 100
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2  # Linux gives KiB
    return {
        "mean_percent": float(error.mean()),
        "median_percent": float(np.median(error)),
        "seconds": seconds[0],
        "cpu_seconds": seconds[1],
        "peak_gb": peak,
    }


def figures(megapixels: float, names: list[str], folder: Path) -> dict[str, Any]:
    """Both tables; "left_out" lists what was not measured, and why."""
    result: dict[str, Any] = {"depth": {}, "at_size": {}, "megapixels": megapixels, "left_out": []}
    place = folder / "bini_diligent"
    if place.is_dir():
        result["depth"] = depth_errors(place)
    else:
        result["left_out"].append(f"depth of the reference objects: no folder {place}; set DEGLOSS_DATA")
    for name in names:
        # A process of its own each, so that the peak memory is this integrator's.
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
            result["at_size"][name] = alone.submit(at_size, HEIGHT[name], megapixels).result()
    return result


def text(result: dict[str, Any]) -> str:
    """The two tables, and what was left out."""
    lines = []
    if result["depth"]:
        lines.append("mean absolute depth error in mm after the median scale (seconds, processor seconds)")
        for name, row in result["depth"].items():
            cells = (f"{thing} {v['mm']:.4f} ({v['seconds']:.1f}, {v['cpu_seconds']:.1f})" for thing, v in row.items())
            lines.append(f"  {name:<14}" + "   ".join(cells))
    lines.append(f"relief with a flap, {result['megapixels']:g} megapixels: error in % of the range, mean and median")
    lines += [
        f"  {name:<14}{v['mean_percent']:.3f}   {v['median_percent']:.4f}   {v['seconds']:.1f} s   "
        f"{v['cpu_seconds']:.1f} processor s   {v['peak_gb']:.2f} GB"
        for name, v in result["at_size"].items()
    ]
    return "\n".join(lines + [f"left out: {line}" for line in result["left_out"]])


def main(arguments: list[str] | None = None) -> int:
    """The command; exit code 2 with one line for a bad option."""
    parser = argparse.ArgumentParser(prog="python -m recon.height.bench", description="Every integrator in figures.")
    parser.add_argument("--size", type=float, default=4.0, help="megapixels of the large relief (default: 4)")
    parser.add_argument(
        "--only", nargs="+", default=[*HEIGHT], metavar="NAME", help="integrators for the large relief (default: all)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    try:
        if not 1e-3 <= options.size <= 100:
            raise InputError(f"--size {options.size:g}: must be from 0.001 to 100 megapixels")
        for name in options.only:
            HEIGHT[name]
        result = figures(options.size, options.only, data_folder())
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(dumps(result) if options.json else text(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
