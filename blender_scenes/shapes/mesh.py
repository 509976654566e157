"""The arrays of a mesh, and what a shape's parameter is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Range:
    """The inclusive limits of a parameter."""

    low: float
    high: float


@dataclass(frozen=True)
class Parameter:
    """A shape's parameter: kind (float or int), default, and inclusive limits."""

    kind: type[float] | type[int]
    default: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface as plain arrays, millimetres, faces counter-clockwise seen from outside.

    vertices: (V, 3) float64. faces: (F, 3) or (F, 4) int. normals: (V, 3) float64 unit normals, interpolated over each face as they
    stand ("free" normals, which need not follow the faces), or None for flat faces. A sharp edge repeats its vertices, one copy a
    side. Raises ValueError where shapes disagree, an index is out of range, a value is not finite or a normal has no length.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    normals: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        vertices = _rows(self.vertices, "vertices")
        faces = np.asarray(self.faces)
        if faces.ndim != 2 or faces.shape[1] not in (3, 4) or not len(faces) or not np.issubdtype(faces.dtype, np.integer):
            raise ValueError(f"mesh: faces must be whole numbers (F, 3) or (F, 4), got {faces.dtype} {faces.shape}")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise ValueError(f"mesh: faces name vertices from {faces.min()} to {faces.max()}, there are {len(vertices)}")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces.astype(np.int32))
        if self.normals is not None:
            normals = _rows(self.normals, "normals")
            if normals.shape != vertices.shape:
                raise ValueError(f"mesh: {len(normals)} normals for {len(vertices)} vertices")
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            if length.min() < 1e-9:
                raise ValueError(f"mesh: normal {int(length.argmin())} has no length")
            object.__setattr__(self, "normals", normals / length)

    @property
    def radius(self) -> float:
        """Distance of the farthest vertex from the origin."""
        return float(np.sqrt((self.vertices**2).sum(axis=1).max()))


def _rows(array: Any, what: str) -> NDArray[np.float64]:
    rows = np.asarray(array, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3 or not len(rows):
        raise ValueError(f"mesh: {what} must be (V, 3), got {rows.shape}")
    if not np.isfinite(rows).all():
        raise ValueError(f"mesh: {what} holds a value that is not finite")
    return rows


def grid_faces(rows: int, columns: int, around: bool = True) -> NDArray[np.int32]:
    """Triangles of a grid of vertices (row-major, `rows` x `columns`). around: the last column meets the first.

    Counter-clockwise seen from where the columns' direction crossed with the rows' points.
    """
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns if around else columns - 1), indexing="ij")
    a = i * columns + j
    b = i * columns + (j + 1) % columns
    quads = np.stack([a, b, b + columns, a + columns], axis=-1).reshape(-1, 4)
    triangles: NDArray[np.int32] = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32)
    return triangles
