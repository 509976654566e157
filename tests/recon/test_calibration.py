"""Calibrated uncertainty: what a table learns of drawn errors holds for others, and every registered method has one."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Capture, Truth
from gen.formats.render_folder import write_render
from recon import calibrate
from recon.calibration import LEAST, Table, change, fit, table_for
from recon.compare import shape_metrics
from recon.pipeline import measure
from recon.reconstruct import Settings, reconstruct
from recon.registry import GLOSS, NORMALS

Synthetic = Callable[..., Capture]


def drawn(seed: int, count: int = 40000) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Stated angles, changes, true standard deviations (a solver that states a third, and knows nothing of the change), and errors."""
    rng = np.random.default_rng(seed)
    sigma, changed = rng.uniform(0.2, 4, count), rng.uniform(0, 60, count)
    true = 3 * np.hypot(sigma, 0.1 * changed)
    return sigma, changed, true, true * np.sqrt(rng.exponential(1, count))


def test_a_fitted_table_holds_for_other_draws() -> None:
    table = fit(*drawn(0)[:2], drawn(0)[3])
    sigma, changed, true, error = drawn(1)
    stated = table(sigma, changed)
    assert table.weight == 0.1
    assert np.all(np.diff(table.score) > 0)
    assert np.all(np.diff(table.error) >= 0)
    for low, high in ((0, 2), (2, 5), (5, 12), (12, 30)):
        here = (stated >= low) & (stated < high)
        if here.sum() > 500:
            assert np.sqrt((stated[here] ** 2).mean()) == pytest.approx(np.sqrt((error[here] ** 2).mean()), rel=0.06)
    assert np.corrcoef(stated, true)[0, 1] > 0.98


def test_what_is_unknown_stays_unknown_and_nothing_is_stated_below_or_beyond_the_table() -> None:
    table = Table(0.0, (1.0, 10.0), (2.0, 40.0))
    given = np.array([np.nan, 0.0, 1.0, np.sqrt(10.0), 10.0, 80.0])
    assert np.allclose(table(given, np.zeros(6)), [np.nan, 2, 2, np.sqrt(80), 40, 40], equal_nan=True)
    assert fit(np.zeros(500), np.zeros(500), np.zeros(500)).error[-1] == LEAST


def test_the_change_is_an_angle(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 24)
    assert not change(capture, capture.images).any()
    assert not change(capture, capture.images.copy()).any()
    assert np.allclose(change(capture, capture.images / 2)[capture.mask], 45, atol=1e-3)
    assert np.allclose(change(capture, capture.images / 3)[capture.mask], np.degrees(np.arctan(2)), atol=1e-3)


@pytest.mark.parametrize("name", [name for name in NORMALS if name != "three-light"])
def test_every_solver_is_calibrated(name: str) -> None:
    for gloss in ("none", "chromaticity", "group"):
        assert table_for(gloss, name) is not None


@pytest.mark.parametrize("name", [name for name in GLOSS if not name.startswith("true-")])
def test_every_remover_is_calibrated(name: str) -> None:
    assert table_for(name, Settings.normals) is not None


def test_a_measurement_states_what_the_table_says(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 32, specular=0.5, alpha=0.1)
    shape = measure(capture, gloss="none", repair="none")
    own = NORMALS.load("least-squares")(capture.reflectance(), capture.lights, capture.mask, shape.weights).uncertainty
    table = table_for("none", "least-squares")
    assert table is not None
    assert np.allclose(shape.normals.uncertainty, table(own, np.zeros_like(own)), rtol=1e-5, equal_nan=True)
    assert np.nanmedian(shape.normals.uncertainty) > np.nanmedian(own)


def test_where_removal_was_doubted_a_pixel_is_as_uncertain_as_without_it(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 32, specular=0.5, alpha=0.1)
    layers = GLOSS.load("chromaticity")(capture)
    doubt = np.zeros(capture.mask.shape, np.float32)
    doubt[:, 12:] = 0.5
    doubt[:, 20:] = 1
    layers = replace(layers, matte=np.where(doubt[None, ..., None] == 1, capture.images, layers.diffuse), doubt=doubt)
    shape = reconstruct(capture, layers, Settings(gloss="chromaticity", repair="none"))
    own = NORMALS.load("least-squares")(
        capture.reflectance(layers.matte), capture.lights, capture.mask, shape.weights
    ).uncertainty
    changed = change(capture, shape.images)
    with_it, without = (table_for(name, "least-squares") for name in ("chromaticity", "none"))
    assert with_it is not None
    assert without is not None
    a, b = with_it(own, changed), without(own, np.zeros_like(own))
    assert np.nanmax(np.abs(a - b)) > 1
    np.testing.assert_allclose(shape.normals.uncertainty, a + doubt * (b - a), rtol=1e-4)
    (note,) = (note for note in shape_metrics(shape)["notes"] if "no surface has" in note)
    assert note.startswith(f"On {100 * doubt[capture.mask].mean():.0f} % of the object")
    assert "chromaticity" in note
    calm = reconstruct(capture, replace(layers, doubt=0 * doubt), Settings(gloss="chromaticity", repair="none"))
    np.testing.assert_allclose(calm.normals.uncertainty, a, rtol=1e-4)
    assert not any("measured as they are" in note for note in shape_metrics(calm)["notes"])


def test_where_the_pictures_were_kept_for_little_would_change_it_is_said(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 32, layer="matte")
    layers = GLOSS.load("chromaticity")(capture)
    kept = np.zeros(capture.mask.shape, np.float32)
    kept[:, 8:] = 1
    doubt = np.zeros_like(kept)
    doubt[:, 30:] = 1
    for parts, says in (((doubt, kept), True), ((doubt, doubt), False), ((kept, kept), False), ((None, kept[::-1, ::-1]), True)):
        shape = reconstruct(
            capture, replace(layers, doubt=parts[0], kept=parts[1]), Settings(gloss="chromaticity", repair="none")
        )
        notes = [note for note in shape_metrics(shape)["notes"] if "hardly turn" in note]
        assert len(notes) == says
        if says:
            share = parts[1][capture.mask].mean() - (0 if parts[0] is None else parts[0][capture.mask].mean())
            assert notes[0].startswith(f"On {100 * share:.0f} % of the object")
            assert "chromaticity" in notes[0]


def test_the_command_writes_tables(
    synthetic: Synthetic, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(calibrate, "pairs", lambda: [("none", "least-squares"), ("chromaticity", "l1")])
    for i, alpha in enumerate((0.1, 0.3)):
        write_render(synthetic("sphere", 32, specular=0.5, alpha=alpha), tmp_path / "set" / f"c{i}")
    out = tmp_path / "calibration.json"
    assert calibrate.main([str(tmp_path / "set"), "-o", str(out)]) == 0
    tables = json.loads(out.read_text())["tables"]
    assert [(t["gloss"], t["normals"]) for t in tables] == [("chromaticity", "l1"), ("none", "least-squares")]
    assert all(0 < t["pixels"] <= 4 * calibrate.PIXELS and t["error"][-1] >= t["error"][0] > 0 for t in tables)
    write_render(replace(synthetic("sphere", 16), truth=Truth()), tmp_path / "bare")
    capsys.readouterr()
    assert calibrate.main([str(tmp_path / "bare"), "-o", str(tmp_path / "no.json")]) == 2
    assert "no true normals" in capsys.readouterr().err
    assert not (tmp_path / "no.json").exists()
