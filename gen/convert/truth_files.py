"""True normals and depth in the files that lie beside photographs, as `gen.formats.truth` reads them."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from gen.capture import Capture, Floats
from gen.convert.sixteen_bit import TOP
from gen.files import writing
from gen.images import write_png


def write_normal_map(normals: Floats, path: Path) -> None:
    """Unit normals (H, W, 3) as a 16-bit PNG of (n + 1) / 2; where there is none it is middle grey."""
    write_png(path, np.rint((np.clip(normals, -1, 1) + 1) / 2 * TOP).astype(np.uint16))


def write_depth(capture: Capture, folder: Path) -> tuple[str, ...]:
    """Write depth_gt.npz (key depth, millimetres along -z, NaN where unknown) where the capture knows its depth; ("depth",) if so."""
    depth = capture.truth.depth
    if depth is None or not (depth[capture.mask] > 0).any():
        return ()
    memory = io.BytesIO()
    np.savez_compressed(memory, depth=depth.astype(np.float64) * 1000)
    with writing(folder / "depth_gt.npz") as temporary:
        temporary.write_bytes(memory.getbuffer())
    return ("depth",)
