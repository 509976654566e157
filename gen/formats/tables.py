"""The small tables beside the pictures of a capture: names, light directions, intensities, scale; and its mask."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Bools, Capture, Fault, Scale
from gen.capture_lights import check_not_endless
from gen.errors import InputError
from gen.files import inside, is_count, read_lines, read_numbers
from gen.images import SUFFIXES, Frames, read_mask

Numbers = NDArray[np.float64]

SHORTEST = 1e-6
"""A light direction shorter than this is a zero that was written with rounding."""


def natural(name: str) -> list[tuple[int, int, str]]:
    """A key that sorts names as people count: 2 before 10."""
    words = re.split(r"(\d+)", name.casefold())
    return [(0, int(word), "") if i % 2 else (1, 0, word) for i, word in enumerate(words)]


def pictures_in(folder: Path) -> list[str]:
    """The names of the picture files of a folder, in natural order; hidden files are left out."""
    names = [p.name for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith(".") and p.is_file()]
    return sorted(names, key=natural)


def picture_paths(folder: Path, names: list[str], table: Path) -> list[Path]:
    """The files `names` of `folder`, as the text file `table` lists them.

    Raises InputError, naming the table, where there are none, or a name leads out of the folder, comes twice or is not there.
    """
    if not names:
        raise InputError(f"{table}: names no pictures")
    paths: list[Path] = []
    seen: set[Path] = set()
    for name in names:
        try:
            path = inside(folder, name)
        except InputError as error:
            raise InputError(f"{table}: {error}") from error
        if path in seen:
            raise InputError(f"{table}: names {name} twice; each picture has one light")
        if not os.path.isfile(path):  # unlike Path.is_file, which raises for a name too long to be one
            raise InputError(f"{path}: there is no such file ({table.name} names it)")
        seen.add(path)
        paths.append(path)
    return paths


def read_directions(path: Path, count: int | None = None) -> Numbers:
    """Light directions (K, 3) from rows of x y z, or from three rows of K numbers (K other than 3). Not yet unit vectors.

    count: how many there must be. Raises InputError where the table is missing or malformed, the number is another, or a
    direction has no length.
    """
    table = read_numbers(path, "light directions, x y z a row", None)
    if table.shape[1] != 3:
        if table.shape[0] != 3:
            raise InputError(f"{path}: has {table.shape[0]} rows of {table.shape[1]} numbers; light directions are rows of x y z")
        table = table.T
    check_count(path, len(table), count, "light directions")
    check_lengths(path, table)
    return table


def read_intensities(path: Path, count: int) -> Numbers:
    """Light intensities (K, 3) from rows of one or three positive numbers, or from three rows of K numbers (K other than 3)."""
    table = read_numbers(path, "light intensities, one or three numbers a row", None)
    if table.shape[1] not in (1, 3) and table.shape[0] in (1, 3):
        table = table.T
    if table.shape[1] not in (1, 3):
        raise InputError(f"{path}: has rows of {table.shape[1]} numbers; light intensities are one or three numbers a row")
    check_count(path, len(table), count, "light intensities")
    if (table <= 0).any():
        row = int(np.argmax((table <= 0).any(axis=1)))
        raise InputError(f"{path}: intensity {row + 1} is not positive; leave a light that was off out of the capture")
    return np.broadcast_to(table, (count, 3)).copy()


def read_named_directions(path: Path, what: str) -> tuple[list[str], Numbers]:
    """(names, directions (K, 3)) from rows `name x y z`, names with blanks included; a first row with only the count is checked.

    Raises InputError as `read_directions` does.
    """
    lines = read_lines(path, what)
    said = None
    if len(lines) > 1 and is_count(lines[0][1]):
        said, lines = int(lines[0][1]), lines[1:]
    names: list[str] = []
    rows: list[list[float]] = []
    for i, line in lines:
        if line.startswith("#"):
            continue
        words = line.split(" #")[0].replace(",", " ").replace(";", " ").rsplit(maxsplit=3)
        try:
            row = [float(word) for word in words[1:]]
        except ValueError:
            row = []
        if len(row) != 3:
            raise InputError(f"{path}: line {i} is not a file name and three numbers ({what})")
        if not np.isfinite(row).all():
            raise InputError(f"{path}: line {i} holds a value that is not finite ({what})")
        names.append(words[0].strip("\"'"))
        rows.append(row)
    if not rows:
        raise InputError(f"{path}: holds no lights ({what})")
    if said is not None and said != len(rows):
        raise InputError(f"{path}: its first line says {said}, but {len(rows)} rows follow ({what})")
    directions = np.array(rows, dtype=np.float64)
    check_lengths(path, directions)
    return names, directions


def check_count(path: Path, found: int, wanted: int | None, what: str) -> None:
    """InputError unless there is one row a picture."""
    if wanted is not None and found != wanted:
        raise InputError(f"{path}: has {found} {what} for {wanted} pictures; there must be one a picture")


def check_lengths(path: Path, directions: Numbers) -> None:
    """InputError where a direction is so short that it points nowhere, or so long that nothing can be worked out with it."""
    check_not_endless(directions, str(path))
    length = np.linalg.norm(directions, axis=1)
    if (length < SHORTEST).any():
        raise InputError(f"{path}: light direction {int(np.argmin(length)) + 1} has no length")


def read_scale(folder: Path, size: tuple[int, int]) -> Scale:
    """The scale of a capture from the optional files of its folder; unknown where there are none.

    `scale.txt`: lines `mm_per_pixel 0.05` (orthographic) or `distance_mm 500` (camera to the object's middle), '#' begins a
    comment. `K.txt`: three rows of the camera's intrinsics (OpenCV's: y down, pixel centres at integers), of the uncropped
    picture where `crop.txt` (`y0 y1 x0 x1`, the rows and columns kept) stands beside it. size: (H, W) of the pictures. Raises
    InputError where one of them is malformed or contradicts the pictures.
    """
    values: dict[str, float] = {}
    path = folder / "scale.txt"
    if path.exists():
        for i, line in read_lines(path, "the scale"):
            words = line.split("#")[0].replace("=", " ").replace(":", " ").split()
            if not words:
                continue
            try:
                name, value = words[0], float(words[1])
            except (IndexError, ValueError):
                name, value = "", 0.0
            if len(words) != 2 or name not in ("mm_per_pixel", "distance_mm") or name in values:
                raise InputError(f"{path}: line {i} must be 'mm_per_pixel NUMBER' or 'distance_mm NUMBER', each once")
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{path}: line {i}: {name} must be a positive number")
            values[name] = value
    camera = _read_camera(folder, size)
    if camera is not None and "mm_per_pixel" in values:
        raise InputError(
            f"{path}: mm_per_pixel is for orthographic views, but K.txt makes the view perspective; give distance_mm"
        )
    if camera is None and "distance_mm" in values:
        raise InputError(f"{path}: distance_mm needs the camera's K.txt beside it; or give mm_per_pixel")
    return Scale(values.get("mm_per_pixel"), camera, values.get("distance_mm"))


def _read_camera(folder: Path, size: tuple[int, int]) -> Numbers | None:
    path = folder / "K.txt"
    if not path.exists():
        return None
    K = read_numbers(path, "camera intrinsics K", 3)
    if K.shape != (3, 3) or K[0, 0] <= 0 or K[1, 1] <= 0 or not np.allclose(K[2], (0, 0, 1)):
        raise InputError(f"{path}: must hold the three rows 'fx s cx', '0 fy cy', '0 0 1' with positive fx and fy")
    crop = folder / "crop.txt"
    if crop.exists():
        rows = read_numbers(crop, "the crop, y0 y1 x0 x1", 4)
        y0, y1, x0, x1 = rows[0]
        if len(rows) != 1 or (y1 - y0, x1 - x0) != size or y0 < 0 or x0 < 0:
            raise InputError(f"{crop}: 'y0 y1 x0 x1' must span the pictures, which are {size[1]}x{size[0]} pixels")
        K[0, 2] -= x0
        K[1, 2] -= y0
    return K


def mask_or_frame(path: Path, frames: Frames) -> tuple[Bools, str]:
    """(mask, its origin in words): the mask picture where there is one, else every pixel with a value in some picture.

    path: the mask's usual name, such as mask.png; other endings and capitals (MASK.PNG, mask.jpg) are found as well. Raises InputError
    where the mask is empty, damaged or of another size, where there are several, or where no pixel has a value.
    """
    size = frames.faults.shape[1:]
    found = [
        p for p in sorted(path.parent.iterdir()) if p.stem.casefold() == path.stem.casefold() and p.suffix.lower() in SUFFIXES
    ]
    if len(found) > 1:
        raise InputError(f"{path.parent}: holds more than one mask ({', '.join(p.name for p in found)}); keep one")
    if found:
        return read_mask(found[0], (size[0], size[1])), found[0].name
    seen = ((frames.faults & np.uint8(Fault.MISSING)) == 0).any(axis=0)
    if not seen.any():
        raise InputError(f"{path.parent}: not one pixel of the pictures has a value")
    return seen, f"none given ({path.name} is not there): the whole frame"


def with_distance(capture: Capture) -> Capture:
    """`capture` with its missing camera distance filled in from the true depth (median over the mask), the record saying so."""
    depth, scale = capture.truth.depth, capture.scale
    if scale.camera is None or scale.distance_mm is not None or depth is None or not np.isfinite(depth).any():
        return capture
    distance = float(np.nanmedian(depth)) * 1000
    record: dict[str, Any] = {**capture.provenance, "distance": "median of the true depth"}
    return replace(capture, scale=replace(scale, distance_mm=distance), provenance=record)
