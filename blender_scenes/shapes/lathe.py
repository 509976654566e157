"""Surfaces of revolution: a profile of smooth pieces, each with its own normals, turned about the y axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from blender_scenes.shapes.mesh import Mesh
from blender_scenes.shapes.surface import Array, grid, join


class Piece(NamedTuple):
    """A smooth piece of a plane curve with the outside on its right. points: (M, 2). normals: (M, 2), any length."""

    points: Array
    normals: Array


def curve(points: Array, tangents: Array) -> Piece:
    """A piece from its points and derivatives (M, 2)."""
    return Piece(points, np.stack([tangents[:, 1], -tangents[:, 0]], axis=1))


def line(start: Sequence[float] | Array, stop: Sequence[float] | Array, count: int = 1) -> Piece:
    """A straight piece of `count` segments."""
    points = np.linspace(start, stop, count + 1)
    return curve(points, np.broadcast_to(points[-1] - points[0], points.shape))


def arc(centre: Sequence[float] | Array, radius: float, start: float, stop: float, count: int) -> Piece:
    """An arc of `count` segments from one angle to another (radians from the first axis); outside is the middle where stop < start."""
    angle = np.linspace(start, stop, count + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Piece(np.asarray(centre) + radius * ring, ring if stop > start else -ring)


def path(*corners: Sequence[float] | Array) -> list[Piece]:
    """Straight pieces from corner to corner, sharp where they meet; a corner given twice is one."""
    return [line(start, stop) for start, stop in pairwise(corners) if math.dist(start, stop) > 0]


def azimuths(count: int) -> Array:
    """Equal angles around the axis, radians; the first looks along z."""
    return 2 * np.pi * np.arange(count) / count


def lathe(profile: Sequence[Piece], angles: Array) -> Mesh:
    """The profile, points (radius, height), turned about y: at azimuth a to (radius sin a, height, radius cos a).

    The solid lies on the left of the profile, which runs up on its outside; where pieces meet, the edge is sharp and its vertices come
    twice. angles: (S,) ascending azimuths within one turn. At radius 0, allowed at either end of a piece, each facet has its own copy
    of the pole with the normal of the facet's middle: right for tips as for smooth poles.
    """
    scale = max(np.abs(piece.points).max() for piece in profile)
    after = np.append(angles[1:], angles[0] + 2 * np.pi)
    middle = (angles + after) / 2
    before = np.roll(middle, 1)
    meshes = []
    for points, normals in profile:
        radius = np.where(np.abs(points[:, 0]) < 1e-12 * scale, 0.0, points[:, 0])
        azimuth = np.tile(angles, (len(points), 1))
        if radius[0] == 0:
            azimuth[0] = middle
        if radius[-1] == 0:
            azimuth[-1] = before
        around = np.stack([np.sin(azimuth), np.zeros_like(azimuth), np.cos(azimuth)], axis=-1)
        up = np.array([0.0, 1.0, 0.0])
        meshes.append(
            grid(
                radius[:, None, None] * around + points[:, 1, None, None] * up,
                normals[:, 0, None, None] * around + normals[:, 1, None, None] * up,
            )
        )
    return join(*meshes)
