"""The check of a folder of photographs: what is missing or doubtful is said in words."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.capture import Capture
from gen.errors import InputError
from recon.photo_check import Finding, check_photos
from tests.gen.photos.photo_scenes import LIGHTS, matte_folder, ring, save, say

Synthetic = Callable[..., Capture]


@pytest.fixture
def folder(tmp_path: Path, synthetic: Synthetic) -> Path:
    return matte_folder(tmp_path / "photos", synthetic(lights=LIGHTS, layer="matte"))


def untouched(path: Path) -> None:
    """The picture stays as it is."""


DOUBTS: dict[str, tuple[dict[str, Any], Callable[[Path], object], str, str]] = {
    # what is wrong: (beside the ordinary, what is done to p3.png, the level, what it is about)
    "no lights": ({"lights": None}, untouched, "missing", "lights"),
    "lights in one plane": ({"lights": {"directions": [[x, 0, 1] for x in range(6)]}}, untouched, "missing", "lights"),
    "lights too much alike": ({"lights": {"directions": ring(1, 5).tolist()}}, untouched, "missing", "lights"),
    "a light from behind": (
        {"lights": {"directions": (LIGHTS * [[1], [1], [1], [1], [1], [-1]]).tolist()}},
        untouched,
        "doubtful",
        "lights",
    ),
    "two pictures": (
        {"images": ["p1.png", "p2.png"], "lights": {"directions": LIGHTS[:2].tolist()}},
        untouched,
        "missing",
        "lights",
    ),
    "a clipped picture": ({}, lambda p: save(p, np.ones((64, 64, 3))), "doubtful", "clipped"),
    "a lamp that was off": ({}, lambda p: save(p, np.full((64, 64, 3), 0.001)), "doubtful", "dark"),
    "no scale": ({"mm_per_pixel": None}, untouched, "note", "scale"),
    "a ball that is not there": (
        {"lights": {"balls": [{"kind": "chrome", "circle_px": [900, 20, 8]}]}},
        untouched,
        "missing",
        "ball",
    ),
    "three lights of unknown strength": (
        {"images": ["p1.png", "p2.png", "p4.png"], "lights": {"directions": LIGHTS[[0, 1, 3]].tolist()}, "intensities": None},
        untouched,
        "doubtful",
        "intensities",
    ),
}


@pytest.mark.parametrize("case", list(DOUBTS))
def test_what_is_doubtful_is_said(folder: Path, case: str) -> None:
    values, harm, level, about = DOUBTS[case]
    say(
        folder,
        **{"images": "p*.png", "lights": {"directions": LIGHTS.tolist()}, "intensities": "equal", "mm_per_pixel": 0.1, **values},
    )
    harm(folder / "p3.png")
    findings = check_photos(folder)
    assert (level, about) == (findings[0].level, findings[0].about), findings
    assert len(findings[0].text) > 20
    assert findings[0].text.endswith((".", "?"))


@pytest.mark.parametrize("stored", ["srgb", "linear"])
def test_numbers_that_are_read_the_wrong_way_are_suspected(folder: Path, synthetic: Synthetic, stored: str) -> None:
    for k, picture in enumerate(synthetic(lights=LIGHTS, layer="matte").images):
        save(folder / f"p{k + 1}.png", picture, 8, srgb=stored == "srgb")
    for said in ("srgb", "linear"):
        say(folder, images="p*.png", lights={"directions": LIGHTS.tolist()}, intensities="equal", mm_per_pixel=0.1, colour=said)
        about = [f.about for f in check_photos(folder)]
        assert about == (["8-bit"] if said == stored else ["encoding", "8-bit"])


def test_no_mask_and_a_black_picture_are_said(folder: Path) -> None:
    (folder / "mask.png").unlink()
    for k in range(1, 7):
        save(folder / f"p{k}.png", np.full((64, 64, 3), 0.004))
    about = {f.about: f.level for f in check_photos(folder)}
    assert about["mask"] == about["dark"] == "doubtful"


def test_the_command_says_it_in_words_or_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from recon.cli import capture

    capture(folder)
    assert capsys.readouterr().out == "nothing is missing or doubtful\n"
    say(folder, images="p*.png", lights=None, intensities="equal")
    with pytest.raises(InputError, match="cannot be measured yet: 1 thing is missing"):
        capture(folder)
    out = capsys.readouterr().out
    assert out.startswith("missing   capture.yaml: lights: is missing")
    assert "heights are in pixels" in out
    with pytest.raises(InputError):
        capture(folder, json=True)
    found = json.loads(capsys.readouterr().out)
    assert found["measurable"] is False
    assert [Finding(**one).level for one in found["findings"]] == ["missing", "note"]
