"""Writing one shard: captures are read and checked ahead, and stand in the archive in the order of their keys.

A shard counts as done when its note is there, which is written last: so whatever is killed, whenever, what is done is kept, and what
is not is written again to the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from gen.errors import InputError
from gen.exr import read_exr, stack
from gen.files import sha256_of, write_json
from gen.release.ahead import ahead
from gen.release.contents import Contents, Entry, Shard, digest_of, released_files
from gen.release.layout import CAPTURE, FACTS, PREVIEW
from gen.release.samples import picture_rows, read_checked, read_index, sample_facts
from gen.release.tables import MEMBERS, PICTURES, table_writer
from gen.release.tar import ShardWriter
from gen.sets.set_folder import ITEM, Row, SetFolder, read_row
from gen.sets.thumbnail import frontal, thumbnail

AHEAD_BYTES = 64_000_000
"""What waits to be written, at most."""

BUFFER = 1 << 20


@dataclass(frozen=True)
class Done:
    """The note of a finished shard. pictures_sha256, members_sha256: of its parts of the tables."""

    name: str
    items: int
    pictures: int
    bytes: int
    sha256: str
    pictures_sha256: str
    members_sha256: str


class _Ready(NamedTuple):
    """A capture that is about to be written. said: its capture.json. captured: its field `capture`."""

    row: Row
    place: Path
    said: dict[str, Any]
    captured: bytes


class _File(NamedTuple):
    ready: _Ready
    field: str
    data: bytes
    sha256: str


def write_shard(folder: SetFolder, contents: Contents, shard: Shard, data: Path, work: Path, step: Callable[[], None]) -> Done:
    """Write a shard into the folder `data` and its parts of the tables into `work`; its note. step: called after each capture.

    Raises InputError where a file of the set is not what the index says, OSError where the disk refuses.
    """
    partial = work / f"{shard.name}.partial"
    with (
        partial.open("wb", buffering=BUFFER) as stream,
        table_writer(part_of(work, shard, "pictures"), PICTURES) as add_pictures,
        table_writer(part_of(work, shard, "members"), MEMBERS) as add_members,
        closing(ahead(_files(folder, contents, shard), lambda file: len(file.data), AHEAD_BYTES)) as files,
    ):
        writer = ShardWriter(stream)
        for item, group in groupby(files, key=lambda file: file.ready.row["id"]):
            places: dict[str, tuple[int, int, str]] = {}
            for ready, field, content, digest in group:  # noqa: B007 - the last one's is used below
                places[field] = (writer.add(f"{item}.{field}", content), len(content), digest)
            verdicts = contents.verdicts[item]
            add_pictures(picture_rows(ready.row, ready.said, shard.split, shard.name, verdicts, places))
            names = ("offset", "bytes", "sha256")
            add_members(
                {"shard": shard.name, "item": item, "field": field, **dict(zip(names, place, strict=True))}
                for field, place in places.items()
            )
            step()
        digest = writer.end()
    os.replace(partial, data / shard.name)
    done = Done(
        shard.name,
        len(shard.entries),
        sum(entry.pictures for entry in shard.entries),
        writer.length,
        digest,
        sha256_of(part_of(work, shard, "pictures")),
        sha256_of(part_of(work, shard, "members")),
    )
    write_json(_note(work, shard), asdict(done))
    return done


def finished(shard: Shard, data: Path, work: Path) -> Done | None:
    """The note of a shard that is there, whole to the last byte; None where it has to be written."""
    try:
        done = Done(**json.loads(_note(work, shard).read_text(encoding="utf-8")))
        whole = (
            (data / shard.name).stat().st_size == done.bytes
            and sha256_of(part_of(work, shard, "pictures")) == done.pictures_sha256
            and sha256_of(part_of(work, shard, "members")) == done.members_sha256
            and sha256_of(data / shard.name) == done.sha256
        )
    except (OSError, ValueError, TypeError):
        return None
    return done if whole else None


def part_of(work: Path, shard: Shard, table: str) -> Path:
    """A shard's part of a table."""
    return work / f"{shard.name}.{table}.parquet"


def _note(work: Path, shard: Shard) -> Path:
    return work / f"{shard.name}.json"


def _files(folder: SetFolder, contents: Contents, shard: Shard) -> Iterator[_File]:
    """Every file of a shard, in its order."""
    for entry in shard.entries:
        ready = _ready(folder, entry)
        row = ready.row
        files = {FACTS: "", PREVIEW: "", **released_files(row)}
        for field, file in sorted(files.items()):
            if field != CAPTURE and file:
                yield _File(ready, field, read_checked(ready.place, file, row), row["files"][file])
                continue
            if field == CAPTURE:
                data = ready.captured
            elif field == FACTS:
                data = sample_facts(row, ready.said, shard.split, contents.verdicts[row["id"]])
            else:
                data = _drawn(ready)
            yield _File(ready, field, data, hashlib.sha256(data).hexdigest())


def _ready(folder: SetFolder, entry: Entry) -> _Ready:
    place = folder.item_folder(entry.id)
    found = read_row(place / ITEM)
    if found is None or digest_of(found[0]) != entry.row:
        raise InputError(f"{place / ITEM}: is not the row of the index; check the set with degloss gen verify")
    return _Ready(found[0], place, *read_index(place, found[0]))


def _drawn(ready: _Ready) -> bytes:
    """The preview of a capture that was rendered without one. Of its file nothing is decoded before its checksum."""
    file = ready.said["frames"][frontal([frame["direction"] for frame in ready.said["frames"]])]["file"]
    if file not in ready.row["files"]:
        raise InputError(f"{ready.place / 'capture.json'}: names {file!r:.80}, which the index does not list")
    read_checked(ready.place, file, ready.row)
    picture = stack(read_exr(ready.place / file), "", "RGB")
    if picture is None:
        raise InputError(f"{ready.place / file}: lacks the channels R, G, B")
    return thumbnail(picture)
