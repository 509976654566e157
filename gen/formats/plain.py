"""Plain folders: pictures and a table of light directions. What a person with a camera and five lamps has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture
from gen.errors import InputError
from gen.files import read_lines
from gen.formats.tables import (
    check_count,
    mask_or_frame,
    picture_paths,
    pictures_in,
    read_directions,
    read_intensities,
    read_named_directions,
    read_scale,
)
from gen.formats.truth import read_truth
from gen.images import read_frames

LIGHTS = ("lights.txt", "light_directions.txt")
INTENSITIES = ("intensities.txt", "light_intensities.txt")
NOT_PICTURES = ("mask", "normal", "normals", "normal_gt", "normal_map", "depth", "depth_gt", "height", "albedo")
"""Picture files of these names (without suffix, in any case) are not frames of the capture."""


def is_plain(path: Path) -> bool:
    """Whether `path` is a folder that holds pictures."""
    return path.is_dir() and bool(_frames_in(path))


def read_plain(path: Path, encoding: str | None = None) -> Capture:
    """Read a folder of pictures with `lights.txt` (or `light_directions.txt`).

    The table has one row a picture: `x y z`, the pictures in natural order of their names (2 before 10), or `name x y z`, and
    then only the named pictures are read; or three rows of K numbers. Directions point from the object to the light, x right, y
    up, z to the camera, of any length. Optional: `intensities.txt` (or `light_intensities.txt`), one or three numbers a row in
    the order of the lights; `mask.png`, white on the object (else the whole frame); `scale.txt`, `K.txt`, `crop.txt` (see
    `gen.formats.tables.read_scale`); truth (see `gen.formats.truth.read_truth`). Raises InputError where a file is missing,
    damaged or contradicts another.
    """
    all_names = _frames_in(path)
    if not all_names:
        raise InputError(f"{path}: holds no pictures")
    table = next((path / name for name in LIGHTS if (path / name).exists()), path / LIGHTS[0])
    names, lights = _lights(table, all_names)
    paths = picture_paths(path, names, table)
    strength = next((path / name for name in INTENSITIES if (path / name).exists()), None)
    intensities = np.ones((len(paths), 3)) if strength is None else read_intensities(strength, len(paths))
    frames = read_frames(paths, encoding)
    mask, mask_origin = mask_or_frame(path / "mask.png", frames)
    record: dict[str, Any] = {"format": "plain", "encoding": frames.reading, "bits": frames.bits, "mask": mask_origin}
    unused = [name for name in all_names if name not in set(names)]
    if unused:
        record["not_in_the_table"] = unused
    return Capture(
        images=frames.images,
        lights=lights,
        mask=mask,
        intensities=intensities,
        faults=frames.faults,
        names=tuple(names),
        scale=read_scale(path, (mask.shape[0], mask.shape[1])),
        truth=read_truth(path, mask),
        encoding=frames.encoding,
        source=str(path),
        provenance=record,
    )


def _frames_in(folder: Path) -> list[str]:
    return [name for name in pictures_in(folder) if Path(name).stem.casefold() not in NOT_PICTURES]


def _lights(table: Path, pictures: list[str]) -> tuple[list[str], NDArray[np.float64]]:
    """(names of the pictures, their light directions)."""
    lines = [line for _, line in read_lines(table, "light directions, x y z a row") if not line.startswith("#")]
    if lines and not all(_is_number(word) for word in lines[-1].split("#")[0].replace(",", " ").replace(";", " ").split()):
        return read_named_directions(table, "lights, file x y z a line")
    lights = read_directions(table)
    check_count(table, len(lights), len(pictures), "light directions")
    return pictures, lights


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
