"""Memory and time of one large stack: `python -m recon.big_bench [--megapixels 24] [OPTIONS of degloss recon run] [--json]`.

Five 16-bit pictures of glossy balls on a wavy ground are made here, `degloss recon run` measures them in a process of its own, and what is
printed is the most memory that each of its steps had in use, the time it took, and how far the heights are from the true ones.

Five pictures of 24 megapixels take, in bytes a pixel: reading 120, removing the gloss by `group` 180, repairing 220, solving for normals
140, integrating 210, writing 245. A third of that are working files (`gen.large`), whose memory the system can take back.
"""

from __future__ import annotations

import argparse
import math
import os
import pty
import re
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.files import dumps

STRIP = 1 << 20
"""Pixels that are made at a time."""

TILT = 35.0
"""Degrees of the four lights around the frontal one."""

NOISE = 0.002
"""Standard deviation of the pictures' noise, in shares of white."""

BALL = (0.25, 0.33)
"""Balls stand this share of the picture's height apart, and reach this share of that distance around their middles."""

Doubles = NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    """A step of the command. resident: the most bytes in memory, mapped files included. anonymous: the same without what is a file."""

    title: str
    seconds: float
    resident: int
    anonymous: int


def size_of(megapixels: float) -> tuple[int, int]:
    """(H, W) of a picture in the shape 2 to 3, sides in whole tens."""
    side = math.sqrt(megapixels * 1e6 / 6)
    return max(round(2 * side / 10), 2) * 10, max(round(3 * side / 10), 3) * 10


def scene(rows: slice, height: int, width: int) -> tuple[Doubles, Doubles]:
    """True heights (h, W) in pixels and unit normals (h, W, 3) of some rows: caps of balls on a waving ground, a crease around each."""
    y, x = np.mgrid[rows, :width].astype(np.float64)
    wave = height / 9
    z = 0.35 * wave / math.tau * np.sin(math.tau * x / wave) * np.cos(math.tau * y / wave)
    dx = 0.35 * np.cos(math.tau * x / wave) * np.cos(math.tau * y / wave)
    dy = -0.35 * np.sin(math.tau * x / wave) * np.sin(math.tau * y / wave)
    apart = BALL[0] * height
    reach = BALL[1] * apart
    radius = 1.15 * reach  # caps that rise at 60 degrees from their rims
    u, v = (x + apart / 2) % apart - apart / 2, (y + apart / 2) % apart - apart / 2
    on = u * u + v * v < reach * reach
    cap = np.sqrt(np.where(on, radius**2 - u * u - v * v, 1))
    z += np.where(on, cap - math.sqrt(radius**2 - reach**2), 0)
    slope = np.stack([dx - np.where(on, u / cap, 0), dy - np.where(on, v / cap, 0)], axis=-1)
    n = np.stack([-slope[..., 0], slope[..., 1], np.ones_like(z)], axis=-1)  # rows run down, y runs up
    return z, n / np.linalg.norm(n, axis=-1, keepdims=True)


def write_stack(folder: Path, height: int, width: int) -> None:
    """The pictures of the scene and their lights.txt: the reference BRDF with a coloured base, noise, no mask."""
    from gen.images import write_png
    from gen.substrate import shade

    t = math.radians(TILT)
    lights = [
        [0, 0, 1],
        *([math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t)] for a in np.radians([0, 90, 180, 270])),
    ]
    pictures = np.empty((len(lights), height, width, 3), np.uint16)
    noise = np.random.default_rng(0)
    for rows in strips(height, width):
        _, normal = scene(rows, height, width)
        for k, light in enumerate(np.array(lights)):
            d, s, _ = shade(normal, light, np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.3, 0.15]), 0.1, 0.15)
            picture = np.clip(0.45 * (d + s) + NOISE * noise.standard_normal(d.shape), 0, 1)
            pictures[k, rows] = np.rint(picture * 65535)
    folder.mkdir(parents=True)
    for k, picture in enumerate(pictures):
        write_png(folder / f"{k + 1}.png", picture)
    np.savetxt(folder / "lights.txt", np.array(lights))


