"""Tubes: a circle swept along a curve."""

from __future__ import annotations

import numpy as np

from blender_scenes.shapes.mesh import Mesh
from blender_scenes.shapes.surface import Array, grid


def rings(tangents: Array, sides: Array, count: int) -> Array:
    """Unit circles (R, count, 3) across a curve. tangents: (R, 3). sides: (R, 3) unit vectors at right angles to them."""
    angle = 2 * np.pi * np.arange(count) / count
    tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    across = np.cross(tangents, sides)
    circles: Array = np.cos(angle)[:, None] * sides[:, None] + np.sin(angle)[:, None] * across[:, None]
    return circles


def tube(centres: Array, circles: Array, radius: float, inside: bool = False) -> Mesh:
    """A circle of constant radius along a curve; normals are exactly those of the tube, the circles' own radii.

    centres: (R, 3). circles: (R, C, 3) of `rings`. inside: the wall of a bore, seen from within.
    """
    points = centres[:, None] + radius * circles
    return grid(points[:, ::-1], -circles[:, ::-1]) if inside else grid(points, circles)


def end(centre: Array, circle: Array, radius: float, bore: float, normal: Array) -> Mesh:
    """The flat end of a tube, open in the middle where `bore` > 0. circle: (C, 3) of `rings`. normal: (3,), outward."""
    across, along = circle[1] - circle[0], circle[0]
    rim, hole = centre + radius * circle, centre + bore * circle
    inward = np.dot(np.cross(across, -along), normal) > 0
    return grid(np.stack([rim, hole] if inward else [hole, rim]), normal)
