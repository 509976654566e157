"""The benchmark of the shipped networks' time: what it times is the network and what is around it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from learn.method import METHODS
from learn.speed import glossy_sphere, main, seconds
from recon.normals.least_squares import least_squares


@pytest.mark.parametrize("method", METHODS)
def test_the_network_is_a_part_of_the_remover(method: str) -> None:
    network, whole = seconds(method, glossy_sphere(48, 3), runs=2)
    assert 0 < network < whole < 5


def test_the_sphere_is_one() -> None:
    """Least squares finds x to the right and y up on it; gloss bends how far, not whereto."""
    capture = glossy_sphere(96, 5)
    assert capture.images.shape == (5, 96, 96, 3)
    every = np.ones(capture.images.shape[:3], np.float32)
    normals = least_squares(capture.reflectance(capture.images), capture.lights, capture.mask, every).normal
    y, x = np.mgrid[:96, :96] - 47.5
    middle = np.hypot(x, y) < 30
    for found, true in ((normals[..., 0], x), (normals[..., 1], -y)):
        assert np.corrcoef(found[middle], true[middle])[0, 1] > 0.9


def test_json_is_one_object(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--size", "32", "--pictures", "1", "--json"])
    figures = json.loads(capsys.readouterr().out)
    assert set(figures["seconds"]) == set(METHODS)


@pytest.mark.parametrize("given", [["--size", "7"], ["--pictures", "0"]])
def test_bad_input_ends_in_one_line(given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(given)
    assert ended.value.code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
