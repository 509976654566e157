"""Hostile tables, masks and truths beside photographs, through `degloss recon run`. More of them: tests/gen/test_bad_captures.py."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.images import write_png
from tests.hostile.commands import Case, require_refusal
from tests.hostile.files import (
    LIGHTS,
    lay_photographs,
    mat_of_nothing,
    npy_header,
    npz_of,
    pickled,
    png,
    rows,
    tiff,
)

UP = np.zeros((6, 8, 3))
UP[..., 2] = 1
DIGITS = "9" * 5000


def saved(array: Any, allow: bool = False) -> bytes:
    memory = io.BytesIO()
    np.save(memory, array, allow_pickle=allow)
    return memory.getvalue()


def matlab(**variables: Any) -> bytes:
    from scipy.io import savemat

    memory = io.BytesIO()
    savemat(memory, variables)
    return memory.getvalue()


def hdf() -> bytes:
    return b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b" " * 8 + b"\x00\x02IM" + b"\0" * 512 + b"\x89HDF\r\n\x1a\n"


CELLS = np.empty((6, 8, 3), object)
CELLS[...] = 1.0

TABLES: dict[str, tuple[str, str | bytes | Callable[[], bytes], str]] = {
    # what it is: (the file, its content, what the line says); the line names the file
    "lights: a count of 5,000 digits": ("lights.txt", f"{DIGITS}\n{rows(LIGHTS)}", "line"),
    "lights: all in one plane": ("lights.txt", "1 0 1\n0 0 1\n-1 0 1\n0.5 0 1\n-0.5 0 1\n", "one plane"),
    "lights: all the same": ("lights.txt", "0 0 1\n" * 5, "one plane"),
    "lights: none has a length": ("lights.txt", "0 0 0\n" * 5, "no length"),
    "lights: beyond all numbers": ("lights.txt", "1e400 0 1\n" * 5, "not finite"),
    "lights: as large as numbers go": ("lights.txt", "1e308 1e308 1e308\n0 1e308 1e308\n1 0 1\n0 1 1\n0 0 1\n", "is longer than"),
    "lights: twelve megabytes": ("lights.txt", "0 0 1\n" * 2_000_000, "too large"),
    "lights: one long line": ("lights.txt", "1 " * 100_000, "rows of"),
    "lights: hexadecimal": ("lights.txt", "0x1 0 1\n" * 5, "not a file name and three numbers"),
    "lights: a name as long as a page": ("lights.txt", f"{'a' * 300}.png 0 0 1\n" * 5, "lights.txt"),
    "lights: a name that leads up, spelt as in Windows": ("lights.txt", "..\\1.png 0 0 1\n" * 2, "leads out"),
    "rti: a count of 5,000 digits": ("dirs.lp", f"{DIGITS}\n1.png 0 0 1\n", "line 1"),
    "rti: a count that is not the number": ("dirs.lp", "3\n1.png 0 0 1\n2.png 0 1 1\n", "says 3, but 2 rows follow"),
    "intensities: beyond all numbers": ("intensities.txt", "1e999\n" * 5, "not finite"),
    "intensities: words": ("intensities.txt", "strong\n" * 5, "not a row of numbers"),
    "scale: not a number": ("scale.txt", "mm_per_pixel nan\n", "positive number"),
    "scale: below zero": ("scale.txt", "mm_per_pixel -1\n", "positive number"),
    "scale: twice": ("scale.txt", "mm_per_pixel 1\nmm_per_pixel 2\n", "each once"),
    "scale: a key that is not known": ("scale.txt", "inches 3\n", "must be 'mm_per_pixel NUMBER'"),
    "scale: a distance without a camera": ("scale.txt", "distance_mm 500\n", "K.txt"),
    "scale: not text": ("scale.txt", b"\xff\xfe\x00", "not UTF-8"),
    "camera: two rows": ("K.txt", "100 0 4\n0 100 3\n", "three rows"),
    "camera: no focal length": ("K.txt", "0 0 4\n0 100 3\n0 0 1\n", "positive fx and fy"),
    "camera: not finite": ("K.txt", "inf 0 4\n0 100 3\n0 0 1\n", "not finite"),
    "camera: the last row is another": ("K.txt", "100 0 4\n0 100 3\n1 0 1\n", "three rows"),
    "mask: black": ("mask.png", lambda: png_of_zeros(), "mask is empty"),
    "mask: a TIFF that is cut": ("mask.png", lambda: tiff()[:-60], "damaged or truncated"),
    "mask: two of them": ("MASK.tif", tiff, "more than one mask"),
    "mask: another size": ("mask.png", lambda: sized(7, 9), "the mask is 9x7 pixels"),
    "normals: Python objects": ("normal_gt.npy", lambda: saved(CELLS, True), "Python objects"),
    "normals: Python objects in an archive": (
        "normal_gt.npz",
        lambda: npz_of({"normal.npy": saved(CELLS, True)}),
        "Python objects",
    ),
    "normals: a pickle": ("normal_gt.npy", pickled, "damaged or truncated"),
    "normals: records": ("normal_gt.npy", lambda: saved(np.zeros((6, 8), [("x", "f8"), ("y", "f8")])), "Python objects or text"),
    "normals: text": ("normal_gt.npy", lambda: saved(np.full((6, 8, 3), "a")), "Python objects or text"),
    "normals: another shape": ("normal_gt.npy", lambda: saved(UP[:5]), "the pictures ask for"),
    "normals: another shape in an archive": (
        "normal_gt.npz",
        lambda: npz_of({"normal.npy": saved(UP[:5])}),
        "shape (5, 8, 3), the pictures ask for",
    ),
    "normals: cut": ("normal_gt.npy", lambda: saved(UP)[:-8], "ends early"),
    "normals: all zero": ("normal_gt.npy", lambda: saved(0 * UP), "unit normals"),
    "normals: seven long": ("normal_gt.npy", lambda: saved(7 * UP), "unit normals"),
    "normals: all NaN": ("normal_gt.npy", lambda: saved(np.nan * UP), "unit normals"),
    "normals: all infinite": ("normal_gt.npy", lambda: saved(np.full((6, 8, 3), np.inf)), "unit normals"),
    "normals: as large as numbers go": ("normal_gt.npy", lambda: saved(1e300 * UP), "unit normals"),
    "normals: a header of a hundred kilobytes": ("normal_gt.npy", lambda: npy_header(100_000), "damaged or truncated"),
    "normals: a header of 100 MB in an archive of 100 kB": (
        "normal_gt.npz",
        lambda: npz_of({"normal.npy": npy_header(100_000_000)}),
        "larger than",
    ),
    "normals: an archive without them": ("normal_gt.npz", lambda: npz_of({"other.npy": saved(UP)}), "has no array named"),
    "normals: an archive whose file leads up": (
        "normal_gt.npz",
        lambda: npz_of({"../normal.npy": saved(UP)}),
        "has no array named",
    ),
    "normals: an archive that is cut": ("normal_gt.npz", lambda: npz_of({"normal.npy": saved(UP)})[:-30], "damaged or truncated"),
    "normals: 100 MB in a MATLAB file of 100 kB": ("Normal_gt.mat", lambda: mat_of_nothing(100), "far more than true normals"),
    "normals: MATLAB cells": ("Normal_gt.mat", lambda: matlab(Normal_gt=CELLS), "must hold Normal_gt"),
    "normals: MATLAB text": ("Normal_gt.mat", lambda: matlab(Normal_gt="hello"), "must hold Normal_gt"),
    "normals: another MATLAB variable": ("Normal_gt.mat", lambda: matlab(N=UP), "must hold Normal_gt"),
    "normals: MATLAB 7.3": ("Normal_gt.mat", hdf, "MATLAB 7.3"),
    "normals: no MATLAB file": ("Normal_gt.mat", b"\x00" * 600, "Normal_gt.mat"),
    "normals: text by the name of a MATLAB file": ("Normal_gt.mat", "hello" * 100, "damaged or truncated"),
    "normals: a row too few": ("normal.txt", "0 0 1\n" * 47, "47 normals for 48 pixels"),
    "normals: a picture of floats": ("normals.png", lambda: tiff_of_floats(), "8 or 16-bit picture"),
    "depth: below zero": ("depth_gt.npz", lambda: npz_of({"depth.npy": saved(np.full((6, 8), -1.0))}), "no positive depth"),
    "depth: as large as numbers go": (
        "depth_gt.npz",
        lambda: npz_of({"depth.npy": saved(np.full((6, 8), 1e300))}),
        "no positive depth",
    ),
    "depth: not a number": ("depth_gt.npy", lambda: saved(np.full((6, 8), np.nan)), "no positive depth"),
}


def png_of_zeros() -> bytes:
    return sized(6, 8, 0)


def sized(height: int, width: int, value: int = 255) -> bytes:
    import cv2

    return cv2.imencode(".png", np.full((height, width), value, np.uint8))[1].tobytes()


def tiff_of_floats() -> bytes:
    import tifffile

    memory = io.BytesIO()
    tifffile.imwrite(memory, UP.astype(np.float32), photometric="rgb")
    return memory.getvalue()


@pytest.mark.parametrize("what", TABLES)
def test_a_hostile_table_is_refused(what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    name, content, says = TABLES[what]

    def lay(folder: Path) -> None:
        (folder / "photos").mkdir()
        lay_photographs(folder / "photos")
        data = content() if callable(content) else content
        (folder / "photos" / name).write_bytes(data.encode() if isinstance(data, str) else data)

    names = "photos" if says in ("one plane", "more than one mask") else name
    require_refusal(Case(lay, "recon run HERE/photos -o HERE/out", names, says), tmp_path, capfd)


def lay_psm(folder: Path, table: str) -> None:
    (folder / "thing").mkdir()
    for k in range(3):
        (folder / "thing" / f"{k}.png").write_bytes(png())
    write_png(folder / "thing" / "thing.mask.png", np.full((6, 8), 255, np.uint8))
    (folder / "lights.txt").write_text("3\n0 0 1\n0 1 1\n1 0 1\n")
    (folder / "thing.txt").write_text(table)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        (f"{DIGITS}\nthing/0.png\n", "is a file, but a capture is a folder or its list"),
        ("3\nthing/0.png\nthing/1.png\n", "says 3 pictures"),
        ("2\nthing/0.png\n../../etc/a.png\n", "leads out"),
        ("2\nthing/0.png\nthing/0.png\n", "twice"),
    ],
    ids=["a count of 5,000 digits", "a picture too few", "a name leads up", "a picture twice"],
)
def test_a_hostile_list_is_refused(table: str, says: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    require_refusal(
        Case(lambda folder: lay_psm(folder, table), "recon run HERE/thing.txt -o HERE/out", "thing.txt", says), tmp_path, capfd
    )
