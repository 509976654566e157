"""Odd names that are quite in order: blanks, quotes, other scripts, bytes that are no text. The commands work on them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gen.capture import read_capture
from tests.hostile.commands import run
from tests.hostile.files import lay_photographs

ROOT = Path(__file__).resolve().parents[2]

NAMES = {
    "blanks": b"my  photos ",
    "quotes": b'it\'s "so"',
    "a line end": b"two\nlines",
    "other scripts": "Фото 写真 🙂".encode(),
    "a combining accent": "cafe\u0301".encode(),
    "bytes that are no text": b"caf\xe9",
    "an escape sequence": b"\x1b[31mred",
    "markup": b"<b>&amp;",
    "a hyphen first": b"-photos",
    "250 letters": b"a" * 250,
}


@pytest.mark.parametrize("kind", NAMES)
def test_photographs_under_an_odd_name_are_measured(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """From the folder that they lie in, with nothing before the name but the ./ that a shell completes."""
    name = os.fsdecode(NAMES[kind])
    output = f"{name[:200]}-out"
    monkeypatch.chdir(tmp_path)
    Path(name).mkdir()
    lay_photographs(Path(name))
    words = (
        "recon",
        "run",
        f"./{name}",
        "-o",
        f"./{output}",
        "--gloss",
        "none",
        "--inpaint",
        "none",
        "--normals",
        "least-squares",
        "--json",
    )
    assert run(*words).code == 0, capfd.readouterr()
    out, err = capfd.readouterr()
    assert json.loads(out)["lights"] == 5
    assert err == ""
    assert json.loads((tmp_path / output / "metrics.json").read_text())["lights"] == 5


def test_pictures_under_odd_names_are_read(tmp_path: Path) -> None:
    lay_photographs(tmp_path)
    names = ["a b.png", "ü.png", os.fsdecode(b"\xff.png"), "'c'.PNG", "5.png"]
    for k, name in enumerate(names[:4]):
        (tmp_path / f"{k + 1}.png").rename(tmp_path / name)
    capture = read_capture(tmp_path)
    assert sorted(capture.names) == sorted([*names[:2], "\\udcff.png", *names[3:]])
    assert capture.images.std(axis=(1, 2, 3)).min() > 0


def test_a_name_that_is_no_text_is_named_in_a_refusal(tmp_path: Path) -> None:
    """From the outside, as the bytes that a shell hands over, where the terminal knows ASCII alone."""
    place = os.fsencode(tmp_path) + b"/caf\xe9"
    done = subprocess.run(
        [sys.executable, "-m", "degloss", "recon", "run", place, "-o", os.fsencode(tmp_path) + b"/out"],
        capture_output=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )
    assert done.returncode == 2
    assert done.stderr.count(b"\n") == 1
    assert b"caf\\udce9: there is no such file or folder" in done.stderr
    assert list(tmp_path.iterdir()) == []
