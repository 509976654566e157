"""Views: captures of one object from several sides, and where the camera of each stood.

    cameras.json      {"format": "degloss views", "version": 1, "unit": "mm",
                       "views": [{"capture": "items/ring-000000", "object_to_camera": [[...], [...], [...], [0, 0, 0, 1]]}, ...]}

The matrix takes a point of the object, in millimetres, to the camera's frame: x right, y up, z to the viewer, the camera at the origin,
so that what it sees has a negative z. A set of ours needs no such file: its renders say how the object was turned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Scale, read_capture
from gen.errors import InputError
from gen.files import inside, read_json, write_json

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

CAMERAS = "cameras.json"
FORMAT = "degloss views"
VERSION = 1
MAX_VIEWS = 1000

OPENCV = np.diag([1.0, -1.0, -1.0])
"""From our camera frame to OpenCV's (y down, z forward), and back."""


@dataclass(frozen=True, eq=False)
class View:
    """A capture and its camera. pose: (4, 4) from the object's frame to the camera's, in millimetres."""

    name: str
    capture: Capture
    pose: Doubles

    @property
    def K(self) -> Doubles:
        """(3, 3) OpenCV intrinsics."""
        assert self.capture.scale.camera is not None
        return self.capture.scale.camera

    @property
    def rotation(self) -> Doubles:
        """(3, 3) from the object's frame to the camera's."""
        return self.pose[:3, :3]

    @property
    def centre(self) -> Doubles:
        """(3,) where the camera stands, in the object's frame."""
        place: Doubles = -self.rotation.T @ self.pose[:3, 3]
        return place

    @property
    def to_opencv(self) -> Doubles:
        """(3, 4) from the object's frame to OpenCV's camera frame."""
        matrix: Doubles = OPENCV @ self.pose[:3]
        return matrix

    def rays(self) -> Doubles:
        """(H, W, 3) OpenCV camera frame: the direction that each pixel looks in, of unit depth."""
        rows, columns = np.indices(self.capture.size)
        pixels = np.stack([columns, rows, np.ones(self.capture.size)], axis=-1)
        directions: Doubles = pixels @ np.linalg.inv(self.K).T
        return directions

    def points(self, depth: NDArray[Any]) -> Doubles:
        """(H, W, 3) the points at these depths in mm (H, W), in the object's frame; NaN where the depth is."""
        seen = self.rays() * depth[..., None].astype(np.float64)
        points: Doubles = (seen @ OPENCV - self.pose[:3, 3]) @ self.rotation
        return points

    def project(self, points: Doubles) -> tuple[Doubles, Doubles, Doubles]:
        """Column, row and depth (...) of points (..., 3) of the object's frame; NaN columns and rows behind the camera."""
        P = self.K @ self.to_opencv
        image = points @ P[:, :3].T + P[:, 3]
        depth = image[..., 2]
        safe = np.where(depth > 0, depth, np.nan)
        return image[..., 0] / safe, image[..., 1] / safe, depth


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball around the object, from its outlines: centre (3,) and radius in mm, object's frame."""

    centre: Doubles
    radius: float


def ball_of(views: Sequence[View]) -> Ball:
    """The ball that the outlines of the views put around the object.

    Its centre is the point nearest to the rays through the middles of the masks; its radius is the distance from there of the mask's
    farthest pixel, at the centre's depth, in the view where that is largest. Raises InputError where the views do not look at one thing.
    """
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for view in views:
        rays = view.rays()[view.capture.mask]
        middle = (rays.min(axis=0) + rays.max(axis=0)) / 2
        toward = view.rotation.T @ OPENCV @ (middle / np.linalg.norm(middle))
        across = np.eye(3) - np.outer(toward, toward)
        normal, right = normal + across, right + across @ view.centre
    if np.linalg.cond(normal) > 1e6:
        raise InputError("the views all look from one side: their cameras must stand apart to tell how far the object is")
    centre = np.linalg.solve(normal, right)
    radius = 0.0
    for view in views:
        seen = view.to_opencv[:, :3] @ centre + view.to_opencv[:, 3]
        if seen[2] <= 0:
            raise InputError(f"view {view.name}: the object would be behind its camera; check object_to_camera (z to the viewer)")
        rays = view.rays()[view.capture.mask]
        radius = max(radius, float(np.linalg.norm(rays[:, :2] * seen[2] - seen[:2], axis=1).max()))
    if any(np.linalg.norm(view.centre - centre) < 1.2 * radius for view in views):
        raise InputError("the views do not look at one object: their outlines do not meet; check the poses and the masks")
    return Ball(centre, radius)


