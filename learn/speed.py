"""How long gloss removal takes by the shipped networks, `python -m learn.speed [--size S] [--pictures K] [--json]` (part of `make bench`).

A glossy sphere by the reference BRDF fills the frame: seconds a picture in the network, and in the remover around it with all its checks.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np

from gen.capture import Capture
from gen.errors import InputError
from gen.files import dumps
from gen.substrate import shade
from learn.method import METHODS

RUNS = 5
"""Runs whose median is taken, after one that warms up."""

TILT = np.radians(35)
"""Angle of the lights to the view."""


def seconds(method: str, capture: Capture, runs: int = RUNS) -> tuple[float, float]:
    """Seconds a picture of a capture (K, H, W, 3) in a method's network and in the whole remover, the medians of some runs.

    Raises InputError where no weights are shipped, MissingPart without torch, and as `learn.removers.remove_by`.
    """
    from learn.removers import remove_by
    from learn.weights import load_weights

    loaded = load_weights(method)
    inside = 0.0
    original = loaded.model.forward

    def forward(*given: object, **named: object) -> object:
        nonlocal inside
        start = time.perf_counter()
        result = original(*given, **named)
        inside += time.perf_counter() - start
        return result

    loaded.model.forward = forward
    times = []
    for _ in range(1 + runs):
        inside, start = 0.0, time.perf_counter()
        remove_by(loaded, capture)
        times.append((inside, time.perf_counter() - start))
    network, whole = np.median(times[1:], axis=0) / capture.count
    return float(network), float(whole)


def glossy_sphere(size: int, count: int) -> Capture:
    """A sphere that fills size x size pixels under `count` lights around the view, without cast shadows. Reflectance: `gen.substrate`."""
    y, x = (np.mgrid[:size, :size] + 0.5) * 2 / size - 1
    mask = x**2 + y**2 < 1
    normals = np.stack([x, -y, np.sqrt(np.clip(1 - x**2 - y**2, 0, None))], -1)
    around = 2 * np.pi * np.arange(count) / count
    lights = np.stack([np.sin(TILT) * np.cos(around), np.sin(TILT) * np.sin(around), np.full(count, np.cos(TILT))], 1)
    parts = shade(normals, lights[:, None, None], np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.3, 0.15]), 0.2, 0.2)
    images = (parts[0] + parts[1]).astype(np.float32) * mask[None, :, :, None]
    return Capture(images, lights, mask, source="sphere")


def main(arguments: Sequence[str] | None = None) -> None:
    """Time the networks and print the figures."""
    parser = argparse.ArgumentParser(prog="python -m learn.speed", description=__doc__)
    parser.add_argument("--size", type=int, default=256, help="pixels a side (default: 256)")
    parser.add_argument("--pictures", type=int, default=5, help="pictures of the view (default: 5)")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    given = parser.parse_args(arguments)
    try:
        if given.size < 8 or given.pictures < 1:
            raise InputError("--size must be at least 8 and --pictures at least 1")
        capture = glossy_sphere(given.size, given.pictures)
        found = {name: dict(zip(("network", "remover"), seconds(name, capture), strict=True)) for name in METHODS}
    except InputError as error:
        print(f"learn.speed: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    if given.json:
        print(dumps({"size": given.size, "pictures": given.pictures, "seconds": found}, indent=2))
        return
    print(
        f"seconds a picture, {given.pictures} of {given.size}x{given.size}\n\n| method | network | with all checks |\n|---|---|---|"
    )
    for name, row in found.items():
        print(f"| {name} | {row['network']:.3f} | {row['remover']:.3f} |")


if __name__ == "__main__":
    main()
