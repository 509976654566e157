"""Reading sets that somebody damaged, the diary, and the folders for work in progress. No Blender."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from gen.errors import InputError
from gen.sets.events import record
from gen.sets.set_folder import COLUMNS, SetFolder, is_set_folder, read_row, row_text
from gen.sets.work_folder import DEAD_AFTER, elsewhere, sweep, work_folder

ROOT = Path(__file__).resolve().parents[3]


def row(**values: Any) -> dict[str, Any]:
    """A row of a rendered item."""
    good: dict[str, Any] = {
        "id": "a-000000",
        "group": "a",
        "single": True,
        "status": "rendered",
        "spec_sha256": "0" * 64,
        "seed": 1,
        "pictures": 1,
        "size": [4, 3],
        "files": {"mask.png": "0" * 64},
        "bytes": {"mask.png": 9},
        "overexposed_pixels": [0],
        "clipped_samples": 0,
        "exposure": 1.5,
        "object_share": 0.5,
    }
    return dict.fromkeys(COLUMNS) | good | values


def a_set(folder: Path, *rows: dict[str, Any]) -> SetFolder:
    folder.mkdir()
    (folder / "set.json").write_text(json.dumps({"format": "degloss set", "version": 1}))
    (folder / "index.jsonl").write_text("".join(row_text(one) + "\n" for one in rows))
    return SetFolder(folder)


def test_rows_come_back_as_they_were(tmp_path: Path) -> None:
    quarantined = row(
        id="b", status="quarantined", error="no", pictures=None, size=None, files={}, bytes={}, overexposed_pixels=[]
    )
    folder = a_set(tmp_path / "set", row(), quarantined)
    assert folder.rows() == [row(), quarantined]
    assert is_set_folder(folder.path)
    assert not is_set_folder(tmp_path)
    (tmp_path / "item.json").write_text(row_text(row()) + "\n")
    assert read_row(tmp_path / "item.json") == (row(), row_text(row()))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"id": "../../etc"}, "is no id"),
        ({"id": 7}, "id is missing or not"),
        ({"seed": True}, "seed is missing"),
        ({"status": "lost"}, "status must be"),
        ({"pictures": None}, "not what"),
        ({"files": {"a": 1}, "bytes": {"a": 1}}, "SHA-256"),
        ({"files": {"a": "0"}}, "bytes must hold"),
        ({"bytes": {"mask.png": -1}}, "bytes must hold"),
        ({"size": [4]}, "size must be"),
        ({"size": [4, 0]}, "size must be"),
        ({"overexposed_pixels": ["x"]}, "overexposed_pixels"),
        ({"overexposed_pixels": [0, 0]}, "one number a picture"),
        ({"single": None}, "single is missing"),
    ],
)
def test_a_row_that_is_not_as_it_should_be_is_one_line(changes: dict[str, Any], says: str, tmp_path: Path) -> None:
    folder = a_set(tmp_path / "set", row(id="b"), row(**changes))
    with pytest.raises(InputError, match=rf"index.jsonl: line 2: .*{says}"):
        folder.rows()
    (tmp_path / "item.json").write_text(row_text(row(**changes)))
    assert read_row(tmp_path / "item.json") is None


@pytest.mark.parametrize("text", ["[1]", "{", '{"id": "a"}', "[" * 100_000, "\udcff"])
def test_lines_that_are_no_rows(text: str, tmp_path: Path) -> None:
    folder = a_set(tmp_path / "set")
    (folder.path / "index.jsonl").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=r"index\.jsonl"):
        folder.rows()


def test_what_is_missing_is_one_line(tmp_path: Path) -> None:
    folder = a_set(tmp_path / "set", row(), row())
    with pytest.raises(InputError, match="line 2: the id a-000000 is there twice"):
        folder.rows()
    for name in ("../x", "", "a/b", "/etc"):
        with pytest.raises(InputError, match="is no id of an item"):
            folder.item_folder(name)
    with pytest.raises(InputError, match="there is no such item"):
        folder.capture("a-000000")
    (folder.path / "items").mkdir()
    (folder.path / "items" / "b").symlink_to("/etc")
    with pytest.raises(InputError, match="leads out of the folder"):
        folder.capture("b")
    (folder.path / "index.jsonl").unlink()
    with pytest.raises(InputError, match="--resume"):
        folder.rows()
    for said, says in (({"format": "x"}, "is not the head"), ({"format": "degloss set", "version": 2}, "version 2")):
        (folder.path / "set.json").write_text(json.dumps(said))
        with pytest.raises(InputError, match=says):
            folder.rows()


def test_the_diary_holds_whole_lines_whoever_writes(tmp_path: Path) -> None:
    def write(who: int) -> None:
        for n in range(50):
            record(tmp_path, "rendered", id=f"{who}-{n}", text="x" * 300)

    (tmp_path / "events.jsonl").write_text('{"event": "cut sh')
    threads = [threading.Thread(target=write, args=(who,)) for who in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    first, *lines = (tmp_path / "events.jsonl").read_text().splitlines()
    assert first == '{"event": "cut sh'
    said = [json.loads(line) for line in lines]
    assert sorted(one["id"] for one in said) == sorted(f"{who}-{n}" for who in range(4) for n in range(50))
    assert all(one["time"].endswith("Z") for one in said)


HOLD = """
import sys, time
from pathlib import Path
from gen.sets.work_folder import work_folder
with work_folder(Path(sys.argv[1])) as folder:
    (folder / "file").write_text("x")
    print(folder, flush=True)
    time.sleep(100)
"""


def test_what_dead_processes_left_is_swept_and_nothing_else(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    processes = [subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    try:
        places = [Path(process.stdout.readline().strip()) for process in processes]  # type: ignore[union-attr]
        outside = elsewhere(places[0])
        outside.mkdir()
        (tmp_path / ".work.notes").mkdir()
        (tmp_path / "thesis.txt").write_text("mine")
        processes[0].kill()
        processes[0].wait()
        assert places[0].is_dir()
        with work_folder(tmp_path) as own:
            assert own.is_dir()
            assert not places[0].exists()
            assert not outside.exists()
            assert (places[1] / "file").read_text() == "x"
        assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
            [places[1].name, f"{places[1].name}.lock", ".work.notes", "thesis.txt"]
        )
    finally:
        for process in processes:
            process.kill()
            process.communicate()
    sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [".work.notes", "thesis.txt"]


def test_another_machines_folder_is_swept_when_it_has_lain_untouched(tmp_path: Path) -> None:
    """Its lock does not count here; the time of its last touch does. A folder without a lock file is nobody's."""
    old, new = (tmp_path / f".work.elsewhere.{n}.0123456{n}" for n in (1, 2))
    for place, age in ((old, DEAD_AFTER + 60), (new, DEAD_AFTER / 2)):
        place.mkdir()
        lock = place.with_name(f"{place.name}.lock")
        lock.touch()
        os.utime(lock, (time.time() - age,) * 2)
    (tmp_path / ".work.elsewhere.3.01234563").mkdir()
    with work_folder(tmp_path):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == [new.name, f"{new.name}.lock"]
