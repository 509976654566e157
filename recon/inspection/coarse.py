"""Start poses: from which side, and how turned, the nominal looks most like what was measured."""

from __future__ import annotations

import numpy as np

from recon.inspection.nominal import Surface
from recon.inspection.pose import Doubles, Pose, rotation_of, vector_of
from recon.inspection.registration import Level
from recon.inspection.view import Bools, Seen, seen

TURNS = 12
"""Turns about the line of sight from each side."""

MAX_TRIANGLES = 20_000
"""Triangles that the nominal is thinned to while poses are tried."""

UNLIKE = 0.5
"""Cosine between two normals at which they agree in nothing."""


def thinned(surface: Surface) -> Surface:
    """The surface with at most `MAX_TRIANGLES`, by merging neighbouring points."""
    from recon.page_mesh import cluster

    if len(surface.faces) <= MAX_TRIANGLES:
        return surface
    vertices, faces, normals = cluster(surface.vertices, surface.faces, surface.normals, MAX_TRIANGLES)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Surface(vertices, faces, normals, surface.source, surface.unit)


def start_poses(level: Level, surface: Surface, free_scale: bool, only: Doubles | None = None) -> list[tuple[float, Pose]]:
    """Poses with their likeness, best first: the nominal seen from 42 sides (its axes among them), in `TURNS` turns each.

    only: (3, 3) the one rotation to try. The nominal is moved so that the silhouettes' middles meet and, where the scale is free, grown so
    that their areas agree. Normals decide, since heights may have drifted: see `likeness`.
    """
    sides = _sides() if only is None else [only]
    turns = [rotation_of(np.array([0, 0, a])) for a in np.arange(TURNS if only is None else 1) * 2 * np.pi / TURNS]
    area, middle = _silhouette(level, level.known)
    height = float(np.nanmean(level.points[..., 2]))
    found = []
    for side in sides:
        first = _placed(level, surface, side, free_scale, area)
        there = seen(surface, first, level.view)
        if not there.inside.any():
            continue
        own, at = _silhouette(level, there.inside)
        growth = np.sqrt(area / own) if free_scale else 1.0
        depth = float(there.points[..., 2][there.inside].mean())
        for turn in turns:
            pose = first.moved(vector_of(turn), np.zeros(3), growth - 1, level.about)
            # Where the silhouette's middle has gone with the turn, and back to the measured one.
            where = growth * turn @ (np.append(at, depth) - level.about) + level.about
            pose = Pose(pose.rotation, pose.translation + np.append(middle, height) - where, pose.scale)
            found.append((likeness(level, seen(surface, pose, level.view)), pose))
    return sorted(found, key=lambda item: -item[0])


def likeness(level: Level, nominal: Seen) -> float:
    """From 0 to 1: over the union of both silhouettes, the mean agreement of the normals, 1 where equal and 0 from 60 degrees on."""
    both, either = level.known & nominal.inside, level.known | nominal.inside
    cosine = np.einsum("nk,nk->n", level.normal[both], nominal.normal[both])
    return float(np.clip((cosine - UNLIKE) / (1 - UNLIKE), 0, 1).sum() / max(int(either.sum()), 1))


def _placed(level: Level, surface: Surface, rotation: Doubles, free_scale: bool, area: float) -> Pose:
    """The nominal's middle at the measurement's, at a size that fills about the same area where the scale is free."""
    scale = 2 * level.length / float(np.linalg.norm(np.ptp(surface.vertices, axis=0))) if free_scale else 1.0
    return Pose(rotation, level.about - scale * rotation @ surface.middle, scale)


def _silhouette(level: Level, mask: Bools) -> tuple[float, Doubles]:
    """Area in pixels, and the middle (2,) in lengths at z = 0."""
    rows, columns = np.nonzero(mask)
    origin, toward = level.view.rays(np.array([rows.mean()]), np.array([columns.mean()]))
    at = origin[0] - toward[0] * origin[0, 2] / toward[0, 2]
    return float(len(rows)), at[:2]


def _sides() -> list[Doubles]:
    """Rotations that bring each of the 42 directions of a divided icosahedron toward the viewer."""
    import trimesh

    directions = np.asarray(trimesh.creation.icosphere(subdivisions=1).vertices)
    rotations = []
    for d in directions / np.linalg.norm(directions, axis=1, keepdims=True):
        axis = np.cross(d, [0, 0, 1.0])
        sine = float(np.linalg.norm(axis))
        if sine < 1e-9:
            rotations.append(np.eye(3) if d[2] > 0 else np.diag([1.0, -1, -1]))
        else:
            rotations.append(rotation_of(axis / sine * np.arctan2(sine, d[2])))
    return rotations
