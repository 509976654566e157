"""The main job on a real render: the paper's experiment from Blender to report."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from gen.capture import read_capture

pytestmark = pytest.mark.render
ROOT = Path(__file__).resolve().parent.parent.parent


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of `degloss demo`."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    command = [sys.executable, "-m", "degloss", "demo", "-o", str(folder)]
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=300)
    assert run.returncode == 0, run.stderr
    assert str(folder / "report.html") in run.stdout
    return folder


@pytest.fixture(scope="module")
def rows(demo: Path) -> dict[str, Any]:
    """The rows of the comparison by name."""
    return dict(json.loads((demo / "metrics.json").read_text())["comparison"])


def test_least_squares_errs_as_the_physics_says(rows: dict[str, Any]) -> None:
    """Attached shadows alone cost 1.3 degrees on the matte twin, the coat's dimming 4.5 on the diffuse layer, pbrt's gloss 15."""
    mean = {name: row["normals"]["mask"]["mean"] for name, row in rows.items()}
    assert mean["true matte"] == pytest.approx(1.25, abs=0.1)
    assert mean["true diffuse"] == pytest.approx(4.5, abs=0.2)
    assert mean["glossy"] == pytest.approx(15.1, abs=1)
    assert rows["true matte"]["normals"]["lit by all"]["mean"] < 0.05


def test_removing_the_gloss_helps(rows: dict[str, Any]) -> None:
    row, glossy = rows["removed"], rows["glossy"]
    assert row["gap closed"] > 0.7
    assert row["non-glossy"]["normal MSE"] < 0.3 * glossy["non-glossy"]["normal MSE"]
    assert row["non-glossy"]["height MSE"] < 0.3 * glossy["non-glossy"]["height MSE"]


def test_mesh_is_the_cylinder_in_metres(demo: Path) -> None:
    """A cylinder of radius 22 mm, 50 mm long, seen from its side."""
    capture = read_capture(demo / "capture")
    mesh = trimesh.load(demo / "mesh.ply", force="mesh")
    assert mesh.extents[0] == pytest.approx(0.044, abs=0.001)
    assert mesh.extents[1] == pytest.approx(0.050, abs=0.001)
    assert capture.scale.unit == "m"
    assert np.asarray(mesh.face_normals)[:, 2].min() > 0


def test_report_is_there_and_asks_for_nothing(demo: Path) -> None:
    page = (demo / "report.html").read_text()
    assert "gloss removed" in page
    assert 'src="http' not in page
    assert "<canvas" in page
