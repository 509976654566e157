"""Meshes of users: GLB, OBJ, STL and PLY files as plain arrays in our frame, with normals that can be shaded.

Nothing but the file itself is read: textures, material files and external buffers are left alone. Files are hostile: whatever is wrong
with one ends in one line.
"""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gen.errors import InputError
from gen.files import library_silenced, must_exist, sha256_of, writing
from gen.mesh_formats import FORMATS, MAX_FACES, check_size
from gen.mesh_normals import agreeing, smoothed

if TYPE_CHECKING:
    from blender_scenes.shapes import Mesh

MAX_BYTES = 500_000_000
LONGEST_MM = 1e5
"""The longest side of a mesh after scaling, as of any other shape."""


@dataclass(frozen=True)
class MeshFile:
    """A user's mesh in a spec. file: absolute path. sha256: of its bytes. size_mm: its longest side, None for the file's own scale
    (metres in GLB, else millimetres). up: the file's axis that points up, y or z. smooth_degrees: sharper edges are shaded sharp, where
    the file's own normals are not used."""

    file: str
    sha256: str
    size_mm: float | None = None
    up: str = "y"
    smooth_degrees: float = 30.0


KEYS = ("file", "size_mm", "up", "smooth_degrees", "sha256")


def mesh_file(values: Mapping[str, Any], folder: Path | None = None) -> MeshFile:
    """The checked mesh of a spec's keys (`KEYS`); its hash is filled in, or compared where it is given.

    folder: what a relative path starts from, by default the working folder. Raises InputError.
    """
    for key in values:
        if key not in KEYS:
            raise InputError(f"{key}: unknown key of a mesh; there are {', '.join(KEYS)}")
    file = values.get("file")
    if not isinstance(file, str) or not file or "\0" in file:
        raise InputError(f"file: must be the path of a mesh ({', '.join(FORMATS)})")
    path = (folder or Path.cwd()).resolve() / file
    size, smooth = values.get("size_mm"), values.get("smooth_degrees", 30.0)
    if size is not None and not _number(size, 1e-3, LONGEST_MM):
        raise InputError(f"size_mm: must be a number from 0.001 to {LONGEST_MM:g}, got {size!r}")
    if not _number(smooth, 0, 180):
        raise InputError(f"smooth_degrees: must be a number from 0 to 180, got {smooth!r}")
    if values.get("up", "y") not in ("y", "z"):
        raise InputError(f"up: must be y or z, got {values['up']!r}")
    _check_name(path)
    found, said = _digest(path), values.get("sha256", None)
    if said is not None and said != found:
        raise InputError(f"{path}: has changed: its SHA-256 is {found}, the spec says {said}; remove sha256 to take it as it is")
    return MeshFile(str(path), found, None if size is None else float(size), values.get("up", "y"), float(smooth))


def load_mesh(mesh: MeshFile) -> Mesh:
    """The mesh of a file: one surface, in our frame, centred on its bounding box, in millimetres, with unit normals.

    Raises InputError where the file is missing, changed, not a mesh, not finite or too large.
    """
    if _digest(Path(mesh.file)) != mesh.sha256:
        raise InputError(f"{mesh.file}: has changed since the spec was read; read the spec again")
    return _load(mesh)


def write_mesh(mesh: MeshFile, folder: Path) -> Path:
    """The mesh as an .npz of vertices, faces and normals in `folder`, where it is written once. Returns its path."""
    loaded = load_mesh(mesh)
    name = hashlib.sha256(repr((mesh.sha256, mesh.size_mm, mesh.up, mesh.smooth_degrees)).encode()).hexdigest()
    path = folder / f"mesh-{name[:24]}.npz"
    if not path.exists():
        with writing(path) as temporary:
            np.savez(temporary, vertices=loaded.vertices, faces=loaded.faces, normals=np.asarray(loaded.normals))
    return path


@lru_cache(maxsize=2)
def _load(mesh: MeshFile) -> Mesh:
    from blender_scenes.shapes import Mesh as Surface

    path = Path(mesh.file)
    vertices, faces, normals = merged(path, read_scene(path)[0])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    longest = float((high - low).max())
    if not longest > 0:
        raise InputError(f"{path}: all its points lie in one place")
    metres = 1000.0 if path.suffix.lower() == ".glb" else 1.0
    scale = mesh.size_mm / longest if mesh.size_mm is not None else metres
    if not 1e-3 <= longest * scale <= LONGEST_MM:
        raise InputError(f"{path}: is {longest * scale:g} mm long; give its longest side as size_mm")
    vertices = (vertices - (low + high) / 2) * scale
    if mesh.up == "z":  # turned about x
        flip = np.array([1.0, 1.0, -1.0])
        vertices, normals = vertices[:, [0, 2, 1]] * flip, None if normals is None else normals[:, [0, 2, 1]] * flip
    if normals is None or not agreeing(vertices, faces, normals):
        vertices, faces, normals = smoothed(vertices, faces, mesh.smooth_degrees)
    if not len(faces):
        raise InputError(f"{path}: has no face with an area")
    return Surface(vertices, faces, normals)


