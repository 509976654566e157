"""Parts to inspect, made without a renderer: a nominal surface seen in a known pose, with a known dent and a known drift."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import trimesh

from blender_scenes.shapes import build
from gen.mesh_normals import smoothed
from recon.inspection.measured import Measured, measured_from
from recon.inspection.nominal import Surface
from recon.inspection.pose import Pose
from recon.inspection.view import View, seen


def triangles(name: str, **values: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a named shape, mm."""
    mesh = build(name, **values)
    faces = mesh.faces.astype(np.int64)
    return mesh.vertices, faces if faces.shape[1] == 3 else np.vstack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])


@cache
def surface(name: str, **values: float) -> Surface:
    vertices, faces, normals = smoothed(*triangles(name, **values), 30.0)
    return Surface(vertices, faces, normals, f"{name}.stl", "mm, as given")


def write_stl(path: Path, name: str, **values: float) -> Path:
    trimesh.Trimesh(*triangles(name, **values), process=False).export(path)
    return path


def seen_part(
    nominal: Surface,
    rotation: np.ndarray,
    size: int = 112,
    dent: tuple[float, float, float, float] | None = None,
    bowl: float = 0.0,
    unit: str = "m",
    uncertainty: float = 0.5,
) -> tuple[Measured, Pose, float]:
    """A measurement of the nominal, its true pose (camera frame in the measurement's unit), and the mm a pixel.

    dent: x, y, depth along the view and sigma, mm. bowl: mm that the height drifts from the middle to the end of the longest side.
    """
    step = nominal.size * 1.15 / size
    view = View((size, size), ((size - 1) / 2, (size - 1) / 2), step)
    pose = Pose(rotation, np.array([0.7, -0.4, 0.0]))
    there = seen(nominal, pose, view)
    points = np.where(there.inside[..., None], there.points, np.nan)
    x, y = points[..., 0].copy(), points[..., 1].copy()
    if dent is not None:
        points[..., 2] -= dent[2] * np.exp(-((x - dent[0]) ** 2 + (y - dent[1]) ** 2) / (2 * dent[3] ** 2))
    points[..., 2] += bowl * (x**2 + y**2) / (nominal.size / 2) ** 2
    per = 1000.0 if unit == "m" else step
    measured = measured_from(points / per, there.normal, np.full((size, size), uncertainty), unit, "part")
    k = 1.0 if unit == "m" else 1 / step
    return measured, Pose(rotation, k * pose.translation, k), step
