"""The set folder: many rendered captures, their plan and their index. Names of its files, and reading them.

    set.json          what the set is: name, seed, digests of the set spec and of the plan, number of items, units
    plan.jsonl        the plan (`gen.sets.plan`)
    items/<id>/       a capture folder of ours (`gen.formats.render_folder`), its spec.yaml, preview.png (`gen.sets.thumbnail`), and
                      item.json, its row of the index
    index.jsonl       the rows of all items in the plan's order; there as soon as every item is rendered or quarantined
    events.jsonl      what happened when (`gen.sets.events`)

Nothing but events.jsonl holds a time: the same plan gives the same bytes, however often the work was interrupted and however it was
shared out. Hidden names belong to work in progress, and .quarantined/ keeps the rows of items that could not be rendered.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gen.capture import Capture
from gen.errors import InputError
from gen.files import inside, must_exist, read_json

if TYPE_CHECKING:
    from gen.sets.plan import Plan

SET = "set.json"
PLAN = "plan.jsonl"
ITEMS = "items"
ITEM = "item.json"
INDEX = "index.jsonl"
EVENTS = "events.jsonl"
QUARANTINE = ".quarantined"
FORMAT = "degloss set"
VERSION = 1
RENDERED, QUARANTINED = "rendered", "quarantined"
MAX_ROW = 5_000_000
"""The longest row in characters."""

ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")

Row = Mapping[str, Any]

COLUMNS: dict[str, tuple[type, ...]] = {
    "id": (str,),
    "group": (str,),
    "split": (str, type(None)),
    "single": (bool,),
    "status": (str,),
    "error": (str, type(None)),
    "spec_sha256": (str, type(None)),
    "seed": (int, type(None)),
    "pictures": (int, type(None)),
    "size": (list, type(None)),
    "shape": (str, type(None)),
    "material": (str, type(None)),
    "files": (dict,),
    "bytes": (dict,),
    "blender": (str, type(None)),
    "cycles": (str, type(None)),
    "device": (str, type(None)),
    "exposure": (int, float, type(None)),
    "clipped_samples": (int, type(None)),
    "overexposed_pixels": (list,),
    "object_share": (int, float, type(None)),
    "object": (str, type(None)),
    "material_key": (str, type(None)),
    "lights_key": (str, type(None)),
}
"""The columns of the index with their JSON types. Those of a quarantined item that nobody knows are null or empty.

files: SHA-256 of each file of the item's folder but item.json, by its name there; bytes: its size. overexposed_pixels: one number a
picture, of pixels whose R, G and B are all 255 in 8-bit sRGB. object, material_key, lights_key: see `gen.sets.plan.identities`.
"""


@dataclass(frozen=True)
class SetFolder:
    """A set on disk, read as it is asked for. Every method raises InputError, one line, where a file is missing or damaged."""

    path: Path

    def about(self) -> dict[str, Any]:
        """What set.json says."""
        where = self.path / SET
        said = read_json(where, "the head of a set")
        if not isinstance(said, dict) or said.get("format") != FORMAT:
            raise InputError(f"{where}: is not the head of a set of ours (format '{FORMAT}')")
        if said.get("version") != VERSION:
            raise InputError(
                f"{where}: has version {said.get('version')!r}, this program reads {VERSION}; use the one that wrote it"
            )
        return said

    def plan(self) -> Plan:
        """The plan that the set is rendered from."""
        from gen.sets.plan import read_plan

        return read_plan(self.path / PLAN)

    def rows(self) -> list[dict[str, Any]]:
        """The index, one row an item in the plan's order, with the keys of `COLUMNS`."""
        return list(self.each_row())

    def each_row(self) -> Iterator[dict[str, Any]]:
        """The rows of the index one by one, for what must not grow with the set."""
        self.about()
        where = self.path / INDEX
        if not where.is_file():
            raise InputError(f"{where}: is not there yet; render the rest of the set first: degloss gen render --resume")
        must_exist(where, "the index of a set")
        yield from _rows(where)

    def item_folder(self, name: str) -> Path:
        """The capture folder of an item."""
        if not ID.fullmatch(name):
            raise InputError(f"{self.path}: {name!r:.80} is no id of an item")
        return inside(self.path, f"{ITEMS}/{name}")

    def capture(self, name: str) -> Capture:
        """The capture of an item."""
        from gen.capture import read_capture

        folder = self.item_folder(name)
        if not folder.is_dir():
            raise InputError(f"{folder}: there is no such item; the index says which are rendered")
        return read_capture(folder)


def is_set_folder(path: Path) -> bool:
    """Whether `path` is a set folder of ours."""
    return (path / SET).is_file()


def row_text(row: Row) -> str:
    """A row as its line, without the line's end; item.json and index.jsonl hold the same one."""
    return json.dumps(row, ensure_ascii=True, allow_nan=False)


def read_row(path: Path) -> tuple[dict[str, Any], str] | None:
    """The row in a file that holds one line, and that line; None where there is no such file or it is not a row."""
    try:
        with must_exist(path, "a row of the index").open(encoding="utf-8") as file:
            text = file.read(MAX_ROW)
    except (InputError, OSError, UnicodeDecodeError):
        return None
    row = _parse(text)
    return None if row is None or _fault(row) else (row, text.rstrip("\n"))


def _rows(where: Path) -> Iterator[dict[str, Any]]:
    seen: set[str] = set()
    try:
        with where.open(encoding="utf-8") as file:
            for number, line in enumerate(iter(lambda: file.readline(MAX_ROW), ""), 1):
                row = _parse(line)
                if row is None:
                    raise InputError(f"{where}: line {number}: is not a row of the index; it was cut short or changed")
                fault = _fault(row)
                if fault or row["id"] in seen:
                    raise InputError(f"{where}: line {number}: {fault or 'the id ' + row['id'] + ' is there twice'}")
                seen.add(row["id"])
                yield row
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: is not a text file (the index of a set)") from error
    except OSError as error:
        raise InputError(f"{where}: cannot be read ({error.strerror}; the index of a set)") from error


def _parse(line: str) -> dict[str, Any] | None:
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return row if isinstance(row, dict) else None


def _fault(row: Row) -> str:
    """What is wrong with a row, or nothing."""
    for key, types in COLUMNS.items():
        value = row.get(key)
        if key not in row or not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
            return f"{key} is missing or not as an index has it"
    if not ID.fullmatch(row["id"]):
        return f"{row['id']!r:.80} is no id of an item"
    if row["status"] not in (RENDERED, QUARANTINED):
        return f"status must be {RENDERED} or {QUARANTINED}, got {row['status']!r:.40}"
    if row["status"] == RENDERED and any(row[key] is None for key in ("pictures", "size", "spec_sha256", "object_share")):
        return "says that it is rendered, but not what"
    if not all(isinstance(value, str) for value in row["files"].values()):
        return "files must hold a SHA-256 for every name"
    if row["files"].keys() != row["bytes"].keys() or not all(_whole(value) for value in row["bytes"].values()):
        return "bytes must hold a size for every name in files"
    if row["size"] is not None and (len(row["size"]) != 2 or not all(_whole(value) and value > 0 for value in row["size"])):
        return "size must be [width, height]"
    if not all(_whole(value) for value in row["overexposed_pixels"]):
        return "overexposed_pixels must hold whole numbers"
    if row["status"] == RENDERED and len(row["overexposed_pixels"]) != row["pictures"]:
        return "overexposed_pixels must hold one number a picture"
    return ""


def _whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0
