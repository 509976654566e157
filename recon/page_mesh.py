"""A mesh made small enough for a page: clustered to a bound, quantised, deflated. `templates/viewer.js` reads it."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError

if TYPE_CHECKING:
    import trimesh

Floats = NDArray[np.float64]
Triangles = NDArray[np.int64]


@dataclass(frozen=True)
class Packed:
    """header: what the viewer must know. data: deflated arrays. total: triangles of the mesh before clustering."""

    header: dict[str, Any]
    data: bytes
    total: int


def pack(mesh: trimesh.Trimesh, colours: NDArray[np.uint8] | None, limit: int) -> Packed:
    """The mesh for the viewer: positions on 16 bits an axis of its box, normals on 12, colours on 8, each as steps from the last.

    colours: (V, 3) uint8 sRGB, or None for the mesh's own vertex colours where it has them. limit: the most triangles kept.
    Data, little-endian, deflated: indices (3T) uint32; x, y, z, nx, ny, nz (V each) uint16; r, g, b (V each) uint8 if coloured.
    Raises InputError for a mesh without triangles, or colours that do not match its vertices.
    """
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    triangles = np.asarray(mesh.faces, dtype=np.int64)
    if not len(triangles) or not np.isfinite(vertices[triangles]).all():
        raise InputError("a mesh to show needs triangles and finite vertices")
    normals = np.asarray(mesh.vertex_normals, dtype=np.float64)
    if colours is None and getattr(mesh.visual, "kind", None) == "vertex":
        colours = np.asarray(mesh.visual.vertex_colors, dtype=np.uint8)[:, :3]
    if colours is not None and colours.shape != (len(vertices), 3):
        raise InputError(
            f"the mesh has {len(vertices)} vertices and colours of shape {colours.shape}; one colour a vertex is needed"
        )
    total = len(triangles)
    extra = np.zeros((len(vertices), 0)) if colours is None else colours.astype(np.float64)
    vertices, triangles, attributes = cluster(vertices, triangles, np.hstack([normals, extra]), limit)
    normals = attributes[:, :3] / np.maximum(np.linalg.norm(attributes[:, :3], axis=1, keepdims=True), 1e-12)

    lo, span = vertices.min(axis=0), np.ptp(vertices, axis=0)
    steps = np.round((vertices - lo) / np.where(span > 0, span, 1) * 65535)
    planes = [_delta(triangles.ravel(), "<u4")]
    planes += [_delta(column, "<u2") for column in (*steps.T, *np.round(normals * 2047).T)]
    if colours is not None:
        planes += [_delta(column, "<u1") for column in np.round(attributes[:, 3:]).T]
    header = {
        "vertices": len(vertices),
        "triangles": len(triangles),
        "lo": lo.tolist(),
        "span": span.tolist(),
        "colours": colours is not None,
    }
    return Packed(header, zlib.compress(b"".join(planes), 6), total)


def cluster(vertices: Floats, triangles: Triangles, attributes: Floats, limit: int) -> tuple[Floats, Triangles, Floats]:
    """At most `limit` triangles, by merging the vertices that share a cell of a grid, as coarse as it must be.

    vertices: (V, 3). triangles: (T, 3). attributes: (V, A), averaged like the positions. Vertices that no triangle uses go.
    Source: Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes", 1993.
    """
    used, flat = np.unique(triangles, return_inverse=True)
    vertices, attributes, triangles = vertices[used], attributes[used], flat.reshape(-1, 3)
    if len(triangles) <= limit:
        return vertices, triangles, attributes
    edges = np.linalg.norm(vertices[triangles[:, 0]] - vertices[triangles[:, 1]], axis=1)
    extent = float(np.ptp(vertices, axis=0).max()) or 1.0
    # Vertices of a pixel grid stand one edge apart: cells of that size times the root of the excess leave about the right number.
    cell = max(float(np.median(edges)), extent * 1e-6) * np.sqrt(len(triangles) / limit)
    while True:
        keys = np.floor((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
        _, label = np.unique(keys, axis=0, return_inverse=True)
        label = label.ravel()
        merged = label[triangles]
        a, b, c = merged.T
        merged = merged[(a != b) & (b != c) & (c != a)]
        _, first = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
        merged = merged[np.sort(first)]
        if len(merged) <= limit:
            break
        cell *= 1.1
    number = np.bincount(label).astype(np.float64)

    def mean(values: Floats) -> Floats:
        columns = [np.bincount(label, column) / number for column in values.T]
        return np.stack(columns, axis=1) if columns else np.zeros((len(number), 0))

    return cluster(mean(vertices), merged, mean(attributes), limit)


def _delta(values: NDArray[Any], kind: str) -> bytes:
    """Steps from one value to the next, modulo the type's range: smooth data become small numbers, which deflate well."""
    whole = values.astype(np.int64)
    return np.diff(whole, prepend=0).astype(kind).tobytes()
