"""Reading a release back: captures by their id, or all folders of a shard. Nothing is parsed before its checksum has been compared.

from gen.release.reading import open_release

release = open_release("degloss-cylinders-1.0.0")
capture = release.capture(release.items("train")[0])
"""

from __future__ import annotations

import hashlib
import tarfile
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from gen.capture import Capture, read_capture
from gen.errors import InputError
from gen.files import inside, read_json, sha256_of, writing_folder
from gen.release.bag import read_manifest
from gen.release.layout import DATA, FORMAT, KEY, MANIFEST, MAX_FILE, MEMBERS, PICTURES, PROVENANCE, SHARD, VERSION, file_of
from gen.release.tables import MEMBERS as MEMBER_COLUMNS
from gen.release.tables import PICTURES as PICTURE_COLUMNS
from gen.release.tables import read_rows, read_table

Member = Mapping[str, Any]
"""A row of members.parquet."""


@dataclass(frozen=True)
class Release:
    """A release on disk. Methods raise InputError, one line, where a file is missing, damaged or not what the tables say."""

    path: Path

    def about(self) -> dict[str, Any]:
        """What provenance.json says."""
        where = self.path / PROVENANCE
        said = read_json(where, "the provenance of a release")
        if not isinstance(said, dict) or said.get("format") != FORMAT:
            raise InputError(f"{where}: is not the provenance of a release of ours (format '{FORMAT}')")
        if said.get("format_version") != VERSION:
            raise InputError(f"{where}: has version {said.get('format_version')!r:.40}, this program reads {VERSION}")
        return said

    def items(self, split: str | None = None) -> list[str]:
        """The ids of all captures, or of those of a split, in the order in which they stand in the shards."""
        rows = read_table(self.path / PICTURES, PICTURE_COLUMNS)
        return [row["item"] for row in rows if row["picture"] == 1 and split in (None, row["split"])]

    def capture(self, item: str) -> Capture:
        """A capture, with its truth."""
        with tempfile.TemporaryDirectory(prefix="degloss-") as place:
            self._put(item, read_rows(self.path / MEMBERS, MEMBER_COLUMNS, item), Path(place))
            return self._read(item, Path(place))

    def captures(self) -> Iterator[Capture]:
        """Every capture, one after another, in the memory of one."""
        for item, place in self.folders():
            yield self._read(item, place)

    def folders(self) -> Iterator[tuple[str, Path]]:
        """Every capture as its id and a folder that every degloss command reads, byte for byte, there until the next is asked for."""
        for item, members in groupby(read_table(self.path / MEMBERS, MEMBER_COLUMNS), key=lambda row: str(row["item"])):
            with tempfile.TemporaryDirectory(prefix="degloss-") as place:
                self._put(item, members, Path(place))
                yield item, Path(place)

    def unpack(self, item: str, folder: Path) -> None:
        """A capture as a folder that every degloss command reads, whole or not at all."""
        members = read_rows(self.path / MEMBERS, MEMBER_COLUMNS, item)
        with writing_folder(folder, "capture") as temporary:
            self._put(item, members, temporary)

    def _read(self, item: str, place: Path) -> Capture:
        return replace(read_capture(place), source=f"{self.path}: {item}")

    def _put(self, item: str, members: Iterable[Member], place: Path) -> None:
        count = 0
        for member in members:
            file = file_of(member["field"])
            if file is not None:
                put(place / file, read_member(self.path, member))
                count += 1
        if not count:
            raise InputError(f"{self.path}: holds no capture {item!r:.100}")


def open_release(path: str | Path) -> Release:
    """The release in a folder. Raises InputError where it is none, or one of its tables is not what the manifest says."""
    release = Release(Path(path))
    release.about()
    listed = read_manifest(release.path, MANIFEST)
    for name in (PICTURES, MEMBERS):
        table = release.path / name
        if table.is_symlink() or not table.is_file() or sha256_of(table) != listed.get(name):
            raise InputError(f"{table}: is not the table that {MANIFEST} lists; check the release by degloss gen verify")
    return release


def is_release(path: Path) -> bool:
    """Whether a folder is, or once was, a release of ours: a damaged one counts."""
    if not (path / DATA).is_dir():
        return False
    return (path / PROVENANCE).is_file() or (path / MEMBERS).is_file()


def shard_file(release: Path, name: Any) -> Path:
    """The file of a shard. Raises InputError where the name is no shard's, or the file is a link or missing."""
    if not isinstance(name, str) or not SHARD.fullmatch(name):
        raise InputError(f"{release}: {name!r:.100} is no name of a shard")
    path = inside(release, f"{DATA}/{name}")
    if path.is_symlink() or not path.is_file():
        raise InputError(f"{path}: is missing or no plain file")
    return path


def read_member(release: Path, member: Member) -> bytes:
    """The bytes of a file in a shard. Raises InputError where the shard is too short for it, or its SHA-256 differs."""
    path = shard_file(release, member["shard"])
    offset, size = member["offset"], member["bytes"]
    if not (0 <= size <= MAX_FILE and 0 <= offset <= path.stat().st_size - size):
        raise InputError(f"{path}: has no room for {member['item']}.{member['field']}, which should be in it")
    with path.open("rb") as shard:
        shard.seek(offset)
        data = shard.read(size)
    if hashlib.sha256(data).hexdigest() != member["sha256"]:
        raise InputError(f"{path}: {member['item']}.{member['field']} differs from its SHA-256; check it by degloss gen verify")
    return data


def unpack_shard(shard: Path, folder: Path) -> list[Path]:
    """The captures of a shard as folders below a new `folder`, each of which `gen.capture.read_capture` reads; their paths.

    For a shard that came alone: its own checksum is not known here. Members are regular files with names of samples, or it is refused.
    Raises InputError where it is damaged or holds anything else.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: is there already; choose another place")
    names: dict[str, None] = {}
    room = shard.stat().st_size if shard.is_file() else 0  # nothing in a plain archive is larger than the archive
    try:
        with writing_folder(folder, "unpacked shard") as temporary, tarfile.open(shard, "r:") as tar:
            for member in tar:
                item, _, field = member.name.partition(".")
                if not member.isreg() or not KEY.fullmatch(item) or not field or "/" in field or member.size > room:
                    raise InputError(f"{shard}: holds {member.name!r:.100}, which is no file of a sample")
                room -= member.size
                file = file_of(field)
                if file is not None:
                    tar.extract(member.replace(name=f"{item}/{file}", deep=False), temporary, filter="data")
                    names[item] = None
                tar.members = []  # type: ignore[attr-defined] # it would keep every header
    except (tarfile.TarError, EOFError) as error:
        raise InputError(f"{shard}: is damaged or no tar archive ({' '.join(str(error).split())[:200]})") from error
    return [folder / name for name in names]


def put(path: Path, data: bytes) -> None:
    """Write a new file, and the folder above it. Raises InputError where it is there: no capture holds a file twice."""
    path.parent.mkdir(exist_ok=True)
    try:
        with path.open("xb") as file:
            file.write(data)
    except FileExistsError:
        raise InputError(f"{MEMBERS}: lists {path.name} of a capture twice") from None
