"""Hostile capture folders of ours: an index that lies, leads elsewhere, or asks for more than there is."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.exr import read_exr, write_exr
from gen.formats.render_folder import write_files
from tests.conftest import synthetic_capture
from tests.hostile.commands import Case, require_refusal

Harm = Callable[[Path], object]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    write_files(synthetic_capture(size=8), folder)
    return folder


def text(content: str | bytes) -> Harm:
    return lambda folder: (folder / "capture.json").write_bytes(content.encode() if isinstance(content, str) else content)


def index(**changes: Any) -> Harm:
    """Keys of the index set to other values; GONE takes them out."""

    def harm(folder: Path) -> None:
        table = json.loads((folder / "capture.json").read_text())
        table |= changes
        (folder / "capture.json").write_text(json.dumps({key: value for key, value in table.items() if value is not GONE}))

    return harm


def frame(number: int = 0, **changes: Any) -> Harm:
    def harm(folder: Path) -> None:
        table = json.loads((folder / "capture.json").read_text())
        entry = table["frames"][number] | changes
        table["frames"][number] = {key: value for key, value in entry.items() if value is not GONE}
        (folder / "capture.json").write_text(json.dumps(table))

    return harm


def channels(change: Callable[[dict[str, Any]], object], file: str = "frames/002.exr") -> Harm:
    def harm(folder: Path) -> None:
        held = read_exr(folder / file)
        change(held)
        write_exr(folder / file, held)

    return harm


def outside(folder: Path) -> None:
    shutil.move(folder / "frames/001.exr", folder.parent / "secret.exr")
    (folder / "frames/001.exr").symlink_to(folder.parent / "secret.exr")


def one_picture_ten_thousand_times(folder: Path) -> None:
    table = json.loads((folder / "capture.json").read_text())
    table["frames"] = table["frames"][:1] * 10_000
    (folder / "capture.json").write_text(json.dumps(table))


def key_twice(folder: Path) -> None:
    content = (folder / "capture.json").read_text()
    (folder / "capture.json").write_text(content.replace('"encoding"', '"source": "elsewhere", "encoding"', 1))


GONE: Any = object()
CAPTURES: dict[str, tuple[Harm, str, str]] = {
    # what is wrong: (how it is done, what the line names, what it says)
    "an empty index": (text(""), "capture.json", "is empty"),
    "an index that is cut": (text('{"format": "degloss capture", '), "capture.json", "not valid JSON"),
    "no JSON": (text("format: degloss capture"), "capture.json", "not valid JSON"),
    "a list": (text("[]"), "capture.json", "is not the index"),
    "nested 100,000 deep": (text("[" * 100_000), "capture.json", "not valid JSON"),
    "a number of 5,000 digits": (text('{"version": ' + "9" * 5000 + "}"), "capture.json", "not valid JSON"),
    "not UTF-8": (text(b'{"format": "\xe9"}'), "capture.json", "not valid JSON"),
    "a key twice": (key_twice, "capture.json", "'source' is there twice"),
    "another format": (index(format="tar"), "capture.json", "is not the index"),
    "another version": (index(version=99), "capture.json", "version 99"),
    "no frames": (index(frames=[]), "capture.json", "it lists 0"),
    "frames that are none": (index(frames="all"), "capture.json", "not a list"),
    "frames without end": (index(frames=[{}] * 10_001), "capture.json", "it lists 10001"),
    "one picture 10,000 times": (one_picture_ten_thousand_times, "capture.json", "a second time"),
    "a frame that is a number": (index(frames=[3]), "capture.json", "must be an object"),
    "a frame without a file": (frame(file=GONE), "capture.json", "file is missing"),
    "a file that leads up": (frame(file="../x.exr"), "capture", "leads out of the folder"),
    "an absolute file": (frame(file="/etc/hostname"), "capture", "leads out of the folder"),
    "a file of a Windows drive": (frame(file="C:\\x.exr"), "capture", "leads out of the folder"),
    "a file with a zero byte": (frame(file="a\0.exr"), "capture", "leads out of the folder"),
    "a file with half a character": (frame(file="\ud800.exr"), "capture", ""),
    "a link that leads out": (outside, "capture", "leads out of the folder"),
    "a name too long for a file": (frame(file="a" * 300), "capture", ""),
    "no direction": (frame(direction=GONE), "capture.json", "direction is missing"),
    "a direction of two numbers": (frame(direction=[0, 1]), "capture.json", "three numbers"),
    "a direction of words": (frame(direction=["0", "0", "1"]), "capture.json", "three numbers"),
    "a direction that is NaN": (frame(direction=[0, float("nan"), 1]), "capture", "not finite"),
    "a direction of no length": (frame(direction=[0, 0, 0]), "capture", "has no length"),
    "an intensity of nothing": (frame(intensity=[0, 1, 1]), "capture", "positive and finite"),
    "an intensity below zero": (frame(intensity=[-1, 1, 1]), "capture", "positive and finite"),
    "an intensity without end": (frame(intensity=[1e301, 1, 1]), "capture.json", "three numbers"),
    "a kind of light that is not known": (frame(kind="laser"), "capture", "unknown kind 'laser'"),
    "a near light without a place": (frame(kind="point"), "capture", "no position"),
    "a near light at the object": (frame(kind="point", position_mm=[0, 0, 0]), "capture", "at the origin"),
    "a sun with a place": (frame(position_mm=[0, 0, 500]), "capture", "which has none"),
    "a mask that leads up": (index(mask="../../mask.png"), "capture", "leads out of the folder"),
    "a mask that is not there": (index(mask="no.png"), "no.png", "no such file"),
    "a view that leads up": (index(view="../view.exr"), "capture", "leads out of the folder"),
    "a view that is a number": (index(view=3), "capture.json", "view is missing"),
    "a scale of nothing": (index(scale={"mm_per_pixel": 0}), "", "mm_per_pixel must be a positive number"),
    "a scale that is NaN": (index(scale={"mm_per_pixel": float("nan")}), "", "mm_per_pixel must be a positive number"),
    "a scale in words": (index(scale={"mm_per_pixel": "1"}), "capture.json", "number or null"),
    "a scale of 400 digits": (index(scale={"mm_per_pixel": 10**400}), "capture.json", "number or null"),
    "a camera of 400 digits": (index(scale={"camera": [[10**400, 0, 0], [0, 1, 0], [0, 0, 1]]}), "capture.json", "3x3"),
    "a direction of 400 digits": (frame(direction=[10**400, 0, 1]), "capture.json", "three numbers"),
    "a camera of two rows": (index(scale={"camera": [[1, 0, 0], [0, 1, 0]]}), "", "3x3"),
    "a camera of words": (index(scale={"camera": [["a"]]}), "capture.json", "3x3"),
    "a ragged camera": (index(scale={"camera": [[1], [1, 2]]}), "capture.json", "3x3"),
    "faults without a channel": (index(faults=True), "frames/001.exr", "faults.V"),
    "no provenance": (index(provenance=[]), "capture.json", "provenance is missing"),
    "a picture without colour": (
        channels(lambda held: [held.pop(k) for k in ("R", "diffuse.R", "specular.R", "matte.R")]),
        "frames/002.exr",
        "",
    ),
    "a layer in one picture only": (
        channels(lambda held: held.update({f"ks0.{c}": held["R"] for c in "RGB"})),
        "frames/002.exr",
        "has the layers",
    ),
    "shadows that are no flags": (channels(lambda held: held.update({"shadow.V": held["R"] + 0.5})), "frames/002.exr", "flags"),
    "a picture of another size": (
        lambda folder: write_exr(folder / "frames/003.exr", dict.fromkeys("RGB", np.ones((9, 9)))),
        "frames/003.exr",
        "9x9 pixels",
    ),
    "a view of another size": (
        lambda folder: write_exr(folder / "view.exr", {"depth.Z": np.ones((9, 9))}),
        "view.exr",
        "9x9 pixels",
    ),
    "a picture that is cut": (
        lambda folder: (folder / "frames/002.exr").write_bytes((folder / "frames/002.exr").read_bytes()[:400]),
        "frames/002.exr",
        "damaged or truncated",
    ),
    "a picture that is text": (
        lambda folder: (folder / "frames/002.exr").write_text("hello"),
        "frames/002.exr",
        "not an OpenEXR file",
    ),
    "nothing but NaN": (
        lambda folder: [write_exr(p, dict.fromkeys("RGB", np.full((8, 8), np.nan))) for p in folder.glob("frames/*")],
        "capture",
        "not one finite value",
    ),
}


@pytest.mark.parametrize("what", CAPTURES)
def test_a_hostile_capture_folder_is_refused(what: str, sound: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    harm, names, says = CAPTURES[what]

    def lay(folder: Path) -> None:
        shutil.copytree(sound, folder / "capture")
        harm(folder / "capture")

    require_refusal(Case(lay, "recon run HERE/capture -o HERE/out", names, says), tmp_path, capfd)
