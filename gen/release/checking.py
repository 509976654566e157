"""Whether a release is whole: every byte by its checksum, the tables against the shards, the captures by what their layers promise.

First the folder itself (no links, sizes as bag-info.txt says), then checksums; only what passes them is parsed. A shard must be, byte for
byte, what members.parquet says: no reader of archives is needed for that.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from itertools import groupby, islice
from pathlib import Path
from typing import IO, Any

import numpy as np

from gen.errors import InputError
from gen.files import read_json
from gen.release import layout
from gen.release.bag_checking import bag_faults
from gen.release.layout import CAPTURE, DATA, FACTS, MAX_FILE, MEMBERS, PICTURES, PLAN, REJECTED, SPLITS
from gen.release.reading import Release, put, shard_file
from gen.release.samples import picture_rows, sample_facts
from gen.release.tables import MEMBERS as MEMBER_COLUMNS
from gen.release.tables import PICTURES as PICTURE_COLUMNS
from gen.release.tables import REJECTED as REJECTED_COLUMNS
from gen.release.tables import read_table
from gen.release.tar import BLOCK, ending, header, padding
from gen.sets.plan import Plan, read_plan
from gen.sets.screening import Verdict
from gen.sets.splits import unsaid
from gen.sets.verify import Progress, Verified, pixel_faults

MAX_PARSED = 50_000_000
"""The largest JSON field in bytes."""

CHUNK = 1 << 20
KIND = "release"


def verify_release(path: Path, sample: int | None, seed: int, progress: Progress | None) -> Verified:
    """Check a release; see `gen.sets.verify.verify`. progress: called with (shards done, shards in all)."""
    faults, files = bag_faults(path)
    damaged = {fault.partition(":")[0] for fault in faults}
    needed = (PICTURES, REJECTED, MEMBERS, PLAN, SPLITS, layout.PROVENANCE)
    if not files or damaged & set(needed):
        return Verified(tuple(faults), 0, files, 0, KIND)  # what the tables say cannot be relied on
    try:
        about = Release(path).about()
        plan = read_plan(path / PLAN)
        rows = list(_by_item(path))
        faults += _division(path, rows)
        faults += _settled(path, plan, rows)
        drawn = np.random.default_rng(seed).permutation(len(rows))[: len(rows) if sample is None else sample]
        chosen = {rows[i]["id"] for i in drawn}
        if not _named_files(about):  # the names of such files are cut short, and the specs' digests with them
            faults += _specs(plan, rows)
        found, pixels = _shards(path, damaged, rows, chosen, progress)
        faults += found
    except InputError as error:
        return Verified((*faults, str(error)), 0, files, 0, KIND)
    except (KeyError, TypeError) as error:
        fault = f"{DATA}: its tables hold what no release has ({' '.join(str(error).split())[:200]})"
        return Verified((*faults, fault), 0, files, 0, KIND)
    return Verified(tuple(faults), len(rows), files, pixels, KIND)


def _named_files(about: Mapping[str, Any]) -> bool:
    """Whether specs name files of their maker, as provenance.json says."""
    said = about.get("set")
    named = said.get("named_files") if isinstance(said, dict) else None
    if not isinstance(named, bool):
        raise InputError(f"{layout.PROVENANCE}: does not say whether specs name files (set.named_files)")
    return named


def _by_item(path: Path) -> Iterator[dict[str, Any]]:
    """Of every capture what its pictures' rows say together: the keys of the set's index that it shares with them."""
    for item, group in groupby(read_table(path / PICTURES, PICTURE_COLUMNS), key=lambda row: str(row["item"])):
        rows = list(group)
        first = rows[0]
        if not layout.KEY.fullmatch(item):
            raise InputError(f"{PICTURES}: {item!r:.80} is no name of a capture")
        if [row["picture"] for row in rows] != list(range(1, first["pictures"] + 1)):
            raise InputError(f"{PICTURES}: {item}: its pictures are not 1 to {first['pictures']}")
        same = ("group", "single", "pictures", "shape", "material", "exposure", "object_share", "seed", "object", "material_key",
                "lights_key", "spec_sha256", "blender", "device", "split", "shard")  # fmt: skip
        yield {
            "id": item,
            "size": [first["width"], first["height"]],
            **{key: first[key] for key in same},
            "overexposed_pixels": [row["overexposed_pixels"] for row in rows],
            "clipped": [row["clipped_samples"] for row in rows],
            "clipped_samples": sum(row["clipped_samples"] for row in rows),
        }


def _division(path: Path, rows: list[dict[str, Any]]) -> Iterator[str]:
    """That the splits are those of splits.json, and share nothing but what it says they share."""
    said = read_json(path / SPLITS, "the splits of a release")
    try:
        split_of = {str(item): str(name) for name, ids in said["splits"].items() for item in ids}
    except (KeyError, TypeError, AttributeError):
        yield f"{SPLITS}: does not say how the set is divided"
        return
    found = {row["id"]: row["split"] for row in rows}
    wrong = sorted(item for item in found.keys() | split_of.keys() if found.get(item) != split_of.get(item))
    yield from (f"{PICTURES}: {item} is in {found.get(item)}, {SPLITS} says {split_of.get(item)}" for item in wrong)
    yield from (f"{SPLITS}: {fault}" for fault in unsaid(said, rows))


def _settled(path: Path, plan: Plan, rows: list[dict[str, Any]]) -> Iterator[str]:
    """That every item of the plan is released, or left out with a reason, and nothing else is."""
    planned, kept = {item.id for item in plan.items}, [row["id"] for row in rows]
    out = {row["item"] for row in read_table(path / REJECTED, REJECTED_COLUMNS) if row["reason"]}
    yield from (f"{PICTURES}: {item} is there {n} times" for item, n in Counter(kept).items() if n > 1)
    yield from (f"{PLAN}: {item} is neither released nor left out with a reason" for item in sorted(planned - set(kept) - out))
    yield from (f"{PLAN}: does not hold {item}, which is released or left out" for item in sorted((set(kept) | out) - planned))
    yield from (f"{REJECTED}: {item} is left out and released" for item in sorted(set(kept) & out))


def _specs(plan: Plan, rows: list[dict[str, Any]]) -> Iterator[str]:
    """That captures were made from the specs in the plan. A spec is compared as it is written: nothing that it names is opened."""
    specs = {item.id: item.spec for item in plan.items}
    for row in rows:
        text = json.dumps(specs.get(row["id"]), sort_keys=True)
        if row["id"] in specs and hashlib.sha256(text.encode()).hexdigest() != row["spec_sha256"]:
            yield f"{PICTURES}: {row['id']}: spec_sha256 is not that of its spec in {PLAN}"


def _shards(
    path: Path, damaged: set[str], rows: list[dict[str, Any]], chosen: set[str], progress: Progress | None
) -> tuple[list[str], int]:
    """The faults of all shards that passed their checksum, and how many captures had their pixels read. rows: of `_by_item`."""
    faults: list[str] = []
    pixels = 0
    items = groupby(rows, key=lambda row: str(row["shard"]))
    members = groupby(read_table(path / MEMBERS, MEMBER_COLUMNS), key=lambda row: str(row["shard"]))
    pictures = groupby(read_table(path / PICTURES, PICTURE_COLUMNS), key=lambda row: str(row["shard"]))
    names = sorted(place.name for place in (path / DATA).glob("*.tar"))
    seen: list[str] = []
    for (name, of_items), (name_of_members, of_members), (_, of_pictures) in zip(items, members, pictures, strict=False):
        seen.append(name)
        if name != name_of_members:
            raise InputError(f"{MEMBERS}: speaks of {name_of_members!r:.60} where {PICTURES} speaks of {name!r:.60}")
        if f"{DATA}/{name}" not in damaged:
            with ExitStack() as stack:
                checking = _Shard(stack.enter_context(shard_file(path, name).open("rb")), name, chosen)
                faults += checking.run(of_items, of_members, of_pictures)
                pixels += checking.pixels
        else:
            for rest in (of_items, of_members, of_pictures):
                for _ in rest:
                    pass
        if progress is not None:
            progress(len(seen), len(names))
    if next(items, None) or next(members, None):
        faults.append(f"{MEMBERS}: speaks of other shards than {PICTURES}")
    faults += [f"{DATA}/{name}: is not spoken of in {PICTURES}" for name in names if name not in seen]
    if len(set(seen)) < len(seen):
        faults.append(f"{PICTURES}: the rows of a shard do not stand together")
    return faults, pixels


class _Shard:
    """One shard, read from its first byte to its last beside its rows of the tables."""

    def __init__(self, stream: IO[bytes], name: str, chosen: set[str]) -> None:
        self._stream, self._name, self._chosen = stream, name, chosen
        self._at, self.pixels = 0, 0

    def run(self, items: Iterator[dict[str, Any]], members: Iterator[Any], pictures: Iterator[Any]) -> Iterator[str]:
        """Its faults. Nothing after the first place where bytes and table part ways is looked at."""
        by_item = groupby(members, key=lambda row: str(row["item"]))
        last = ""
        for item in items:
            rows = list(islice(pictures, item["pictures"]))
            name, own = next(by_item, ("", iter(())))
            if name != item["id"] or name <= last or any(row["item"] != name for row in rows):
                yield f"{DATA}/{self._name}: {name or 'nothing'} stands where {item['id']} should, or out of order"
                return
            last = name
            with tempfile.TemporaryDirectory(prefix="degloss-") as place:
                kept: dict[str, bytes] = {}
                fields = list(own)
                fault = next((fault for member in fields if (fault := self._member(member, Path(place), kept))), None)
                if fault:
                    yield fault
                    return
                yield from (
                    f"{DATA}/{self._name}: {name}: {fault}" for fault in self._capture(item, fields, rows, kept, Path(place))
                )
        if next(by_item, None) is not None:
            yield f"{MEMBERS}: {self._name} holds a sample that {PICTURES} does not list"
        rest = self._stream.read(len(ending(self._at)) + 1)
        if rest != ending(self._at):
            yield f"{DATA}/{self._name}: does not end where its last file does"

    def _member(self, member: Mapping[str, Any], place: Path, kept: dict[str, bytes]) -> str:
        """Read a file; what is wrong with it, or nothing. Fields that are parsed go to `kept`, files of a chosen capture to `place`."""
        name, size = f"{member['item']}.{member['field']}", member["bytes"]
        at = f"{DATA}/{self._name}: {name}"
        parsed = member["field"] in (FACTS, CAPTURE)
        if not parsed and member["field"] != layout.PREVIEW and layout.file_of(str(member["field"])) is None:
            return f"{DATA}/{self._name}: {name[:100]!r} is no file of a sample"
        if not 0 <= size <= (MAX_PARSED if parsed else MAX_FILE):
            return f"{at}: is too large"
        if self._stream.read(BLOCK) != header(name, size) or member["offset"] != self._at + BLOCK:
            return f"{at}: does not stand at byte {member['offset']} with {size} bytes"
        digest, file = hashlib.sha256(), layout.file_of(member["field"])
        keep = parsed or (file is not None and member["item"] in self._chosen)
        parts: list[bytes] = []
        left = size
        while left:
            data = self._stream.read(min(CHUNK, left))
            if not data:
                return f"{at}: is cut short"
            digest.update(data)
            left -= len(data)
            if keep:
                parts.append(data)
        if self._stream.read(len(padding(size))) != padding(size):
            return f"{at}: is not followed by zeros"
        self._at += BLOCK + size + len(padding(size))
        if digest.hexdigest() != member["sha256"]:
            return f"{at}: its SHA-256 is not the one in {MEMBERS}"
        if parsed:
            kept[member["field"]] = b"".join(parts)
        if file is not None and member["item"] in self._chosen:
            put(place / file, b"".join(parts))
        return ""

    def _capture(
        self, item: Mapping[str, Any], fields: list[Any], rows: list[Any], kept: dict[str, bytes], place: Path
    ) -> Iterator[str]:
        """That the tables and the sample's facts are what its capture.json says, and, where it was chosen, that its layers add up."""
        names = [member["field"] for member in fields]
        if names != sorted(set(names)) or not {CAPTURE, FACTS, layout.PREVIEW} <= set(names):
            yield f"its fields are not in order, or one is missing: {', '.join(names)[:200]}"
            return
        places = {member["field"]: (member["offset"], member["bytes"], member["sha256"]) for member in fields}
        verdicts = [
            Verdict(item["id"], k + 1, True, None, bright, clipped)
            for k, (bright, clipped) in enumerate(zip(item["overexposed_pixels"], item["clipped"], strict=True))
        ]
        try:
            index = json.loads(kept[CAPTURE])
            again = picture_rows(item, index, item["split"], self._name, verdicts, places)
            facts = sample_facts(item, index, item["split"], verdicts)
        except (InputError, ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError, RecursionError) as error:
            yield f"its capture cannot be read ({' '.join(str(error).split())[:200]})"
            return
        for row, expected in zip(rows, again, strict=True):
            wrong = [key for key, value in expected.items() if row[key] != value]
            yield from (
                f"picture {row['picture']}: {key} is {row[key]!r:.80} in {PICTURES}, the capture has {expected[key]!r:.80}"
                for key in wrong
            )
        if facts != kept[FACTS]:
            yield f"its field {FACTS} differs from {PICTURES}"
        if item["id"] in self._chosen:
            self.pixels += 1
            yield from pixel_faults(place, item, None)
