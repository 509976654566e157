"""Hostile places to write to: full, read-only, not a folder, no end to their names; and writes that are broken off."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from gen.exr import write_exr
from gen.files import write_json, writing, writing_folder
from gen.formats.render_folder import write_files
from gen.images import write_png
from tests.conftest import full_disk, synthetic_capture
from tests.gen.sets.conftest import SET_SPEC, write_set
from tests.hostile.commands import bound_by_permissions, require_line, run, tree
from tests.hostile.files import large_picture
from tests.hostile.readers import SET

torch = pytest.mark.skipif(find_spec("torch") is None, reason="torch is not installed")

COMMANDS = [
    "recon run IN/capture -o OUT --gloss none --inpaint none",
    "gen plan IN/set.yaml -o OUT",
    "gen preview IN/set -o OUT",
    "gen pack IN/set -o OUT --all",
    pytest.param("learn predict specular IN/a.png -o OUT --device cpu", marks=torch),
]
"""Commands that write, each of which needs no renderer."""

ROOM = 600
"""Bytes that a file may grow to on a full disk: the opening of each of theirs."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the commands read."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "capture").mkdir()
    write_files(synthetic_capture(size=24), folder / "capture")
    (folder / "a.png").write_bytes(large_picture())
    (folder / "set.yaml").write_text(SET)
    (folder / "closed.yaml").write_text(SET_SPEC.replace("count: 6", "count: 2"))
    write_set(folder / "closed.yaml", folder / "set", synthetic_capture)
    return folder


def refused(
    command: str,
    inputs: Path,
    output: Path,
    names: str,
    capsys: pytest.CaptureFixture[str],
    around: Callable[[], AbstractContextManager[None]],
    says: str = "",
) -> None:
    before = tree(output.parent) if os.path.isdir(output.parent) else {}
    words = [word.replace("IN", str(inputs), 1) if word.startswith("IN/") else word for word in command.split()]
    capsys.readouterr()
    with around():
        outcome = run(*[str(output) if word == "OUT" else word for word in words])
    out, err = capsys.readouterr()
    assert outcome.code == 2, (out, err)
    assert out == ""
    require_line(err, names, says)
    if os.path.isdir(output.parent):
        assert tree(output.parent) == before


@contextmanager
def nothing() -> Iterator[None]:
    yield


@pytest.mark.parametrize("command", COMMANDS)
def test_a_full_disk_leaves_nothing_and_says_so(
    command: str, inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused(command, inputs, tmp_path / "out", "out", capsys, lambda: full_disk(ROOM), "cannot be written")


@pytest.mark.parametrize("command", COMMANDS)
def test_an_earlier_result_outlives_a_full_disk(
    command: str, inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out"
    words = [
        str(output) if w == "OUT" else w.replace("IN", str(inputs), 1) if w.startswith("IN/") else w for w in command.split()
    ]
    assert run(*words).code == 0
    held = tree(output) if output.is_dir() else output.read_bytes()
    refused(command, inputs, output, "out", capsys, lambda: full_disk(ROOM), "cannot be written")
    assert (tree(output) if output.is_dir() else output.read_bytes()) == held


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_that_may_not_be_written_is_refused(
    command: str, inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "locked").mkdir(mode=0o555)
    refused(command, inputs, tmp_path / "locked" / "out", "out", capsys, bound_by_permissions, "cannot be written")


@pytest.mark.parametrize("name", ["capture/capture.json", "capture/frames/002.exr", "capture/mask.png", "capture"])
def test_what_may_not_be_read_is_named(name: str, inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(inputs / "capture", tmp_path / "capture")
    (tmp_path / name).chmod(0o000)
    try:
        refused("recon run IN/capture -o OUT", tmp_path, tmp_path / "out", name, capsys, bound_by_permissions)
    finally:
        (tmp_path / name).chmod(0o755)


PLACES: dict[str, tuple[Callable[[Path], Path], str]] = {
    # what is there: (what lays it and says where to write, what the line says)
    "a pipe": (lambda folder: (os.mkfifo(folder / "out"), folder / "out")[1], "is there already"),
    "a device": (lambda folder: ((folder / "out").symlink_to("/dev/full"), folder / "out")[1], "is there already"),
    "a link to itself": (lambda folder: ((folder / "out").symlink_to(folder / "out"), folder / "out")[1], "is there already"),
    "under a file": (lambda folder: ((folder / "file").touch(), folder / "file" / "out")[1], "cannot be written"),
    "under a link to itself": (
        lambda folder: ((folder / "loop").symlink_to("loop"), folder / "loop" / "out")[1],
        "cannot be written",
    ),
    "a name without end": (lambda folder: folder / ("out" * 200), "cannot be written"),
    "a path without end": (lambda folder: folder / "/".join(["out"] * 2000), "cannot be written"),
    "a place of the system": (lambda folder: Path("/proc/out/out"), "cannot be written"),
    "a folder with other things in it": (
        lambda folder: ((folder / "out" / "mine").mkdir(parents=True), folder / "out")[1],
        "is there already",
    ),
}


@pytest.mark.parametrize("where", PLACES)
def test_a_place_that_cannot_hold_a_folder_is_refused(
    where: str, inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lay, says = PLACES[where]
    place = lay(tmp_path)
    before = tree(tmp_path)
    refused("recon run IN/capture -o OUT --gloss none --inpaint none", inputs, place, "out", capsys, nothing, says)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError("no room"), MemoryError, SystemExit])
def test_a_write_that_is_broken_off_leaves_nothing(error: BaseException | type[BaseException], tmp_path: Path) -> None:
    def half_a_file() -> None:
        with writing(tmp_path / "a.txt") as temporary:
            temporary.write_text("half")
            raise error

    def half_a_folder() -> None:
        with writing_folder(tmp_path / "folder", "capture") as folder:
            (folder / "half").write_text("half")
            raise error

    for write in (half_a_file, half_a_folder):
        with pytest.raises((Exception, KeyboardInterrupt, SystemExit)):
            write()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("write", ["png", "exr", "json"])
def test_a_writer_leaves_the_earlier_file_where_the_disk_is_full(write: str, tmp_path: Path) -> None:
    path, noise = tmp_path / "a", np.random.default_rng(0).random((64, 64))
    writers: dict[str, Callable[[], None]] = {
        "png": lambda: write_png(path, (255 * noise).astype(np.uint8)),
        "exr": lambda: write_exr(path, {"R": noise}),
        "json": lambda: write_json(path, noise),
    }
    path.write_text("mine")
    with full_disk(ROOM), pytest.raises(ValueError, match="cannot be written"):
        writers[write]()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a", "mine")]
