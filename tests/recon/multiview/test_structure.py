"""Cameras found by structure from motion: against the poses of a ring in closed form, and what is refused."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Scale
from gen.errors import InputError
from recon.multiview.depth import matching_picture
from recon.multiview.structure import _scaled, solve_poses, write_solved
from recon.multiview.views import OPENCV, read_views
from tests.recon.multiview.ring import DISTANCE, capture_at, ring, turned, write_ring


def angle(rotation: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


def test_scale_and_frame_are_ours() -> None:
    """Poses in another unit, another frame and OpenCV's axes come back as rigid motions that put the points where the views see them."""
    views, ball = ring((0, 14, 28), size=48)
    other = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    other *= np.sign(np.linalg.det(other))
    shift, unit = np.array([3.0, -1.0, 2.0]), 0.01
    # A point p of the object is other @ (unit p) + shift in the foreign frame.
    matrices = [np.column_stack([OPENCV @ v.rotation @ other.T, unit * OPENCV @ v.pose[:3, 3]]) for v in views]
    matrices = [np.column_stack([m[:, :3], m[:, 3] - m[:, :3] @ shift]) for m in matrices]
    points = ball.centre + np.random.default_rng(1).uniform(-5, 5, (99, 3))
    found = _scaled(matrices, points * unit @ other.T + shift, [v.capture for v in views])
    for pose, view in zip(found, views, strict=True):
        assert angle(pose[:3, :3] @ found[0][:3, :3].T @ (view.rotation @ views[0].rotation.T).T) < 1e-4
        apart = np.linalg.norm(np.linalg.inv(pose)[:3, 3] - np.linalg.inv(found[0])[:3, 3])
        assert apart == pytest.approx(np.linalg.norm(view.centre - views[0].centre), rel=0.02)
    assert np.allclose(found[0][:3, :3], np.eye(3))
    assert found[0][2, 3] == pytest.approx(-(views[0].capture.scale.distance_mm or 0), rel=0.02)


def test_what_cannot_be_found_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    captures = [capture_at(turned(angle), 48) for angle in (0, 14, 28)]
    known = [view.capture for view in ring((0, 14, 28), size=48)[0]]
    pictures = [np.zeros((48, 48), np.uint8)] * 3
    if find_spec("pycolmap") is None:
        with pytest.raises(InputError, match="pip install pycolmap"):
            solve_poses(known, "abc", pictures)
        monkeypatch.setattr("recon.multiview.structure.find_spec", lambda name: name)
    with pytest.raises(InputError, match="at least 3 views, there are 2"):
        solve_poses(known[:2], "ab", pictures[:2])
    with pytest.raises(InputError, match="view a: finding cameras needs its camera K and distance_mm"):
        solve_poses(captures, "abc", pictures)
    with pytest.raises(InputError, match="holds no capture folders"):
        write_solved(tmp_path)
    write_ring(tmp_path, (0, 14), size=48)
    with pytest.raises(InputError, match=r"cameras.json: is there already"):
        write_solved(tmp_path)


@pytest.mark.skipif(find_spec("pycolmap") is None, reason="pycolmap is not installed")
def test_the_ring_is_found_again(tmp_path: Path) -> None:
    angles = (0, 12, 24, 36, 48)
    views, _ = ring(angles, size=160)
    pictures = [matching_picture(view, view.capture.truth.albedo) for view in views]
    solved = solve_poses([view.capture for view in views], [view.name for view in views], pictures)
    assert solved.error < 0.5
    for view, pose in zip(views, solved.poses, strict=True):
        apart = pose[:3, :3] @ solved.poses[0][:3, :3].T @ (view.rotation @ views[0].rotation.T).T
        assert angle(apart) < 3
    blank = [np.where(view.capture.mask, 128, 0).astype(np.uint8) for view in views]
    with pytest.raises(InputError, match="could not be found"):
        solve_poses([view.capture for view in views], [view.name for view in views], blank)


@pytest.mark.skipif(find_spec("pycolmap") is None, reason="pycolmap is not installed")
def test_found_cameras_are_read_like_given_ones(tmp_path: Path) -> None:
    from dataclasses import replace

    from gen.formats.render_folder import write_render

    for number in (0, 12, 24):
        capture = capture_at(turned(number), 160)
        scale = Scale(camera=capture.scale.camera, distance_mm=DISTANCE)
        write_render(replace(capture, scale=scale), tmp_path / f"{number:02d}")
    write_solved(tmp_path, "none")
    views, ball = read_views(tmp_path)
    assert [view.name for view in views] == ["00", "12", "24"]
    assert 12 < ball.radius < 22
