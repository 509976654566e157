"""Photographs to walk through the tutorial with, without a camera: `python docs/examples/photographs.py photos/button`.

A glossy painted button of 24 mm with a dent that does not belong there, beside a chrome and a matte ball, under six lamps some 400 mm away
that are not equally strong, each taken with two exposures, with noise, a black level and a little light from the room; dark frames, a
picture of the room's light alone, and masks. `nominal.ply` beside them is the button as it was meant to be, without the dent.
Everything in closed form, by the substrate of `gen.substrate`. capture.yaml is left to the reader (see docs/tutorial.md).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gen.images import write_png
from gen.lights import ring
from gen.substrate import shade

Doubles = NDArray[np.float64]

WIDTH_MM, HEIGHT_MM = 60.0, 34.0
EXPOSURES = (0.01, 0.08)
STRENGTHS = (1.0, 0.85, 1.1, 0.95, 1.2, 0.9)
LAMPS = 400.0 * ring(5, 38.0, frontal=True, start_degrees=20.0)
"""Places of the six lamps in mm from where the camera looks: one beside the lens, five around it."""

PAINT, KS, ALPHA = np.array([0.55, 0.12, 0.08]), 0.06, 0.15
RADIUS, RISE = 12.0, 4.0
DENT = (4.0, -3.0, 1.2, 0.12)
"""x, y, radius and depth in mm."""

BALLS = {"chrome": (-19.0, 0.0, 6.0), "matte": (19.0, 0.0, 6.0)}
"""x, y and radius in mm; their middles lie in the plane z = 0, in which the button stands."""

METHODS = (
    ("none", "least-squares"),
    ("chromaticity", "least-squares"),
    ("group", "least-squares"),
    ("explain", "least-squares"),
    ("none", "explain"),
)

BLACK, READ, ELECTRONS = 0.004, 0.0006, 20_000.0


def button(x: Doubles, y: Doubles, dent: bool) -> Doubles:
    """The button's height in mm: a dome with a rounded groove, by itself or with the dent."""
    r = np.hypot(x, y)
    z = RISE * (1 - (r / RADIUS) ** 2) - 0.35 * np.exp(-(((r - 8.5) / 0.7) ** 2))
    if dent:
        cx, cy, radius, depth = DENT
        z = z - depth * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / radius**2)
    return z


