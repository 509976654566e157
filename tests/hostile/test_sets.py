"""Hostile sets, plans and views: rows that lie, ids that lead elsewhere, files that are cut."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.sets.set_folder import SetFolder
from tests.conftest import synthetic_capture
from tests.gen.sets.conftest import SET_SPEC, write_set
from tests.hostile.commands import Case, require_refusal
from tests.hostile.files import pickled

Harm = Callable[[Path], object]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> SetFolder:
    place = tmp_path_factory.mktemp("sets")
    spec = SET_SPEC.replace("count: 6", "count: 2").replace("count: 3\n    capture", "count: 1\n    capture")
    (place / "set.yaml").write_text(spec)
    return write_set(place / "set.yaml", place / "set", synthetic_capture)


def text(file: str, content: str | bytes) -> Harm:
    return lambda folder: (folder / file).write_bytes(content.encode() if isinstance(content, str) else content)


def line(file: str, number: int, change: Callable[[dict[str, Any]], object]) -> Harm:
    def harm(folder: Path) -> None:
        lines = (folder / file).read_text().splitlines()
        row = json.loads(lines[number])
        change(row)
        lines[number] = json.dumps(row)
        (folder / file).write_text("\n".join(lines) + "\n")

    return harm


def keys(file: str, **changes: Any) -> Harm:
    def harm(folder: Path) -> None:
        (folder / file).write_text(json.dumps(json.loads((folder / file).read_text()) | changes))

    return harm


def twice(file: str) -> Harm:
    return lambda folder: (folder / file).write_text(
        (folder / file).read_text() + (folder / file).read_text().splitlines()[-1] + "\n"
    )


def cut(file: str) -> Harm:
    return lambda folder: (folder / file).write_bytes((folder / file).read_bytes()[:-40])


SETS: dict[str, tuple[Harm, str, str, str]] = {
    # what is wrong: (how it is done, the command's name, what the line names, what it says)
    "no head": (lambda folder: (folder / "set.json").unlink(), "screen", "set.json", "no such file"),
    "an empty head": (text("set.json", ""), "screen", "set.json", "is empty"),
    "a head of something else": (text("set.json", '{"format": "tar"}'), "screen", "set.json", "is not the head of a set"),
    "a head of another version": (keys("set.json", version=9), "screen", "set.json", "version 9"),
    "a head with a key twice": (
        text("set.json", '{"format": "degloss set", "version": 1, "version": 1}'),
        "screen",
        "set.json",
        "twice",
    ),
    "a head nested deep": (text("set.json", "[" * 100_000), "screen", "set.json", "not valid JSON"),
    "no index": (lambda folder: (folder / "index.jsonl").unlink(), "screen", "index.jsonl", "not there yet"),
    "an empty index": (text("index.jsonl", ""), "screen", "index.jsonl", "is empty"),
    "an index that is cut": (cut("index.jsonl"), "screen", "index.jsonl", "line"),
    "an index of pickles": (text("index.jsonl", pickled()), "screen", "index.jsonl", ""),
    "a row twice": (twice("index.jsonl"), "screen", "index.jsonl", "is there twice"),
    "a row nested deep": (text("index.jsonl", "[" * 100_000 + "\n"), "screen", "index.jsonl", "line 1"),
    "a row of ten megabytes": (text("index.jsonl", '"' + "a" * 10_000_000), "screen", "index.jsonl", "line 1"),
    "an id that leads up": (line("index.jsonl", 0, lambda row: row.update(id="../../etc")), "pack", "index.jsonl", "is no id"),
    "an id of a page": (line("index.jsonl", 0, lambda row: row.update(id="a" * 3000)), "pack", "index.jsonl", "is no id"),
    "a picture too many": (
        line("index.jsonl", 0, lambda row: row.update(pictures=9)),
        "screen",
        "index.jsonl",
        "one number a picture",
    ),
    "a size below zero": (line("index.jsonl", 0, lambda row: row.update(size=[-1, 8])), "pack", "index.jsonl", "size"),
    "a status that is not known": (
        line("index.jsonl", 0, lambda row: row.update(status="lost")),
        "screen",
        "index.jsonl",
        "status",
    ),
    "a key less": (line("index.jsonl", 0, lambda row: row.pop("split")), "split", "index.jsonl", "split is missing"),
    "a share that is a list": (
        line("index.jsonl", 0, lambda row: row.update(object_share=[1])),
        "pack",
        "index.jsonl",
        "object_share",
    ),
    "no plan": (lambda folder: (folder / "plan.jsonl").unlink(), "pack", "plan.jsonl", "no such file"),
    "a plan that is cut": (cut("plan.jsonl"), "pack", "plan.jsonl", "line"),
    "an item that is gone": (lambda folder: shutil.rmtree(folder / "items/one-000000"), "pack", "one-000000", "no such item"),
    "an item that is a link out": (
        lambda folder: (shutil.rmtree(folder / "items/one-000000"), (folder / "items/one-000000").symlink_to("/etc")),
        "pack",
        "one-000000",
        "leads out",
    ),
    "an item whose picture is cut": (cut("items/one-000000/frames/001.exr"), "pack", "001.exr", "damaged or truncated"),
    "an item whose index is empty": (text("items/one-000000/capture.json", ""), "preview", "capture.json", "is empty"),
    "a screening of something else": (text("screening.jsonl", '{"id": "x"}\n'), "split", "screening.jsonl", "line 1"),
    "a screening of other items": (
        text(
            "screening.jsonl",
            json.dumps({"id": "x", "frame": 1, "kept": True, "reason": None, "overexposed_pixels": 0, "clipped_samples": 0})
            + "\n",
        ),
        "split",
        "screening.jsonl",
        "other items",
    ),
    "splits of something else": (text("splits.json", "[]"), "pack --split train", "splits.json", "ids of each split"),
    "splits that are cut": (
        text("splits.json", '{"splits": {"train": ["one'),
        "pack --split train",
        "splits.json",
        "not valid JSON",
    ),
}


@pytest.mark.parametrize("what", SETS)
def test_a_hostile_set_is_refused(what: str, sound: SetFolder, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    harm, name, names, says = SETS[what]

    def lay(folder: Path) -> None:
        shutil.copytree(sound.path, folder / "set", symlinks=True)
        harm(folder / "set")

    command, *options = name.split()
    place = {"pack": "-o HERE/out.safetensors --all", "preview": "-o HERE/out.png"}.get(command, "")
    require_refusal(Case(lay, " ".join(["gen", command, "HERE/set", place, *options]), names, says), tmp_path, capfd)


PLANS: dict[str, tuple[Callable[[list[str]], str | bytes], str]] = {
    "its header alone": (lambda lines: lines[0] + "\n", "holds 0 items"),
    "cut": (lambda lines: "\n".join(lines)[:-30], "line 2"),
    "an item twice": (
        lambda lines: "\n".join([lines[0].replace('"items": 1', '"items": 2'), lines[1], lines[1]]),
        "is there twice",
    ),
    "more items than it says": (lambda lines: "\n".join([lines[0], lines[1], lines[1]]), "more follow"),
    "another version": (lambda lines: lines[0].replace('"version": 1', '"version": 9'), "version 9"),
    "a billion items": (lambda lines: lines[0].replace('"items": 1', '"items": 1000000000'), "line 1"),
    "an id that leads up": (lambda lines: "\n".join([lines[0], lines[1].replace("one-000000", "../x-000000")]), "id must be"),
    "a number that is NaN": (lambda lines: "\n".join([lines[0], lines[1].replace('"seed": 0', '"seed": NaN')]), "not an item"),
    "an item nested deep": (lambda lines: lines[0] + "\n" + "[" * 100_000, "line 2"),
    "not UTF-8": (lambda lines: lines[0].encode() + b"\n\xff\xfe\n", "not a text file"),
}


@pytest.mark.parametrize("what", PLANS)
def test_a_hostile_plan_is_refused(what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from tests.hostile.readers import READERS

    change, says = PLANS[what]

    def lay(folder: Path) -> None:
        READERS["plan"].lay(folder)
        data = change((folder / "plan.jsonl").read_text().splitlines())
        (folder / "plan.jsonl").write_bytes(data.encode() if isinstance(data, str) else data)

    require_refusal(
        Case(lay, "gen render-chunk HERE/plan.jsonl --index 0 --chunks 1 -o HERE/out", "plan.jsonl", says), tmp_path, capfd
    )


EYE = np.eye(4).tolist()
VIEWS: dict[str, tuple[Any, str]] = {
    "nothing": ("", "is empty"),
    "no JSON": ("{", "not valid JSON"),
    "a list": ([], "cameras of views"),
    "another version": ({"version": 9}, "version 9"),
    "inches": ({"unit": "inch"}, "unit must be mm"),
    "no views": ({"views": None}, "views must be a list"),
    "a view without a capture": ({"views": [{"object_to_camera": EYE}]}, "views must be a list"),
    "views without end": ({"views": [{"capture": f"v{k}", "object_to_camera": EYE} for k in range(2000)]}, "at most 1000"),
    "a capture twice": ({"views": [{"capture": "a", "object_to_camera": EYE}] * 2}, "is there twice"),
    "a matrix of three rows": ({"views": [{"capture": "a", "object_to_camera": EYE[:3]}]}, "4x4"),
    "a matrix of words": ({"views": [{"capture": "a", "object_to_camera": [["x"] * 4] * 4}]}, "4x4"),
    "a matrix beyond numbers": ({"views": [{"capture": "a", "object_to_camera": [[10**400] * 4] * 4}]}, "4x4"),
    "a capture that leads up": ({"views": [{"capture": f"../{k}", "object_to_camera": EYE} for k in range(2)]}, "leads out"),
    "a capture that is not there": ({"views": [{"capture": f"v{k}", "object_to_camera": EYE} for k in range(2)]}, "no such file"),
}


@pytest.mark.parametrize("what", VIEWS)
def test_hostile_views_are_refused(what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    content, says = VIEWS[what]

    def lay(folder: Path) -> None:
        (folder / "views").mkdir()
        table = {"format": "degloss views", "version": 1, "unit": "mm"}
        data = content if isinstance(content, str) else json.dumps(table | content if isinstance(content, dict) else content)
        (folder / "views" / "cameras.json").write_text(data)

    names = "views" if says in ("leads out", "no such file") else "cameras.json"
    require_refusal(Case(lay, "recon multiview HERE/views -o HERE/out", names, says), tmp_path, capfd)
