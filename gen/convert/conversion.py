"""Converting: one capture into a folder, a set or a release into a folder of such folders or into shards, one capture at a time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from gen.convert import FOLDERS, FORMATS, SHARDS
from gen.convert.entries import COLUMNS, Entry, Source, source_of
from gen.errors import InputError
from gen.files import keep_apart, keep_outside, write_json, writing_folder

CAPTURES = "captures.json"
"""The list of many: what their index says of every capture (`gen.convert.entries.COLUMNS`), by the name of its folder."""

KIND = "conversion"
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Converted:
    """What was written. lost: what the format does not hold, in plain words, and of how many captures."""

    captures: int
    pictures: int
    lost: Mapping[str, int]

    def note(self, format: str) -> str:
        """What the format does not hold as one line; empty where it holds everything."""
        parts = [what if n == self.captures else f"{what} (of {n} captures)" for what, n in self.lost.items()]
        return f"note: {format} does not hold: {'; '.join(parts)}" if parts else ""


def convert(
    source: Path,
    output: Path,
    format: str,
    encoding: str | None = None,
    white: float | None = None,
    progress: Progress | None = None,
) -> Converted:
    """Write a capture, or every capture of a set or a release, in another layout.

    source: what `read_capture` reads, a set folder or a release. output: a folder, which appears whole or not at all; an earlier
    conversion there is replaced. Of many captures it holds a folder each, by its id, and captures.json; or shards. format: a name of
    `FORMATS`. encoding: as in `read_capture`. white: see `gen.convert.sixteen_bit`. progress: called with (captures done, in all). The
    memory needed is that of one capture. Raises InputError where the source cannot be read, or the output cannot be written or holds
    something else.
    """
    if format not in FORMATS:
        raise InputError(f"format {format!r:.40} is unknown; there are {', '.join(FORMATS)}")
    keep_apart(source, output)
    captures = source_of(source, encoding)
    if captures.rows is not None:
        keep_outside(source, output)
    lost: Counter[str] = Counter()
    pictures = 0

    def counted() -> Iterator[Entry]:
        nonlocal pictures
        for n, entry in enumerate(captures, 1):
            yield entry
            pictures += entry.capture.count
            if progress is not None:
                progress(n, captures.count)

    with writing_folder(output, KIND) as folder:
        if format in SHARDS:
            _load(SHARDS[format])(counted(), folder, white)
        else:
            write = _load(FOLDERS[format])
            for entry in counted():
                lost.update(write(entry.capture, _place(folder, entry), white))
            _list(captures, folder, format)
    return Converted(captures.count, pictures, lost)


def _place(folder: Path, entry: Entry) -> Path:
    if entry.name is None:
        return folder
    (folder / entry.name).mkdir()
    return folder / entry.name


def _list(captures: Source, folder: Path, format: str) -> None:
    if captures.rows is not None:
        listed = [{"folder": row["id"], **{key: row[key] for key in COLUMNS}} for row in captures.rows]
        write_json(folder / CAPTURES, {"format": format, "captures": listed})


def _load(target: str) -> Callable[..., Any]:
    module, function = target.split(":")
    found: Callable[..., Any] = getattr(import_module(module), function)
    return found
