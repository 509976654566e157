"""Proving a release: what is whole passes, every damage is named in one line, and nothing hostile is opened."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gen.cli import app
from gen.errors import InputError
from gen.exr import read_exr, write_exr
from gen.release.reading import Release
from gen.release.tables import MEMBERS, PICTURES, table_writer
from gen.release.tar import ShardWriter
from gen.sets.verify import verify
from tests.gen.release.test_build import divided, edit, flip


def shard_of(release: Path, item: str) -> Path:
    """The shard that holds an item."""
    rows = pq.read_table(release / "data/members.parquet").to_pylist()
    return release / "data" / next(row["shard"] for row in rows if row["item"] == item)


def seal(release: Path) -> None:
    """Write the manifests anew: only who forges a whole release does that."""

    def lines(paths: list[Path]) -> str:
        return "".join(
            f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(release).as_posix()}\n" for path in sorted(paths)
        )

    payload = [path for path in (release / "data").rglob("*") if path.is_file()]
    (release / "manifest-sha256.txt").write_text(lines(payload))
    oxum = f"{sum(path.stat().st_size for path in payload)}.{len(payload)}"
    edit(release / "bag-info.txt", r"Oxum: .*", f"Oxum: {oxum}")
    tags = [path for path in release.iterdir() if path.is_file() and path.name != "tagmanifest-sha256.txt"]
    (release / "tagmanifest-sha256.txt").write_text(lines(tags))


def change_table(release: Path, name: str, change: Callable[[dict[str, Any]], None], only: str = "one-000000") -> None:
    """Change the rows of an item in a table."""
    path = release / f"data/{name}.parquet"
    rows = pq.read_table(path).to_pylist()
    for row in rows:
        if row["item"] == only:
            change(row)
    with table_writer(path, {"pictures": PICTURES, "members": MEMBERS}[name]) as append:
        append(rows)


def rewrite(release: Path, item: str, field: str, change: Callable[[bytes], bytes]) -> None:
    """Change a file in a shard, and everything that is said of it but the facts: a forger's work."""
    path = shard_of(release, item)
    members = pq.read_table(release / "data/members.parquet").to_pylist()
    data = path.read_bytes()
    with path.open("wb") as stream:
        writer = ShardWriter(stream)
        for row in members:
            if row["shard"] == path.name:
                content = data[row["offset"] :][: row["bytes"]]
                content = change(content) if (row["item"], row["field"]) == (item, field) else content
                row["offset"] = writer.add(f"{row['item']}.{row['field']}", content)
                row["bytes"], row["sha256"] = len(content), hashlib.sha256(content).hexdigest()
        writer.end()
    with table_writer(release / "data/members.parquet", MEMBERS) as append:
        append(members)
    placed = {(row["item"], row["field"]): row for row in members}
    pictures = pq.read_table(release / "data/pictures.parquet").to_pylist()
    for row in pictures:
        row |= {key: placed[row["item"], row["field"]][key] for key in ("offset", "bytes", "sha256")}
        row["view_sha256"] = placed[row["item"], "view.exr"]["sha256"]
    with table_writer(release / "data/pictures.parquet", PICTURES) as append:
        append(pictures)
    seal(release)


def brighter(channel: str) -> Callable[[bytes], bytes]:
    def change(data: bytes) -> bytes:
        path = Path(os.environ["PYTEST_SCRATCH"]) / "x.exr"
        path.write_bytes(data)
        channels = read_exr(path)
        channels[channel] = np.where(channels[channel] > 0, channels[channel] * 1.25, channels[channel])
        write_exr(path, channels)
        return path.read_bytes()

    return change


