"""The mesh: right way round, at the right scale, and readable by others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gen.capture import Scale
from gen.errors import InputError
from recon.mesh import surface_mesh, write_mesh
from recon.registry import HEIGHT


def half_sphere(size: int = 65, mm_per_pixel: float = 0.5) -> tuple[np.ndarray, np.ndarray, float]:
    row, column = np.mgrid[:size, :size].astype(float)
    x, y = column - (size - 1) / 2, (size - 1) / 2 - row
    R = 0.45 * size
    mask = x**2 + y**2 < (0.9 * R) ** 2
    n = np.stack([x, y, np.sqrt(np.where(mask, R**2 - x**2 - y**2, 0))], -1) / R * mask[..., None]
    result = HEIGHT.load("quadratic")(n.astype(np.float32), mask, Scale(mm_per_pixel=mm_per_pixel))
    return result.points, n.astype(np.float32), R * mm_per_pixel / 1000


def test_faces_look_at_the_camera_and_agree_with_the_normals() -> None:
    points, normal, _ = half_sphere()
    mesh = surface_mesh(points, normal)
    assert (mesh.face_normals[:, 2] > 0).all()
    assert (np.sum(mesh.face_normals * mesh.vertex_normals[mesh.faces[:, 0]], axis=1) > 0.9).all()


def test_scale_and_place() -> None:
    points, normal, radius = half_sphere()
    mesh = surface_mesh(points, normal)
    assert mesh.extents[0] == pytest.approx(2 * 0.9 * radius, rel=0.03)
    A = np.concatenate([2 * mesh.vertices, np.ones((len(mesh.vertices), 1))], axis=1)
    fit = np.linalg.lstsq(A, (mesh.vertices**2).sum(axis=1), rcond=None)[0]
    assert np.sqrt(fit[3] + fit[:3] @ fit[:3]) == pytest.approx(radius, rel=1e-3)
    assert np.abs(fit[:2]).max() < 1e-3 * radius


def test_corners_with_three_points_get_one_triangle() -> None:
    points = np.zeros((2, 2, 3), np.float32)
    points[..., 0] = [[0, 1], [0, 1]]
    points[..., 1] = [[1, 1], [0, 0]]
    assert len(surface_mesh(points).faces) == 2
    for r in range(2):
        for c in range(2):
            cut = points.copy()
            cut[r, c] = np.nan
            mesh = surface_mesh(cut)
            assert len(mesh.faces) == 1
            assert mesh.face_normals[0, 2] == pytest.approx(1)
    with pytest.raises(InputError, match="no triangle"):
        surface_mesh(np.full((2, 2, 3), np.nan, np.float32))


@pytest.mark.parametrize("ending", ["ply", "glb"])
def test_files_read_back(tmp_path: Path, ending: str) -> None:
    points, normal, _ = half_sphere(33)
    albedo = np.full_like(points, 0.2)
    albedo[..., 0] = 0.8
    mesh = surface_mesh(points, normal, albedo)
    write_mesh(mesh, tmp_path / f"mesh.{ending}", "m")
    back = trimesh.load(tmp_path / f"mesh.{ending}", force="mesh", process=False)
    assert np.allclose(back.vertices, mesh.vertices, atol=1e-7)
    assert len(back.faces) == len(mesh.faces)
    assert back.volume == pytest.approx(mesh.volume, rel=1e-4)
    red = back.visual.vertex_colors[:, 0].astype(int)
    assert (red == 255).all()
    assert [p.name for p in tmp_path.iterdir()] == [f"mesh.{ending}"]
    data = (tmp_path / f"mesh.{ending}").read_bytes()
    assert (b"comment unit m\n" if ending == "ply" else b'"unit":"m"') in data
