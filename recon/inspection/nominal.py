"""The nominal surface: a mesh file in millimetres, or one line that says why it cannot be read."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from gen.mesh_normals import smoothed
from gen.meshes import merged, read_scene

Doubles = NDArray[np.float64]
Faces = NDArray[np.int64]

UNITS = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3, "inch": 25.4}
"""Millimetres in each unit of length that a mesh file may be in."""

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


def read_nominal(path: str | Path, unit: str | None = None) -> Surface:
    """The nominal mesh in millimetres, in the axes of the file.

    path: a GLB, STL, OBJ or PLY file. unit: of its numbers, a key of `UNITS`; None: what the file says, else metres for GLB (as its
    standard has it) and millimetres for the others. Raises InputError, one line, for whatever is wrong with the file.
    """
    surface = read_surface(path, unit)
    if surface.unit.startswith("px"):
        raise InputError(f"{path}: says that it is in pixels, which have no length; give its unit with --unit")
    return surface


def read_surface(path: str | Path, unit: str | None = None) -> Surface:
    """As `read_nominal`, but a file in pixels ("px", as `recon.mesh.write_mesh` says where no scale is known) stays in pixels."""
    if unit is not None and unit not in (*UNITS, "px"):
        raise InputError(f"{unit}: unknown unit of a mesh; there are {', '.join(UNITS)}")
    path = Path(path)
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
    scene, data = read_scene(path)
    vertices, faces, _ = merged(path, scene)
    if not np.ptp(vertices, axis=0).max() > 0:
        raise InputError(f"{path}: all its points lie in one place")
    return np.asarray(vertices, np.float64), np.asarray(faces, np.int64), _unit_said(data, scene)


def _unit_said(data: bytes, scene: Any) -> str | None:
    """The unit that `recon.mesh.write_mesh` puts into a file: a comment in a PLY, an extra in a GLB."""
    if data.startswith(b"ply"):
        found = re.search(rb"^comment unit (\w+)\r?$", data[: data.find(b"end_header")], re.MULTILINE)
        said: Any = found[1].decode() if found else None
    else:
        said = next((part.metadata.get("unit") for part in scene.geometry.values()), None)
    return said if said in (*UNITS, "px") else None
