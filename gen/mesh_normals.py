"""Normals of triangle meshes: whether given ones agree with the faces, and smooth ones that are split at sharp edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from blender_scenes.shapes.detail_surface import merged

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

AGREE_DEGREES = 45.0
"""Given normals count where they stand no more than this off their faces..."""

DISAGREE = 0.01
"""... but for this share of the area."""


def agreeing(vertices: Array, faces: Faces, normals: Array) -> bool:
    """Whether normals (V, 3) are those of the faces (F, 3), about: see `AGREE_DEGREES` and `DISAGREE`."""
    length = np.linalg.norm(normals, axis=1)
    if not np.isfinite(normals).all() or length.min() < 1e-6:
        return False
    cross = _cross(vertices, faces)
    area = np.linalg.norm(cross, axis=1)
    least = np.full(len(faces), np.inf)
    for corner in faces.T:
        least = np.minimum(least, np.einsum("ij,ij->i", cross, normals[corner]) / length[corner])
    off = least < np.cos(np.radians(AGREE_DEGREES)) * area
    return bool(area[off].sum() <= DISAGREE * area.sum())


def smoothed(vertices: Array, faces: Faces, smooth_degrees: float) -> tuple[Array, Faces, Array]:
    """Vertices, faces and unit normals: angle-weighted means over the faces around a point that are joined by edges no sharper than
    `smooth_degrees` (Thuermer and Wuethrich 1998). A point with several such groups becomes several vertices.

    Points in one place are made one, faces without area left out, and faces wound against their neighbours or, on a closed surface, inward
    turned.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    vertices, place = merged(vertices)
    faces = place[faces]
    faces = faces[np.linalg.norm(_cross(vertices, faces), axis=1) > 1e-12 * np.ptp(vertices, axis=0).max() ** 2]
    if not len(faces):
        return vertices, faces, np.zeros_like(vertices)
    faces = _wound_alike(vertices, faces)
    normals = _cross(vertices, faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    one, two, ends, against = _neighbours(faces)
    smooth = np.einsum("ij,ij->i", normals[one], normals[two]) >= np.cos(np.radians(smooth_degrees)) - 1e-9
    one, two, ends = (rows[smooth & ~against] for rows in (one, two, ends))
    # Corners (one a face and point) that a smooth edge joins are one vertex.
    pairs = [(_corner(faces, one, ends[:, i]), _corner(faces, two, ends[:, i])) for i in (0, 1)]
    first, second = (np.concatenate(corners) for corners in zip(*pairs, strict=True))
    links = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(faces.size, faces.size))
    count, group = connected_components(links, directed=False)
    angle = _angles(vertices, faces)
    weighted = (normals[:, None] * angle[..., None]).reshape(-1, 3)
    summed: Array = np.stack([np.bincount(group, column, count) for column in weighted.T], axis=1)
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    of_group = np.empty(count, np.int64)
    of_group[group] = np.arange(faces.size)
    summed = np.where(length > 1e-9, summed / np.maximum(length, 1e-9), normals[of_group // 3])
    return vertices[faces.ravel()[of_group]], group.reshape(-1, 3).astype(np.int64), summed


def _cross(vertices: Array, faces: Faces) -> Array:
    a, b, c = (vertices[corner] for corner in faces.T)
    return np.cross(b - a, c - a)


def _angles(vertices: Array, faces: Faces) -> Array:
    """The angle (F, 3) at each corner."""
    corners = vertices[faces]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(ahead, behind), axis=2)
    angle: Array = np.arctan2(sine, (ahead * behind).sum(axis=2))
    return angle


def _corner(faces: Faces, which: Faces, point: Faces) -> Faces:
    """The number, 3 face + i, of each face's corner at a point."""
    corner: Faces = 3 * which + np.argmax(faces[which] == point[:, None], axis=1)
    return corner


def _neighbours(faces: Faces) -> tuple[Faces, Faces, Faces, NDArray[np.bool_]]:
    """Of each edge of exactly two faces: both faces, its ends (E, 2), and whether both run along it the same way: wound apart."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    forward = edges[:, 0] < edges[:, 1]
    ends = np.sort(edges, axis=1)
    order = np.lexsort([ends[:, 1], ends[:, 0]])
    ends = ends[order]
    new = np.concatenate([[True], (np.diff(ends, axis=0) != 0).any(axis=1)])
    start = np.flatnonzero(new)
    start = start[np.diff(np.append(start, len(ends))) == 2]
    one, two = order[start], order[start + 1]
    apart = one // 3 != two // 3
    one, two, start = one[apart], two[apart], start[apart]
    return one // 3, two // 3, ends[start], forward[one] == forward[two]


def _wound_alike(vertices: Array, faces: Faces) -> Faces:
    """The faces with neighbours wound alike, where the surface has two sides: as most of the area is; outward where it is closed."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    one, two, _, against = _neighbours(faces)
    n = len(faces)
    # Two copies of each face, as it is and turned: neighbours agree as (as it is, as it is), or crosswise where wound against each other.
    first = np.concatenate([one, one + n])
    second = np.concatenate([np.where(against, two + n, two), np.where(against, two, two + n)])
    _, label = connected_components(
        coo_array((np.ones(len(first), np.int8), (first, second)), shape=(2 * n, 2 * n)), directed=False
    )
    as_is, turned = label[:n], label[n:]
    cross = _cross(vertices, faces)
    volume = np.einsum("ij,ij->i", vertices[faces[:, 0]] - vertices.mean(axis=0), cross)
    area = np.linalg.norm(cross, axis=1)
    # The pieces of both labels: of each the area that stays, and its signed volume.
    count = int(label.max()) + 1
    stays = np.bincount(as_is, area, count)
    inside = np.bincount(as_is, volume, count) - np.bincount(turned, volume, count)
    open_edges = 3 * np.bincount(as_is, minlength=count) + 3 * np.bincount(turned, minlength=count)
    open_edges -= np.bincount(label[first], minlength=count) * 2
    closed = (open_edges[as_is] == 0) & (as_is != turned)
    flip = (as_is != turned) & np.where(closed, inside[as_is] < 0, stays[turned] > stays[as_is])
    result = faces.copy()
    result[flip] = result[flip][:, ::-1]
    return result