def read_scene(path: Path) -> tuple[Any, bytes]:
    """The trimesh scene of a mesh file, and the file's bytes. Nothing but the file itself is read. Raises InputError, one line."""
    import trimesh

    _check_name(path)
    kind = path.suffix.lower()[1:]
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    check_size(path, data)
    try:
        with library_silenced():  # it logs whole tracebacks of what it then copes with
            # No resolver: no other file is opened. Pictures inside the file are not decoded.
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, resolver=None, process=False, skip_materials=True)
    except MemoryError:
        raise InputError(f"{path}: does not fit into memory") from None
    except Exception as error:  # a reader of foreign files fails in any way it likes
        raise InputError(f"{path}: cannot be read as {kind.upper()} ({type(error).__name__}: {str(error)[:120]})") from None
    return scene, data


def merged(path: Path, scene: Any) -> tuple[Any, Any, Any]:
    """Vertices (V, 3), faces (F, 3) and the file's own normals (V, 3; None where any part lacks them) of the whole scene.

    Each part stands where the scene puts it, in the file's unit and axes. path: for messages. Raises InputError, one line, where there are
    no faces or too many, or a coordinate is not finite.
    """
    import trimesh

    try:
        parts = [(scene.graph[node][0], scene.geometry[scene.graph[node][1]]) for node in scene.graph.nodes_geometry]
    except Exception as error:  # a scene's graph may be broken in any way
        raise InputError(f"{path}: its parts have no place ({type(error).__name__}: {str(error)[:120]})") from None
    parts = [(place, part) for place, part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    if not parts:
        raise InputError(f"{path}: holds no faces (points and curves are no mesh)")
    if sum(len(part.faces) for _, part in parts) > MAX_FACES:
        raise InputError(f"{path}: has more than {MAX_FACES // 10**6} million faces; simplify it")
    all_vertices, all_faces = [], []
    all_normals: list[Any] = []
    first = 0
    for place, part in parts:
        place, vertices, faces = np.asarray(place, float), np.asarray(part.vertices, float), np.asarray(part.faces)
        turn = place[:3, :3]
        # Lazily computed normals are not the file's: only those that the reader put there.
        own = part._cache.cache.get("vertex_normals")
        if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
            raise InputError(
                f"{path}: its points have {vertices.shape[-1]} coordinates and its faces {faces.shape[-1]} corners, not three"
            )
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError(f"{path}: a face names a point that is not there")
        if not np.isfinite(place).all() or not np.isfinite(vertices[faces.ravel()]).all():
            raise InputError(f"{path}: holds a coordinate that is not finite")
        determinant = float(np.linalg.det(turn))
        if abs(determinant) < 1e-30:
            raise InputError(f"{path}: a part is scaled to nothing")
        vertices = np.where(np.isfinite(vertices), vertices, 0.0) @ turn.T + place[:3, 3]
        all_vertices.append(vertices)
        all_faces.append((faces if determinant > 0 else faces[:, ::-1]) + first)
        sane = own is not None and np.shape(own) == vertices.shape and np.isfinite(own).all()
        all_normals.append(np.asarray(own, float) @ np.linalg.inv(turn) if sane else None)
        first += len(vertices)
    normals: Any = None if any(rows is None for rows in all_normals) else np.concatenate(all_normals)
    vertices, faces = np.concatenate(all_vertices), np.concatenate(all_faces)
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > 1e12:
        raise InputError(f"{path}: its coordinates are too large")
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3), None if normals is None else normals[used]


def _check_name(path: Path) -> None:
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: is not one of {', '.join(FORMATS)}")
    try:
        must_exist(path, "a mesh")
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: is larger than {MAX_BYTES // 10**6} MB; simplify it")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def _digest(path: Path) -> str:
    try:
        state = path.stat()
        return _digest_of(str(path), state.st_mtime_ns, state.st_size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}; a mesh)") from None


@lru_cache(maxsize=64)
def _digest_of(path: str, _changed: int, _size: int) -> str:
    return sha256_of(Path(path))


def _number(value: Any, low: float, high: float) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and math.isfinite(value) and low <= value <= high