def strips(height: int, width: int) -> Iterator[slice]:
    """Rows of about `STRIP` pixels."""
    step = max(STRIP // width, 1)
    for start in range(0, height, step):
        yield slice(start, min(start + step, height))


def run(command: Sequence[str]) -> list[Step]:
    """The steps of a command that shows them as `recon.progress` does. Raises RuntimeError where it fails."""
    ours, theirs = pty.openpty()  # the steps are shown on terminals only
    environment = os.environ | {"COLUMNS": "160", "TERM": "xterm"}
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=theirs, stdin=subprocess.DEVNULL, env=environment)
    os.close(theirs)
    steps: list[Step] = []
    title, began, peak, text = "starting", time.perf_counter(), (0, 0), ""

    def end(now: float) -> None:
        steps.append(Step(title, now - began, *peak))
        print(f"{title}: {now - began:.0f} s, {peak[0] / 1e9:.2f} GB", file=sys.stderr, flush=True)

    while True:
        if select.select([ours], [], [], 0.05)[0]:
            try:
                text = (text + os.read(ours, 65536).decode("utf-8", "replace"))[-20000:]
            except OSError:  # the other end is closed
                break
        peak = tuple(map(max, peak, in_use(process.pid)))  # type: ignore[assignment] # of two numbers
        shown = titles(text)
        if shown and shown[-1] != title:
            now = time.perf_counter()
            end(now)
            title, began, peak = shown[-1], now, (0, 0)
    end(time.perf_counter())
    os.close(ours)
    if process.wait():
        raise RuntimeError(f"{' '.join(command)}: ended with {process.returncode}: {text[-400:]}")
    return steps


def titles(text: str) -> list[str]:
    """The titles of steps in what a terminal was sent."""
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    return [line[:40].strip() for line in re.split(r"[\r\n]+", plain) if " steps " in line]


def in_use(process: int) -> tuple[int, int]:
    """Bytes of a process that are in memory: the most since this was last asked, and those of no file now; zeros where it has ended."""
    place = Path(f"/proc/{process}")
    try:
        status = (place / "status").read_text()
        (place / "clear_refs").write_text("5")  # begins the peak anew
    except OSError:
        return 0, 0
    found = {
        name: int(line.split()[1]) * 1024
        for line in status.splitlines()
        for name in ("VmHWM", "RssAnon")
        if line.startswith(name)
    }
    return found.get("VmHWM", 0), found.get("RssAnon", 0)


def height_error(output: Path, height: int, width: int) -> float:
    """Root mean square error of the written heights in pixels after the best shift, over the ground and the balls."""
    from gen.exr import read_exr

    found = read_exr(output / "height.exr")["height.Z"]
    sums = np.zeros(3)
    for rows in strips(height, width):
        off = found[rows] - scene(rows, height, width)[0]
        known = np.isfinite(off)
        sums += known.sum(), off[known].sum(), np.square(off[known]).sum()
    return float(np.sqrt(max(sums[2] / sums[0] - (sums[1] / sums[0]) ** 2, 0)))


def measured(megapixels: float, options: Sequence[str], scratch: Path) -> dict[str, Any]:
    """What the command takes on a stack of so many megapixels: size, steps, the most memory in bytes, seconds, and the heights' error."""
    height, width = size_of(megapixels)
    write_stack(scratch / "stack", height, width)
    start = time.perf_counter()
    command = [sys.executable, "-m", "degloss", "recon", "run", str(scratch / "stack"), "-o", str(scratch / "out"), *options]
    steps = run(command)
    return {
        "size": [width, height],
        "options": list(options),
        "seconds": time.perf_counter() - start,
        "resident": max(step.resident for step in steps),
        "anonymous": max(step.anonymous for step in steps),
        "height error px": height_error(scratch / "out", height, width),
        "steps": [vars(step) for step in steps],
    }


def table(figures: dict[str, Any]) -> str:
    """The figures as text, a step a line."""
    pixels = figures["size"][0] * figures["size"][1]
    lines = [f"{'step':<42} {'seconds':>8} {'GB':>6} {'of it no file':>14} {'bytes a pixel':>14}"]
    lines += [
        f"{s['title']:<42} {s['seconds']:>8.1f} {s['resident'] / 1e9:>6.2f} {s['anonymous'] / 1e9:>14.2f} {s['resident'] / pixels:>14.0f}"
        for s in figures["steps"]
    ]
    lines.append(
        f"{figures['size'][0]}x{figures['size'][1]}: {figures['seconds']:.0f} s, at most {figures['resident'] / 1e9:.2f} GB; "
        f"heights err by {figures['height error px']:.2f} px"
    )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the stack, measure it and print the figures."""
    parser = argparse.ArgumentParser(prog="python -m recon.big_bench", description=__doc__)
    parser.add_argument("--megapixels", type=float, default=24.0, help="of each picture")
    parser.add_argument(
        "--scratch", type=Path, default=None, help="where to make a folder for pictures and results, removed at the end"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    options, others = parser.parse_known_args(arguments)
    with tempfile.TemporaryDirectory(dir=options.scratch) as folder:
        figures = measured(options.megapixels, others, Path(folder))
    print(dumps(figures, indent=2) if options.json else table(figures))


if __name__ == "__main__":
    main()
