"""Whether a set folder, a release or a capture folder is whole: every byte by its checksum, then every pixel by what its layers promise.

Checksums come first, and what fails them is never parsed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gen.capture import Capture, Fault, read_capture
from gen.errors import InputError
from gen.files import MARK, inside, read_json, sha256_of
from gen.formats.render_folder import is_render
from gen.sets.layer_checks import faults_of, overexposed
from gen.sets.plan import Item, Plan, read_plan
from gen.sets.set_folder import INDEX, ITEM, ITEMS, PLAN, RENDERED, Row, SetFolder, is_set_folder, read_row

SHARE = 1e-6
"""How far the recorded share of the object may be from that of the mask: nothing but decimal notation."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Verified:
    """What was found. faults: one line each, none where all is well.

    items: captures. files: checksums that were compared. pixels: captures whose pixels were read. kind: set, release or capture.
    """

    faults: tuple[str, ...]
    items: int
    files: int
    pixels: int
    kind: str = "set"


def verify(path: Path, sample: int | None = None, seed: int = 0, progress: Progress | None = None) -> Verified:
    """Check a set folder, a release, or one capture folder of ours.

    sample: read the pixels of so many items only, drawn by the seed; checksums are of all. A capture folder without item.json has no
    checksums. Raises InputError where `path` is neither, or where the set's head or index cannot be read at all.
    """
    if sample is not None and sample < 0:
        raise InputError(f"--sample {sample}: must be at least 0")
    if seed < 0:
        raise InputError(f"--seed {seed}: must be at least 0")
    if is_set_folder(path):
        return _verify_set(SetFolder(path), sample, seed, progress)
    if is_render(path):
        return _verify_capture(path, sample)
    from gen.release.reading import is_release

    if is_release(path):
        from gen.parts import require
        from gen.release.checking import verify_release

        require("release")
        return verify_release(path, sample, seed, progress)
    raise InputError(
        f"{path}: is neither a set folder (set.json), nor a release (provenance.json), nor a capture folder of ours (capture.json)"
    )


def _verify_set(folder: SetFolder, sample: int | None, seed: int, progress: Progress | None) -> Verified:
    about = folder.about()
    faults: list[str] = []
    planned = _plan(folder, about, faults)
    rows = folder.rows()
    if planned is not None:
        faults += _against_plan(planned, rows)
    elif about.get("items") != len(rows):
        faults.append(f"{INDEX}: holds {len(rows)} rows, set.json says {about.get('items')}")
    rendered = [row for row in rows if row["status"] == RENDERED]
    faults += _strangers(folder, {row["id"] for row in rendered})
    drawn = np.random.default_rng(seed).permutation(len(rendered))[: len(rendered) if sample is None else sample]
    chosen = {rendered[i]["id"] for i in drawn}
    specs = {item.id: item for item in planned.items} if planned is not None else {}
    files = pixels = 0
    for n, row in enumerate(rendered):
        place, at = folder.item_folder(row["id"]), f"{ITEMS}/{row['id']}"
        found = list(_files(place, row))
        files += len(row["files"])
        if not found and row["id"] in chosen:
            found = list(pixel_faults(place, row, specs.get(row["id"])))
            pixels += 1
        faults += [f"{at}/{fault}" for fault in found]
        if progress is not None:
            progress(n + 1, len(rendered))
    return Verified(tuple(faults), len(rendered), files, pixels)


def _verify_capture(path: Path, sample: int | None) -> Verified:
    found = read_row(path / ITEM)
    row = None if found is None else found[0]
    if row is not None:
        faults = list(_files(path, row, with_item=False))
    elif (path / ITEM).exists():
        faults = [f"{ITEM}: is not a row of an index; it was cut short or changed"]
    else:
        faults = list(_marked(path))
    wanted = not faults and sample != 0
    if wanted:
        faults = list(pixel_faults(path, row, None))
    return Verified(tuple(faults), 1, 0 if row is None else len(row["files"]), int(wanted), "capture")


def _plan(folder: SetFolder, about: Mapping[str, Any], faults: list[str]) -> Plan | None:
    """The plan, if it is the one that set.json names."""
    where = folder.path / PLAN
    if not where.is_file():
        faults.append(f"{PLAN}: is missing")
        return None
    if sha256_of(where) != about.get("plan_sha256"):
        faults.append(f"{PLAN}: its SHA-256 is not the one in set.json")
        return None
    plan = read_plan(where)
    for key, value in (("name", plan.name), ("seed", plan.seed), ("set_sha256", plan.set_sha256), ("items", len(plan.items))):
        if about.get(key) != value:
            faults.append(f"set.json: {key} is {about.get(key)!r:.80}, the plan says {value!r:.80}")
    return plan


