"""Every registered shape: a closed, outward surface with exact normals, found by name and checked at the door."""

from __future__ import annotations

import inspect
import subprocess
import sys
from importlib import import_module

import numpy as np
import pytest

from blender_scenes.shapes import SHAPES, Mesh, build, describe, parameters, sample

AREA = {
    "sphere": lambda radius, **_: 4 * np.pi * radius**2,
    "cylinder": lambda radius, length, **_: 2 * np.pi * radius * (radius + length),
}
VOLUME = {
    "sphere": lambda radius, **_: 4 / 3 * np.pi * radius**3,
    "cylinder": lambda radius, length, **_: np.pi * radius**2 * length,
}


def triangles(mesh: Mesh) -> np.ndarray:
    faces = mesh.faces if mesh.faces.shape[1] == 3 else np.concatenate([mesh.faces[:, :3], mesh.faces[:, [0, 2, 3]]])
    return mesh.vertices[faces]


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("seed", [None, 1, 2])
def test_surface_has_the_area_and_volume_of_its_formula(name: str, seed: int | None) -> None:
    values = {} if seed is None else sample(name, np.random.default_rng(seed))
    p = triangles(build(name, **values))
    cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    given = {key: values.get(key, parameter.default) for key, parameter in parameters(name).items()}
    assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(AREA[name](**given), rel=2e-4)
    # The signed volume is positive, and right, only if every face is wound outward.
    assert (p[:, 0] * cross).sum() / 6 == pytest.approx(VOLUME[name](**given), rel=2e-4)


@pytest.mark.parametrize("name", SHAPES)
def test_surface_is_closed(name: str) -> None:
    mesh = build(name)
    _, same = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)
    faces = same.reshape(-1)[mesh.faces]
    edges = np.concatenate([np.stack([faces[:, i], np.roll(faces, -1, axis=1)[:, i]], 1) for i in range(faces.shape[1])])
    forth, back = np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0)
    assert len(forth) == len(edges), "an edge is walked twice in one direction"
    np.testing.assert_array_equal(forth, back)


@pytest.mark.parametrize("name", SHAPES)
def test_facets_lie_within_1e_4_of_the_size_and_face_their_normals(name: str) -> None:
    mesh = build(name)
    assert mesh.normals is not None
    p = triangles(mesh)
    cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    cross /= np.linalg.norm(cross, axis=1, keepdims=True)
    n = mesh.normals[mesh.faces]
    assert ((cross[:, None] * n).sum(-1) > 0.999).all()
    # A chord between two points with normals at an angle d lies d^2 / 8 of the radius of curvature deep; in a triangle, d^2 / 6 or so.
    spread = np.linalg.norm(n - np.roll(n, 1, axis=1), axis=-1).max()
    assert spread**2 / 6 < 1e-4


@pytest.mark.parametrize("name", SHAPES)
def test_samples_are_within_the_ranges_and_reproducible(name: str) -> None:
    known = parameters(name)
    rng = np.random.default_rng(7)
    drawn = [sample(name, rng) for _ in range(50)]
    for values in drawn:
        assert all(known[key].low <= value <= known[key].high for key, value in values.items())
    assert drawn[0] != drawn[1]
    assert sample(name, np.random.default_rng(7)) == drawn[0]


@pytest.mark.parametrize("name", SHAPES)
def test_parameters_are_read_from_the_signature(name: str) -> None:
    function = getattr(import_module(SHAPES[name]), name)
    assert {key: p.default for key, p in parameters(name).items()} == {
        key: argument.default for key, argument in inspect.signature(function).parameters.items()
    }
    assert describe()[name]


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("value", [0, -1.0, float("nan"), float("inf"), "3", None, True, 1e9])
def test_bad_sizes_are_refused(name: str, value: object) -> None:
    for key in parameters(name):
        with pytest.raises(ValueError, match=f"shape {name}: {key} must be a number from"):
            build(name, **{key: value})


def test_bad_names_are_refused() -> None:
    with pytest.raises(ValueError, match="shape cone: unknown; there are cylinder, sphere"):
        build("cone")
    with pytest.raises(ValueError, match="unknown parameter size; it has radius, segments"):
        build("sphere", size=3)
    with pytest.raises(ValueError, match="unknown parameter name"):
        build("sphere", name=3)
    with pytest.raises(ValueError, match="segments must be a whole number"):
        build("sphere", segments=64.5)


@pytest.mark.parametrize(
    ("vertices", "faces", "normals", "message"),
    [
        ([[0, 0]], [[0, 0, 0]], None, r"vertices must be \(V, 3\)"),
        ([[0, 0, np.nan]], [[0, 0, 0]], None, "not finite"),
        ([[0, 0, 0]], [[0, 0, 1]], None, "there are 1"),
        ([[0, 0, 0]], [[0, 0]], None, "faces must be whole numbers"),
        ([[0, 0, 0]], [[0.0, 0, 0]], None, "faces must be whole numbers"),
        ([[0, 0, 0]], [[0, 0, 0]], [[0, 0, 0]], "normal 0 has no length"),
        ([[0, 0, 0]], [[0, 0, 0]], [[0, 0, 1], [0, 0, 1]], "2 normals for 1 vertices"),
    ],
)
def test_bad_meshes_are_refused(vertices: object, faces: object, normals: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Mesh(np.array(vertices), np.array(faces), None if normals is None else np.array(normals))


def test_shapes_import_numpy_alone() -> None:
    code = "import sys, blender_scenes.shapes as s; [s.build(n) for n in s.SHAPES]; sys.exit('bpy' in sys.modules or 'gen' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0
