"""Screening: single pictures with overexposed pixels are left out, frames of stacks never are."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Fault, read_capture
from gen.cli import app
from gen.errors import InputError
from gen.sets.screening import Verdict, kept_items, reasons, screen, screening_of, write_screening
from gen.sets.set_folder import SetFolder


def call(*tokens: str | Path) -> None:
    app([str(token) for token in tokens], exit_on_error=False, result_action="return_value")


def test_singles_are_left_out_and_frames_are_not(finished_set: SetFolder) -> None:
    verdicts = {(v.id, v.frame): v for v in screen(finished_set)}
    assert verdicts["one-000000", 1] == Verdict("one-000000", 1, True, None, 0, 0)
    assert verdicts["one-000001", 1] == Verdict("one-000001", 1, False, "overexposed", 6, 0)
    assert verdicts["one-000005", 1] == Verdict("one-000005", 1, False, "not rendered", 0, 0)
    assert verdicts["stack-000000", 1] == Verdict("stack-000000", 1, True, None, 6, 6)
    assert len(verdicts) == 6 + 3 * 5 + 2
    assert kept_items(verdicts.values())["stack-000000"] == 5
    assert reasons(verdicts.values()) == {"overexposed": 2, "not rendered": 1}


def test_what_is_kept_agrees_with_the_pictures_in_8_bits(finished_set: SetFolder) -> None:
    """Against the definition, from the pixels: sRGB by IEC 61966-2-1, written out here."""
    for verdict in screen(finished_set):
        if verdict.reason == "not rendered":
            continue
        capture = read_capture(finished_set.path / "items" / verdict.id)
        x = np.clip(capture.images[verdict.frame - 1].astype(float), 0, 1)
        eight_bit = np.rint(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055))
        white = int((eight_bit.min(axis=2) == 255).sum())
        assert verdict.overexposed_pixels == white
        assert verdict.clipped_samples == int(((capture.faults[verdict.frame - 1] & Fault.CLIPPED) > 0).sum())
        assert verdict.kept == (not white or verdict.id.startswith("stack"))


def test_the_file_holds_the_verdicts(set_folder: SetFolder) -> None:
    path = set_folder.path / "screening.jsonl"
    verdicts = screening_of(set_folder)  # screens first
    assert [Verdict(**json.loads(line)) for line in path.read_text().splitlines()] == verdicts == screen(set_folder)
    before = path.read_bytes()
    write_screening(set_folder)
    assert path.read_bytes() == before
    path.write_text(path.read_text().replace('"kept": true', '"kept": false', 1))
    with pytest.raises(InputError, match=r"screening.jsonl: line 1 is not a verdict; run degloss gen screen again"):
        screening_of(set_folder)


DAMAGE: dict[str, tuple[Callable[[str], str], str]] = {
    "cut": (lambda text: text[:-20], "line 23 is not a verdict"),
    "not JSON": (lambda text: "{" * 3000 + "\n" + text, "line 1 is not a verdict"),
    "wrong kind": (lambda text: text.replace('"frame": 1', '"frame": true', 1), "line 1 is not a verdict"),
    "other set": (lambda text: text.replace("one-000000", "two-000000"), "judges other items than the index holds"),
    "short": (lambda text: "\n".join(text.splitlines()[:5]), "judges other items than the index holds"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_file_is_one_line(set_folder: SetFolder, name: str) -> None:
    write_screening(set_folder)
    path = set_folder.path / "screening.jsonl"
    path.write_text(DAMAGE[name][0](path.read_text()))
    with pytest.raises(InputError, match=DAMAGE[name][1]):
        screening_of(set_folder)


def test_pixels_are_read_only_for_stacks_that_clip(set_folder: SetFolder) -> None:
    for place in (set_folder.path / "items").iterdir():
        if place.name != "stack-000000":
            (place / "capture.json").unlink()
    assert sum(v.clipped_samples for v in screen(set_folder)) == 6


def test_the_command_says_what_was_left_out(set_folder: SetFolder, capsys: pytest.CaptureFixture[str]) -> None:
    call("screen", set_folder.path)
    printed = capsys.readouterr().out
    assert "20 of 23 pictures kept; 2 left out: overexposed; 1 left out: not rendered; 6 clipped samples" in printed
    call("screen", set_folder.path, "--json")
    facts = json.loads(capsys.readouterr().out)
    assert (facts["pictures"], facts["kept"], facts["left_out"]) == (23, 20, {"overexposed": 2, "not rendered": 1})
    with pytest.raises(InputError, match=r"set.json"):
        call("screen", set_folder.path / "items")
