"""From a rendered set to a release: shards, tables, documents and manifests, in the memory of a few captures.

All is made in a hidden folder beside the output, which gets its name by one rename when it is complete. What a killed run left there is
gone on with: shards that are done and whole are kept.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TextIO

from gen.errors import InputError
from gen.files import dumps, keep_outside, must_exist, read_json, sha256_of, write_json
from gen.release.about import About
from gen.release.bag import write_bag
from gen.release.contents import Contents, contents_of, rejected_rows
from gen.release.documents import write_documents
from gen.release.facts import count_facts
from gen.release.layout import DATA, MEMBERS, PICTURES, PLAN, REJECTED, SHARD_BYTES, SPLITS
from gen.release.provenance import code_sha256
from gen.release.samples import without_paths
from gen.release.shards import Done, finished, part_of, write_shard
from gen.release.tables import MEMBERS as MEMBER_COLUMNS
from gen.release.tables import PICTURES as PICTURE_COLUMNS
from gen.release.tables import REJECTED as REJECTED_COLUMNS
from gen.release.tables import concatenate, table_writer
from gen.sets.screening import SCREENING
from gen.sets.set_folder import INDEX, SET, SetFolder
from gen.sets.set_folder import PLAN as SET_PLAN
from gen.sets.splits import SPLITS as SET_SPLITS

BEGUN, BUILT, WORK, LOCK, ENDED = "begun.json", "release", "work", "lock", "ended.json"
SOURCES = (SET, SET_PLAN, INDEX, SCREENING, SET_SPLITS)
Progress = Callable[[int, int], None]
"""Called with (captures done, captures in all)."""


@dataclass(frozen=True)
class Released:
    """What a release holds. kept: shards that an earlier run had finished."""

    items: int
    pictures: int
    rejected: int
    shards: int
    kept: int
    bytes: int


def release_set(
    folder: SetFolder,
    output: Path,
    about: About,
    shard_bytes: int = SHARD_BYTES,
    resume: bool = False,
    progress: Progress | None = None,
) -> Released:
    """Make a release of a rendered, screened and split set.

    shard_bytes: of a shard, about. resume: go on with what an interrupted run left, to the same bytes. Raises InputError where the output
    is there already or lies in the set, the set is not whole or not divided, one of its files is not what the index says, or the disk
    refuses; a KeyboardInterrupt comes with a sentence that says how to go on.
    """
    keep_outside(folder.path, output)
    with workplace(output, resume) as place:
        return release_in(place, folder, output, about, shard_bytes, progress)


@contextmanager
def workplace(output: Path, resume: bool) -> Iterator[Path]:
    """The hidden folder beside the output that a release is made in, held by a lock; removed when the output is there.

    Raises InputError where the output holds something that no unfinished run put there, an unfinished release is there without `resume`,
    or another process is at it.
    """
    output = Path(os.path.abspath(output))
    place = output.parent / f".{output.name}.partial"
    lock = _locked(output, place, resume)
    try:
        yield place
        shutil.rmtree(place, ignore_errors=True)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; what is done is kept, run the same command with --resume to go on with {output}"
        ) from None
    except OSError as error:
        raise InputError(
            f"{output}: cannot be written ({error.strerror or error}); what is done is kept: make room, then run the same command "
            "with --resume"
        ) from error
    finally:
        with lock, suppress(OSError):
            if {entry.name for entry in place.iterdir()} == {LOCK}:  # nothing was begun
                shutil.rmtree(place)


def _locked(output: Path, place: Path, resume: bool) -> TextIO:
    """The lock of a `workplace`, which is there from now on."""
    try:
        there = output.is_symlink() or (output.exists() and (not output.is_dir() or any(output.iterdir())))
        if there and not (resume and (place / ENDED).exists()):
            raise InputError(f"{output}: is there already, and a release is never written over; choose another place with -o")
        if place.exists() and not resume:
            raise InputError(f"{output}: an unfinished release is in {place.name}; go on with it by --resume, or remove it")
        place.mkdir(parents=True, exist_ok=True)
        lock = (place / LOCK).open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            raise InputError(f"{output}: another process is making it") from None
    except OSError as error:
        raise InputError(f"{output}: cannot be written ({error.strerror or error}); choose another place with -o") from error
    return lock


def release_in(
    place: Path, folder: SetFolder, output: Path, about: About, shard_bytes: int, progress: Progress | None
) -> Released:
    """Make a release in a `workplace`; see `release_set`."""
    if (place / ENDED).exists() and not (place / BUILT).exists():  # killed after its last step
        return Released(**read_json(place / ENDED, "the tally of a release"))
    contents = contents_of(folder, shard_bytes)
    sources = {name: _digest(folder.path / name) for name in SOURCES}
    _check_head(folder, sources[SET_PLAN])
    _same_as_before(place, {"sources": sources, "about": asdict(about), "shard_bytes": shard_bytes, "code_sha256": code_sha256()})
    built, work = place / BUILT, place / WORK
    (built / DATA).mkdir(parents=True, exist_ok=True)
    work.mkdir(exist_ok=True)
    done, kept = _all_shards(folder, contents, built / DATA, work, progress)
    _sweep(built, {shard.name for shard in contents.shards})
    concatenate([part_of(work, shard, "pictures") for shard in contents.shards], built / PICTURES, PICTURE_COLUMNS)
    concatenate([part_of(work, shard, "members") for shard in contents.shards], built / MEMBERS, MEMBER_COLUMNS)
    rejected = 0
    with table_writer(built / REJECTED, REJECTED_COLUMNS) as append:
        for row in rejected_rows(folder, contents):
            append((row,))
            rejected += 1
    named_files = _write_plan(folder.path / SET_PLAN, built / PLAN)
    shutil.copyfile(folder.path / SET_SPLITS, built / SPLITS)
    hashes = {f"{DATA}/{one.name}": one.sha256 for one in done}
    write_documents(built, folder, about, count_facts(built, folder, named_files), sources, hashes)
    total = write_bag(built, about, hashes)
    released = Released(sum(one.items for one in done), sum(one.pictures for one in done), rejected, len(done), kept, total)
    write_json(place / ENDED, asdict(released))
    os.replace(built, os.path.abspath(output))
    return released


def _same_as_before(place: Path, now: dict[str, object]) -> None:
    """Note what the release is made of, or see that it is what an earlier run noted."""
    note = place / BEGUN
    if not note.exists():
        for left in (place / BUILT, place / WORK):
            shutil.rmtree(left, ignore_errors=True)
        write_json(note, now)
    elif read_json(note, "what an unfinished release is made of") != json.loads(dumps(now)):
        raise InputError(
            f"{place}: was begun from another set, with other options or by another version of degloss; remove it and start again"
        )


def _digest(path: Path) -> str:
    what = "a file of the set"
    try:
        return sha256_of(must_exist(path, what))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}; {what})") from error


def _check_head(folder: SetFolder, plan_sha256: str) -> None:
    """That set.json says what documents need of it, and names the plan that is there."""
    said = folder.about()
    for key, kind in (("name", str), ("seed", int), ("items", int), ("set_sha256", str), ("plan_sha256", str)):
        if type(said.get(key)) is not kind:
            raise InputError(f"{folder.path / SET}: {key} is missing or not as a set has it; render the set again")
    if said["plan_sha256"] != plan_sha256:
        raise InputError(f"{folder.path / SET_PLAN}: its SHA-256 is not the one in {SET}; check the set with degloss gen verify")


def _all_shards(
    folder: SetFolder, contents: Contents, data: Path, work: Path, progress: Progress | None
) -> tuple[list[Done], int]:
    """The notes of all shards, and how many of them an earlier run had finished."""
    total, items = contents.items(), 0

    def step(count: int = 1) -> None:
        nonlocal items
        items += count
        if progress is not None:
            progress(items, total)

    notes: list[Done] = []
    kept = 0
    for shard in contents.shards:
        done = finished(shard, data, work)
        if done is not None:
            kept += 1
            step(done.items)
        notes.append(done or write_shard(folder, contents, shard, data, work, step))
    return notes, kept


def _sweep(built: Path, shards: set[str]) -> None:
    """Remove what an interrupted run may have written after its shards: all of it is written again."""
    for path in built.iterdir():
        if path.is_file():
            path.unlink()
    for path in (built / DATA).iterdir():
        if path.name not in shards:
            path.unlink()


def _write_plan(source: Path, target: Path) -> bool:
    """The set's plan, without the folders of files that specs name; whether they name any."""
    named = False
    with source.open(encoding="utf-8") as lines, target.open("w", encoding="utf-8", newline="\n") as out:
        for number, line in enumerate(lines, 1):
            try:
                item = json.loads(line)
            except (ValueError, RecursionError):
                raise InputError(f"{source}: line {number}: is not JSON (a plan)") from None
            bare = without_paths(item)
            named |= bare != item
            out.write(line if bare == item else json.dumps(bare, sort_keys=True, ensure_ascii=True, allow_nan=False) + "\n")
    return named
