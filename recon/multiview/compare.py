"""How well a mesh agrees with the true surface: accuracy, completeness, normals, in millimetres and degrees.

Source: Seitz et al., "A Comparison and Evaluation of Multi-View Stereo Reconstruction Algorithms" (2006): accuracy is the distance from
the result to the truth, completeness that from the truth to the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from recon.mesh import surface_mesh
from recon.multiview.views import Doubles, View

if TYPE_CHECKING:
    import trimesh

SAMPLES = 50_000
"""Points drawn on a surface."""

CANDIDATES = 8
"""Nearest points whose triangles are tried for the nearest."""

TOLERANCE = 0.25
"""Mm within which a share is reported, where nobody says another."""

STEEP = 0.12
"""Cosine toward the camera under which a true triangle is left out: there pixels are too far apart, or across an edge of the object."""


def true_surface(views: Sequence[View]) -> trimesh.Trimesh | None:
    """The true surface that the views show, from their captures' true depth; None where one has none.

    It is made of the triangles between pixels of every view, in the object's frame, in mm, so it overlaps itself; what no view shows is
    not part of it. Triangles seen at a cosine under `STEEP` are left out.
    """
    import trimesh

    parts = []
    for view in views:
        depth = view.capture.truth.depth
        if depth is None:
            return None
        points = view.points(np.where(view.capture.mask, 1000.0 * depth, np.nan))
        mesh = surface_mesh(points.astype(np.float32))
        toward = view.centre - mesh.triangles_center
        cosine = np.einsum("fk,fk->f", mesh.face_normals, toward) / np.linalg.norm(toward, axis=1)
        mesh.update_faces(cosine >= STEEP)
        parts.append(mesh)
    whole: trimesh.Trimesh = trimesh.util.concatenate(parts)
    return whole


def compare(mesh: trimesh.Trimesh, truth: trimesh.Trimesh, tolerance: float = TOLERANCE, seed: int = 0) -> dict[str, Any]:
    """Figures of a mesh against the true surface, both in mm in one frame.

    "accuracy" and "completeness": mean, median and 95th percentile in mm, and the share within the tolerance in percent. "chamfer": the
    mean of the two means. "f score": the harmonic mean of the two shares. "normals": mean and median angle in degrees between the true
    faces' normals and those of the mesh at the nearest point, over the true surface within the tolerance. seed: of the points drawn.
    Raises InputError where either has no area.
    """
    there, _ = _drawn(mesh, seed)
    wanted, faces = _drawn(truth, seed)
    wanted, faces = _thinned(wanted, faces, spacing=float(np.sqrt(mesh.area / SAMPLES)))
    to_truth, _ = nearest(there, truth, seed + 1)
    to_mesh, found = nearest(wanted, mesh, seed + 1)
    within = to_mesh <= tolerance
    cosine = np.einsum("nk,nk->n", truth.face_normals[faces[within]], mesh.face_normals[found[within]])
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    accuracy, completeness = _summary(to_truth, tolerance), _summary(to_mesh, tolerance)
    a, c = accuracy["within"], completeness["within"]
    return {
        "tolerance": tolerance,
        "accuracy": accuracy,
        "completeness": completeness,
        "chamfer": (accuracy["mean"] + completeness["mean"]) / 2,
        "f score": 2 * a * c / (a + c) if a + c > 0 else 0.0,
        "normals": {"mean": float(angle.mean()), "median": float(np.median(angle))} if within.any() else None,
    }


def nearest(points: Doubles, mesh: trimesh.Trimesh, seed: int = 0) -> tuple[Doubles, NDArray[np.intp]]:
    """Distance (N,) of each point (N, 3) to the mesh and the triangle (N,) that is nearest.

    The distance is exactly that to the nearest of the triangles to which the `CANDIDATES` nearest points belong, of all triangles' middles
    (which find small triangles) and of many points drawn by area (which find large ones).
    """
    from scipy.spatial import cKDTree
    from trimesh.triangles import closest_point

    triangles = np.asarray(mesh.triangles)
    drawn, of = _drawn(mesh, seed)
    faces = np.concatenate([np.arange(len(triangles)), of])
    _, near = cKDTree(np.concatenate([triangles.mean(axis=1), drawn])).query(points, CANDIDATES)
    best, which = np.full(len(points), np.inf), np.zeros(len(points), np.intp)
    for column in np.asarray(near).T:
        face = faces[column]
        distance = np.linalg.norm(closest_point(triangles[face], points) - points, axis=1)
        closer = distance < best
        best[closer], which[closer] = distance[closer], face[closer]
    return best, which


def _drawn(mesh: trimesh.Trimesh, seed: int) -> tuple[Doubles, NDArray[np.intp]]:
    """`SAMPLES` points drawn on a mesh evenly by area, and the triangle of each."""
    rng = np.random.default_rng(seed)
    area = np.asarray(mesh.area_faces)
    if not area.sum() > 0:
        raise InputError("a mesh without area cannot be compared")
    faces = np.sort(rng.choice(len(area), SAMPLES, p=area / area.sum()))
    u, v = rng.random((2, SAMPLES, 1))
    over = u + v > 1
    u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
    a, b, c = np.moveaxis(np.asarray(mesh.triangles)[faces], 1, 0)
    points: Doubles = a + u * (b - a) + v * (c - a)
    return points, faces


def _thinned(points: Doubles, faces: NDArray[np.intp], spacing: float) -> tuple[Doubles, NDArray[np.intp]]:
    """One point of each cube of that side: what several views show must not count several times."""
    _, first = np.unique(np.floor(points / spacing).astype(np.int64), axis=0, return_index=True)
    return points[first], faces[first]


def _summary(distance: Doubles, tolerance: float) -> dict[str, float]:
    return {
        "mean": float(distance.mean()),
        "median": float(np.median(distance)),
        "95 %": float(np.percentile(distance, 95)),
        "within": 100 * float((distance <= tolerance).mean()),
    }
