"""Pipes, folders, devices and links where a file is wanted: every command, every input. Nothing waits for ever, nothing reads on."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.hostile.commands import Case, require_refusal
from tests.hostile.files import lay_photographs, pack_bytes, png


def pipe(path: Path) -> None:
    os.mkfifo(path)


def folder(path: Path) -> None:
    path.mkdir()


def zeros(path: Path) -> None:
    """A link to a device that never ends."""
    path.symlink_to("/dev/zero")


def dangling(path: Path) -> None:
    path.symlink_to(path.parent / "gone")


def circle(path: Path) -> None:
    path.symlink_to(path)


KINDS: dict[str, Callable[[Path], None]] = {
    "pipe": pipe,
    "folder": folder,
    "device": zeros,
    "dangling link": dangling,
    "link to itself": circle,
}


def photographs(folder: Path) -> Path:
    (folder / "photos").mkdir()
    lay_photographs(folder / "photos")
    return folder / "photos"


def beside_photographs(name: str) -> Callable[[Path], Path]:
    def lay(folder: Path) -> Path:
        path = photographs(folder) / name
        path.unlink(missing_ok=True)
        return path

    return lay


def alone(name: str) -> Callable[[Path], Path]:
    return lambda folder: folder / name


def with_picture(name: str) -> Callable[[Path], Path]:
    def lay(folder: Path) -> Path:
        (folder / "a.png").write_bytes(png())
        return folder / name

    return lay


def with_pack(name: str) -> Callable[[Path], Path]:
    def lay(folder: Path) -> Path:
        (folder / "data.safetensors").write_bytes(pack_bytes())
        return folder / name

    return lay


INPUTS: dict[str, tuple[Callable[[Path], Path], str]] = {
    # what is replaced: (what lays the rest and says where it goes, the command)
    "a picture": (alone("a.png"), "learn predict specular HERE/a.png -o HERE/out"),
    "lights": (beside_photographs("lights.txt"), "recon run HERE/photos -o HERE/out"),
    "a spec": (alone("spec.yaml"), "gen render HERE/spec.yaml -o HERE/out"),
    "a set spec": (alone("set.yaml"), "gen plan HERE/set.yaml -o HERE/plan.jsonl"),
    "a plan": (alone("plan.jsonl"), "gen render-chunk HERE/plan.jsonl --index 0 --chunks 2 -o HERE/out"),
    "a benchmark": (alone("bench.yaml"), "recon bench HERE/bench.yaml -o HERE/out"),
    "a config": (alone("config.toml"), "learn train HERE/config.toml -o HERE/out"),
    "weights": (with_picture("w.safetensors"), "learn predict HERE/w.safetensors HERE/a.png -o HERE/out"),
    "weights to export": (alone("w.safetensors"), "learn export HERE/w.safetensors -o HERE/w.onnx"),
    "a pack": (alone("data.safetensors"), "learn eval specular HERE/data.safetensors"),
    "a mask": (with_picture("mask.png"), "learn predict specular HERE/a.png --mask HERE/mask.png -o HERE/out"),
    "a table of lights": (with_picture("l.txt"), "learn predict group HERE/a.png --lights HERE/l.txt -o HERE/out"),
    "a capture": (alone("capture"), "recon run HERE/capture -o HERE/out"),
    "photographs to check": (alone("capture"), "recon capture HERE/capture"),
    "photographs without lights": (alone("capture"), "recon lights HERE/capture"),
    "a set": (alone("set"), "gen verify HERE/set"),
    "a set to screen": (alone("set"), "gen screen HERE/set"),
    "a set to divide": (alone("set"), "gen split HERE/set"),
    "a set to draw": (alone("set"), "gen preview HERE/set -o HERE/sheet.png"),
    "a set to pack": (alone("set"), "gen pack HERE/set -o HERE/pack.safetensors"),
    "views": (alone("views"), "recon multiview HERE/views -o HERE/out"),
    "a measured mesh": (alone("part.stl"), "recon inspect HERE/part.stl HERE/part.stl -o HERE/out --tolerance 0.1"),
}


@contextmanager
def nobody_waits(path: Path) -> Iterator[None]:
    """Fail, in place of waiting for ever, where somebody has opened a pipe to read from it."""
    waited = threading.Event()

    def end_it() -> None:
        try:
            os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK))
        except OSError:
            return  # nobody reads
        waited.set()

    timer = threading.Timer(10, end_it)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
    assert not waited.is_set(), "a pipe was opened and waited for"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("what", INPUTS)
def test_what_is_no_file_is_refused(what: str, kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    place, command = INPUTS[what]
    if command.startswith("learn") and find_spec("torch") is None:
        pytest.skip("torch is not installed")
    path = place(tmp_path).resolve()
    KINDS[kind](path)
    with nobody_waits(path):
        require_refusal(Case(lambda _: None, command, path.name, ""), tmp_path, capfd)