@pytest.fixture(autouse=True)
def _scratch(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    monkeypatch.setenv("PYTEST_SCRATCH", str(tmp_path_factory.mktemp("scratch")))


def test_a_whole_release_has_no_faults(released: Path) -> None:
    steps: list[tuple[int, int]] = []
    found = verify(released, progress=lambda done, total: steps.append((done, total)))
    assert found.faults == ()
    assert (found.kind, found.items, found.pixels) == ("release", 8, 8)
    assert found.files == sum(1 for path in released.rglob("*") if path.is_file()) - 1
    assert steps[-1][0] == steps[-1][1] == len(list(released.glob("data/*.tar")))
    some = verify(released, sample=3, seed=1)
    assert (some.faults, some.items, some.pixels) == ((), 8, 3)


def test_what_a_download_adds_is_no_fault(released_copy: Path) -> None:
    (released_copy / ".gitattributes").write_text("x")
    (released_copy / ".cache").mkdir()
    (released_copy / ".cache/lock").write_text("x")
    assert verify(released_copy, sample=0).faults == ()


def turned(data: bytes) -> bytes:
    """capture.json with another light."""
    said = json.loads(data)
    said["frames"][0]["direction"] = [0.6, 0, 0.8]
    return json.dumps(said).encode()


def moved(row: dict[str, Any]) -> None:
    """A row of another split."""
    row["split"] = {"train": "test", "validation": "train", "test": "train"}[row["split"]]


DAMAGE: dict[str, tuple[Callable[[Path], Any], str]] = {
    "a bit of a shard": (lambda f: flip(shard_of(f, "one-000000")), r"^data/\S+\.tar: its SHA-256 is not the one in the manifest$"),
    "a bit of a table": (lambda f: flip(f / "data/pictures.parquet"), r"^data/pictures.parquet: its SHA-256"),
    "a bit of the plan": (lambda f: flip(f / "data/plan.jsonl"), r"^data/plan.jsonl: its SHA-256"),
    "the card": (lambda f: (f / "README.md").write_text("x"), r"^README.md: its SHA-256"),
    "the manifest": (lambda f: flip(f / "manifest-sha256.txt"), r"^manifest-sha256.txt: its SHA-256 is not the one in tagmanifest"),
    "missing shard": (lambda f: shard_of(f, "one-000000").unlink(), r"^data/\S+\.tar: is missing$"),
    "missing tag": (lambda f: (f / "bagit.txt").unlink(), r"^bagit.txt: is missing$"),
    "no provenance": (lambda f: (f / "provenance.json").unlink(), r"^provenance.json: is missing$"),
    "extra": (lambda f: (f / "data/more.tar").write_text("x"), r"^data/more.tar: is an extra file$"),
    "extra deep": (lambda f: ((f / "data/a").mkdir(), (f / "data/a/b").write_text("x")), r"^data/a/b: is an extra file$"),
    "a link": (lambda f: (f / "data/link").symlink_to("/etc/passwd"), r"^data/link: is a link or a special file"),
    "a link to a folder": (lambda f: (f / "up").symlink_to(".."), r"^up: is a link or a special file"),
    "a shard is a link": (lambda f: relink(shard_of(f, "one-000000")), r"^data/\S+\.tar: is a link or a special file"),
    "a pipe": (lambda f: os.mkfifo(f / "data/pipe"), r"^data/pipe: is a link or a special file"),
    "a path outside": (lambda f: outside(f, "../x"), r"^tagmanifest-sha256.txt: line \d+ is no line of a manifest, or names a file"),
    "a whole path": (lambda f: outside(f, "/etc/passwd"), r"^tagmanifest-sha256.txt: line \d+ is no line of a manifest"),
    "the sum of sizes": (lambda f: (edit(f / "bag-info.txt", r"Oxum: \d", "Oxum: 9")), r"^bag-info.txt: Payload-Oxum is not \d+\.\d+"),
    "a row": (lambda f: (change_table(f, "pictures", lambda r: r.update(light_x=0.5)), seal(f)), r"light_x is 0.5 in data/pictures"),
    "gloss": (lambda f: (change_table(f, "pictures", lambda r: r.update(alpha_low=0.01)), seal(f)), r"alpha_low is 0.01 in data/pic"),
    "an offset": (lambda f: (change_table(f, "members", lambda r: r.update(offset=1)), seal(f)), r"001.exr: does not stand at byte 1 "),
    "a size": (lambda f: (change_table(f, "members", lambda r: r.update(bytes=1 << 40)), seal(f)), r"001.exr: is too large"),
    "a hash": (lambda f: (change_table(f, "members", lambda r: r.update(sha256="0" * 64)), seal(f)), r"is not the one in data/members"),
    "a shard's name": (lambda f: (change_table(f, "members", lambda r: r.update(shard="../x.tar")), seal(f)), r"speaks of '../x.tar'"),
    "a group": (lambda f: (change_table(f, "pictures", lambda r: r.update(group="x")), seal(f)), r"field json differs from data/pict"),
    "a split": (lambda f: (change_table(f, "pictures", moved), seal(f)), r"is in \w+, data/splits.json says"),
    "divided by": (lambda f: (divided(f / "data", by="object"), seal(f)), r"^data/splits.json: does not say by what the set is divided"),
    "no set": (lambda f: (edit(f / "provenance.json", '"set"', '"sat"'), seal(f)), r"^provenance.json: does not say whether specs name"),
    "shared": (lambda f: (share(f), seal(f)), r"^data/splits.json: \w+ and \w+ share 1 object, and it does not say so$"),
    "a shorter plan": (lambda f: (edit(f / "data/plan.jsonl", r".*test-000001.*\n", ""), seal(f)), r"holds 10 items, its first line"),
    "another plan": (lambda f: (edit(f / "data/plan.jsonl", '"radius": 1', '"radius": 2'), seal(f)), r"is not that of its spec"),
    "no number": (lambda f: (change_table(f, "pictures", lambda r: r.update(pictures=None)), seal(f)), r"^data: its tables hold what no"),
    "columns": (lambda f: (pq.write_table(pa.table({"x": [1]}), f / "data/members.parquet"), seal(f)), r"has other columns than"),
    "no table": (lambda f: ((f / "data/members.parquet").write_bytes(b"PAR1"), seal(f)), r"members.parquet: is not a table that can"),
    "the end": (lambda f: (lengthen(shard_of(f, "one-000000")), seal(f)), r"\.tar: does not end where its last file does$"),
    "pixels": (lambda f: rewrite(f, "stack-000000", "002.exr", brighter("diffuse.R")), r"002.exr: the picture as stored differs from dif"),
    "normals": (lambda f: rewrite(f, "one-000000", "view.exr", brighter("normal.Z")), r"one-000000: normals: \d+ are not unit vectors"),
    "its index": (lambda f: rewrite(f, "one-000000", "capture", lambda d: b"{}"), r"one-000000: its capture cannot be read"),
    "its light": (lambda f: rewrite(f, "one-000000", "capture", turned), r"light_x is"),
}  # fmt: skip


def relink(path: Path) -> None:
    kept = path.parent.parent.parent / "kept.tar"
    path.rename(kept)
    path.symlink_to(kept)


def outside(release: Path, name: str) -> None:
    path = release / "tagmanifest-sha256.txt"
    path.write_text(path.read_text() + f"{'0' * 64}  {name}\n")


def share(release: Path) -> None:
    """Give a test capture the object of a training one."""
    rows = pq.read_table(release / "data/pictures.parquet").to_pylist()
    donor = next(row for row in rows if row["split"] == "train")
    change_table(release, "pictures", lambda row: row.update(object=donor["object"]), only="test-000000")


def lengthen(path: Path) -> None:
    path.write_bytes(path.read_bytes() + bytes(10240))


@pytest.mark.parametrize("name", DAMAGE)
def test_every_damage_is_named(released_copy: Path, name: str) -> None:
    damage, expected = DAMAGE[name]
    damage(released_copy)
    faults = verify(released_copy, sample=None if name in ("pixels", "normals") else 0).faults
    assert any(re.search(expected, fault) for fault in faults), faults
    assert all("\n" not in fault and len(fault) < 500 for fault in faults)


def test_what_fails_its_checksum_is_never_parsed(released_copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gen.release.checking.read_table", lambda *_: pytest.fail("a table was read"))
    monkeypatch.setattr("gen.release.checking.pixel_faults", lambda *_: pytest.fail("pixels were read"))
    flip(released_copy / "data/members.parquet")
    for shard in (released_copy / "data").glob("*.tar"):
        flip(shard)
    assert len(verify(released_copy).faults) == 1 + len(list((released_copy / "data").glob("*.tar")))


UNCOMPARED: dict[str, tuple[Callable[[Path], Any], str]] = {
    "no declaration": (lambda f: (f / "bagit.txt").unlink(), "bagit.txt: is missing"),
    "too much information": (lambda f: (f / "bag-info.txt").write_text("x" * 100_001), "bag-info.txt: is too large"),
    "manifest": (lambda f: flip(f / "manifest-sha256.txt"), "manifest-sha256.txt: its SHA-256 is not the one in tagmanifest-sha256.txt"),
    "its manifest": (lambda f: outside(f, "../x"), "tagmanifest-sha256.txt: line 11 is no line of a manifest, or names a file twice"),
}  # fmt: skip


@pytest.mark.parametrize("name", UNCOMPARED)
def test_where_no_checksum_can_be_compared_no_table_is_read(
    released_copy: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """The one fault is named, and nothing untrue beside it."""
    monkeypatch.setattr("gen.release.checking.read_table", lambda *_: pytest.fail("a table was read"))
    damage, fault = UNCOMPARED[name]
    damage(released_copy)
    flip(released_copy / "data/members.parquet")
    found = verify(released_copy)
    assert (found.faults, found.files) == ((fault,), 0)


def test_the_command_recognises_a_release(released: Path, released_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    app(["verify", str(released), "--sample", "1"], exit_on_error=False, result_action="return_value")
    assert "whole; 8 items" in capsys.readouterr().out
    (released_copy / "LICENSE").write_text("mine")
    with pytest.raises(InputError, match=r"1 fault found; get it again"):
        app(["verify", str(released_copy)], exit_on_error=False, result_action="return_value")
    assert capsys.readouterr().out == "LICENSE: its SHA-256 is not the one in the manifest\n"


def test_a_reader_compares_checksums_too(released: Path, released_copy: Path) -> None:
    rows = pq.read_table(released_copy / "data/members.parquet").to_pylist()
    row = next(row for row in rows if (row["item"], row["field"]) == ("one-000000", "001.exr"))
    path = released_copy / "data" / row["shard"]
    data = bytearray(path.read_bytes())
    data[row["offset"] + 99] ^= 1
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"one-000000.001.exr differs from its SHA-256"):
        Release(released_copy).capture("one-000000")
    path.write_bytes(data[:2000])
    with pytest.raises(InputError, match=r"has no room for one-000000"):
        Release(released_copy).capture("one-000000")
    shutil.copyfile(released / "data" / row["shard"], path)
    twice = [row for row in rows if (row["item"], row["field"]) == ("one-000000", "mask.png")]
    with table_writer(released_copy / "data/members.parquet", MEMBERS) as append:
        append([*rows, *twice])
    with pytest.raises(InputError, match=r"lists mask.png of a capture twice"):
        Release(released_copy).capture("one-000000")
    change_table(released_copy, "members", lambda r: r.update(shard="../../etc/passwd"))
    with pytest.raises(InputError, match=r"is no name of a shard"):
        Release(released_copy).capture("one-000000")
