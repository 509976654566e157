"""WebDataset shards. A capture is one sample, with the fields that it has in our releases (`gen.release.layout`) but for the preview.

    train-00000.tar, ...    shards of each split; captures-00000.tar where a capture is in none
    KEY.json                lights, size, group, split, shape and material: fewer facts than in our releases, in the same words
    KEY.capture             capture.json
    KEY.001.exr, ...        the pictures with their layers
    KEY.view.exr            normals, depth, albedo, gloss, as far as they are known
    KEY.mask.png

The pictures of a capture folder of ours, which the captures of sets and releases are too, go in byte for byte; any other capture goes in
as such a folder holds it. So nothing is lost. The same captures give the same bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import IO, Any

from gen.convert.entries import Entry
from gen.errors import InputError
from gen.files import dumps, inside, read_json, real
from gen.formats.render_folder import INDEX, is_render, write_files
from gen.release.layout import CAPTURE, FACTS, SHARD_BYTES, field_of, key_of
from gen.release.samples import without_paths
from gen.release.tar import ShardWriter

NO_SPLIT = "captures"


class Shards:
    """The shards of one split: a new one is begun where the last has reached `SHARD_BYTES`."""

    def __init__(self, folder: Path, split: str) -> None:
        self._folder, self._split, self._count = folder, split, 0
        self._stream: IO[bytes] | None = None

    def add(self, key: str, fields: Iterable[tuple[str, bytes]]) -> None:
        """Append a sample."""
        if self._stream is None:
            self._stream = (self._folder / f"{self._split}-{self._count:05d}.tar").open("wb")
            self._writer = ShardWriter(self._stream)
            self._count += 1
        for field, data in fields:
            self._writer.add(f"{key}.{field}", data)
        if self._writer.length >= SHARD_BYTES:
            self.close()

    def close(self) -> None:
        """End the shard that is open, if one is."""
        if self._stream is not None:
            with self._stream:
                self._writer.end()
            self._stream = None


def write_shards(entries: Iterable[Entry], folder: Path, white: float | None = None) -> None:
    """Write captures as samples into shards in an existing folder, in their order.

    white: must be None; floats have no top. Raises InputError where it is given, or an id or a file has no place in a shard.
    """
    if white is not None:
        raise InputError(f"--white {white}: is for 16-bit formats; shards hold any radiance as it is")
    with ExitStack() as stack:
        shards: dict[str, Shards] = {}
        for entry in entries:
            split = entry.facts.get("split") or NO_SPLIT
            if split not in shards:
                shards[split] = Shards(folder, split)
                stack.callback(shards[split].close)
            key = key_of(entry.name or _key(entry.path))
            with capture_folder(entry, folder) as place:
                shards[split].add(key, _fields(entry, key, place))


@contextmanager
def capture_folder(entry: Entry, room: Path) -> Iterator[Path]:
    """A capture folder of ours that holds the entry: its own, or one that is there for a while in the folder `room`."""
    if is_render(entry.path):
        yield entry.path
        return
    with TemporaryDirectory(prefix=".", dir=room) as temporary:  # there is room where the shards go
        write_files(replace(entry.capture, source=entry.path.name), Path(temporary))
        yield Path(temporary)


def _fields(entry: Entry, key: str, place: Path) -> Iterator[tuple[str, bytes]]:
    """The fields of a sample by their names, each read when it is asked for. place: a capture folder that was read well before."""
    index = read_json(place / INDEX, "the index of a capture")
    pictures = [frame["file"] for frame in index["frames"]]
    files: dict[str, str] = {}
    for file in (*pictures, index["mask"], *([index["view"]] if index.get("view") else [])):
        field = field_of(file)
        if field is None or field in files:
            raise InputError(f"{place / INDEX}: the file {file!r:.80} has no place in a shard")
        files[field] = file
    for field in sorted([CAPTURE, FACTS, *files]):
        if field == CAPTURE:
            yield field, (dumps(without_paths(index), indent=1) + "\n").encode()
        elif field == FACTS:
            yield field, (dumps(_facts(entry, key, index, pictures)) + "\n").encode()
        else:
            yield field, inside(place, files[field]).read_bytes()


def _facts(entry: Entry, key: str, index: Mapping[str, Any], pictures: list[str]) -> dict[str, Any]:
    height, width = entry.capture.size
    return {
        "item": key,
        "group": entry.facts.get("group"),
        "split": entry.facts.get("split"),
        "pictures": len(pictures),
        "width": width,
        "height": height,
        "fields": [PurePosixPath(file).name for file in pictures],
        "directions": [frame["direction"] for frame in index["frames"]],
        "intensities": [frame["intensity"] for frame in index["frames"]],
        "light_kinds": list(entry.capture.light_kinds),
        "shape": entry.facts.get("shape"),
        "material": entry.facts.get("material"),
    }


def _key(path: Path) -> str:
    """A key of a sample made of a file's or folder's name: loaders cut keys at dots."""
    name = path.stem if path.is_file() else real(path).name
    words = re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-")
    return words[:80] or "capture"
