"""The view of a measurement, found from its own points, and what of a mesh is seen in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from recon.inspection.nominal import Surface
from recon.inspection.pose import Pose
from recon.normals.compiled import compiled

Doubles = NDArray[np.float64]
Bools = NDArray[np.bool_]

ON_GRID = 0.05
"""Pixels by which points may miss the pixel grid that they are said to stand on."""


@dataclass(frozen=True)
class View:
    """How pixels look at the camera frame (x right, y up, z to the viewer).

    size: (H, W). centre: (column, row) of the axis. step: lengths a pixel, at the middle where the view is perspective.
    focal: (x, y) in pixels, None: orthographic. distance: from the camera to z = 0 where perspective.
    """

    size: tuple[int, int]
    centre: tuple[float, float]
    step: float
    focal: tuple[float, float] | None = None
    distance: float = 0.0

    def project(self, points: Doubles) -> Doubles:
        """(N, 3) of column, row and a key that is linear across the picture and larger for what is nearer. NaN behind the camera."""
        x, y, z = points.T
        if self.focal is None:
            return np.stack([x / self.step + self.centre[0], self.centre[1] - y / self.step, z], axis=1)
        depth = np.where(z < self.distance, self.distance - z, np.nan)
        return np.stack(
            [self.focal[0] * x / depth + self.centre[0], self.centre[1] - self.focal[1] * y / depth, 1 / depth], axis=1
        )

    def rays(self, rows: NDArray[Any], columns: NDArray[Any]) -> tuple[Doubles, Doubles]:
        """A point on the ray of each pixel, and the unit direction toward the viewer, (N, 3) each. rows, columns: (N,)."""
        x, y = columns - self.centre[0], self.centre[1] - rows
        zero = np.zeros(len(rows))
        if self.focal is None:
            return np.stack([x * self.step, y * self.step, zero], axis=1), np.stack([zero, zero, zero + 1], axis=1)
        away = np.stack([x / self.focal[0], y / self.focal[1], zero - 1], axis=1)
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        return np.tile([0.0, 0.0, self.distance], (len(rows), 1)), -away

    def coarser(self, by: int) -> View:
        """The view of blocks of `by` x `by` pixels; a part of a block at the far edges is a whole one."""
        H, W = (-(-n // by) for n in self.size)
        cx, cy = ((c - (by - 1) / 2) / by for c in self.centre)
        focal = None if self.focal is None else (self.focal[0] / by, self.focal[1] / by)
        return replace(self, size=(H, W), centre=(cx, cy), step=self.step * by, focal=focal)

    def finer(self, by: int) -> View:
        """The view with every pixel cut into `by` x `by`."""
        H, W = (n * by for n in self.size)
        cx, cy = (c * by + (by - 1) / 2 for c in self.centre)
        focal = None if self.focal is None else (self.focal[0] * by, self.focal[1] * by)
        return replace(self, size=(H, W), centre=(cx, cy), step=self.step / by, focal=focal)


def view_of(points: NDArray[Any], source: str) -> View:
    """The view that puts each point (H, W, 3; NaN where there is none) onto its own pixel.

    Orthographic where x and y do not depend on z, else a pinhole, from x f + z (c - c0) = d (c - c0), which is linear in what is sought.
    Raises InputError where the points stand on no pixel grid.
    """
    known = np.isfinite(points).all(axis=2)
    if known.sum() < 16:
        raise InputError(f"{source}: fewer than 16 pixels were measured; there is nothing to compare")
    rows, columns = (v.astype(np.float64) for v in np.nonzero(known))
    x, y, z = points[known].astype(np.float64).T
    one = np.ones(len(x))
    line = np.stack([one, -one], axis=1)
    line[:, 0] = columns
    (step, shift), *_ = np.linalg.lstsq(line, x, rcond=None)
    (step_y, shift_y), *_ = np.linalg.lstsq(np.stack([-rows, one], axis=1), y, rcond=None)
    if step > 0 and abs(step_y - step) < 1e-3 * step:
        view = View(known.shape, (shift / step, shift_y / step_y), float(step))
        if _misses(view, points[known], rows, columns) < ON_GRID:
            return view
    (ax, bx, cx, _), *_ = np.linalg.lstsq(np.stack([columns, -columns * z, -one, z], axis=1), x, rcond=None)
    (ay, by, cy, _), *_ = np.linalg.lstsq(np.stack([-rows, rows * z, one, -z], axis=1), y, rcond=None)
    if bx > 0 and by > 0:
        distance = (ax / bx + ay / by) / 2
        view = View(known.shape, (cx / ax, cy / ay), float(distance * bx), (1 / bx, 1 / by), float(distance))
        if _misses(view, points[known], rows, columns) < ON_GRID:
            return view
    raise InputError(f"{source}: its points do not stand on the rays of one camera's pixels; measure it again")


def _misses(view: View, points: Doubles, rows: Doubles, columns: Doubles) -> float:
    """The largest distance in pixels of a point from its pixel."""
    seen = view.project(points.astype(np.float64))
    missed = np.hypot(seen[:, 0] - columns, seen[:, 1] - rows)
    return float(missed.max()) if np.isfinite(missed).all() else np.inf


@dataclass(frozen=True, eq=False)
class Seen:
    """The part of a surface that the view shows. inside: (H, W). points, normal: (H, W, 3), zero outside; normals face the viewer.

    toward: (H, W, 3) unit directions to the viewer. cosine: (H, W) between normal and `toward`, 0 outside.
    """

    inside: Bools
    points: Doubles
    normal: Doubles
    toward: Doubles
    cosine: Doubles


def seen(surface: Surface, pose: Pose, view: View) -> Seen:
    """What the view shows of a surface in that pose: exactly where each pixel's ray meets the nearest face."""
    face = faces_seen(surface, pose, view)
    inside = face >= 0
    rows, columns = np.nonzero(inside)
    points, normal, toward = struck(surface, pose, view, face[inside], rows, columns)
    whole = [np.zeros((*inside.shape, 3)) for _ in range(3)]
    for array, values in zip(whole, (points, normal, toward), strict=True):
        array[inside] = values
    return Seen(inside, whole[0], whole[1], whole[2], np.einsum("hwk,hwk->hw", whole[1], whole[2]))


