"""Inspections whose outcome is known: dents, drift, ignorance; the files, and the command."""

from __future__ import annotations

import html
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.capture import Capture, read_capture
from gen.errors import InputError
from gen.exr import read_exr
from recon.inspection.inspection import Inspection, inspect
from recon.inspection.measured import measured_from, of_shape, read_measured
from recon.inspection.nominal import read_nominal
from recon.inspection.pose import Pose, initial_rotation, rotation_of, vector_of
from recon.inspection.view import View, seen
from recon.normals.least_squares import least_squares
from recon.pipeline import measure
from tests.recon.inspection.parts import seen_part, surface, write_stl

ROOT = Path(__file__).resolve().parent.parent.parent.parent
TILT = rotation_of(np.array([0.25, 0.15, 0.3]))


def inspected(tolerance: float = 0.1, cutoff: float = 12.0, **part: Any) -> Inspection:
    nominal = surface("rounded_box")
    measured, _, _ = seen_part(nominal, TILT, **part)
    return inspect(measured, nominal, tolerance, cutoff=cutoff, initial=TILT)


def dent(inspection: Inspection) -> float:
    return float(np.nanmin(np.where(inspection.deviation.judged, inspection.deviation.features, np.nan)))


@pytest.mark.parametrize("bowl", [0.0, 0.4])
def test_a_dent_keeps_its_depth_and_fails(bowl: float) -> None:
    """0.3 mm along the view is 0.3 cos(tilt) along the normal of the front face; the drift changes nothing."""
    found = inspected(dent=(2.0, 3.0, 0.3, 1.6), bowl=bowl)
    assert dent(found) == pytest.approx(-0.3 * TILT[2, 2], rel=0.04)
    assert found.verdict.features == "fail"
    assert len(found.verdict.places) == 1
    place = found.figures()["verdict"]["places"][0]
    at = found.measured.points[place["row"] - 1, place["column"] - 1]
    assert at[:2] == pytest.approx([2, 3], abs=0.6)
    assert place["on the nominal mm"] == pytest.approx(TILT.T @ (at - [0.7, -0.4, 0]), abs=0.5)


def test_drift_neither_fails_nor_passes() -> None:
    """Four times the tolerance of slow drift: the features pass, the raw map shows it, and of the form nothing is said but its name."""
    found = inspected(bowl=0.4)
    judged = found.deviation.judged
    assert np.ptp(found.deviation.raw[judged]) > 0.25
    assert np.abs(found.deviation.features[judged]).max() < 0.02
    figures = found.figures()
    assert figures["verdict"]["features"] == "pass"
    assert figures["verdict"]["form"] == "not measurable"
    assert found.sentence().endswith("Form longer than 12 mm: not measurable.")
    assert "Form longer than the cut-off" in found.notes()[0]


def test_the_raw_uncertainty_is_larger_than_that_of_the_features() -> None:
    found = inspected()
    assert np.nanmedian(found.deviation.raw_uncertainty) > 2 * np.nanmedian(found.deviation.uncertainty)


def test_uncertain_normals_decide_nothing() -> None:
    assert inspected(uncertainty=20.0).verdict.features == "cannot be decided"
    unknown = inspected(uncertainty=float("nan"))
    assert unknown.verdict.features == "cannot be decided"
    assert "--uncertainty" in unknown.verdict.reason
    assert any("states no uncertainty" in note for note in unknown.notes())


def test_without_a_scale_deviations_are_in_percent_of_the_size() -> None:
    found = inspected(dent=(2.0, 3.0, 0.3, 1.6), unit="px")
    size = found.nominal.size
    assert found.unit == "%"
    assert dent(found) == pytest.approx(-0.3 * TILT[2, 2], rel=0.04)
    figures = found.figures()
    assert figures["deviation"]["features"]["lowest"] == pytest.approx(100 * dent(found) / size)
    assert figures["verdict"]["tolerance"] == pytest.approx(10 / size)
    assert any("error of size cannot show" in note for note in found.notes())


def test_cutoffs_that_cannot_be_are_refused() -> None:
    for cutoff in (0.5, 400.0):
        with pytest.raises(InputError, match="--cutoff"):
            inspected(cutoff=cutoff)


def test_a_measured_sphere_end_to_end(synthetic: Any) -> None:
    """A matte sphere in closed form, measured and inspected in pixels: it is the nominal, though attached shadows bend it."""
    capture: Capture = synthetic("sphere", 80, layer="matte")
    shape = measure(capture, "none", "none")
    nominal = surface("sphere", radius=10)
    reflectance = capture.reflectance(shape.images)
    own = least_squares(reflectance, capture.lights, capture.mask, shape.weights)  # its uncertainty by the residuals alone
    found = inspect(of_shape(replace(shape, normals=own)), nominal, tolerance=0.2, initial=np.eye(3))
    assert found.alignment.pose.scale == pytest.approx(3.6, rel=0.01)  # 0.45 x 80 pixels over 10 mm
    assert found.deviation.raised > 10  # the fit in the lit part is perfect, and says so; shadows make it wrong elsewhere
    assert any("raised" in note for note in found.notes())
    assert found.verdict.features != "fail"


