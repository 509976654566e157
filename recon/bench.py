"""Figures that README and docs quote, by one command: `python -m recon.bench [--json]` (or `make bench`).

Least squares on the reference photographs, the comparison of the demo's presets, the repair, and the time of each step on a stack of five
pictures of 512x612. Figures that need a part which is not there (Blender, the reference data) are left out and named.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from gen.capture import read_capture
from gen.files import dumps
from gen.parts import PARTS, data_folder
from recon.compare import compare
from recon.pipeline import measure
from recon.registry import GLOSS

PRESETS = ("paper-cylinder", "polished-cylinder", "grey-cylinder", "paper-sphere")
RUNS = 5


def diligent(folder: Path) -> dict[str, float]:
    """Mean angular error in degrees of least squares on all lights, for every DiLiGenT object in a folder."""
    figures = {}
    for place in sorted(p for p in folder.iterdir() if p.is_dir()):
        metrics = measure(read_capture(place), "none", "none", "least-squares").metrics()
        figures[place.name] = metrics["truth"]["normals"]["mask"]["mean"]
    return figures


def presets(folder: Path) -> dict[str, Any]:
    """The comparison of every preset with every remover: rendered here, measured with least squares."""
    from gen.render import render_capture
    from gen.spec import read_spec

    figures: dict[str, Any] = {}
    for name in PRESETS:
        render_capture(read_spec(name), folder / name)
        capture = read_capture(folder / name)
        removers = [gloss for gloss in removers_here() if gloss != "none"]
        for gloss in removers:
            rows = compare(measure(capture, gloss, "telea")).figures()
            figures.setdefault(name, {k: rows[k] for k in ("glossy", "true diffuse", "true matte")})
            figures[name][gloss] = rows["removed"]
            figures[name][f"{gloss}, repaired"] = rows["repaired"]
    return figures


def removers_here() -> list[str]:
    """The removers that need no truth, without the learned ones where torch is missing."""
    learned = {name for name in GLOSS if GLOSS[name].startswith("learn.")} if PARTS["torch"].look().state != "ok" else set()
    return [name for name in GLOSS if name not in {"true-diffuse", "true-matte", *learned}]


def speed(folder: Path) -> dict[str, dict[str, float]]:
    """Seconds from files to height for each remover, best of `RUNS`: five 16-bit PNGs of 512x612, every pixel in the mask."""
    write_stack(folder)
    best: dict[str, dict[str, float]] = {}
    for gloss in removers_here():
        for _ in range(RUNS):
            start = time.perf_counter()
            capture = read_capture(folder)
            load = time.perf_counter() - start
            shape = measure(capture, gloss, "telea")
            total = time.perf_counter() - start
            if gloss not in best or total < best[gloss]["total"]:
                best[gloss] = {"load": load, **shape.seconds, "total": total}
    return best


def write_stack(folder: Path) -> None:
    """A plain folder of five 16-bit PNGs of 512x612: a glossy relief by the reference BRDF, filling the frame."""
    from gen.images import write_png
    from gen.substrate import shade

    H, W = 512, 612
    y, x = np.mgrid[:H, :W] / 60.0
    slope = np.stack([-0.5 * np.cos(x) * np.cos(y), -0.5 * np.sin(x) * np.sin(y), np.ones_like(x)], axis=-1)
    normal = slope / np.linalg.norm(slope, axis=-1, keepdims=True)
    t = np.radians(35)
    lights = [[0, 0, 1], *([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)] for a in np.radians([0, 90, 180, 270]))]
    noise = np.random.default_rng(0)
    for k, light in enumerate(np.array(lights)):
        d, s, _ = shade(normal, light, np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.3, 0.15]), 0.1, 0.2)
        picture = np.clip(0.5 * (d + s) + 0.002 * noise.normal(size=d.shape), 0, 1)
        write_png(folder / f"{k + 1}.png", np.rint(picture * 65535).astype(np.uint16))
    np.savetxt(folder / "lights.txt", lights)


def help_seconds() -> float:
    """Seconds that `degloss recon run --help` takes, the best of `RUNS`."""
    times = []
    for _ in range(RUNS):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "degloss", "recon", "run", "--help"], capture_output=True, check=True)
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    """Work out all figures and print them."""
    parser = argparse.ArgumentParser(prog="python -m recon.bench", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    arguments = parser.parse_args()
    figures: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as scratch:
        if (data_folder() / "diligent").is_dir():
            figures["diligent"] = diligent(data_folder() / "diligent")
        else:
            print(f"left out: {PARTS['reference data'].line}", file=sys.stderr)
        if PARTS["bpy"].look().state == "ok":
            figures["presets"] = presets(Path(scratch))
        else:
            print(f"left out: {PARTS['bpy'].line}", file=sys.stderr)
        if PARTS["torch"].look().state != "ok":
            print(f"left out: {PARTS['torch'].line}", file=sys.stderr)
        stack = Path(scratch) / "stack"
        stack.mkdir()
        figures["speed"] = speed(stack)
    figures["help"] = help_seconds()
    if arguments.json:
        print(dumps(figures, indent=2))
        return
    print_tables(figures)


def print_tables(figures: dict[str, Any]) -> None:
    """The figures as Markdown tables."""
    if "diligent" in figures:
        print("least squares, all lights, mean angular error in degrees\n\n| object | error |\n|---|---|")
        for name, error in figures["diligent"].items():
            print(f"| {name} | {error:.2f} |")
    for name, rows in figures.get("presets", {}).items():
        print(f"\n{name}: normals in degrees against the truth, gap closed, height error in % of the range\n")
        print("| pictures | normals | gap closed | height | height MSE against non-glossy, 8-bit |\n|---|---|---|---|---|")
        for label, row in rows.items():
            gap = "-" if row["gap closed"] is None else f"{row['gap closed']:.2f}"
            error, height = row["normals"]["mask"]["mean"], row["height"]["percent"]
            print(f"| {label} | {error:.2f} | {gap} | {height:.2f} | {row['non-glossy']['height MSE']:.0f} |")
    steps = ["load", "gloss", "repair", "normals", "height", "total"]
    print(f"\nseconds, five pictures of 512x612\n\n| remover | {' | '.join(steps)} |\n|{'---|' * (len(steps) + 1)}")
    for name, seconds in figures["speed"].items():
        print(f"| {name} | {' | '.join(f'{seconds[step]:.2f}' for step in steps)} |")
    print(f"\ndegloss recon run --help: {figures['help']:.2f} s")


if __name__ == "__main__":
    main()
