"""How fast captures are made: `python -m gen.bench [PRESET] [--json]` (part of `make bench`).

Side by side in one run, pictures a second of (i) a bare Cycles loop over the same shots, crop, samples and threads, with the result thrown
away; (ii) what `degloss gen render` does, with 1 worker and with one a core: the same shots, several lights of a convex object by one
render, fetched, averaged, checked, exposed, written as layered EXR and hashed; (iii) BlenderProc, where a Python that has it is named: ten
renders a stack, since it has no gloss-free twin. Starting Blender is left out everywhere, and said apart.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gen.farm import Farm
from gen.files import dumps
from gen.render import jobs_of
from gen.sets.campaign import render_items
from gen.sets.plan import Item, plan_of

BLENDERPROC = "BLENDERPROC_PYTHON"
"""The environment variable that names a Python with BlenderProc and bpy, in place of --blenderproc."""

REPEATS = 3
"""How often the preset's items are rendered in one go: of a few, the files of the last one, which no render runs beside, would count."""


def bare(jobs: Sequence[dict[str, Any]], processes: int, threads: int) -> float:
    """Pictures a second of the bare loop: `processes` of them at once, each over all jobs, with `threads` each."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "jobs.json"
        path.write_text(json.dumps(jobs), encoding="utf-8")
        command = [sys.executable, "-P", "-m", "blender_scenes.bare", str(path), "--threads", str(threads)]
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parent.parent)}
        running = [
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment)
            for _ in range(processes)
        ]
        seconds = [float(process.communicate()[0].strip().splitlines()[-1]) for process in running]
    return processes * sum(len(job["lights"]) for job in jobs) / max(seconds)


def product(items: Sequence[Item], workers: int) -> tuple[float, float]:
    """(pictures a second, seconds until the workers were ready) of the whole product; each worker renders an item before it counts."""
    with tempfile.TemporaryDirectory() as scratch, Farm(workers) as farm:
        began = time.perf_counter()
        for number, chosen in enumerate((items[:workers], items)):
            folder = Path(scratch) / str(number)
            (folder / "items").mkdir(parents=True)
            work = folder / "work"
            work.mkdir()
            started = time.perf_counter()
            ended = list(render_items(folder, chosen, farm, work, finishers=min(16, 1 + workers // 2)))
            took = time.perf_counter() - started
            if number == 0:
                start_up = time.perf_counter() - began
            if any(one.error for one in ended):
                raise SystemExit(f"gen.bench: an item failed: {next(one.error for one in ended if one.error)}")
    return sum(one.pictures for one in ended) / took, start_up


def blenderproc(python: str, stacks: int) -> dict[str, float]:
    """Seconds a stack and of the start of BlenderProc, by its own script under another Python."""
    with tempfile.TemporaryDirectory() as scratch:
        script = Path(__file__).with_name("bench_blenderproc.py")
        run = subprocess.run([python, str(script), scratch, str(stacks)], cwd=scratch, capture_output=True, text=True)
    lines = [line for line in run.stdout.splitlines() if line.startswith('{"start"')]
    if run.returncode or not lines:
        raise SystemExit(f"gen.bench: BlenderProc failed: {(run.stderr.strip().splitlines() or ['no output'])[-1]}")
    figures = json.loads(lines[-1])
    return {"start": figures["start"], "stack": statistics.median(figures["stacks"])}


def measure(preset: str, rounds: int, python: str | None) -> dict[str, Any]:
    """All figures, medians over rounds in which everything is run in turn, so that a drifting machine harms none more than another."""
    cores = os.cpu_count() or 1
    items: dict[str, list[Item]] = {}
    frames: dict[str, list[dict[str, Any]]] = {}
    for name, crop in (("crop", True), ("full frame", False)):
        # Ks = 0 would be a second render of every picture.
        items[name] = [
            replace(item, id=f"{item.id}-{again}", spec={**item.spec, "ks0": False, "crop": crop})
            for again in range(REPEATS)
            for item in plan_of(preset).items
        ]
        frames[name] = [job for item in items[name] for job in jobs_of(item.capture_spec(), Path("unused"))]
    rows: dict[str, list[float]] = {}
    starts: list[float] = []
    stacks: list[dict[str, float]] = []
    for _ in range(rounds):
        for name, jobs in frames.items():
            rows.setdefault(f"bare loop, 1 process of {cores} threads, {name}", []).append(bare(jobs, 1, cores))
        if cores > 1:
            rows.setdefault(f"bare loop, {cores} processes of 1 thread, crop", []).append(bare(frames["crop"], cores, 1))
        for name, chosen in items.items():
            for workers in dict.fromkeys((1, cores)):
                rate, start_up = product(chosen, workers)
                rows.setdefault(f"gen render, {workers} worker{'s' * (workers > 1)}, {name}", []).append(rate)
                starts.append(start_up)
        if python is not None:
            stacks.append(blenderproc(python, 2))
    figures: dict[str, Any] = {
        "preset": preset,
        "pictures": sum(len(job["lights"]) for job in frames["crop"]),
        "box": box_share(items["crop"][0]),
        "rate": {name: {"median": statistics.median(rates), "all": rates} for name, rates in rows.items()},
        "start": statistics.median(starts),
    }
    if stacks:
        figures["blenderproc"] = {key: statistics.median(one[key] for one in stacks) for key in ("stack", "start")}
    return figures


def box_share(item: Item) -> float:
    """Share of the frame that the box around an item's object takes."""
    from gen.render import render

    capture = render(item.capture_spec()).capture
    y, x = np.nonzero(capture.mask)
    return float((np.ptp(y) + 3) * (np.ptp(x) + 3) / capture.mask.size)


def main() -> None:
    """Work out all figures and print them."""
    parser = argparse.ArgumentParser(prog="python -m gen.bench", description=__doc__)
    parser.add_argument("preset", nargs="?", default="paper-stack", help="a preset of a set (default: paper-stack)")
    parser.add_argument("--rounds", type=int, default=3, help="how often everything is run in turn (default: 3)")
    parser.add_argument(
        "--blenderproc",
        default=os.environ.get(BLENDERPROC) or None,
        metavar="PYTHON",
        help="a Python that runs BlenderProc by bpy",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    arguments = parser.parse_args()
    figures = measure(arguments.preset, arguments.rounds, arguments.blenderproc)
    if arguments.json:
        print(dumps(figures, indent=2))
        return
    bare_rate = {
        name.split(", ")[-1]: row["median"] for name, row in reversed(figures["rate"].items()) if name.startswith("bare")
    }
    print(f"{figures['preset']}: {figures['pictures']} pictures, the object's box is {100 * figures['box']:.0f} % of the frame\n")
    print("| | pictures a second | of the bare loop |\n|---|---|---|")
    for name, row in figures["rate"].items():
        print(f"| {name} | {row['median']:.2f} | {row['median'] / bare_rate[name.split(', ')[-1]]:.2f} |")
    print(f"\nstart-up of the workers, with one item each: {figures['start']:.1f} s")
    if "blenderproc" in figures:
        stack = figures["blenderproc"]["stack"]
        print(
            f"BlenderProc: {stack:.2f} s a stack (ten renders with files) after {figures['blenderproc']['start']:.1f} s of start-up"
        )
        for name, row in figures["rate"].items():
            if name.startswith("gen"):
                print(
                    f"{name}: {5 / row['median']:.2f} s a stack of 5, {stack * row['median'] / 5:.1f} times faster than BlenderProc"
                )
    else:
        print(f"BlenderProc: left out; name a Python that has it by --blenderproc or {BLENDERPROC}")


if __name__ == "__main__":
    main()