def test_a_perspective_view_is_compared_along_its_rays() -> None:
    """A dent pressed in along the rays of a pinhole, 0.3 mm deep at its middle."""
    nominal = surface("rounded_box")
    view = View((90, 100), (46.0, 44.0), 0.53, (377.0, 377.0), 200.0)
    there = seen(nominal, Pose(TILT, np.array([0.7, -0.4, 0.0])), view)
    points = np.where(there.inside[..., None], there.points, np.nan)
    depth = 0.3 * np.exp(-((points[..., 0] - 2) ** 2 + (points[..., 1] - 3) ** 2) / (2 * 2.0**2))
    measured = measured_from((points - depth[..., None] * there.toward) / 1000, there.normal, np.full((90, 100), 0.5), "m")
    found = inspect(measured, nominal, 0.1, cutoff=14.0, initial=rotation_of(np.array([0.03, -0.02, 0.03])) @ TILT)
    assert np.degrees(np.linalg.norm(vector_of(found.alignment.pose.rotation @ TILT.T))) < 0.1
    assert found.alignment.pose.translation == pytest.approx([0.7, -0.4, 0], abs=0.1)
    assert dent(found) == pytest.approx(-np.nanmax(depth * there.cosine), rel=0.04)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A measurement's folder with what an inspection reads, its nominal beside it, and the inspection that the command wrote."""
    from gen.exr import unstack, write_exr
    from gen.files import write_json

    folder = tmp_path_factory.mktemp("inspection")
    nominal = write_stl(folder / "box.stl", "rounded_box")
    measured, _, _ = seen_part(read_nominal(nominal), TILT, 96, dent=(2.0, 3.0, 0.3, 1.6))
    points = measured.points / 1000
    write_exr(folder / "part" / "height.exr", {"height.Z": points[..., 2]} | unstack("points", "XYZ", points))
    write_exr(folder / "part" / "normal.exr", unstack("normal", "XYZ", measured.normal) | {"uncertainty.V": measured.uncertainty})
    write_json(folder / "part" / "metrics.json", {"height": {"unit": "m"}})
    return folder


def command(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "degloss", "recon", "inspect", "part", "box.stl", *options]
    environment = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    return subprocess.run(line, capture_output=True, text=True, cwd=folder, env=environment, timeout=300)


def test_the_command_writes_everything(written: Path) -> None:
    run = command(written, "-o", "out", "--tolerance", "0.1", "--initial-pose", _angles(), "--check", "--json")
    assert run.returncode == 1, run.stderr
    figures = json.loads(run.stdout)
    assert figures == json.loads((written / "out" / "inspection.json").read_text())
    assert figures["verdict"]["features"] == "fail"
    names = {"deviation.exr", "inspection.json", "report.html", ".degloss"}
    names |= {f"{name}.png" for name in ("raw", "form", "features", "uncertainty", "verdict")}
    assert {p.name for p in (written / "out").iterdir()} == names
    maps = read_exr(written / "out" / "deviation.exr")
    assert maps["features.Z"].shape == (96, 96)
    assert set(np.unique(maps["verdict.V"][np.isfinite(maps["verdict.V"])])) <= {-1, 0, 1}
    raw, parts = maps["raw.Z"], maps["form.Z"] + maps["features.Z"]
    known = np.isfinite(raw) & np.isfinite(parts)
    assert np.median(np.abs(raw - parts)[known]) < 1e-3  # the S-filter alone is between them
    page = html.unescape((written / "out" / "report.html").read_text("utf-8"))
    assert "default-src 'none'" in page
    assert not re.search(r"https?://", re.sub(r"data:[^\"]+", "", page))
    assert "not measurable" in page
    assert "cannot be decided" in page


def test_a_bad_option_ends_in_one_line_and_leaves_nothing(written: Path) -> None:
    run = command(written, "--tolerance", "0.1", "--uncertainty", "90", "-o", "none")
    assert run.returncode == 2
    assert "--uncertainty 90" in run.stderr
    assert len(run.stderr.strip().splitlines()) == 1
    assert not (written / "none").exists()
    assert not list(written.glob(".*tmp"))


def _angles() -> str:
    from scipy.spatial.transform import Rotation

    return ",".join(f"{a:.1f}" for a in Rotation.from_matrix(TILT).as_euler("xyz", degrees=True))


@pytest.mark.render
def test_a_rendered_part_is_found_and_passes(tmp_path: Path) -> None:
    """From Blender to verdict: a box rendered in a known pose, its matte twin measured, inspected against its own STL."""
    from gen.render import render_capture
    from gen.spec import spec_from

    spec = spec_from(
        {
            "name": "box",
            "resolution": [96, 96],
            "shape": {"name": "rounded_box"},
            "material": {"albedo": [0.5, 0.4, 0.3], "specular": 0.3, "alpha": 0.25},
            "lights": [[0, 0, 1], [3, 0, 4], [-3, 0, 4], [0, 3, 4], [0, -3, 4]],
            "camera": {"kind": "orthographic", "width_mm": 56},
            "pose": {"rotation_degrees": [20, 10, 15]},
        },
        "test",
    )
    render_capture(spec, tmp_path / "capture")
    shape = measure(read_capture(tmp_path / "capture"), "true-matte", "none", shadows="drop")
    shape.write(tmp_path / "measured")
    nominal = read_nominal(write_stl(tmp_path / "box.stl", "rounded_box"))
    found = inspect(read_measured(tmp_path / "measured"), nominal, tolerance=0.5)
    # A box is the same when turned by half about any of its axes.
    turn = initial_rotation("20,10,15").T @ found.alignment.pose.rotation
    half = np.diag(np.sign(np.diag(turn)))
    assert np.degrees(np.linalg.norm(vector_of(turn @ half))) < 2
    assert found.alignment.outline < 0.5
    assert found.verdict.features in ("pass", "cannot be decided")
    assert found.figures()["verdict"]["form"] == "not measurable"
