"""Cameras that nobody measured: structure from motion by COLMAP (the package pycolmap, an extra), up to the scale that distances give.

python -m recon.multiview.structure FOLDER [--gloss NAME]     writes FOLDER/cameras.json for the captures in FOLDER
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gen.capture import Capture, read_capture
from gen.errors import InputError
from gen.files import read_json, write_json
from gen.images import write_png
from recon.multiview.stereo import Picture
from recon.multiview.views import CAMERAS, OPENCV, Doubles, View, write_cameras

ERODED = 4
"""Pixels inside the outline where no feature is taken: the outline itself moves over the surface as the object turns."""

LEAST_VIEWS = 3
"""Of two views alone the poses would rest on a handful of features; from three on they check each other."""


@dataclass(frozen=True, eq=False)
class Solved:
    """poses: (4, 4) object to camera of each capture, mm. points: how many points of the object they were found from.

    error: mean distance in pixels between where those points are seen and where the poses put them.
    """

    poses: list[Doubles]
    points: int
    error: float


def solve_poses(captures: Sequence[Capture], names: Sequence[str], pictures: Sequence[Picture]) -> Solved:
    """Where the cameras stood, from features that the views share.

    captures: with camera K and distance_mm, which sets the scale: pictures alone know none. pictures: 8-bit grey (H, W) of each, gloss and
    shading removed. The object's frame is the first camera's, moved to the object. Cameras far from a small object see it nearly in
    parallel: a turn of the camera and a shift of it then look alike, which does little harm to the surface, and the scale is as good as
    the distances that are stated.
    Raises InputError where pycolmap is missing or a view cannot be placed.
    Source: Schoenberger and Frahm, "Structure-from-Motion Revisited" (2016), as COLMAP has it.
    """
    if find_spec("pycolmap") is None:
        raise InputError("finding cameras needs the package pycolmap: pip install pycolmap; or write cameras.json yourself")
    if len(captures) < LEAST_VIEWS:
        raise InputError(f"finding cameras needs at least {LEAST_VIEWS} views, there are {len(captures)}")
    for name, capture in zip(names, captures, strict=True):
        if capture.scale.camera is None or capture.scale.distance_mm is None:
            raise InputError(f"view {name}: finding cameras needs its camera K and distance_mm, which sets the scale")
    with tempfile.TemporaryDirectory(prefix="degloss-") as scratch:
        return _solved(captures, names, pictures, Path(scratch))


def _solved(captures: Sequence[Capture], names: Sequence[str], pictures: Sequence[Picture], folder: Path) -> Solved:
    from scipy.ndimage import binary_erosion

    problem = []
    for k, (capture, picture) in enumerate(zip(captures, pictures, strict=True)):
        file = f"{k:04d}.png"
        inner = binary_erosion(capture.mask, iterations=ERODED)
        write_png(folder / "pictures" / file, picture)
        write_png(folder / "masks" / f"{file}.png", np.where(inner, 255, 0).astype(np.uint8))
        problem.append({"file": file, "K": capture.scale.camera})
    write_json(folder / "problem.json", problem)
    # A process of its own: COLMAP and OpenCV each bring a copy of libpng and zlib, and in one process they crash.
    program = [sys.executable, "-m", "recon.multiview.colmap", str(folder)]
    run = subprocess.run(program, capture_output=True, text=True, check=False)
    if run.returncode != 0 or not (folder / "poses.json").is_file():
        last = (run.stderr.strip().splitlines() or ["no message"])[-1]
        raise InputError(f"the cameras could not be found: COLMAP failed ({last[:200]})")
    answer = read_json(folder / "poses.json", "COLMAP's poses")
    found = {entry["file"]: np.array(entry["matrix"]) for entry in answer["poses"]}
    missing = [name for name, entry in zip(names, problem, strict=True) if entry["file"] not in found]
    if missing:
        raise InputError(
            f"the cameras of {len(missing)} of {len(names)} views could not be found, {missing[0]} first: they share too few "
            "features; take views closer together, or of a surface with more pattern"
        )
    matrices = [found[str(entry["file"])] for entry in problem]
    return Solved(_scaled(matrices, np.array(answer["points"]), captures), len(answer["points"]), float(answer["error"]))


def _scaled(matrices: Sequence[Doubles], points: Doubles, captures: Sequence[Capture]) -> list[Doubles]:
    """Poses in mm and our frames, from (3, 4) OpenCV matrices in COLMAP's unit. points: (N, 3) in that unit."""
    middle = np.median(points, axis=0)
    depths = np.array([(matrix[:, :3] @ middle + matrix[:, 3])[2] for matrix in matrices])
    scale = float(np.median([capture.scale.distance_mm or 0.0 for capture in captures] / depths))
    poses = []
    for matrix in matrices:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = OPENCV @ matrix[:, :3], OPENCV @ matrix[:, 3] * scale
        poses.append(pose)
    # From the first camera's axes at the object's middle to COLMAP's frame.
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = poses[0][:3, :3].T, middle * scale
    return [pose @ start for pose in poses]


def write_solved(folder: Path, gloss: str | None = None) -> Solved:
    """Find the cameras of the captures in a folder, each in a folder of its own, and write `cameras.json` there.

    gloss: the remover whose albedo is matched, by default that of `default_methods`. Raises InputError as `solve_poses` does, and where
    the file is there already.
    """
    from recon.multiview.depth import matching_picture, photometric
    from recon.reconstruct import Settings
    from recon.registry import default_methods

    if (folder / CAMERAS).exists():
        raise InputError(f"{folder / CAMERAS}: is there already; move it away to have it found anew")
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder")
    names = sorted(path.parent.relative_to(folder).as_posix() for path in folder.glob("**/capture.json"))
    if not names:
        raise InputError(f"{folder}: holds no capture folders of ours")
    captures = [read_capture(folder / name) for name in names]
    pictures = []
    for name, capture in zip(names, captures, strict=True):
        view = View(name, capture, np.eye(4))
        remover, repair = default_methods(capture.count, gloss)
        pictures.append(matching_picture(view, photometric(view, Settings(remover, repair)).albedo))
    solved = solve_poses(captures, names, pictures)
    write_cameras(folder, names, solved.poses)
    return solved


def main(arguments: Sequence[str] | None = None) -> None:
    """Find the cameras and say how well."""
    parser = argparse.ArgumentParser(
        prog="python -m recon.multiview.structure", description="Find the cameras of a folder of captures."
    )
    parser.add_argument("folder", type=Path, help="the folder that holds a capture folder for each view")
    parser.add_argument("--gloss", help="the gloss remover")
    options = parser.parse_args(arguments)
    try:
        solved = write_solved(options.folder, options.gloss)
    except InputError as error:
        print(f"degloss: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    print(
        f"{options.folder / CAMERAS}: {len(solved.poses)} cameras from {solved.points} points, {solved.error:.2f} pixels off on average"
    )


if __name__ == "__main__":
    main()
