"""DiLiGenT's layout, which published photometric-stereo code reads.

    001.png, 002.png, ...   16-bit RGB; picture over intensity is reflectance times cosine
    filenames.txt           their names
    light_directions.txt    x y z a row: x right, y up, z to the camera
    light_intensities.txt   r g b a row
    mask.png                white on the object
    Normal_gt.mat           true normals under the key Normal_gt, (H, W, 3) double, with Normal_gt.png and normal.txt (a pixel a row)

Beside these lie the files that `gen.formats.diligent` knows: K.txt, scale.txt, depth_gt.npz. Words are parted by one blank and every
line ends, as in the original: some programs split at these.

Source: Shi, Mo, Wu, Duan, Yeung, Tan, "A Benchmark Dataset and Evaluation for Non-Lambertian and Uncalibrated Photometric Stereo",
TPAMI 2019, and its data.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from gen.capture import Capture, Floats
from gen.convert.about import distance_left_out, lights_left_out, truth_left_out, write_about
from gen.convert.sixteen_bit import to_sixteen_bits
from gen.convert.truth_files import write_depth, write_normal_map
from gen.files import writing
from gen.images import write_png

MAT_HEADER = 116
"""Bytes of free text that a MATLAB 5 file begins with."""


def write_diligent(capture: Capture, folder: Path, white: float | None = None) -> tuple[str, ...]:
    """Write a capture in DiLiGenT's layout into an empty folder; returns what that does not hold.

    white: the radiance that is stored as 65535 (`gen.convert.sixteen_bit`); the intensities are divided by it, so that picture over
    intensity stays what it is. Raises InputError where the folder cannot be written.
    """
    stored = to_sixteen_bits(capture, white)
    names = [f"{k + 1:03d}.png" for k in range(capture.count)]
    for name, picture in zip(names, stored.words, strict=True):
        write_png(folder / name, picture)
    write_png(folder / "mask.png", np.where(capture.mask, 255, 0).astype(np.uint8))
    _lines(folder / "filenames.txt", names)
    _rows(folder / "light_directions.txt", capture.lights)
    _rows(folder / "light_intensities.txt", capture.intensities / stored.white)
    held = write_depth(capture, folder)
    if capture.truth.normals is not None:
        _write_normals(capture.truth.normals, folder)
        held += ("normals",)
    lost = [*stored.lost, *truth_left_out(capture, held), *lights_left_out(capture), *_write_scale(capture, folder)]
    write_about(capture, folder, "diligent", names, stored.white)
    return tuple(lost)


def _write_normals(normals: Floats, folder: Path) -> None:
    from scipy.io import savemat

    memory = io.BytesIO()
    savemat(memory, {"Normal_gt": normals.astype(np.float64)}, do_compression=True)  # type: ignore[arg-type] # any stream will do
    data = bytearray(memory.getbuffer())
    # scipy puts the time there; the same capture shall give the same bytes.
    data[:MAT_HEADER] = b"MATLAB 5.0 MAT-file".ljust(MAT_HEADER)
    with writing(folder / "Normal_gt.mat") as temporary:
        temporary.write_bytes(data)
    write_normal_map(normals, folder / "Normal_gt.png")
    _rows(folder / "normal.txt", np.round(normals.reshape(-1, 3).astype(np.float64), 7))


def _write_scale(capture: Capture, folder: Path) -> Iterable[str]:
    """K.txt and scale.txt, as far as the scale is known; what of it these cannot say."""
    scale = capture.scale
    if scale.camera is not None:
        if not np.array_equal(scale.camera[1:, 0], (0, 0)) or not np.array_equal(scale.camera[2], (0, 0, 1)):
            return ["the camera's K, which is not of OpenCV's form", *distance_left_out(scale)]
        _rows(folder / "K.txt", scale.camera)
        if scale.distance_mm is not None:
            _lines(folder / "scale.txt", [f"distance_mm {scale.distance_mm!r}"])
        return []
    if scale.mm_per_pixel is not None:
        _lines(folder / "scale.txt", [f"mm_per_pixel {scale.mm_per_pixel!r}"])
    return distance_left_out(scale)


def _rows(path: Path, table: ArrayLike) -> None:
    """Rows of numbers, each with the digits that give it back exactly."""
    _lines(path, [" ".join(map(str, row)) for row in np.asarray(table).tolist()])


def _lines(path: Path, lines: list[str]) -> None:
    with writing(path) as temporary:
        temporary.write_text("".join(line + "\n" for line in lines), encoding="utf-8", newline="\n")
