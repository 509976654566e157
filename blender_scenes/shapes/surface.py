"""Pieces of surface: grids of points with their normals, joined to a mesh. What every shape family is put together from."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from blender_scenes.shapes.mesh import Mesh, grid_faces

Array = NDArray[np.float64]

TOLERANCE = 2e-5
"""Depth of a chord under its arc that `divisions` allows, as a share of the object's size."""


def divisions(radius: float, size: float, turn: float = 2 * math.pi) -> int:
    """How many chords an arc of `turn` radians needs to lie within `TOLERANCE` of `size` under it; at least eight a quarter."""
    step = math.sqrt(8 * TOLERANCE * size / radius)
    return math.ceil(turn / min(step, math.pi / 16))


def grid(points: Array, normals: Array, around: bool = True) -> Mesh:
    """A grid of points (R, C, 3) with normals (broadcast to the same shape) as a mesh; outward is columns cross rows.

    around: the last column meets the first. Triangles with two corners in one point, as at a pole, are left out.
    """
    rows, columns = points.shape[:2]
    vertices = points.reshape(-1, 3)
    faces = grid_faces(rows, columns, around)
    corners = vertices[faces]
    # A part of the size far under any facet, far over rounding. Written out: numpy reduces an axis of three slowly.
    differ = np.abs(corners - corners[:, [2, 0, 1]]) > 1e-9 * np.abs(vertices).max()
    apart = differ[..., 0] | differ[..., 1] | differ[..., 2]
    kept: Array = np.broadcast_to(normals, points.shape).reshape(-1, 3)
    return Mesh(vertices, faces[apart[:, 0] & apart[:, 1] & apart[:, 2]], kept)


def parametric(points: Array, across: Array, along: Array, around: bool = True) -> Mesh:
    """A grid whose normals are the cross product of its derivatives over the columns (`across`) and the rows (`along`)."""
    return grid(points, np.cross(across, along), around)


def flat(points: Array, faces: NDArray[np.int32], normal: tuple[float, float, float]) -> Mesh:
    """Plane triangles (F, 3) on points (V, 3), all of one normal."""
    return Mesh(points, faces, np.broadcast_to(np.array(normal), points.shape))


def join(*meshes: Mesh) -> Mesh:
    """All meshes (triangles with normals) as one; points in the same place stay several, and each keeps its normal."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, first, strict=False)]),
        np.concatenate([_normals(mesh) for mesh in meshes]),
    )


def moved(mesh: Mesh, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Mesh:
    """The mesh shifted."""
    return Mesh(mesh.vertices + np.array([x, y, z]), mesh.faces, mesh.normals)


def centred(mesh: Mesh) -> Mesh:
    """The mesh with the middle of its bounding box at the origin."""
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    return moved(mesh, *(-middle))


def turned(mesh: Mesh, rotation: Array) -> Mesh:
    """The mesh turned by a rotation (3, 3)."""
    return Mesh(mesh.vertices @ rotation.T, mesh.faces, _normals(mesh) @ rotation.T)


def facing(mesh: Mesh) -> Mesh:
    """The mesh turned about x so that its y axis points to the viewer, along z."""
    return turned(mesh, np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))


def upright(mesh: Mesh) -> Mesh:
    """The mesh turned about x so that its z axis points up, along y: the inverse of `facing`."""
    return turned(mesh, np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))


def mirrored(mesh: Mesh) -> Mesh:
    """The mesh's image in the plane z = 0, outward again."""
    flip = np.array([1.0, 1.0, -1.0])
    return Mesh(mesh.vertices * flip, mesh.faces[:, ::-1], _normals(mesh) * flip)


def stretched(mesh: Mesh, x: float, y: float, z: float) -> Mesh:
    """The mesh scaled along each axis, its normals by the inverse."""
    factors = np.array([x, y, z])
    return Mesh(mesh.vertices * factors, mesh.faces, _normals(mesh) / factors)


def _normals(mesh: Mesh) -> Array:
    assert mesh.normals is not None
    return mesh.normals
