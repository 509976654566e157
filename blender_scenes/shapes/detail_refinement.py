"""Refinement without cracks: edges are split in the middle, on the smooth surface that the normals tell of, the same way on all sides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from blender_scenes.shapes.detail_field import Asking
from blender_scenes.shapes.detail_pieces import of_quads, of_triangles
from blender_scenes.shapes.detail_surface import Edges, Indices, Surface, edges_of, spread
from blender_scenes.shapes.surface import Array

MAX_VERTICES = 2_000_000
"""The most vertices of a refined mesh: some 2 GB of memory on the way there."""

SQUARE = 1.5
"""A quad whose sides differ by more than this factor is first cut across alone."""

SLACK = 1.5
"""How many times too long a diagonal of a quad may be, and an edge between triangles, into which such quads fall where one side alone
is split: were these held to 1, one split would run on from quad to quad all around the shape."""

Flags = NDArray[np.bool_]


class _Active(NamedTuple):
    """The faces that may change, by number, and their edges."""

    triangles: Indices
    quads: Indices
    edges: Edges


def refined(surface: Surface, asking: Sequence[Asking]) -> Surface:
    """The surface with every edge split that anything in `asking` counts over 1, until none is left.

    Edges are judged and split by their points alone, so all faces and copies of vertices along one agree. Raises ValueError beyond
    `MAX_VERTICES`.
    """
    fresh = 0  # what lies between older points has been judged before
    while True:
        triangles, quads = _active(surface, fresh)
        edges = edges_of(surface, surface.triangles[triangles], surface.quads[quads])
        active = _Active(triangles, quads, edges)
        middles = _middles(surface, edges)
        found = [_judged(surface, active, middles, one, fresh) for one in asking]
        long, very, whole, coarse = (np.logical_or.reduce(flags) for flags in zip(*found, strict=True))
        split = _wanted(surface, active, long, very, whole, coarse)
        more = int(split[edges.edge].sum())
        if not more:
            return surface
        if len(surface.place) + more > MAX_VERTICES:
            who = asking[int(np.argmax([one[0].sum() for one in found]))].name
            raise ValueError(
                f"detail {who} is too fine for this shape: the mesh would exceed {MAX_VERTICES / 1e6:g} million vertices; "
                "take a coarser detail or a smaller shape"
            )
        fresh = len(surface.points)
        surface = _split(surface, active, split, middles)


def _active(surface: Surface, fresh: int) -> tuple[Indices, Indices]:
    """Faces with a point from `fresh` on, and those with an edge in common with them, by number."""
    near = np.zeros(len(surface.points), bool)
    corners = [surface.place[faces] for faces in (surface.triangles, surface.quads)]
    for corner in corners:
        near[corner[(corner >= fresh).any(axis=1)]] = True
    triangles, quads = (np.flatnonzero(near[corner].sum(axis=1) > 1) for corner in corners)
    return triangles, quads


def _judged(surface: Surface, active: _Active, middles: Array, asking: Asking, fresh: int) -> tuple[Flags, Flags, Flags, Flags]:
    """What one asker finds too coarse: edges (E,) of quads, edges (E,) of triangles, and active triangles and quads as a whole."""
    edges = active.edges
    asked = np.flatnonzero(edges.ends.max(axis=1, initial=0) >= fresh)
    times = np.zeros(len(edges.ends))
    times[asked] = asking.times(surface.points, edges.ends[asked], middles[asked])
    corners = surface.points[surface.place[surface.triangles[active.triangles]]]
    whole = asking.holds(corners)
    a, b, c, d = surface.points[surface.place[surface.quads[active.quads]].T]
    middle = (a + b + c + d) / 4
    coarse = (asking.spans(a, middle, c) > SLACK) | (asking.spans(b, middle, d) > SLACK)
    coarse |= asking.holds(np.stack([a, b, c], axis=1)) | asking.holds(np.stack([a, c, d], axis=1))
    return times > 1, times > SLACK, whole, coarse


def _wanted(surface: Surface, active: _Active, long: Flags, very: Flags, whole: Flags, coarse: Flags) -> Flags:
    """Which edges (E,) to split: those too long; with any edge of a triangle its longest, too; of a quad opposite ones together, and
    those along alone while it is long."""
    edges = active.edges
    chord = surface.points[edges.ends[:, 0]] - surface.points[edges.ends[:, 1]]
    length = np.sqrt(np.einsum("ij,ij->i", chord, chord))
    split = np.zeros(len(long), bool)
    around = edges.edge[edges.of_triangles]
    split[around[very[around]]] = True
    meant = np.flatnonzero(whole | very[around[:, 0]] | very[around[:, 1]] | very[around[:, 2]])
    split[around[meant, np.argmax(length[around[meant]], axis=1)]] = True
    sides = edges.edge[edges.of_quads].T
    across = [long[sides[i]] | long[sides[i + 2]] for i in (0, 1)]
    size = [length[sides[i]] + length[sides[i + 2]] for i in (0, 1)]
    neither = coarse & ~across[0] & ~across[1]
    both = across[0] & across[1]
    for i in (0, 1):
        mine = across[i] | (neither & (size[i] >= size[1 - i]))
        mine &= ~both | (size[i] * SQUARE >= size[1 - i])
        split[sides[i][mine]] = split[sides[i + 2][mine]] = True
    return split


def _middles(surface: Surface, edges: Edges) -> Array:
    """The middle (E, 3) of each edge on the smooth surface: of the cubic whose ends stand at right angles to the normals.

    (a + b) / 2 - (((b - a).na) na + ((a - b).nb) nb) / 8, as in curved PN triangles (Vlachos et al. 2001). Where an edge has several
    sides, their middles differ: the point taken is as far along each side's normal as that side asks, so a rim stays on its circle.
    """
    a, b = (surface.points[surface.place[edges.sides[:, i]]] for i in (0, 1))
    na, nb = (surface.normals[edges.sides[:, i]] for i in (0, 1))
    chord = b - a
    rise = -(np.einsum("ij,ij->i", chord, na)[:, None] * na - np.einsum("ij,ij->i", chord, nb)[:, None] * nb) / 8
    count = np.bincount(edges.edge, minlength=len(edges.ends))
    middles = surface.points[edges.ends].mean(axis=1)
    alone = count[edges.edge] == 1
    middles[edges.edge[alone]] += rise[alone]
    several, group = np.unique(edges.edge[~alone], return_inverse=True)
    if len(several):
        normal = na[~alone] + nb[~alone]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        outer = (normal[:, :, None] * normal[:, None]).reshape(-1, 9)
        asked = (normal * rise[~alone]).sum(axis=1)[:, None] * normal
        matrix, right = spread(outer, group, len(several)).reshape(-1, 3, 3), spread(asked, group, len(several))
        # Normals a few degrees apart count as one: no point runs away along the line where two planes nearly coincide.
        middles[several] += (np.linalg.pinv(matrix, rcond=1e-3, hermitian=True) @ right[:, :, None])[:, :, 0]
    return middles


def _split(surface: Surface, active: _Active, split: Flags, middles: Array) -> Surface:
    """The surface with a new point on each edge of `split` (E,), and the faces at it replaced."""
    edges = active.edges
    point = np.full(len(split), -1)
    point[split] = len(surface.points) + np.arange(int(split.sum()))
    marked = split[edges.edge]
    vertex = np.full(len(marked), -1)
    vertex[marked] = len(surface.place) + np.arange(int(marked.sum()))
    triangles, quads = surface.triangles[active.triangles], surface.quads[active.quads]
    new, new_of_quads = vertex[edges.of_triangles], vertex[edges.of_quads]
    # A quad with all sides split gets a point in its middle, from the sides' middles and the corners (Coons).
    full = (new_of_quads >= 0).all(axis=1)
    corners, sides = quads[full], new_of_quads[full]
    points = np.concatenate([surface.points, middles[split]])
    place = np.concatenate([surface.place, point[edges.edge[marked]]])
    centre = points[place[sides]].sum(axis=1) / 2 - points[place[corners]].sum(axis=1) / 4
    centres = np.full(len(quads), -1)
    centres[full] = len(place) + np.arange(len(centre))
    place = np.concatenate([place, len(points) + np.arange(len(centre))])
    points = np.concatenate([points, centre])
    ends = edges.sides[marked]
    three, four = of_triangles(triangles, new)
    cut, more = of_quads(quads, new_of_quads, centres)
    kept, kept_quads = np.ones(len(surface.triangles), bool), np.ones(len(surface.quads), bool)
    kept[active.triangles[(new >= 0).any(axis=1)]] = False
    kept_quads[active.quads[(new_of_quads >= 0).any(axis=1)]] = False
    return Surface(
        points,
        place,
        np.concatenate([surface.normals, _mean_normal(surface, ends), _mean_normal(surface, corners)]),
        np.concatenate([surface.triangles[kept], three, cut]),
        np.concatenate([surface.quads[kept_quads], four, more]),
    )


def _mean_normal(surface: Surface, vertices: Indices) -> Array:
    """The unit mean (N, 3) of the normals of vertices (N, C); the first where they cancel."""
    normals = surface.normals[vertices].sum(axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    mean: Array = np.where(length > 1e-6, normals / np.maximum(length, 1e-6), surface.normals[vertices[:, 0]])
    return mean
