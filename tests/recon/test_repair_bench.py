"""The benchmark of repairs: holes as large as said, and every repair and threshold in the tables."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gen.capture import Capture
from recon.registry import REPAIR
from recon.repair import bench as repair_bench
from recon.repair.bench import HOLES, THRESHOLDS, cut_holes, hole_figures, main, threshold_figures

Synthetic = Callable[..., Capture]


def test_holes_lie_in_the_object_and_cover_their_share(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 96)
    holes = cut_holes(capture, seed=1)
    assert not holes[:, ~capture.mask].any()
    shares = holes[:, capture.mask].mean(axis=1)
    assert (shares >= HOLES).all()
    assert shares.max() < 3 * HOLES
    np.testing.assert_array_equal(holes, cut_holes(capture, seed=1))
    assert (holes != cut_holes(capture, seed=2)).any()


def test_every_repair_is_judged_in_the_same_holes(synthetic: Synthetic) -> None:
    """Of matte pictures the repairs that fill come near the truth, across the stack nearest; the others leave the holes black."""
    figures = hole_figures(synthetic("sphere", 80, layer="matte"))
    assert list(figures) == list(REPAIR)
    assert figures["none"]["rms"] == pytest.approx(figures["drop"]["rms"])
    filled = {name: row["rms"] for name, row in figures.items() if name not in ("none", "drop")}
    assert max(filled.values()) < 0.3 * figures["none"]["rms"]
    assert figures["stack"]["normals"] < figures["telea"]["normals"] < figures["none"]["normals"]


def test_every_threshold_and_repair_has_its_row(synthetic: Synthetic, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(repair_bench, "REMOVERS", ("chromaticity",))
    figures = threshold_figures(synthetic("cylinder", 32, alpha=0.2, specular=0.3))
    for threshold in THRESHOLDS:
        for repair in ("telea", "stack", "drop"):
            assert np.isfinite(figures[f"chromaticity, {threshold}, {repair}"])


def test_a_wrong_number_of_draws_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--draws", "0"])
    assert stop.value.code == 2
    assert "--draws must be at least 1" in capsys.readouterr().err
