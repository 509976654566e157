"""What a camera sees of a mesh, and which camera saw given points."""

from __future__ import annotations

import numpy as np
import pytest

from gen.errors import InputError
from recon.inspection.nominal import Surface
from recon.inspection.pose import Pose, rotation_of
from recon.inspection.regions import outline, regions
from recon.inspection.view import View, seen, view_of
from tests.recon.inspection.parts import surface

ORTHOGRAPHIC = View((40, 50), (23.0, 21.5), 0.4)
PERSPECTIVE = View((40, 50), (23.0, 21.5), 0.4, (200.0, 210.0), 80.0)


def soup(seed: int) -> Surface:
    """Triangles of all sizes in a box of 16 mm."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-8, 8, (40, 1, 3)) + rng.normal(0, 3, (40, 3, 3))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Surface(corners.reshape(-1, 3), np.arange(120).reshape(-1, 3), normals.repeat(3, axis=0), "soup", "mm")


@pytest.mark.parametrize("view", [ORTHOGRAPHIC, PERSPECTIVE], ids=["orthographic", "perspective"])
def test_what_is_seen_is_the_nearest_hit_of_every_ray(view: View) -> None:
    """Against the intersection of each ray with each triangle (Moeller and Trumbore 1997), all at once."""
    mesh = soup(3)
    found = seen(mesh, Pose(), view)
    rows, columns = (v.ravel() for v in np.mgrid[:40, :50])
    origin, toward = view.rays(rows, columns)
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    d = -toward[:, None]
    p = np.cross(d, (c - a)[None])
    det = (p * (b - a)).sum(-1)
    s = origin[:, None] - a
    u = (s * p).sum(-1) / det
    q = np.cross(s, (b - a)[None])
    v, t = (d * q).sum(-1) / det, (q * (c - a)).sum(-1) / det
    t = np.where((u >= 0) & (v >= 0) & (u + v <= 1), t, np.inf).min(axis=1)
    hit = np.isfinite(t)
    assert 0.3 < hit.mean() < 0.99
    assert (found.inside.ravel() == hit).mean() > 0.999
    both = found.inside.ravel() & hit
    expected = origin[both] - t[both, None] * toward[both]
    assert np.abs(found.points.reshape(-1, 3)[both] - expected).max() < 1e-6
    assert (found.cosine[found.inside] >= 0).all()


@pytest.mark.parametrize("view", [ORTHOGRAPHIC, PERSPECTIVE], ids=["orthographic", "perspective"])
def test_the_view_is_found_from_the_points(view: View) -> None:
    there = seen(surface("sphere", radius=7), Pose(rotation_of(np.array([0.3, 0.2, 0.1])), np.array([0, 0, 2.0])), view)
    points = np.where(there.inside[..., None], there.points, np.nan).astype(np.float32)
    found = view_of(points, "test")
    assert found.centre == pytest.approx(view.centre, abs=0.01)
    assert found.step == pytest.approx(view.step, rel=1e-3)
    if view.focal is None:
        assert found.focal is None
    else:
        assert found.focal == pytest.approx(view.focal, rel=5e-3)
        assert found.distance == pytest.approx(view.distance, rel=5e-3)
    for changed in (view.coarser(2), view.finer(3)):
        by = changed.step / view.step
        at = np.array([[1.0, -2.0, 0.5]])
        a, b = view.project(at)[0, :2], changed.project(at)[0, :2]
        assert (b + 0.5) * by - 0.5 == pytest.approx(a)


def test_points_of_no_camera_are_refused() -> None:
    points = np.random.default_rng(0).normal(size=(20, 20, 3))
    with pytest.raises(InputError, match="one camera's pixels"):
        view_of(points, "junk")


def test_regions_end_at_hidden_steps_and_not_at_creases() -> None:
    """A shaft from its side is three cylinders with steps between; a box from its corner is three faces with creases."""
    view = View((80, 80), (39.5, 39.5), 0.7)
    shaft = seen(surface("stepped_shaft"), Pose(), view)
    assert np.bincount(regions(shaft, shaft.inside, view.step).ravel())[1:].size == 3
    box = seen(surface("rounded_box"), Pose(rotation_of(np.array([0.6, 0.5, 0.2]))), view)
    assert regions(box, box.inside, view.step).max() == 1


def test_the_outline_runs_between_the_pixels() -> None:
    row, column = np.mgrid[:60, :60]
    disc = (row - 29) ** 2 + (column - 31) ** 2 < 20**2
    _, points, outward = outline(disc)
    radius = points - [29, 31]
    assert np.abs(np.linalg.norm(radius, axis=1) - 20).max() < 1.1
    assert ((radius[:, ::-1] / 20 * outward).sum(axis=1) > 0.97).all()
    assert not len(outline(np.ones((5, 5), bool))[1])
