"""`Mesh.is_convex` against the convex hull."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from blender_scenes.shapes import CONVEX, SHAPES, Mesh, build, sample


def fills_its_hull(mesh: Mesh) -> bool:
    """Whether the volume within the faces is that of the hull of the vertices, to 1e-9 (scipy's Qhull)."""
    faces = mesh.faces if mesh.faces.shape[1] == 3 else mesh.faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    a, b, c = np.moveaxis(mesh.vertices[faces], 1, 0)
    volume = (a * np.cross(b, c)).sum() / 6
    return bool(abs(volume / ConvexHull(mesh.vertices).volume - 1) < 1e-9)


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_against_its_hull(name: str) -> None:
    rng = np.random.default_rng(3)
    for parameters in ({}, *(sample(name, rng) for _ in range(2))):
        mesh = build(name, **parameters)
        assert mesh.is_convex() == fills_its_hull(mesh), parameters
        assert mesh.is_convex() or name not in CONVEX


CUBE = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
SIDES = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])


def triangles(faces: np.ndarray) -> np.ndarray:
    return faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def test_a_cube_and_what_is_wrong_with_others() -> None:
    cube = Mesh(CUBE, SIDES)
    assert cube.is_convex()
    assert Mesh(CUBE, triangles(SIDES)).is_convex()
    # Sharp edges repeat their vertices.
    assert Mesh(CUBE[SIDES].reshape(-1, 3), np.arange(24).reshape(6, 4)).is_convex()
    assert not Mesh(CUBE, SIDES[:5]).is_convex()  # open
    assert not Mesh(CUBE, SIDES[:, ::-1]).is_convex()  # inside out
    two = Mesh(np.concatenate([CUBE, CUBE + 3]), np.concatenate([SIDES, SIDES + 8]))
    assert not two.is_convex()
    dented = CUBE.copy()
    dented[7] = [0.6, 0.6, 0.6]
    assert not Mesh(dented, triangles(SIDES)).is_convex()
    twice = Mesh(CUBE, np.concatenate([SIDES, SIDES]))
    assert not twice.is_convex()


@pytest.mark.parametrize("depth", [1e-3, 1e-6])
def test_a_small_dent_is_found(depth: float) -> None:
    """One vertex of a sphere, pushed in until its faces are hollow."""
    mesh = build("sphere")
    vertices = mesh.vertices.copy()
    number = len(vertices) // 2
    same = (abs(vertices - vertices[number]) < 1e-12).all(axis=1)
    vertices[same] *= 1 - depth * 20
    assert not Mesh(vertices, mesh.faces, mesh.normals).is_convex()
