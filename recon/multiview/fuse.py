"""Fusion: the surfaces of all views in one truncated signed distance field, and the mesh of its zero."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from recon.multiview.depth import Surface
from recon.multiview.field import carve, integrate
from recon.multiview.stereo import sampled
from recon.multiview.views import Ball, Bools, Doubles, View

if TYPE_CHECKING:
    import trimesh

VOXEL = 1.0
"""Side of a voxel in pixels at the object's distance, where nobody says another."""

TRUNCATION = 4.0
"""Voxels in front of and behind a surface within which its distance counts."""

LEAST_FACING = 0.2
"""Cosine toward the camera under which a view's surface is not used: there depth and normals are both poor."""

RIM = 2
"""Pixels beside the outline from which on a view's background empties the voxels: nearer by, the surfaces themselves say it better."""

MAX_VOXELS = 200_000_000

SMALLEST_PART = 0.02
"""Of all triangles: parts of the mesh smaller than this are debris."""


def voxel_of(views: Sequence[View]) -> float:
    """The default side of a voxel in mm: `VOXEL` pixels of the finest view, at the object."""
    return VOXEL * min((view.capture.scale.distance_mm or 0.0) / float(view.K[0, 0]) for view in views)


def fuse(views: Sequence[View], surfaces: Sequence[Surface], ball: Ball, voxel: float | None = None) -> trimesh.Trimesh:
    """One mesh of the surfaces of all views, in the object's frame, in mm, with the albedo as vertex colours.

    Every voxel averages its distances to the surfaces, along each view's ray times the cosine at which the ray meets the surface, with
    the weight of that cosine squared over the squared distance to the camera. Voxels that any view sees well beside the object are empty.
    The mesh is open where no view saw the surface. voxel: mm, by default `voxel_of`. Raises InputError where there is no surface, or
    the voxels would be too many.
    Source: Curless and Levoy, "A Volumetric Method for Building Complex Models from Range Images" (1996); outlines as Laurentini (1994).
    """
    import trimesh
    from scipy.ndimage import binary_dilation
    from skimage.measure import marching_cubes

    side = voxel_of(views) if voxel is None else voxel
    if not (np.isfinite(side) and side > 0):
        raise InputError(f"the side of a voxel must be a positive number of mm, got {side!r}")
    count = 2 * int(np.ceil(ball.radius / side + TRUNCATION)) + 1
    if count**3 > MAX_VOXELS:
        raise InputError(
            f"voxels of {side:g} mm are {count**3 / 1e6:.0f} million, more than {MAX_VOXELS / 1e6:.0f}; take larger ones"
        )
    origin = ball.centre - side * (count - 1) / 2
    total, weight = np.zeros((count,) * 3, np.float32), np.zeros((count,) * 3, np.float32)
    limit = TRUNCATION * side
    for view, surface in zip(views, surfaces, strict=True):
        facing = surface.facing(view)
        used = np.isfinite(surface.depth) & (facing >= LEAST_FACING)
        depth = np.where(used, surface.depth, np.nan).astype(np.float32)
        integrate(
            total, weight, origin, side, limit, view.K @ view.to_opencv, depth, np.where(used, facing, 0).astype(np.float32)
        )
    known = weight > 0
    field = np.where(known, total / np.where(known, weight, 1), limit).astype(np.float32)
    for view in views:
        carve(field, known, origin, side, limit, view.K @ view.to_opencv, binary_dilation(view.capture.mask, iterations=RIM))
    if not known.any() or not (field[known].min() < 0 < field[known].max()):
        raise InputError("the views have no surface in common: are the poses and the scale right?")
    vertices, faces, _, _ = marching_cubes(field, 0.0, spacing=(side,) * 3, mask=_whole(known))
    mesh = trimesh.Trimesh(vertices.astype(np.float64) + origin, faces, process=False)
    mesh = without_debris(mesh)
    mesh.visual.vertex_colors = _colours(mesh, views, surfaces, limit)
    return mesh


def _whole(known: Bools) -> Bools:
    """Cells of which all eight corners are known, each at its last corner: there marching cubes looks a cell up."""
    whole = known.copy()
    for axis in range(3):
        along = np.moveaxis(whole, axis, 0)
        along[1:] &= along[:-1].copy()
    return whole


def without_debris(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh without connected parts of less than `SMALLEST_PART` of its triangles."""
    import trimesh
    from trimesh.graph import connected_component_labels

    part = connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    size = np.bincount(part)
    kept = mesh.faces[size[part] >= SMALLEST_PART * len(mesh.faces)]
    used, index = np.unique(kept, return_inverse=True)
    return trimesh.Trimesh(mesh.vertices[used], index.reshape(-1, 3), process=False)


def _colours(mesh: trimesh.Trimesh, views: Sequence[View], surfaces: Sequence[Surface], limit: float) -> NDArray[np.uint8]:
    """(V, 4) sRGB of the albedo that the views show at each vertex, those that look at it straight counting most; black where none does."""
    from gen.srgb import linear_to_srgb

    vertices: Doubles = np.asarray(mesh.vertices)
    total, weight = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for view, surface in zip(views, surfaces, strict=True):
        x, y, z = view.project(vertices)
        seen = np.abs(sampled(surface.depth, x, y) - z) <= limit
        w = np.where(seen, np.nan_to_num(sampled(surface.facing(view), x, y)) ** 2, 0)
        for c in range(3):
            total[:, c] += w * np.nan_to_num(sampled(surface.albedo[..., c], x, y))
        weight += w
    albedo = total / np.maximum(weight, 1e-12)[:, None]
    white = float(np.percentile(albedo.max(axis=1), 99)) or 1.0
    rgb = np.rint(255 * linear_to_srgb(np.clip(albedo / white, 0, 1)))
    return np.concatenate([rgb, np.full((len(rgb), 1), 255)], axis=1).astype(np.uint8)
