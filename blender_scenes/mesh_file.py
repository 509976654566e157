"""A mesh handed over as plain arrays in an .npz file."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from blender_scenes.errors import JobError
from blender_scenes.shapes import Mesh

NAMES = ("vertices", "faces", "normals")
MAX_BYTES = 1 << 30
"""The most that the arrays of a file may take up."""


def read_mesh(file: str) -> Mesh:
    """The mesh of an .npz file: vertices (V, 3) mm, faces (F, 3) or (F, 4), normals (V, 3). JobError for anything else."""
    try:
        with zipfile.ZipFile(Path(file)) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_BYTES:
                raise JobError(f"job: shape.file {file} holds more than {MAX_BYTES >> 20} MB")
        with np.load(file, allow_pickle=False) as arrays:
            if set(arrays.files) != set(NAMES):
                raise JobError(
                    f"job: shape.file {file} must hold {', '.join(NAMES)}, it holds {', '.join(sorted(arrays.files)[:5])}"
                )
            return Mesh(*(arrays[name] for name in NAMES))
    except (OSError, ValueError, TypeError, EOFError, MemoryError, zipfile.BadZipFile) as error:
        if isinstance(error, JobError):
            raise
        raise JobError(f"job: shape.file {file} is not a mesh ({(str(error).splitlines() or ['?'])[0][:200]})") from None
