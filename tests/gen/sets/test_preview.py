"""Contact sheets: the tiles hold the layers as 8-bit sRGB, and the sheet fits on a screen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from gen.capture import Capture, Truth
from gen.cli import app
from gen.errors import InputError
from gen.formats.render_folder import write_render
from gen.sets.preview import LAYERS, WIDTH, brightest, contact_sheet
from gen.sets.screening import write_screening
from gen.sets.set_folder import SetFolder


def call(*tokens: str | Path) -> None:
    app([str(token) for token in tokens], exit_on_error=False, result_action="return_value")


def colours(sheet: np.ndarray) -> set[tuple[int, ...]]:
    return {tuple(map(int, colour)) for colour in np.unique(sheet.reshape(-1, 3), axis=0)}


@pytest.fixture
def flat() -> Capture:
    """A plate that faces the camera, every layer of one colour."""
    layers = {"diffuse": (0.2, 0.1, 0.05), "specular": (0.01, 0.02, 0.03), "matte": (0.5, 0.25, 0.125)}
    parts = {name: np.broadcast_to(np.float32(colour), (2, 40, 40, 3)).copy() for name, colour in layers.items()}
    truth = Truth(normals=np.broadcast_to(np.float32([0, 0, 1]), (40, 40, 3)).copy(), **parts)
    mask = np.ones((40, 40), bool)
    lights = np.array([[0, 0, 1.0], [1, 0, 1.0]])
    return Capture(images=truth.diffuse + truth.specular, lights=lights, mask=mask, truth=truth)


def srgb(*linear: float) -> tuple[int, ...]:
    return tuple(round(255 * (1.055 * x ** (1 / 2.4) - 0.055)) for x in linear)


def test_tiles_are_the_layers(flat: Capture, tmp_path: Path) -> None:
    write_render(flat, tmp_path / "plate")
    sheet = contact_sheet(tmp_path / "plate")
    expected = {
        "picture": srgb(0.21, 0.12, 0.08),
        "diffuse": srgb(0.2, 0.1, 0.05),
        "specular": srgb(0.01, 0.02, 0.03),
        "matte": srgb(0.5, 0.25, 0.125),
        "normals": (128, 128, 255),
    }
    places = []
    for layer in LAYERS:
        rows, columns = np.nonzero((sheet == expected[layer]).all(axis=2))
        assert len(rows) > 2 * 100**2, layer  # a tile for each of the two pictures
        assert len(rows) == len(np.unique(rows)) * len(np.unique(columns)), f"{layer} is not whole rectangles"
        places.append(float(columns.mean()))
    assert places == sorted(places)
    assert len({round(b - a) for a, b in pairwise(places)}) == 1


def test_missing_layers_have_no_column(flat: Capture, tmp_path: Path) -> None:
    write_render(flat, tmp_path / "whole")
    write_render(replace(flat, truth=Truth(normals=flat.truth.normals)), tmp_path / "bare")
    whole, bare = contact_sheet(tmp_path / "whole"), contact_sheet(tmp_path / "bare")
    assert bare.shape[0] == whole.shape[0]
    assert bare.shape[1] < 0.6 * whole.shape[1]
    assert srgb(0.5, 0.25, 0.125) not in colours(bare)


def test_a_set_is_drawn_by_its_seed(finished_set: SetFolder) -> None:
    steps: list[tuple[int, int]] = []
    whole = contact_sheet(finished_set.path, progress=lambda done, total: steps.append((done, total)))
    assert steps[-1] == (10, 10)
    assert whole.dtype == np.uint8
    some = [contact_sheet(finished_set.path, count=3, seed=seed) for seed in (0, 0, 1)]
    assert np.array_equal(some[0], some[1])
    assert not np.array_equal(some[0], some[2])
    assert some[0].shape[0] < whole.shape[0]


@pytest.mark.parametrize("count", [1, 5, 6, 24, 41])
def test_a_sheet_fits_on_a_screen(synthetic: Callable[..., Capture], tmp_path: Path, count: int) -> None:
    lights = np.tile([[0.3, 0.2, 1.0]], (count, 1)) + np.linspace(0, 1, count)[:, None] * [0, 0, 1]
    write_render(synthetic(size=16, lights=lights / np.linalg.norm(lights, axis=1, keepdims=True)), tmp_path / "c")
    sheet = contact_sheet(tmp_path / "c", count=count)
    assert sheet.shape[1] <= WIDTH
    assert sheet.shape[0] <= 2.2 * WIDTH
    assert (sheet[:8] == sheet[0, 0]).all()  # an even margin
    assert (sheet[-8:] == sheet[0, 0]).all()


def test_what_screening_left_out_is_marked(set_folder: SetFolder) -> None:
    before = contact_sheet(set_folder.path)
    write_screening(set_folder)
    after = contact_sheet(set_folder.path)
    red = [int(((s[..., 0] > 150) & (s[..., 2] < 60)).sum()) for s in (before.astype(int), after.astype(int))]
    assert red[1] > red[0] + 50
    assert before.shape == after.shape


def test_the_brightest_picture_is_shown(flat: Capture) -> None:
    scaled = flat.with_images(flat.images * np.float32([1, 2])[:, None, None, None])
    assert brightest(scaled) == 1
    glint = np.zeros_like(flat.images)
    glint[0, :2, :2] = 1e6  # a few pixels of any radiance do not make a bright picture
    assert brightest(scaled.with_images(scaled.images + glint)) == 1


def test_the_command_writes_a_png(
    set_folder: SetFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    call("preview", set_folder.path)
    assert "preview.png: " in capsys.readouterr().out
    drawn = cv2.imread(str(set_folder.path / "preview.png"))
    assert np.array_equal(drawn[..., ::-1], contact_sheet(set_folder.path))
    call("preview", set_folder.path / "items/stack-000000", "--count", "2", "--seed", "3")
    assert (tmp_path / "stack-000000-preview.png").is_file()
    call("preview", set_folder.path / "items/stack-000000", "-o", tmp_path / "s.png")
    assert (tmp_path / "s.png").is_file()
    for options, expected in ((["--count", "0"], "--count 0"), (["--seed=-1"], "--seed -1")):
        with pytest.raises(InputError, match=expected):
            call("preview", set_folder.path, *options)
    with pytest.raises(InputError, match="there is no such file or folder"):
        call("preview", tmp_path / "nothing")
