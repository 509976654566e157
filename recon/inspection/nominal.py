"""The nominal surface: a mesh file in millimetres, or one line that says why it cannot be read."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from gen.files import must_exist
from gen.mesh_formats import FORMATS, MAX_FACES, check_size
from gen.mesh_normals import smoothed

Doubles = NDArray[np.float64]
Faces = NDArray[np.int64]

UNITS = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3, "inch": 25.4}
"""Millimetres in each unit of length that a mesh file may be in."""

MAX_BYTES = 500_000_000

CREASE_DEGREES = 30.0
"""Edges no sharper than this are facets of a curved surface, whose normal is interpolated across them."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh. vertices: (V, 3), in millimetres or pixels. faces: (F, 3). normals: (V, 3) unit, smooth over shallow edges
    (a point of a sharp edge is several vertices). source: the file. unit: what the file's numbers were taken as, and why, in words.
    """

    vertices: Doubles
    faces: Faces
    normals: Doubles
    source: str
    unit: str

    @property
    def size(self) -> float:
        """Its longest side along the axes of the file."""
        return float(np.ptp(self.vertices, axis=0).max())

    @property
    def middle(self) -> Doubles:
        """The middle of its bounding box."""
        return (self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2


def read_nominal(path: Path, unit: str | None = None) -> Surface:
    """The nominal mesh in millimetres, in the axes of the file.

    path: a GLB, STL, OBJ or PLY file. unit: of its numbers, a key of `UNITS`; None: what the file says, else metres for GLB (as its
    standard has it) and millimetres for the others. Raises InputError, one line, for whatever is wrong with the file.
    """
    surface = read_surface(path, unit)
    if surface.unit.startswith("px"):
        raise InputError(f"{path}: says that it is in pixels, which have no length; give its unit with --unit")
    return surface


def read_surface(path: Path, unit: str | None = None) -> Surface:
    """As `read_nominal`, but a file in pixels ("px", as `recon.mesh.write_mesh` says where no scale is known) stays in pixels."""
    if unit is not None and unit not in (*UNITS, "px"):
        raise InputError(f"{unit}: unknown unit of a mesh; there are {', '.join(UNITS)}")
    vertices, faces, said = _read(path)
    default = "m" if path.suffix.lower() == ".glb" else "mm"
    chosen, why = (unit, "as given") if unit else (said, "as the file says") if said else (default, "the default of the format")
    vertices = vertices * UNITS.get(chosen, 1.0)
    vertices, faces, normals = smoothed(vertices, faces, CREASE_DEGREES)
    if not len(faces):
        raise InputError(f"{path}: has no face with an area")
    return Surface(vertices, faces, normals, str(path), f"{chosen}, {why}")


def _read(path: Path) -> tuple[Doubles, Faces, str | None]:
    """Vertices and faces of the whole scene, each part where it stands, and the unit that the file names, if any."""
    import trimesh

    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise InputError(f"{path}: is no mesh that can be read; there are {', '.join(FORMATS)}")
    try:
        must_exist(path, "a mesh")
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: is larger than {MAX_BYTES // 10**6} MB; simplify it")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    check_size(path, data)
    try:
        # No resolver: no other file is opened. Pictures inside the file are not decoded.
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind[1:], resolver=None, process=False, skip_materials=True)
        mesh = scene.to_mesh()
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
        said = _unit_said(data, scene)
    except MemoryError:
        raise InputError(f"{path}: does not fit into memory") from None
    except Exception as error:  # a reader of foreign files fails in any way it likes
        raise InputError(f"{path}: cannot be read as {kind[1:].upper()} ({type(error).__name__}: {str(error)[:120]})") from None
    if not len(faces):
        raise InputError(f"{path}: holds no faces (points and curves are no mesh)")
    if len(faces) > MAX_FACES:
        raise InputError(f"{path}: has more than {MAX_FACES // 10**6} million faces; simplify it")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{path}: a face names a point that is not there")
    used, flat = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], flat.reshape(-1, 3)
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > 1e12:
        raise InputError(f"{path}: holds a coordinate that is not finite, or too large")
    if not np.ptp(vertices, axis=0).max() > 0:
        raise InputError(f"{path}: all its points lie in one place")
    return vertices, faces, said


def _unit_said(data: bytes, scene: Any) -> str | None:
    """The unit that `recon.mesh.write_mesh` puts into a file: a comment in a PLY, an extra in a GLB."""
    if data.startswith(b"ply"):
        found = re.search(rb"^comment unit (\w+)\r?$", data[: data.find(b"end_header")], re.MULTILINE)
        said: Any = found[1].decode() if found else None
    else:
        said = next((part.metadata.get("unit") for part in scene.geometry.values()), None)
    return said if said in (*UNITS, "px") else None
