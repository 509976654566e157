"""Files: nothing half-written, nothing trusted."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gen.errors import InputError
from gen.files import (
    MARK,
    dumps,
    inside,
    library_silenced,
    must_exist,
    read_json,
    read_lines,
    read_numbers,
    replaceable,
    write_json,
    writing,
    writing_folder,
)


def test_writing_replaces_whole_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "new" / "a.txt"
    with writing(target) as temporary:
        temporary.write_text("one")
        assert not target.exists()
        assert temporary.suffix == ".txt"
    assert target.read_text() == "one"

    def fail() -> None:
        with writing(target) as temporary:
            temporary.write_text("half")
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError):
        fail()
    assert target.read_text() == "one"
    assert [p.name for p in target.parent.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("writer", [writing, partial(writing_folder, kind="capture")])
def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path, writer: object) -> None:
    (tmp_path / "file").write_text("x")
    with (
        pytest.raises(InputError, match=r"file/a: cannot be written .*; choose another place$"),
        writer(tmp_path / "file" / "a"),
    ):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_name_that_is_too_long_is_one_line(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match=r"cannot be written \(.*\); choose another place"),
        writing(tmp_path / ("a" * 300)) as name,
    ):
        name.write_text("x")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("place", [".", "/", "here"])
def test_a_folder_is_no_place_for_a_file(tmp_path: Path, place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("here").mkdir()
    with pytest.raises(InputError, match=r": is a folder; give the name of a file with -o"), writing(Path(place)):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["here"]


def test_writing_folder_replaces_only_its_own(tmp_path: Path) -> None:
    target = tmp_path / "out"
    for text in ("one", "two"):
        with writing_folder(target, "capture") as folder:
            (folder / f"{text}.txt").write_text(text)
        assert sorted(p.name for p in target.iterdir()) == sorted([MARK, f"{text}.txt"])
    assert replaceable(target, "capture")
    assert not replaceable(target, "measurement")

    def fail() -> None:
        with writing_folder(target, "capture") as folder:
            (folder / "half.txt").write_text("half")
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError):
        fail()
    assert (target / "two.txt").is_file()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]

    mine = tmp_path / "photos"
    mine.mkdir()
    with writing_folder(mine, "capture"):  # empty: nothing is lost
        pass
    (mine / MARK).unlink()
    (mine / "holiday.jpg").write_text("x")
    with pytest.raises(InputError, match="not an earlier capture"), writing_folder(mine, "capture"):
        pass
    assert (mine / "holiday.jpg").is_file()
    (tmp_path / "link").symlink_to(target)
    with pytest.raises(InputError, match="not an earlier capture"), writing_folder(tmp_path / "link", "capture"):
        pass


@pytest.mark.parametrize(
    "name", ["../a", "/etc/passwd", "b/../../a", "C:\\x.png", "..\\a", "", "a\0b", "link", "link/a", "\\\\host\\a"]
)
def test_names_that_lead_out_are_refused(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "f"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    with pytest.raises(InputError, match="leads out of the folder"):
        inside(folder, name)


@pytest.mark.parametrize("name", ["a.png", "b/a.png", "b\\a.png", "./a.png", "a..png", "here"])
def test_names_inside_are_kept(tmp_path: Path, name: str) -> None:
    (tmp_path / "b").mkdir()
    (tmp_path / "here").symlink_to(tmp_path / "b")
    assert inside(tmp_path, name).resolve().is_relative_to(tmp_path.resolve())


def numbers(tmp_path: Path, text: str | bytes, columns: int | tuple[int, ...] | None = 3) -> list[list[float]]:
    path = tmp_path / "t.txt"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    found: list[list[float]] = read_numbers(path, "things", columns).tolist()
    return found


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3\n4 5 6\n",
        "1,2,3\r\n4, 5, 6",
        "2\n1 2 3\n4 5 6",
        "# a comment\n\n1\t2  3 # here\n4;5;6\n\n",
        "\ufeff1 2 3\n4 5 6e0",
    ],
)
def test_read_numbers(tmp_path: Path, text: str) -> None:
    assert numbers(tmp_path, text) == [[1, 2, 3], [4, 5, 6]]


def test_read_numbers_of_other_widths(tmp_path: Path) -> None:
    assert numbers(tmp_path, "2\n3\n", 1) == [[2], [3]]
    assert numbers(tmp_path, "2\n3\n", (1, 3)) == [[2], [3]]
    assert numbers(tmp_path, "1 2 3 4\n5 6 7 8", None) == [[1, 2, 3, 4], [5, 6, 7, 8]]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("1 2\n", "line 1 has 2 values, 3 are needed"),
        ("1 2 3\n\n4 5 6 7\n", "line 3 has 4 values, 3 are needed"),
        ("1 2 x\n", "line 1 is not a row of numbers"),
        ("1 2 3\n4 nan 6", "line 2 holds a value that is not finite"),
        ("1 2 1e999", "not finite"),
        ("3\n1 2 3\n4 5 6", "its first line says 3, but 2 rows follow"),
        ("# nothing\n", "holds no numbers"),
        ("", "is empty"),
        (b"\xff\xfe1\x00", "not UTF-8 text"),
        (b"1 2 3\0\n", "not a text file"),
        (b"1 2 3\n" * 2_000_000, "too large"),
    ],
)
def test_read_numbers_refuses(tmp_path: Path, text: str | bytes, why: str) -> None:
    with pytest.raises(InputError, match=why) as error:
        numbers(tmp_path, text)
    assert str(error.value).startswith(str(tmp_path / "t.txt"))


def test_read_lines_keeps_the_numbers_of_lines(tmp_path: Path) -> None:
    (tmp_path / "t").write_text(" a b \n\n#c\n")
    assert read_lines(tmp_path / "t", "names") == [(1, "a b"), (3, "#c")]


def test_must_exist(tmp_path: Path) -> None:
    (tmp_path / "empty").touch()
    for name, why in (("absent", "no such file"), ("empty", "is empty"), (".", "is a folder")):
        with pytest.raises(InputError, match=why):
            must_exist(tmp_path / name, "a thing")


def test_json_is_readable_by_anyone(tmp_path: Path) -> None:
    value = {"a": np.float32(0.5), "b": np.arange(3), "c": float("nan"), "d": [np.inf, Path("x")], 1: (np.bool_(True), "é")}
    write_json(tmp_path / "a.json", value)
    wanted = {"a": 0.5, "b": [0, 1, 2], "c": None, "d": [None, "x"], "1": [True, "é"]}
    assert read_json(tmp_path / "a.json", "a record") == wanted == json.loads(dumps(value))


@pytest.mark.parametrize("text", [b"{", b"\xff", b"[" * 100_000])
def test_bad_json_is_one_line(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "a.json").write_bytes(text)
    with pytest.raises(InputError, match=r"a\.json: is not valid JSON") as error:
        read_json(tmp_path / "a.json", "a record")
    assert "\n" not in str(error.value)


def test_a_silenced_library_is_heard_by_the_caller_alone(capfd: pytest.CaptureFixture[str]) -> None:
    with library_silenced() as printed:
        os.write(1, b"chatter ")
        os.write(2, b"warning ")
        print("of Python's", end="")
        assert printed() == "chatter warning of Python's"
        with library_silenced() as inner:
            os.write(2, b" again")
            assert inner() == " again"
    os.write(2, b"heard")
    assert capfd.readouterr() == ("", "heard")


def test_silence_of_several_threads_ends_with_the_last(capfd: pytest.CaptureFixture[str]) -> None:
    for _ in range(50):
        barrier = threading.Barrier(4)

        def chatter(barrier: threading.Barrier = barrier) -> None:
            barrier.wait()
            with library_silenced():
                os.write(2, b"noise")

        threads = [threading.Thread(target=chatter) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    os.write(2, b"heard")
    assert capfd.readouterr().err == "heard"


def test_silence_holds_what_c_buffers_and_works_without_terminals() -> None:
    """C's stdout is buffered when it is a pipe: what was printed in silence must not come out afterwards."""
    code = (
        "import ctypes, os; from gen.files import library_silenced; c = ctypes.CDLL(None); c.printf(b'before '); \n"
        "with library_silenced() as heard: c.printf(b'inside'); c.fflush(None); assert heard() == 'inside'; c.printf(b'more')\n"
        "c.printf(b'after'); os.close(2)\n"
        "with library_silenced(): c.printf(b'inside')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2])
    assert done.stdout == "before after"
