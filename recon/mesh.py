"""From a height map to a mesh, right way round and at the right scale."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from gen.files import writing

if TYPE_CHECKING:
    import trimesh

Floats = NDArray[np.float32]

MOST_POINTS = 4_000_000
"""Pixels up to which each is a vertex of a measurement's mesh. Of more every second, third and so on is: eight million triangles are as
much as viewers show, and the maps hold every pixel."""


def surface_mesh(points: Floats, normal: Floats | None = None, albedo: Floats | None = None) -> trimesh.Trimesh:
    """Triangles between the pixels that have a point, turned counter-clockwise as seen from the camera.

    points: (H, W, 3), NaN where there is none; camera frame (x right, y up, z to the viewer), so the mesh is too, in the points'
    unit.
    normal: (H, W, 3) used as vertex normals. albedo: (H, W, 3) linear, used as sRGB vertex colours, scaled so that its 99th
    percentile is white.
    Every pixel square with four points gives two triangles, with three points one. Raises InputError where there is no triangle.
    """
    import trimesh

    known = np.isfinite(points).all(axis=2)
    index = np.full(known.shape, -1)
    index[known] = np.arange(int(known.sum()))
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate(
        [
            _triangles(a, c, b, np.ones_like(known[1:, 1:])),
            _triangles(b, c, d, np.ones_like(known[1:, 1:])),
            _triangles(a, c, d, b < 0),
            _triangles(a, d, b, c < 0),
        ]
    )
    if not len(faces):
        raise InputError("the surface has no triangle: fewer than three neighbouring pixels were measured")
    options: dict[str, Any] = {}
    if normal is not None:
        options["vertex_normals"] = normal[known].astype(np.float64)
    if albedo is not None:
        white = float(np.percentile(albedo[known].max(axis=1), 99)) or 1.0
        rgb = _srgb(np.clip(albedo[known] / white, 0, 1))
        options["vertex_colors"] = np.concatenate([rgb, np.full((len(rgb), 1), 255, np.uint8)], axis=1)
    return trimesh.Trimesh(points[known].astype(np.float64), faces, process=False, **options)


def write_mesh(mesh: trimesh.Trimesh, path: Path, unit: str) -> None:
    """Write a mesh as .ply (binary) or .glb by the path's ending, by a temporary name.

    unit: of its lengths, "m" or "px", which the file says: a comment in a PLY, an extra in a GLB (whose own unit is the metre).
    Raises InputError where it cannot be written.
    """
    named = mesh.copy()
    named.metadata["unit"] = unit
    data: bytes = named.export(file_type=path.suffix.lstrip("."))
    if path.suffix == ".ply":
        first, rest = data.split(b"\n", 1)
        data = first + b"\n" + rest.replace(b"\n", f"\ncomment unit {unit}\n".encode(), 1)
    with writing(path) as temporary:
        temporary.write_bytes(data)


def _triangles(a: NDArray[Any], b: NDArray[Any], c: NDArray[Any], where: NDArray[Any]) -> NDArray[Any]:
    chosen = (a >= 0) & (b >= 0) & (c >= 0) & where.astype(bool)
    return np.stack([a[chosen], b[chosen], c[chosen]], axis=1)


def _srgb(linear: Floats) -> NDArray[np.uint8]:
    from gen.srgb import linear_to_srgb

    return np.rint(linear_to_srgb(linear) * 255).astype(np.uint8)
