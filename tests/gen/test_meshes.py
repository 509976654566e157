"""Users' meshes: written by trimesh, read back and held against the sphere and the box that they are; hostile files; their specs."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from blender_scenes.errors import JobError
from blender_scenes.mesh_file import read_mesh
from gen import mesh_formats
from gen.errors import InputError
from gen.meshes import load_mesh, mesh_file, write_mesh
from gen.render import jobs_of
from gen.spec import read_spec, spec_from

ENDINGS = ("glb", "obj", "stl", "ply")


def load(path: Path, **values: Any) -> Any:
    return load_mesh(mesh_file({"file": str(path), **values}))


def face_normals(mesh: Any) -> np.ndarray:
    p = mesh.vertices[mesh.faces]
    cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    return cross / np.linalg.norm(cross, axis=1, keepdims=True)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("own", [False, True])
def test_a_sphere_is_read_with_the_normals_of_a_sphere(tmp_path: Path, ending: str, own: bool) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=3)
    ball.apply_translation([5, 6, 7])
    if own:
        assert ball.vertex_normals.shape == ball.vertices.shape  # now they are written, too
    ball.export(tmp_path / f"ball.{ending}")
    mesh = load(tmp_path / f"ball.{ending}", size_mm=50)
    assert len(mesh.vertices) == len(ball.vertices)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 25, atol=1e-5)
    # The file's own normals, or those that trimesh finds by the same rule; an icosphere's facets put them up to 0.13 degrees off.
    nearest = cKDTree(ball.vertices - [5, 6, 7]).query(mesh.vertices * 3 / 25)[1]
    expected = trimesh.geometry.weighted_vertex_normals(len(ball.vertices), ball.faces, ball.face_normals, ball.face_angles)
    np.testing.assert_allclose(mesh.normals, expected[nearest], atol=1e-5)
    np.testing.assert_allclose(mesh.normals, mesh.vertices / 25, atol=2.5e-3)
    np.testing.assert_allclose(abs(mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)), 0, atol=1e-6)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("own", [False, True])
def test_a_box_keeps_its_sharp_edges(tmp_path: Path, ending: str, own: bool) -> None:
    """Also where the file brings normals that are smoothed over the edges."""
    box = trimesh.creation.box((2, 3, 4))
    if own:
        assert box.vertex_normals.shape == (8, 3)
    box.export(tmp_path / f"box.{ending}")
    mesh = load(tmp_path / f"box.{ending}", size_mm=40)
    assert mesh.vertices.shape == (24, 3)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [20, 30, 40], atol=1e-5)
    np.testing.assert_allclose(mesh.normals[mesh.faces], np.repeat(face_normals(mesh)[:, None], 3, axis=1), atol=1e-6)
    soft = load(tmp_path / f"box.{ending}", size_mm=40, smooth_degrees=100)
    assert len(soft.vertices) == 8
    np.testing.assert_allclose(soft.normals, np.sign(soft.vertices) / np.sqrt(3), atol=1e-5)


def test_a_cylinder_is_smooth_around_and_sharp_at_its_rims(tmp_path: Path) -> None:
    trimesh.creation.cylinder(radius=2, height=6, sections=64).export(tmp_path / "c.stl")
    mesh = load(tmp_path / "c.stl", size_mm=60, up="z")
    side = abs(mesh.normals[:, 1]) < 0.5
    assert side.sum() == 2 * 64
    radial = mesh.vertices[side] * [1, 0, 1] / 20
    np.testing.assert_allclose(mesh.normals[side], radial, atol=1e-3)
    assert np.ptp(mesh.vertices[:, 1]) == pytest.approx(60)
    np.testing.assert_allclose(abs(mesh.normals[~side]), [[0, 1, 0]] * (~side).sum(), atol=1e-9)


def test_given_normals_are_kept(tmp_path: Path) -> None:
    """A tilted square whose normals stand 20 degrees off: no geometry would say so."""
    n = [0.0, np.sin(np.radians(20)), np.cos(np.radians(20))]
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n" + f"vn {n[0]} {n[1]} {n[2]}\n" + "f 1//1 2//1 3//1 4//1\n"
    (tmp_path / "a.obj").write_text(text)
    mesh = load(tmp_path / "a.obj", size_mm=10)
    np.testing.assert_allclose(mesh.normals, [n] * len(mesh.normals), atol=1e-6)
    turned = load(tmp_path / "a.obj", size_mm=10, up="z")
    np.testing.assert_allclose(turned.normals, [[n[0], n[2], -n[1]]] * len(mesh.normals), atol=1e-6)


def test_parts_stand_where_the_scene_puts_them_and_glb_is_in_metres(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    part = trimesh.creation.icosphere(subdivisions=3, radius=0.01)
    scene.add_geometry(part, transform=np.diag([1.0, 1, 1, 1]))
    place = np.diag([-2.0, 1, 1, 1])  # mirrored and stretched
    place[:3, 3] = [0.05, 0, 0]
    scene.add_geometry(part, transform=place)
    scene.export(tmp_path / "two.glb")
    mesh = load(tmp_path / "two.glb")
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([80, 20, 20], rel=1e-3)
    assert ((mesh.normals[mesh.faces].sum(axis=1) * face_normals(mesh)).sum(axis=1) > 2.8).all()
    p = mesh.vertices[mesh.faces]
    assert (p[:, 0] * np.cross(p[:, 1], p[:, 2])).sum() / 6 == pytest.approx(3 * 4 / 3 * np.pi * 1000, rel=0.04)


def test_faces_wound_at_random_come_out_outward(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    faces = ball.faces.copy()
    flip = np.random.default_rng(0).random(len(faces)) < 0.4
    for name, turned in (("some", flip), ("all", ~np.zeros_like(flip))):
        wound = np.where(turned[:, None], faces[:, ::-1], faces)
        trimesh.Trimesh(ball.vertices, wound, process=False).export(tmp_path / f"{name}.stl")
        mesh = load(tmp_path / f"{name}.stl", size_mm=2)
        assert ((face_normals(mesh) * mesh.vertices[mesh.faces].mean(axis=1)).sum(axis=1) > 0.9).all()
        np.testing.assert_allclose(mesh.normals, mesh.vertices, atol=0.02)


def glb(content: dict[str, Any], binary: bytes = b"") -> bytes:
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<I4s", len(binary), b"BIN\0") + binary if binary else b""
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(chunk), len(text), b"JSON") + text + chunk


EMPTY = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "scene": 0}
TRIANGLE = {**EMPTY, "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}
HOSTILE: list[tuple[str, bytes, str]] = [
    ("a.stl", b"", "is empty"),
    ("a.step", b"x", "is not one of .glb, .obj, .stl, .ply"),
    ("a.stl", b"hello", "is not a whole STL file"),
    ("a.stl", b"\0" * 80 + struct.pack("<I", 4_000_000_000), "is not a whole STL file"),
    ("a.stl", b"\0" * 80 + struct.pack("<I", 0), "holds no faces|cannot be read"),
    ("a.stl", b"\0" * 80 + struct.pack("<I12fH", 1, *[np.nan] * 12, 0), "not finite"),
    ("a.stl", b"\0" * 80 + struct.pack("<I12fH", 1, 0, 0, 1, *[1.0] * 9, 0), "in one place"),
    ("a.stl", b"\0" * 80 + struct.pack("<I12fH", 1, 0, 0, 1, *[1.0, 1, 1, 2, 2, 2, 3, 3, 3], 0), "no face with an area"),
    ("a.obj", b"\0\1\2", "not text"),
    ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "holds no faces|cannot be read"),
    ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot be read|not there"),
    ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "not finite"),
    ("a.obj", b"v 0 0 0\nv 1e30 0 0\nv 0 1 0\nf 1 2 3\n", "too large"),
    ("a.obj", b"v 0 0 0\nv 1e9 0 0\nv 0 1 0\nf 1 2 3\n", "size_mm"),
    ("a.ply", b"hello", "no header"),
    ("a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\nend_header\n", "not a whole PLY"),
    ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n", "cannot be read|holds no faces"),
    ("a.glb", b"glTF", "is not a whole GLB"),
    ("a.glb", glb({"nodes": 3}), "is not a whole GLB"),
    ("a.glb", glb({**TRIANGLE, "accessors": [{"count": 10**9, "componentType": 5126, "type": "VEC3"}]}), "is not a whole GLB"),
    ("a.glb", glb({**TRIANGLE, "accessors": [{"count": 3}], "buffers": [{"uri": "../../etc/passwd"}]}), "in other files"),
    ("a.glb", glb({"asset": {"version": "2.0"}}), "holds no faces|cannot be read"),
    ("a.glb", glb(EMPTY), "is not a whole GLB"),
]


@pytest.mark.parametrize(("name", "data", "message"), HOSTILE)
def test_hostile_files_end_in_one_line(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        load(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("ending", ENDINGS)
def test_damaged_files_are_read_or_refused(tmp_path: Path, ending: str) -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.export(tmp_path / f"whole.{ending}")
    data, rng = (tmp_path / f"whole.{ending}").read_bytes(), np.random.default_rng(3)
    for i in range(25):
        damaged = bytearray(data if i % 2 else data[: rng.integers(1, len(data))])
        for place in rng.integers(0, len(damaged), 6):
            damaged[place] = rng.integers(256)
        path = tmp_path / f"{i}.{ending}"
        path.write_bytes(damaged)
        refusal = ""
        try:
            mesh = load(path, size_mm=10)
        except InputError as error:
            refusal = str(error)
        else:
            assert np.isfinite(mesh.vertices).all()
        assert "\n" not in refusal


@pytest.mark.parametrize("ending", ENDINGS)
def test_too_many_faces_are_refused_before_they_are_read(tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / f"a.{ending}")
    monkeypatch.setattr(mesh_formats, "MAX_FACES", 300)
    with pytest.raises(InputError, match="has more than 0 million faces; simplify it"):
        load(tmp_path / f"a.{ending}", size_mm=3)


def test_material_files_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "secret.mtl").mkdir()  # opening it would fail
    (tmp_path / "a.obj").write_text("mtllib secret.mtl\nmtllib ../x.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert len(load(tmp_path / "a.obj", size_mm=3).faces) == 1


SPEC = {"name": "part", "camera": {"kind": "orthographic", "width_mm": 60}}


def spec_file(folder: Path, shape: str) -> Path:
    path = folder / "spec.yaml"
    path.write_text(f"name: part\ncamera: {{kind: orthographic, width_mm: 60}}\nshape: {shape}\n")
    return path


def test_a_spec_finds_the_mesh_beside_it_and_names_its_content(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        trimesh.creation.box((1, 2, 3)).export(tmp_path / name / "part.stl")
    specs = [read_spec(spec_file(tmp_path / name, "{name: mesh, file: part.stl, size_mm: 40}")) for name in ("one", "two")]
    one, two = specs
    assert one.plain()["shape"]["file"] == str(tmp_path / "one" / "part.stl")
    assert len(one.plain()["shape"]["sha256"]) == 64
    assert one.digest() == two.digest()
    assert spec_from(one.plain(), "again") == one
    job = jobs_of(one, tmp_path)[0]
    mesh = read_mesh(job["shape"]["file"])
    assert np.ptp(mesh.vertices, axis=0).max() == pytest.approx(40)

    trimesh.creation.box((1, 2, 4)).export(tmp_path / "one" / "part.stl")
    with pytest.raises(InputError, match="has changed"):
        jobs_of(one, tmp_path)
    with pytest.raises(InputError, match=r"shape: .*has changed: its SHA-256 is"):
        spec_from(one.plain(), "again")
    changed = read_spec(spec_file(tmp_path / "one", "{name: mesh, file: part.stl, size_mm: 40}"))
    assert changed.digest() != one.digest()


BAD = [
    ("{name: mesh}", "shape: file: must be the path of a mesh"),
    ("{name: mesh, file: no.glb}", "there is no such file"),
    ("{name: mesh, file: part.stl, radius: 3}", "shape: radius: unknown key of a mesh; there are file, size_mm"),
    ("{name: mesh, file: part.stl, size_mm: 0}", "shape: size_mm: must be a number from 0.001"),
    ("{name: mesh, file: part.stl, size_mm: true}", "shape: size_mm: must be a number from 0.001"),
    ("{name: mesh, file: part.stl, up: x}", "shape: up: must be y or z, got 'x'"),
    ("{name: mesh, file: part.stl, smooth_degrees: 200}", "shape: smooth_degrees: must be a number from 0 to 180"),
    ("{name: mesh, file: part.stl, sha256: abc}", "has changed: its SHA-256 is"),
    ("{name: mesh, file: part.stl, size_mm: 5000}", "camera.distance_mm: the object reaches 2500 mm"),
    ("{name: mesh, file: part.stl, detail: [{kind: rust}]}", "shape.detail: detail rust: unknown; there are"),
    ("{name: sphere, file: part.stl}", "shape.file: unknown parameter of sphere"),
    ("{name: sphere, detail: {kind: dents}}", "shape.detail: detail: must be a list"),
    ("{name: sphere, detail: [{kind: dents, radius: -1}]}", "shape.detail: detail dents: radius must be a number from"),
]


@pytest.mark.parametrize(("shape", "message"), BAD)
def test_bad_shapes_are_refused_in_one_line(tmp_path: Path, shape: str, message: str) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "part.stl")
    with pytest.raises(InputError) as caught:
        read_spec(spec_file(tmp_path, shape))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_detail_is_part_of_the_spec_and_of_its_jobs(tmp_path: Path) -> None:
    text = "{name: cylinder, radius: 12, detail: [{kind: grooves, pitch: 2}, {kind: dents, count: 3}]}"
    spec = read_spec(spec_file(tmp_path, text))
    detail = [{"kind": "grooves", "pitch": 2}, {"kind": "dents", "count": 3}]
    assert jobs_of(spec, tmp_path)[0]["shape"] == {"name": "cylinder", "parameters": {"radius": 12}, "detail": detail}
    assert spec_from(spec.plain(), "again").digest() == spec.digest()
    assert spec.digest() != read_spec(spec_file(tmp_path, "{name: cylinder, radius: 12}")).digest()


def test_a_mesh_survives_the_way_to_the_studio_and_bad_ones_do_not(tmp_path: Path) -> None:
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "part.stl")
    given = mesh_file({"file": "part.stl", "size_mm": 30}, tmp_path)
    path = write_mesh(given, tmp_path)
    assert write_mesh(given, tmp_path) == path
    mesh, found = load_mesh(given), read_mesh(str(path))
    for name in ("vertices", "faces", "normals"):
        assert getattr(mesh, name).tobytes() == getattr(found, name).tobytes()
    good = {"vertices": np.eye(3), "faces": np.array([[0, 1, 2]]), "normals": np.eye(3)}
    bad = {
        "missing": {key: good[key] for key in ("vertices", "faces")},
        "pickle": {**good, "normals": np.array([None, {}], dtype=object)},
        "nan": {**good, "vertices": np.full((3, 3), np.nan)},
        "index": {**good, "faces": np.array([[0, 1, 3]])},
    }
    for name, arrays in bad.items():
        np.savez(tmp_path / f"{name}.npz", **arrays)
    (tmp_path / "text.npz").write_text("hello")
    for name in (*bad, "text", "absent"):
        with pytest.raises(JobError, match=r"^job: shape.file [^\n]+$"):
            read_mesh(str(tmp_path / f"{name}.npz"))
