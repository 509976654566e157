"""The solvers' benchmark: its draws, its plain numpy versions and its tables, on a synthetic object."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Capture
from recon.metrics import angular_error
from recon.normals import bench
from recon.normals.l1 import l1
from recon.normals.least_squares import least_squares

Synthetic = Callable[..., Capture]


def many_lights(count: int = 24) -> np.ndarray:
    rng = np.random.default_rng(0)
    lights = np.c_[rng.uniform(-0.7, 0.7, (count, 2)), np.ones(count)]
    return lights / np.linalg.norm(lights, axis=1, keepdims=True)


def test_plain_versions_find_what_the_solvers_find(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 40, many_lights(), specular=0.1, alpha=0.1)
    given = capture.reflectance(), capture.lights, capture.mask, np.ones(capture.images.shape[:3], np.float32)
    for plain, solver, allowed in ((bench.plain_least_squares, least_squares, 0.01), (bench.plain_l1, l1, 0.3)):
        apart = angular_error(plain(*given).normal, solver(*given).normal)[capture.mask]
        assert np.nanmean(apart) < allowed
        assert np.isfinite(apart).all()


def test_tables_of_an_object(
    synthetic: Synthetic, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "diligent" / "bear").mkdir(parents=True)
    capture = synthetic("sphere", 24, many_lights(30), specular=0.1, alpha=0.1)
    monkeypatch.setenv("DEGLOSS_DATA", str(tmp_path))
    monkeypatch.setattr(bench, "read_capture", lambda place: capture)
    monkeypatch.setattr(bench, "registered", lambda: {"least-squares": least_squares, "l1": l1})
    monkeypatch.setattr(bench, "LARGE_FRAME", (24, 30, 40))
    bench.main(["--draws", "3", "--json"])
    tables = json.loads(capsys.readouterr().out)
    assert all(row["error"] < 2 and row["seconds"] > 0 for row in tables["large frame"].values())
    table = tables["bear"]
    assert set(table) == {"all lights", "without the corrupt", "draws"}
    assert table["draws"]["least-squares"]["difference"] == 0
    for label in ("all lights", "without the corrupt"):
        assert table[label]["l1"]["error"] < table[label]["least-squares"]["error"]
        assert table[label]["least-squares"]["error"] == pytest.approx(
            table[label]["least squares, plain numpy"]["error"], abs=1e-3
        )
        assert table[label]["l1"]["processor"] > 0
    bench.main(["--draws", "1"])
    assert "| l1 |" in capsys.readouterr().out


def test_missing_data_is_left_out_with_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DEGLOSS_DATA", str(tmp_path))
    bench.main([])
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("left out: reference data is missing")
