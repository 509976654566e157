"""What goes where: which items of a rendered set stand in which shard, and which pictures are left out.

Items go by split, then by their number of pictures (so that all samples of a shard have the same fields), then by id; a shard is full
when its files reach the size asked for. It all follows from the set's index, screening and splits alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from gen.errors import InputError
from gen.files import read_json
from gen.release.layout import MAX_FILE, field_of, key_of
from gen.release.tar import BLOCK
from gen.sets.screening import Verdict, screening_of
from gen.sets.set_folder import RENDERED, Row, SetFolder, row_text
from gen.sets.splits import KEYS, NAMES, SPLITS, read_splits, unsaid

MAX_SHARDS = 100_000


@dataclass(frozen=True)
class Entry:
    """An item that is released. pictures: K. size: bytes of its files. row: digest of its row of the index, see `digest_of`."""

    id: str
    pictures: int
    size: int
    row: bytes


@dataclass(frozen=True)
class Shard:
    """One archive. name: of its file. pictures: of each of its captures."""

    name: str
    split: str
    pictures: int
    entries: tuple[Entry, ...]


@dataclass(frozen=True)
class Contents:
    """All of a release. verdicts: what screening says of each picture, by item. kinds: the numbers of pictures a capture may have."""

    shards: tuple[Shard, ...]
    verdicts: Mapping[str, tuple[Verdict, ...]]
    kinds: tuple[int, ...]

    def items(self) -> int:
        """How many captures are released."""
        return sum(len(shard.entries) for shard in self.shards)


def contents_of(folder: SetFolder, shard_bytes: int) -> Contents:
    """Divide a rendered, screened and split set into shards of about so many bytes.

    Raises InputError where the set is not whole or not divided, screening and splits speak of other items than each other, or splits share
    what splits.json does not say.
    """
    verdicts: dict[str, list[Verdict]] = {}
    for verdict in screening_of(folder):
        verdicts.setdefault(verdict.id, []).append(verdict)
    split_of: dict[str, str] = {}
    for name, ids in read_splits(folder).items():
        if name not in NAMES:
            raise InputError(f"{folder.path}: splits.json: {name!r:.40} is no split; there are {', '.join(NAMES)}")
        for item in ids:
            if split_of.setdefault(item, name) != name:
                raise InputError(f"{folder.path}: splits.json: {item!r:.80} is in {split_of[item]} and in {name}")
    kept: dict[tuple[str, int], list[Entry]] = {}
    divided: list[dict[str, Any]] = []
    for row in folder.each_row():
        judged = verdicts.get(row["id"], [])
        if row["status"] != RENDERED or not any(verdict.kept for verdict in judged):
            continue
        if not all(verdict.kept for verdict in judged) or len(judged) != row["pictures"]:
            raise InputError(f"{folder.path}: {row['id']}: screening keeps a part of its pictures; run degloss gen screen again")
        if row["id"] not in split_of:
            raise InputError(f"{folder.path}: {row['id']} is kept, but in no split; run degloss gen split again")
        split = split_of.pop(row["id"])
        divided.append({"split": split, **{column: row[column] for column in KEYS.values()}})
        kept.setdefault((split, row["pictures"]), []).append(_entry(row))
    if split_of:
        raise InputError(
            f"{folder.path}: splits.json holds {next(iter(split_of))}, which is not kept; run degloss gen split again"
        )
    if not kept:
        raise InputError(f"{folder.path}: no picture is left to release")
    if fault := next(unsaid(read_json(folder.path / SPLITS, "the splits of a set"), divided), None):
        raise InputError(f"{folder.path / SPLITS}: {fault}; run degloss gen split again")
    kinds = tuple(sorted({pictures for _, pictures in kept}))
    shards = tuple(_shards(kept, kinds, shard_bytes))
    if len(shards) > MAX_SHARDS - 1:
        raise InputError(f"--shard-mb: {len(shards)} shards are too many; let them be larger")
    return Contents(shards, {item: tuple(ones) for item, ones in verdicts.items()}, kinds)


def digest_of(row: Row) -> bytes:
    """16 bytes that tell a row of the index from any other."""
    return hashlib.sha256(row_text(row).encode()).digest()[:16]


def released_files(row: Row) -> dict[str, str]:
    """The files of an item's folder that are released, by their field, sorted."""
    fields = {field: file for file in row["files"] if (field := field_of(file)) is not None}
    return dict(sorted(fields.items()))


def rejected_rows(folder: SetFolder, contents: Contents) -> Iterator[dict[str, Any]]:
    """A row of rejected.parquet for every picture that is left out, in the plan's order."""
    for row in folder.each_row():
        for verdict in contents.verdicts.get(row["id"], ()):
            if not verdict.kept:
                yield {
                    "item": row["id"],
                    "picture": verdict.frame,
                    "group": row["group"],
                    "split": row["split"],
                    "reason": verdict.reason,
                    "overexposed_pixels": verdict.overexposed_pixels,
                    "clipped_samples": verdict.clipped_samples,
                    "error": row["error"],
                    "shape": row["shape"],
                    "material": row["material"],
                    "seed": row["seed"],
                    "spec_sha256": row["spec_sha256"],
                }


def _entry(row: Row) -> Entry:
    try:
        files = released_files(row)
    except InputError as error:
        raise InputError(f"{row['id']}: {error}") from None
    sizes = [row["bytes"][file] for file in files.values()]
    if max(sizes, default=0) > MAX_FILE:
        raise InputError(f"{row['id']}: holds a file of more than {MAX_FILE // 10**9} GB, too large for a shard")
    return Entry(key_of(row["id"]), row["pictures"], sum(size + BLOCK for size in sizes), digest_of(row))


def _shards(kept: Mapping[tuple[str, int], list[Entry]], kinds: tuple[int, ...], shard_bytes: int) -> Iterator[Shard]:
    for split in NAMES:
        for pictures in kinds:
            middle = f"{split}-{pictures}x" if len(kinds) > 1 else split
            entries = sorted(kept.get((split, pictures), []), key=lambda entry: entry.id)
            for number, part in enumerate(_parts(entries, shard_bytes)):
                yield Shard(f"{middle}-{number:05d}.tar", split, pictures, part)


def _parts(entries: list[Entry], shard_bytes: int) -> Iterator[tuple[Entry, ...]]:
    part: list[Entry] = []
    size = 0
    for entry in entries:
        if part and size + entry.size > shard_bytes:
            yield tuple(part)
            part, size = [], 0
        part.append(entry)
        size += entry.size
    if part:
        yield tuple(part)