def _against_plan(plan: Plan, rows: list[dict[str, Any]]) -> Iterator[str]:
    """That the index has a row for every item of the plan, in its order, and no other."""
    indexed = {row["id"]: row for row in rows}
    planned = {item.id: item for item in plan.items}
    yield from (f"{INDEX}: has no row for {name}" for name in planned if name not in indexed)
    yield from (f"{INDEX}: {name} is not in the plan" for name in indexed if name not in planned)
    if list(indexed) != list(planned) and set(indexed) == set(planned):
        yield f"{INDEX}: is not in the order of the plan"
    for name, row in indexed.items():
        if name in planned:
            item = planned[name]
            said = {"group": item.group, "split": item.split, "single": item.single, "seed": item.spec.get("seed")}
            if row["status"] != RENDERED and row["seed"] is None:
                del said["seed"]
            yield from (
                f"{INDEX}: {name}: {key} is {row[key]!r}, the plan says {value!r}"
                for key, value in said.items()
                if row[key] != value
            )


def _strangers(folder: SetFolder, rendered: set[str]) -> Iterator[str]:
    """Folders beside those of the items. Hidden ones belong to work in progress."""
    place = folder.path / ITEMS
    if place.is_dir():
        for path in sorted(place.iterdir()):
            if path.name not in rendered and not path.name.startswith("."):
                yield f"{ITEMS}/{path.name[:100]}: does not belong to an item that the index calls rendered"


def _files(place: Path, row: Row, with_item: bool = True) -> Iterator[str]:
    """Missing, changed and extra files of an item, and whether its item.json is its row."""
    if not place.is_dir():
        yield "capture.json: is missing, and so is the item's folder"
        return
    if with_item:
        found = read_row(place / ITEM)
        if found is None or found[0] != row:
            yield f"{ITEM}: {'is missing or damaged' if found is None else f'differs from the row in {INDEX}'}"
    for name, digest in row["files"].items():
        try:
            file = inside(place, name)
        except InputError:
            yield f"{name[:100]}: leads out of the folder"
            continue
        if file.is_symlink() or not file.is_file():
            yield f"{name}: is missing"
        elif file.stat().st_size != row["bytes"][name]:
            yield f"{name}: has {file.stat().st_size} bytes, {row['bytes'][name]} were written"
        elif sha256_of(file) != digest:
            yield f"{name}: its SHA-256 is not the one that was recorded when it was written"
    if "capture.json" not in row["files"]:
        yield f"{ITEM}: does not list capture.json"
    yield from (f"{name[:100]}: is an extra file" for name in _names(place) if name not in {*row["files"], ITEM, MARK})


def _marked(place: Path) -> Iterator[str]:
    """Missing and extra files of a capture folder, by the mark that was left in it; nothing where there is none."""
    if not (place / MARK).is_file():
        return
    mark = read_json(place / MARK, "the mark of a result")
    names = mark.get("files") if isinstance(mark, dict) else None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        yield f"{MARK}: does not list the folder's files"
        return
    found = _names(place)
    yield from (f"{name[:100]}: is missing" for name in names if name not in found)
    yield from (f"{name[:100]}: is an extra file" for name in found if name not in {*names, MARK})


def pixel_faults(place: Path, row: Row | None, item: Item | None) -> Iterator[str]:
    """Whether the capture in a folder reads, is what its row and plan say, and keeps its promises; a line for each fault."""
    try:
        capture = read_capture(place)
        listed = read_json(place / "capture.json", "the index of a capture")["frames"]
        frames = [inside(place, frame["file"]) for frame in listed]
        if item is not None and row is not None and item.capture_spec().digest() != row["spec_sha256"]:
            yield f"{ITEM}: spec_sha256 is not that of the plan's spec"
        if row is not None:
            yield from _against_row(capture, row)
        yield from faults_of(capture, frames)
    except InputError as error:
        yield f"capture.json: {error}"


def _against_row(capture: Capture, row: Row) -> Iterator[str]:
    H, W = capture.size
    found = {
        "pictures": capture.count,
        "size": [W, H],
        "clipped_samples": int(((capture.faults & Fault.CLIPPED) > 0).sum()),
        "overexposed_pixels": overexposed(capture.images),
        "exposure": capture.provenance.get("exposure"),
        "spec_sha256": capture.provenance.get("spec_sha256"),
    }
    for key, value in found.items():
        if row[key] != value:
            yield f"{ITEM}: {key} is {row[key]!r:.80}, the capture has {value!r:.80}"
    share = float(capture.mask.mean())
    if abs(share - row["object_share"]) > SHARE:
        yield f"{ITEM}: object_share is {row['object_share']:g}, the mask has {share:g}"


def _names(place: Path) -> list[str]:
    return sorted(path.relative_to(place).as_posix() for path in place.rglob("*") if not path.is_dir() or path.is_symlink())
