"""Nominal meshes from files: units, scenes, and files that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gen.errors import InputError
from recon.inspection.measured import read_measured
from recon.inspection.nominal import read_nominal
from recon.mesh import write_mesh


@pytest.mark.parametrize(("ending", "factor"), [("stl", 1), ("obj", 1), ("ply", 1), ("glb", 1000)])
def test_units_by_the_format_and_as_said(tmp_path: Path, ending: str, factor: float) -> None:
    path = tmp_path / f"box.{ending}"
    box = trimesh.creation.box((2, 3, 4))
    box.apply_translation((10, 0, 0))
    box.export(path)
    nominal = read_nominal(path)
    assert np.ptp(nominal.vertices, axis=0) == pytest.approx(factor * np.array([2, 3, 4]))
    assert nominal.middle == pytest.approx([10 * factor, 0, 0])
    assert ("m" if ending == "glb" else "mm") in nominal.unit
    assert "default" in nominal.unit
    assert read_nominal(path, "inch").size == pytest.approx(4 * 25.4)
    corners = nominal.vertices[nominal.faces]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("fk,fk->f", faces, nominal.normals[nominal.faces[:, 0]]) > 0.999 * np.linalg.norm(faces, axis=1)).all()


def test_parts_of_a_scene_stand_where_they_are_put(tmp_path: Path) -> None:
    scene = trimesh.Scene(trimesh.creation.box((1, 1, 1)))
    scene.add_geometry(trimesh.creation.box((1, 1, 1)), transform=trimesh.transformations.translation_matrix((5, 0, 0)))
    scene.export(tmp_path / "two.glb")
    assert np.ptp(read_nominal(tmp_path / "two.glb", "mm").vertices, axis=0) == pytest.approx([6, 1, 1])


@pytest.mark.parametrize("ending", ["ply", "glb"])
def test_our_own_meshes_say_their_unit(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"mesh.{ending}"
    write_mesh(trimesh.creation.box((0.02, 0.03, 0.004)), path, "m")
    assert read_nominal(path).size == pytest.approx(30)
    write_mesh(trimesh.creation.icosphere(radius=30), path, "px")
    with pytest.raises(InputError, match="in pixels"):
        read_nominal(path)
    measured = read_measured(path)
    assert measured.unit == "px"
    assert np.nanmax(measured.points[..., 2]) == pytest.approx(30, abs=0.5)
    assert np.isnan(measured.uncertainty).all()


def _broken() -> dict[str, bytes]:
    box = trimesh.creation.box((1, 1, 1))
    stl = box.export(file_type="stl")
    glb = box.export(file_type="glb")
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False)
    return {
        "empty.stl": b"",
        "short.stl": stl[:-40],
        "many.stl": stl[:80] + b"\xff\xff\xff\x7f" + stl[84:],
        "short.glb": glb[: len(glb) // 2],
        "text.glb": b"hello",
        "junk.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999\nend_header\n",
        "points.obj": b"v 0 0 0\nv 1 0 0\n",
        "far.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
        "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "line.stl": flat.export(file_type="stl"),
        "part.step": b"ISO-10303-21;",
    }


@pytest.mark.parametrize("name", sorted(_broken()))
def test_broken_files_end_in_one_line(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(_broken()[name])
    with pytest.raises(InputError) as caught:
        read_nominal(path)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_nominal(tmp_path / "none.stl")
    with pytest.raises(InputError, match="metrics"):
        read_measured(tmp_path)
