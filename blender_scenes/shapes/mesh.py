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

    def is_convex(self) -> bool:
        """Whether the faces are the whole surface of one convex solid, to 1e-9 of its size; flat faces of four corners count.

        A closed surface that is convex at every edge is the surface of a convex solid if it has the sphere's Euler characteristic; two
        such surfaces would have twice that (Hadamard's theorem).
        """
        faces = self.faces if self.faces.shape[1] == 3 else self.faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
        allowed = 1e-9 * float(np.ptp(self.vertices, axis=0).max())
        # Most others are found out by some of their faces.
        for a, b, c in self.vertices[faces[:: max(len(faces) // 16, 1)]]:
            normal = np.cross(b - a, c - a)
            if np.einsum("vc,c->v", self.vertices - a, normal).max() > allowed * np.linalg.norm(normal):
                return False
        weld = _welded(self.vertices)
        joined = weld[faces]
        whole = (joined != np.roll(joined, 1, axis=1)).all(axis=1)
        faces, joined = faces[whole], joined[whole].astype(np.int64)
        count = int(weld.max()) + 1
        here = (joined * count + np.roll(joined, -1, axis=1)).ravel()
        there = (np.roll(joined, -1, axis=1) * count + joined).ravel()
        order, other = np.argsort(here), np.argsort(there)
        edges = here[order]
        if (edges[1:] == edges[:-1]).any() or not np.array_equal(edges, there[other]):
            return False
        if int((np.bincount(joined.ravel()) > 0).sum()) - len(here) // 2 + len(faces) != 2:
            return False
        # The corner of the face across an edge that is not on the edge must lie on or below the plane of this face.
        across = np.empty(len(here), np.int64)
        across[order] = np.roll(faces, -2, axis=1).ravel()[other]
        points = self.vertices[faces]
        normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        above = np.einsum("fec,fc->fe", self.vertices[across].reshape(-1, 3, 3) - points[:, :1], normals)
        return bool((above <= allowed * length).all())


def _welded(vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    """A number for each vertex (V,), the same for those at the same place."""
    order = np.lexsort(vertices.T)
    ordered = vertices[order]
    number = np.zeros(len(vertices), np.int64)
    number[order[1:]] = np.cumsum((ordered[1:] != ordered[:-1]).any(axis=1))
    return number


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