def views_of(captures: Sequence[Capture], poses: Sequence[Doubles], names: Sequence[str]) -> tuple[tuple[View, ...], Ball]:
    """Checked views, and the ball around the object; the captures' distances become those to the ball's centre.

    poses: (4, 4) each, from the object's frame to the camera's in mm. Raises InputError where there are fewer than two, a camera is
    not a perspective one, or a pose is not a rigid motion.
    """
    if not 2 <= len(captures) <= MAX_VIEWS:
        raise InputError(f"multi-view needs from 2 to {MAX_VIEWS} views, there are {len(captures)}")
    views = []
    for name, capture, pose in zip(names, captures, poses, strict=True):
        if capture.scale.camera is None:
            raise InputError(f"view {name}: its capture has no camera K; multi-view needs a perspective camera")
        if capture.mask.all():
            raise InputError(f"view {name}: its mask covers the whole picture; multi-view needs the object's outline")
        R = pose[:3, :3]
        rigid = np.isfinite(pose).all() and np.allclose(R @ R.T, np.eye(3), atol=1e-5) and np.linalg.det(R) > 0
        if not rigid or not np.allclose(pose[3], [0, 0, 0, 1]):
            raise InputError(f"view {name}: object_to_camera is not a rotation and a shift (last row 0 0 0 1)")
        views.append(View(name, capture, pose))
    ball = ball_of(views)
    return tuple(_at_distance(view, ball) for view in views), ball


def _at_distance(view: View, ball: Ball) -> View:
    """The view with the distance of the ball's centre along its axis as the scale's."""
    distance = float((view.to_opencv[:, :3] @ ball.centre + view.to_opencv[:, 3])[2])
    return replace(view, capture=replace(view.capture, scale=Scale(camera=view.K, distance_mm=distance)))


def read_views(folder: Path) -> tuple[tuple[View, ...], Ball]:
    """The views of a folder: those of its `cameras.json`, or else the captures of a rendered set, whose records say their poses.

    Raises InputError, one line, where a file is missing, damaged or contradictory, or a render was not of a perspective camera.
    """
    if (folder / CAMERAS).is_file():
        names, poses = _read_cameras(folder)
        return views_of([read_capture(inside(folder, name)) for name in names], poses, names)
    from gen.sets.set_folder import RENDERED, SetFolder, is_set_folder

    if not folder.is_dir() or not is_set_folder(folder):
        raise InputError(f"{folder}: holds no {CAMERAS} and is no rendered set; it must say where the camera of each view stood")
    rendered = SetFolder(folder)
    names = [str(row["id"]) for row in rendered.rows() if row["status"] == RENDERED]
    captures = [read_capture(rendered.item_folder(name)) for name in names]
    return views_of(captures, [pose_of_render(capture) for capture in captures], names)


def pose_of_render(capture: Capture) -> Doubles:
    """(4, 4) object to camera in mm, from what a render of ours says of itself. Raises InputError where it does not."""
    from gen.spec import spec_from

    said = capture.provenance.get("spec")
    if not isinstance(said, Mapping):
        raise InputError(f"{capture.source}: does not say how the object was turned; write its pose into {CAMERAS}")
    spec = spec_from(dict(said), capture.source)
    pose = np.eye(4)
    pose[:3, :3] = spec.pose.matrix()
    pose[:3, 3] = np.array(spec.pose.translation_mm) - [0, 0, spec.camera.distance_mm]
    return pose


def write_cameras(folder: Path, names: Sequence[str], poses: Sequence[Doubles]) -> None:
    """Write `cameras.json`. names: the captures' paths in the folder. poses: (4, 4) each, object to camera in mm."""
    views = [{"capture": name, "object_to_camera": pose} for name, pose in zip(names, poses, strict=True)]
    write_json(folder / CAMERAS, {"format": FORMAT, "version": VERSION, "unit": "mm", "views": views})


def _read_cameras(folder: Path) -> tuple[list[str], list[Doubles]]:
    where = folder / CAMERAS
    said = read_json(where, "the cameras of views")
    if not isinstance(said, dict) or said.get("format") != FORMAT:
        raise InputError(f"{where}: does not hold the cameras of views (format '{FORMAT}')")
    if said.get("version") != VERSION:
        raise InputError(f"{where}: has version {said.get('version')!r}, this program reads {VERSION}")
    if said.get("unit") != "mm":
        raise InputError(f"{where}: unit must be mm, got {said.get('unit')!r}")
    views = said.get("views")
    if not isinstance(views, list) or not all(isinstance(view, dict) and isinstance(view.get("capture"), str) for view in views):
        raise InputError(f"{where}: views must be a list of objects with capture and object_to_camera")
    if len(views) > MAX_VIEWS:
        raise InputError(f"{where}: lists {len(views)} views, at most {MAX_VIEWS} are read")
    names = [view["capture"] for view in views]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{where}: the capture {twice} is there twice")
    poses = []
    for name, view in zip(names, views, strict=True):
        try:
            pose = np.array(view.get("object_to_camera"), dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            pose = np.empty(0)
        if pose.shape != (4, 4):
            raise InputError(f"{where}: {name}: object_to_camera must be a 4x4 matrix of numbers")
        poses.append(pose)
    return names, poses