def surface(size: int) -> tuple[Doubles, Doubles, NDArray[np.bool_], dict[str, NDArray[np.bool_]]]:
    """Points and unit normals (H, W, 3) in mm, the button's mask (H, W), and the masks of the balls. size: pixels across."""
    step = WIDTH_MM / size
    rows = round(HEIGHT_MM / step)
    y, x = np.mgrid[:rows, :size].astype(float)
    x, y = (x - (size - 1) / 2) * step, ((rows - 1) / 2 - y) * step
    h = 1e-4
    slope = [(button(x + a, y + b, True) - button(x - a, y - b, True)) / (2 * h) for a, b in ((h, 0.0), (0.0, h))]
    normal = np.stack([-slope[0], -slope[1], np.ones_like(x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    points = np.stack([x, y, button(x, y, True)], -1)
    balls = {}
    for name, (cx, cy, radius) in BALLS.items():
        rest = radius**2 - (x - cx) ** 2 - (y - cy) ** 2
        balls[name] = rest > 0
        z = np.sqrt(np.maximum(rest, 0))
        points[balls[name]] = np.stack([x, y, z], -1)[balls[name]]
        normal[balls[name]] = (np.stack([x - cx, y - cy, z], -1) / radius)[balls[name]]
    return points, normal, np.hypot(x, y) < RADIUS, balls


def radiance(k: int, points: Doubles, normal: Doubles, mask: NDArray[np.bool_], balls: dict[str, NDArray[np.bool_]]) -> Doubles:
    """(H, W, 3) under lamp k, without the room."""
    toward = LAMPS[k] - points
    distance = np.linalg.norm(toward, axis=-1, keepdims=True)
    light, fall = toward / distance, (400.0 / distance) ** 2 * STRENGTHS[k]
    view = np.array([0.0, 0.0, 1.0])
    picture = np.zeros(points.shape)
    diffuse, specular, _ = shade(normal, light, view, PAINT, KS, ALPHA)
    picture[mask] = ((diffuse + specular) * fall)[mask]
    picture[balls["matte"]] = (0.7 * np.maximum((normal * light).sum(-1, keepdims=True), 0) * fall)[balls["matte"]]
    mirrored = 2 * normal[..., 2:] * normal - view
    off = np.degrees(np.arccos(np.clip((mirrored * light).sum(-1, keepdims=True), -1, 1)))
    picture[balls["chrome"]] = (40 * np.exp(-0.5 * (off / 2.0) ** 2) * STRENGTHS[k])[balls["chrome"]] * np.ones(3)
    return picture


def photograph(light: Doubles, exposure: float, rng: np.random.Generator) -> NDArray[np.uint16]:
    """What a camera stores of radiance (H, W, 3): shot and read noise, black level, 16 linear bits."""
    electrons = np.maximum(light, 0) * exposure / EXPOSURES[-1] * 1.6 * ELECTRONS
    stored = rng.poisson(electrons) / ELECTRONS + BLACK + READ * rng.standard_normal(light.shape)
    return np.round(np.clip(stored, 0, 1) * 65535).astype(np.uint16)


def write(folder: Path, size: int = 480, seed: int = 1) -> None:
    """All photographs, masks and the nominal mesh into a new folder."""
    from recon.mesh import surface_mesh, write_mesh

    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    points, normal, mask, balls = surface(size)
    anything = mask | balls["chrome"] | balls["matte"]
    room = 0.004 * (1 + normal[..., 1:2]) * anything[..., None] * np.ones(3)
    for k in range(len(LAMPS)):
        light = radiance(k, points, normal, mask, balls) + room
        for n, exposure in enumerate(EXPOSURES):
            write_png(folder / f"{k + 1:02d}-{'ab'[n]}.png", photograph(light, exposure, rng))
    for n, exposure in enumerate(EXPOSURES):
        write_png(folder / f"dark-{'ab'[n]}.png", photograph(np.zeros(points.shape), exposure, rng))
    write_png(folder / "room.png", photograph(room, EXPOSURES[-1], rng))
    for name, where in {"object": mask, **balls}.items():
        write_png(folder / f"{name}.png", where.astype(np.uint8) * 255)
    nominal = points.copy()
    nominal[..., 2] = button(points[..., 0], points[..., 1], False)
    nominal[~mask] = np.nan
    write_mesh(surface_mesh((nominal / 1000).astype(np.float32)), folder / "nominal.ply", "m")


def errors(folder: Path) -> dict[str, float]:
    """Mean angle to the true normals in degrees, by method, of photographs that were written before and have their capture.yaml."""
    from gen.capture import read_capture
    from recon.metrics import angular_error
    from recon.pipeline import measure

    capture = read_capture(folder)
    _, normal, mask, _ = surface(capture.size[1])
    found = {}
    for gloss, normals in METHODS:
        shape = measure(capture, gloss, "none", normals)
        found[f"{gloss}, {normals}"] = float(np.nanmean(angular_error(shape.normals.normal, normal.astype(np.float32))[mask]))
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Photographs to walk through the tutorial with, without a camera.")
    parser.add_argument("folder", type=Path, help="the folder to write; it must not be there yet")
    parser.add_argument("--size", type=int, default=480, help="pixels across; default 480")
    parser.add_argument("--errors", action="store_true", help="measure the photographs that are there, against the true normals")
    arguments = parser.parse_args()
    if arguments.errors:
        for method, error in errors(arguments.folder).items():
            print(f"{method}: {error:.1f} degrees")
        raise SystemExit
    write(arguments.folder, arguments.size)
    print(f"{arguments.folder}: {len(LAMPS) * len(EXPOSURES)} photographs; docs/tutorial.md says what to do with them")
