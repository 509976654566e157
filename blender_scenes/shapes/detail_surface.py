"""A mesh made ready for detail: vertices that know which of them share a point, and how the smooth surface bends there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from blender_scenes.shapes.mesh import Mesh
from blender_scenes.shapes.surface import Array

Indices = NDArray[np.int64]

SAME = 1e-9
"""Points nearer than this share of the size are one."""

WIDEST_DEGREES = 150.0
"""The widest corner of a quad made of two triangles."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles and quads whose vertices name points: those of a sharp edge share a point, and each has its own normal.

    points: (P, 3). place: (V,) the point of each vertex. normals: (V, 3) unit. triangles: (F, 3) vertices. quads: (Q, 4) vertices.
    """

    points: Array
    place: Indices
    normals: Array
    triangles: Indices
    quads: Indices

    def faces(self) -> Indices:
        """All as triangles (F, 3), quads cut along their shorter diagonal, unless that would cut off a sliver."""
        if not len(self.quads):
            return self.triangles
        a, b, c, d = self.quads.T
        at = self.points[self.place[self.quads]]
        first, second = at[:, 2] - at[:, 0], at[:, 3] - at[:, 1]
        least = [
            np.minimum(_square(np.cross(across, at[:, i] - at[:, i - 1])), _square(np.cross(across, at[:, i - 2] - at[:, i - 1])))
            for across, i in ((first, 0), (second, 1))
        ]
        short = (_square(first) <= _square(second)) & (least[0] > least[1] / 4) | (least[1] <= least[0] / 4)
        cut = (a, b, np.where(short, c, d)), (np.where(short, a, b), c, d)
        return np.concatenate([self.triangles, *(np.stack(corners, axis=1) for corners in cut)])


class Edges(NamedTuple):
    """Edges of some faces. ends: (E, 2) points, ascending. sides: (N, 2) vertices of each distinct way to have an edge (two at a sharp
    edge). edge: (N,) the edge of each side. of_triangles: (F, 3) the side of each edge, the one opposite to each corner first.
    of_quads: (Q, 4) the side from each corner to the next."""

    ends: Indices
    sides: Indices
    edge: Indices
    of_triangles: Indices
    of_quads: Indices


def surface_of(mesh: Mesh) -> Surface:
    """The surface of a mesh; faces without normals become flat triangles with vertices of their own."""
    faces = mesh.faces.astype(np.int64)
    if faces.shape[1] == 4:
        faces = np.concatenate([faces[:, :3], faces[:, [0, 2, 3]]])
    if mesh.normals is None:
        vertices = mesh.vertices[faces].reshape(-1, 3)
        faces = np.arange(len(vertices)).reshape(-1, 3)
        cross = np.cross(vertices[1::3] - vertices[::3], vertices[2::3] - vertices[::3])
        length = np.linalg.norm(cross, axis=1)
        faces, kept = faces[length > 0], np.repeat(length > 0, 3)
        normals = np.where(kept[:, None], np.repeat(cross, 3, axis=0), 1.0)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    else:
        vertices, normals = mesh.vertices, mesh.normals
    used = np.unique(faces)
    number = np.empty(len(vertices), np.int64)
    number[used] = np.arange(len(used))
    faces, vertices, normals = number[faces], vertices[used], normals[used]
    points, place = merged(vertices)
    corners = place[faces]
    faces = faces[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    return _paired(Surface(points, place, normals, faces, np.empty((0, 4), np.int64)))


def edges_of(surface: Surface, triangles: Indices, quads: Indices) -> Edges:
    """The distinct edges of triangles (F, 3) and quads (Q, 4)."""
    sides = np.concatenate(
        [
            np.stack([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]], axis=1).reshape(-1, 2),
            np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2),
        ]
    )
    ends = surface.place[sides]
    turned = ends[:, 0] > ends[:, 1]
    sides[turned], ends[turned] = sides[turned][:, ::-1], ends[turned][:, ::-1]
    _, first, side_of = np.unique(sides[:, 0] * len(surface.place) + sides[:, 1], return_index=True, return_inverse=True)
    key, edge = np.unique(ends[first, 0] * len(surface.points) + ends[first, 1], return_inverse=True)
    both = np.split(side_of, [triangles.size])
    ends = np.stack(np.divmod(key, len(surface.points)), axis=1)
    return Edges(ends, sides[first], edge, both[0].reshape(-1, 3), both[1].reshape(-1, 4))


def _square(vectors: Array) -> Array:
    square: Array = np.einsum("ij,ij->i", vectors, vectors)
    return square


def spread(values: Array, group: Indices, count: int) -> Array:
    """Sums (count, C) of rows (N, C) by group."""
    return np.stack([np.bincount(group, column, count) for column in values.T], axis=1)


def bent(bend: Array, vectors: Array) -> Array:
    """The shape operator (N, 6) applied to vectors (N, 3)."""
    xx, yy, zz, xy, yz, zx = bend.T
    x, y, z = vectors.T
    return np.stack([xx * x + xy * y + zx * z, xy * x + yy * y + yz * z, zx * x + yz * y + zz * z], axis=1)


def invariants(bend: Array) -> tuple[Array, Array]:
    """Sum and product of the two principal curvatures, (N,) each."""
    total = bend[:, :3].sum(axis=1)
    squares = (bend[:, :3] ** 2).sum(axis=1) + 2 * (bend[:, 3:] ** 2).sum(axis=1)
    return total, (total**2 - squares) / 2


def sharpest(bend: Array) -> Array:
    """The greater of the principal curvatures' magnitudes, (N,)."""
    total, product = invariants(bend)
    largest: Array = np.abs(total) / 2 + np.sqrt(np.maximum(total**2 / 4 - product, 0))
    return largest