def faces_seen(surface: Surface, pose: Pose, view: View) -> NDArray[np.int64]:
    """(H, W) the number of the nearest face behind each pixel's centre, -1 where there is none."""
    face = np.full(view.size, -1, np.int64)
    _rasterise(view.project(pose.apply(surface.vertices)), surface.faces, face, np.full(view.size, -np.inf))
    return face


def struck(
    surface: Surface, pose: Pose, view: View, face: NDArray[np.int64], rows: NDArray[Any], columns: NDArray[Any]
) -> tuple[Doubles, Doubles, Doubles]:
    """Where rays meet given faces: the points, the interpolated normals facing the viewer, the directions to the viewer, (N, 3) each."""
    corners = surface.faces[face]
    a, b, c = (pose.apply(surface.vertices[corners[:, i]]) for i in range(3))
    origin, toward = view.rays(rows, columns)
    plane = np.cross(b - a, c - a)
    slope = np.einsum("nk,nk->n", toward, plane)
    slope = np.where(np.abs(slope) < 1e-12 * np.linalg.norm(plane, axis=1), np.nan, slope)
    points = origin + toward * (np.einsum("nk,nk->n", a - origin, plane) / slope)[:, None]
    points = np.where(np.isfinite(points), points, (a + b + c) / 3)  # a face on edge: hit by rounding alone
    area = np.maximum(np.einsum("nk,nk->n", plane, plane), 1e-300)
    u = np.einsum("nk,nk->n", np.cross(b - points, c - points), plane) / area
    v = np.einsum("nk,nk->n", np.cross(c - points, a - points), plane) / area
    share = np.clip(np.stack([u, v, 1 - u - v], axis=1), 0, 1)
    normal = np.einsum("ni,nik->nk", share, surface.normals[corners]) @ pose.rotation.T
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    normal *= np.where(np.einsum("nk,nk->n", normal, toward) < 0, -1, 1)[:, None]
    return points, normal, toward


@compiled
def _rasterise(corners: Doubles, faces: NDArray[np.int64], face: NDArray[np.int64], nearest: Doubles) -> None:
    """Fill face (H, W) with the number of the nearest face at each pixel's centre. corners: (V, 3) column, row, key."""
    H, W = face.shape
    for f in range(len(faces)):
        ax, ay, az = corners[faces[f, 0], 0], corners[faces[f, 0], 1], corners[faces[f, 0], 2]
        bx, by, bz = corners[faces[f, 1], 0], corners[faces[f, 1], 1], corners[faces[f, 1], 2]
        cx, cy, cz = corners[faces[f, 2], 0], corners[faces[f, 2], 1], corners[faces[f, 2], 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if not abs(area) > 1e-12:  # on edge, or with a corner behind the camera
            continue
        left = max(0, int(np.ceil(min(ax, bx, cx))))
        right = min(W - 1, int(np.floor(max(ax, bx, cx))))
        for row in range(max(0, int(np.ceil(min(ay, by, cy)))), min(H - 1, int(np.floor(max(ay, by, cy)))) + 1):
            for column in range(left, right + 1):
                u = ((bx - column) * (cy - row) - (by - row) * (cx - column)) / area
                v = ((cx - column) * (ay - row) - (cy - row) * (ax - column)) / area
                w = 1 - u - v
                if u >= -1e-9 and v >= -1e-9 and w >= -1e-9:
                    key = u * az + v * bz + w * cz
                    if key > nearest[row, column]:
                        nearest[row, column] = key
                        face[row, column] = f
