"""Plain EXRs, one RGB file a picture and layer, float32: every program that knows EXR reads these, layered ones few do.

001.exr, 002.exr, ...   the pictures; NaN where a sample is missing
capture.yaml            lights, intensities, scale, by which our reader of photographs reads the pictures back
mask.png                white on the object
diffuse/001.exr, ...    the layers that there are; so specular/, matte/, ks0/, mirror/; and shadow/, Y: 1 attached, 2 cast
normals.exr             R, G, B are x, y, z; normals.png, (n + 1) / 2, is what our reader takes
depth.exr               Y, metres along -z, 0 where unknown; depth_gt.npz, millimetres, is what our reader takes
albedo.exr, specular_albedo.exr, gloss.exr (Y)
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Fault, Truth
from gen.convert.about import write_about
from gen.convert.capture_yaml import write_capture_yaml
from gen.convert.truth_files import write_depth, write_normal_map
from gen.errors import InputError
from gen.exr import unstack, write_exr
from gen.images import write_png


def write_exr_files(capture: Capture, folder: Path, white: float | None = None) -> tuple[str, ...]:
    """Write a capture as plain EXRs into an empty folder; returns what that does not hold.

    white: must be None; floats have no top. Raises InputError where it is given, the folder cannot be written, or capture.yaml cannot
    say what there is.
    """
    if white is not None:
        raise InputError(f"--white {white}: is for 16-bit formats; EXR holds any radiance as it is")
    truth = capture.truth
    names = [f"{k + 1:03d}.exr" for k in range(capture.count)]
    missing = (capture.faults & Fault.MISSING) > 0
    for name, picture, hole in zip(names, capture.images, missing, strict=True):
        _write(folder / name, np.where(hole[..., None], np.float32(np.nan), picture))
    for layer in Truth.PER_LIGHT:
        stack = getattr(truth, layer)
        if stack is not None:
            (folder / layer).mkdir()
            for name, picture in zip(names, stack, strict=True):
                _write(folder / layer / name, picture)
    write_png(folder / "mask.png", np.where(capture.mask, 255, 0).astype(np.uint8))
    for layer in Truth.PER_VIEW:
        picture = getattr(truth, layer)
        if picture is not None:
            _write(folder / f"{layer}.exr", np.nan_to_num(picture, nan=0.0) if layer == "depth" else picture)
    if truth.normals is not None:
        write_normal_map(truth.normals, folder / "normals.png")
    write_depth(capture, folder)
    comments = ["Linear pictures. Folders beside them hold their layers."]
    lost = write_capture_yaml(capture, folder, names, comments)
    write_about(capture, folder, "exr", names)
    return (*_marks_left_out(capture), *lost)


def _marks_left_out(capture: Capture) -> Iterable[str]:
    """Of the faults, a reader sees that a sample is missing, and that it is 0."""
    clipped, dark, missing = ((capture.faults & flag) > 0 for flag in (Fault.CLIPPED, Fault.DARK, Fault.MISSING))
    if (clipped & ~missing).any():
        yield "which samples are clipped"
    if (dark & ~missing & capture.images.any(axis=-1)).any():
        yield "which samples are lost in the noise"


def _write(path: Path, picture: NDArray[Any]) -> None:
    """(H, W, 3) as R, G, B, or (H, W) as Y."""
    write_exr(path, unstack("", "RGB", picture) if picture.ndim == 3 else {"Y": picture})