def merged(vertices: Array) -> tuple[Array, Indices]:
    """The distinct points of vertices, and the point of each: rounded to two grids, so that no line of either parts what is one."""
    low = vertices.min(axis=0)
    cell = SAME * max(float(np.ptp(vertices, axis=0).max()), 1e-300)
    label = np.arange(len(vertices))
    groups = []
    for shift in (0.0, 0.5):
        x, y, z = np.floor((vertices - low) / cell + shift).T
        order = np.lexsort([z, y, x])
        new = np.concatenate([[True], (np.diff(x[order]) != 0) | (np.diff(y[order]) != 0) | (np.diff(z[order]) != 0)])
        group = np.empty(len(vertices), np.int64)
        group[order] = np.cumsum(new) - 1
        groups.append(group)
    for group in (*groups, groups[0]):
        least = np.full(group.max() + 1, len(vertices))
        np.minimum.at(least, group, label)
        label = least[group]
    first, place = np.unique(label, return_inverse=True)
    return vertices[first], place


def shape_operator(surface: Surface) -> Array:
    """The derivative of the normal along the surface at each vertex, (V, 6), as xx, yy, zz, xy, yz, zx; 1/mm, positive where convex.

    Of the linear normals over each face, averaged by area over the faces at a vertex: so the finer the mesh, the nearer to an edge
    between a flat and a round part it is right.
    """
    points, normals, faces = surface.points[surface.place], surface.normals, surface.faces()
    total, weight = np.zeros((len(points), 6)), np.zeros(len(points))
    for start in range(0, len(faces), 1 << 18):
        part = faces[start : start + (1 << 18)]
        p, n = points[part], normals[part]
        e, f = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        ee, ef, ff = np.einsum("ij,ij->i", e, e), np.einsum("ij,ij->i", e, f), np.einsum("ij,ij->i", f, f)
        area2 = np.maximum(ee * ff - ef**2, 1e-300)
        # The dual basis: e_.e = 1, e_.f = 0 and the other way around.
        dual_e, dual_f = (
            (ff[:, None] * e - ef[:, None] * f) / area2[:, None],
            (ee[:, None] * f - ef[:, None] * e) / area2[:, None],
        )
        operator = (n[:, 1] - n[:, 0])[:, :, None] * dual_e[:, None] + (n[:, 2] - n[:, 0])[:, :, None] * dual_f[:, None]
        operator = (operator + operator.transpose(0, 2, 1)) / 2
        area = np.sqrt(area2)
        packed = operator[:, [0, 1, 2, 0, 1, 2], [0, 1, 2, 1, 2, 0]] * area[:, None]
        for corner in part.T:
            total += spread(packed, corner, len(points))
            weight += np.bincount(corner, area, len(points))
    total /= np.maximum(weight, 1e-300)[:, None]
    # Only its action along the surface counts: (I - nn) S (I - nn).
    for start in range(0, len(points), 1 << 18):
        piece = slice(start, start + (1 << 18))
        along = np.eye(3) - normals[piece, :, None] * normals[piece, None]
        matrix = along @ total[piece][:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]] @ along
        total[piece] = matrix[:, [0, 1, 2, 0, 1, 2], [0, 1, 2, 1, 2, 0]]
    return total


def _paired(surface: Surface) -> Surface:
    """Two triangles with the longest edge in common made one quad: so a long strip is later cut across and not into slivers."""
    faces = surface.triangles
    edges = edges_of(surface, faces, surface.quads)
    ends = surface.points[edges.ends]
    length = ((ends[:, 0] - ends[:, 1]) ** 2).sum(axis=1)[edges.edge][edges.of_triangles]
    longest = np.argmax(length, axis=1)
    side = edges.of_triangles[np.arange(len(faces)), longest]
    # The side must be the longest of exactly two triangles, and of no third.
    alone = np.bincount(edges.edge, minlength=len(edges.ends)) == 1
    mutual = (np.bincount(side, minlength=len(edges.sides)) == 2) & alone[edges.edge]
    mutual &= np.bincount(edges.of_triangles.ravel(), minlength=len(edges.sides)) == 2
    pair = np.flatnonzero(mutual[side])
    pair = pair[np.argsort(side[pair], kind="stable")].reshape(-1, 2)
    turned = np.take_along_axis(faces[pair], (longest[pair][:, :, None] + np.arange(3)) % 3, axis=2)
    quads = np.stack([turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 0], turned[:, 0, 2]], axis=1)
    # Wound the same way, and not the two sides of a thin sheet.
    sound = (turned[:, 0, 1] == turned[:, 1, 2]) & (turned[:, 0, 2] == turned[:, 1, 1])
    sound &= surface.place[quads[:, 0]] != surface.place[quads[:, 2]]
    # Nor nearly a triangle with a fourth corner on one side, as two of a fan make.
    at = surface.points[surface.place[quads]]
    ahead, behind = np.roll(at, -1, axis=1) - at, np.roll(at, 1, axis=1) - at
    cosine = (ahead * behind).sum(axis=2) / np.maximum(np.linalg.norm(ahead, axis=2) * np.linalg.norm(behind, axis=2), 1e-300)
    sound &= cosine.min(axis=1, initial=1) > np.cos(np.radians(WIDEST_DEGREES))
    left = np.ones(len(faces), bool)
    left[pair[sound]] = False
    return Surface(surface.points, surface.place, surface.normals, faces[left], quads[sound])
