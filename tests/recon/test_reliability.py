"""The calibration of stated uncertainties, against draws whose spread is known."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Capture, Truth
from gen.errors import InputError
from gen.formats.render_folder import write_render
from recon.normals.reliability import main, of_captures, reliability, table

Synthetic = Callable[..., Capture]


def test_true_spreads_are_calibrated_and_scaled_ones_are_not() -> None:
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.6, 10, (400, 300))
    error = np.abs(sigma * rng.normal(size=sigma.shape))
    honest = reliability(sigma, error)
    assert honest.calibration_error < 0.1
    assert honest.actual == pytest.approx(honest.predicted, rel=0.02)
    boasting = reliability(sigma / 2, error)
    assert boasting.calibration_error == pytest.approx(sigma.mean() / 2, rel=0.05)
    assert sum(b.share for b in honest.bins) == pytest.approx(1)


def test_bins_by_hand() -> None:
    sigma = np.array([0.2, 0.4, 4.0, 4.5, np.nan, 200.0])
    error = np.array([0.3, 0.4, 3.0, 5.0, 1.0, np.nan])
    result = reliability(sigma, error, (0, 1, 10))
    first, second = result.bins
    assert (first.low, first.high, first.share) == (0, 1, 0.5)
    assert first.predicted == pytest.approx(0.3)
    assert first.actual == pytest.approx(np.sqrt((0.09 + 0.16) / 2))
    assert second.predicted == pytest.approx(4.25)
    assert second.actual == pytest.approx(np.sqrt(17))
    assert result.calibration_error == pytest.approx((abs(0.3 - first.actual) + abs(4.25 - second.actual)) / 2)
    assert result.pixels == 4
    assert result.unknown == pytest.approx(0.2)


def test_values_beyond_the_edges_fall_into_the_last_bins() -> None:
    result = reliability(np.array([0.1, 90.0]), np.array([1.0, 1.0]), (1, 2, 3))
    assert [b.low for b in result.bins] == [1, 2]


@pytest.mark.parametrize(
    ("sigma", "error", "edges", "words"),
    [
        (np.ones(3), np.ones(4), (0, 1), "must be of one shape"),
        (np.ones(3), np.ones(3), (0, 0, 1), "edges must increase"),
        (np.full(3, np.nan), np.ones(3), (0, 1), "no pixel has both"),
        (-np.ones(3), np.ones(3), (0, 1), "negative"),
    ],
)
def test_nonsense_is_refused(sigma: np.ndarray, error: np.ndarray, edges: tuple[float, ...], words: str) -> None:
    with pytest.raises(InputError, match=words):
        reliability(sigma, error, edges)


def test_the_command_prints_the_table_of_a_solver(
    synthetic: Synthetic, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Least squares on glossy pictures: what it states is set against what it errs, by the same numbers as the function gives."""
    folder = tmp_path / "ball"
    write_render(synthetic("sphere", 32), folder)
    assert main([str(folder), "--normals", "least-squares", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    result = of_captures([folder], "least-squares")
    assert printed["calibration_error"] == pytest.approx(result.calibration_error)
    assert printed["actual"] > 3
    assert main([str(folder), "--normals", "least-squares"]) == 0
    out = capsys.readouterr().out
    assert out == table(result) + "\n"
    assert out.count("\n") == len(result.bins) + 3


def test_the_command_refuses_in_one_line(synthetic: Synthetic, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capture = synthetic("sphere", 16)
    write_render(Capture(capture.images, capture.lights, capture.mask, truth=Truth(diffuse=capture.images)), tmp_path / "bare")
    assert main([str(tmp_path / "bare"), "--normals", "least-squares"]) == 2
    assert "has no true normals" in capsys.readouterr().err
    assert main([str(tmp_path / "bare"), "--normals", "guess"]) == 2
    assert "unknown photometric-stereo solver" in capsys.readouterr().err
