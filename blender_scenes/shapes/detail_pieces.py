"""What becomes of triangles and quads when some of their edges have a new vertex in the middle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from blender_scenes.shapes.detail_surface import Indices


def of_triangles(faces: Indices, new: Indices) -> tuple[Indices, Indices]:
    """Triangles and quads in place of triangles (F, 3). new: (F, 3) vertices on the edges opposite to the corners, -1: not split."""
    count = (new >= 0).sum(axis=1)
    one, two, three = count == 1, count == 2, count == 3
    a, b, c, m, _, _ = _turned(faces[one], new[one], np.argmax(new[one] >= 0, axis=1))
    triangles = [(a, b, m), (a, m, c)]
    a, b, c, _, p, q = _turned(faces[two], new[two], np.argmin(new[two] >= 0, axis=1))
    triangles.append((a, q, p))
    quads = [(q, b, c, p)]
    a, b, c, p, q, r = _turned(faces[three], new[three], np.zeros(int(three.sum()), np.int64))
    triangles += [(a, r, q), (r, b, p), (q, p, c), (p, q, r)]
    return _rows(triangles, 3), _rows(quads, 4)


def of_quads(faces: Indices, new: Indices, centres: Indices) -> tuple[Indices, Indices]:
    """Triangles and quads in place of quads (Q, 4). new: (Q, 4) vertices between each corner and the next, -1: not split. centres: (Q,)
    vertices in the middle of those with four."""
    triangles, quads = [], []
    marked = new >= 0
    count = marked.sum(axis=1)
    opposite = (count == 2) & (marked[:, 0] == marked[:, 2])
    one, two, three, four = count == 1, (count == 2) & ~opposite, count == 3, count == 4
    a, b, c, d, m, _, _, _ = _turned(faces[one], new[one], np.argmax(marked[one], axis=1))
    triangles += [(m, b, c), (m, c, d), (m, d, a)]
    a, b, c, d, m, _, n, _ = _turned(faces[opposite], new[opposite], np.argmax(marked[opposite], axis=1))
    quads += [(a, m, n, d), (m, b, c, n)]
    start = np.argmax(marked[two] & np.roll(marked[two], -1, axis=1), axis=1)
    a, b, c, d, m, n, _, _ = _turned(faces[two], new[two], start)
    triangles += [(m, b, n), (a, m, d), (m, n, d), (n, c, d)]
    start = (np.argmin(marked[three], axis=1) + 1) % 4
    a, b, c, d, m, n, o, _ = _turned(faces[three], new[three], start)
    quads.append((a, m, o, d))
    triangles += [(m, b, n), (n, c, o), (m, n, o)]
    a, b, c, d, m, n, o, p = _turned(faces[four], new[four], np.zeros(int(four.sum()), np.int64))
    e = centres[four]
    quads += [(a, m, e, p), (m, b, n, e), (e, n, c, o), (p, e, o, d)]
    return _rows(triangles, 3), _rows(quads, 4)


def _turned(faces: Indices, new: Indices, start: Indices) -> tuple[Indices, ...]:
    """Columns of corners and new vertices of faces turned so that the corner `start` comes first."""
    n = faces.shape[1]
    order = (start[:, None] + np.arange(n)) % n
    return (*np.take_along_axis(faces, order, axis=1).T, *np.take_along_axis(new, order, axis=1).T)


def _rows(faces: Sequence[tuple[Indices, ...]], corners: int) -> Indices:
    return np.concatenate([np.stack(face, axis=1) for face in faces]).reshape(-1, corners)
