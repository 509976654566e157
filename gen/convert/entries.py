"""What is converted: the one capture of a source, or all of a set or a release, read one at a time, each once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gen.capture import Capture, read_capture
from gen.errors import InputError
from gen.parts import require
from gen.release.layout import MEMBERS, PICTURES, key_of
from gen.release.reading import is_release, open_release
from gen.release.tables import PICTURES as PICTURE_COLUMNS
from gen.release.tables import read_table
from gen.sets.set_folder import RENDERED, SetFolder, is_set_folder
from gen.sets.splits import NAMES, SPLITS, read_splits

COLUMNS = ("group", "split", "shape", "material", "pictures")
"""What the index of a set or a release says of a capture that is told of a converted one."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A capture to convert. name: its id among many; None where it is the only one. facts: by `COLUMNS`.

    path: where it was read, a folder of its own also in a release; it is there until the next one is asked for.
    """

    name: str | None
    path: Path
    capture: Capture
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Source:
    """Captures to convert. rows: what is known of each of many (`id` and `COLUMNS`), None where there is one. read: begins to read them.

    Iterating reads them; InputError, one line, where one cannot be read.
    """

    rows: tuple[Mapping[str, Any], ...] | None
    read: Callable[[], Iterator[Entry]]

    @property
    def count(self) -> int:
        """How many captures there are."""
        return 1 if self.rows is None else len(self.rows)

    def __iter__(self) -> Iterator[Entry]:
        return self.read()


def source_of(path: Path, encoding: str | None = None) -> Source:
    """The captures of a set folder, of a release, or of anything that `read_capture` reads; nothing but an index is read yet.

    encoding: as in `read_capture`. Splits are those of splits.json where a set is divided, else the plan's. Raises InputError where a
    set is not whole, or an encoding is given for one or for a release.
    """
    many = _of_set if is_set_folder(path) else _of_release if is_release(path) else None
    if many is None:
        return Source(None, lambda: iter([Entry(None, path, read_capture(path, encoding))]))
    if encoding is not None:
        raise InputError(f"--encoding {encoding}: {path} is a set of ours, which is linear; leave it out")
    return many(path)


def _of_set(path: Path) -> Source:
    folder = SetFolder(path)
    split_of: Mapping[str, str] | None = None
    if (path / SPLITS).exists():
        split_of = {item: name for name, items in read_splits(folder).items() for item in items}
    rows = [
        _known(row, row["id"], row["split"] if split_of is None else split_of.get(row["id"]), path)
        for row in folder.each_row()
        if row["status"] == RENDERED
    ]
    if not rows:
        raise InputError(f"{path}: nothing is rendered yet")

    def read() -> Iterator[Entry]:
        return (Entry(row["id"], folder.item_folder(row["id"]), folder.capture(row["id"]), row) for row in rows)

    return Source(tuple(rows), read)


def _of_release(path: Path) -> Source:
    require("release")
    release = open_release(path)
    pictures = read_table(path / PICTURES, PICTURE_COLUMNS)
    rows = [_known(row, key_of(row["item"]), row["split"], path) for row in pictures if row["picture"] == 1]
    ids = Counter(row["id"] for row in rows)
    if not rows or ids.most_common(1)[0][1] > 1:
        what = f"{ids.most_common(1)[0][0]} twice" if rows else "no captures"
        raise InputError(f"{path / PICTURES}: lists {what}; check the release with degloss gen verify")

    def read() -> Iterator[Entry]:
        expected = iter(rows)
        for item, place in release.folders():
            row = next(expected, None)
            if row is None or row["id"] != item:
                raise InputError(_other_captures(path))
            yield Entry(item, place, replace(read_capture(place), source=f"{path}: {item}"), row)
        if next(expected, None) is not None:
            raise InputError(_other_captures(path))

    return Source(tuple(rows), read)


def _other_captures(path: Path) -> str:
    return (
        f"{path / MEMBERS}: holds other captures than {PICTURES}, or in another order; check the release with degloss gen verify"
    )


def _known(row: Mapping[str, Any], name: str, split: str | None, where: Path) -> dict[str, Any]:
    """What is kept of a row of an index (the rest grows with the number of pictures). Raises InputError where the split is none of ours."""
    if split is not None and split not in NAMES:
        raise InputError(f"{where}: {name}: {split!r:.40} is no split; there are {', '.join(NAMES)}")
    return {"id": name, **{key: row[key] for key in COLUMNS}, "split": split}
