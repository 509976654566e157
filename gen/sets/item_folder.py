"""One item of a set: its jobs, and the folder that its arrays become, which appears in the set by one rename when it is complete."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gen.assemble import assemble
from gen.capture import Capture, Fault, Floats
from gen.errors import InputError
from gen.files import MARK, dumps, inside
from gen.formats.render_folder import write_files
from gen.render import load_shot
from gen.sets.plan import Item, identities
from gen.sets.set_folder import COLUMNS, ITEM, ITEMS, QUARANTINE, QUARANTINED, RENDERED, Row, read_row, row_text
from gen.sets.thumbnail import THUMBNAIL, frontal, thumbnail
from gen.spec import Spec
from gen.srgb import linear_to_srgb

OURS = re.compile(r"capture\.json|frames/\d+\.exr|view\.exr|mask\.png|preview\.png|spec\.yaml|item\.json|\.degloss")


def finish_item(
    folder: Path, item: Item, spec: Spec, jobs: Sequence[Mapping[str, Any]], made_by: Mapping[str, Any], place: Path
) -> Row:
    """The folder of an item in the set `folder`, from the arrays that its jobs left; its row of the index.

    made_by: Blender's version and device. place: a folder for work in progress. Raises InputError where the object is not in view or
    unlit or the arrays are not what they should be, OSError (or InputError from one) where the disk refuses.
    """
    rendered = assemble(spec, [load_shot(spec, job) for job in jobs], made_by)
    made = place / "made"
    made.mkdir()
    write_files(rendered.capture, made, rendered.coverage, spec.half, spec.crop)
    shown = rendered.capture.images[frontal(rendered.capture.lights)]
    (made / THUMBNAIL).write_bytes(thumbnail(shown))  # while the pixels are at hand: reading them again takes ten times as long
    # JSON is YAML too, and written a hundred times faster: for a single picture that is a tenth of all that is done here.
    (made / "spec.yaml").write_text(dumps(spec.plain(), indent=1) + "\n", encoding="utf-8")
    names = sorted([*_names(made), ITEM])
    (made / MARK).write_text(json.dumps({"degloss": "capture", "files": names}) + "\n", encoding="utf-8")
    row = _row(item, spec, rendered.capture, made)
    (made / ITEM).write_text(row_text(row) + "\n", encoding="utf-8")
    try:
        os.rename(made, folder / ITEMS / item.id)
    except OSError as error:
        if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
            raise
        # Another process was given the same item and was quicker: its bytes are the same.
    (folder / QUARANTINE / f"{item.id}.json").unlink(missing_ok=True)
    return row


def quarantine(folder: Path, item: Item, spec: Spec | None, error: str, work: Path) -> None:
    """Note in the set that an item could not be rendered, and why. work: a folder for work in progress."""
    row = dict.fromkeys(COLUMNS) | _known(item, spec)
    row |= {"status": QUARANTINED, "error": error, "files": {}, "bytes": {}, "overexposed_pixels": []}
    note = work / f"{item.id}.json"
    note.write_text(row_text(row) + "\n", encoding="utf-8")
    (folder / QUARANTINE).mkdir(exist_ok=True)
    os.replace(note, folder / QUARANTINE / note.name)


def rendered_row(folder: Path, name: str) -> tuple[dict[str, Any], str] | None:
    """The row of an item that is rendered and whole, and its line; None where it is missing, or a file is or has another size."""
    place = folder / ITEMS / name
    found = read_row(place / ITEM)
    if found is None or found[0]["id"] != name or found[0]["status"] != RENDERED:
        return None
    try:
        for file, size in found[0]["bytes"].items():
            path = inside(place, file)
            if path.is_symlink() or not path.is_file() or path.stat().st_size != size:
                return None
    except (InputError, OSError):
        return None
    return found


def quarantined_row(folder: Path, name: str) -> tuple[dict[str, Any], str] | None:
    """The row of an item that is in quarantine, and its line; None where it is not."""
    found = read_row(folder / QUARANTINE / f"{name}.json")
    return found if found is not None and found[0]["id"] == name and found[0]["status"] == QUARANTINED else None


def clear_damaged(folder: Path, name: str, work: Path) -> None:
    """Move what is left of a damaged item out of the way. Raises InputError where it holds files that are not ours."""
    place = folder / ITEMS / name
    if not place.is_dir() or place.is_symlink():
        if place.exists() or place.is_symlink():
            raise InputError(f"{place}: is in the place of an item's folder; move it away")
        return
    foreign = [file for file in _names(place) if not OURS.fullmatch(file)]
    if foreign:
        raise InputError(f"{place}: is damaged, and holds a file that is not ours ({foreign[0]}); move that away")
    away = work / f"damaged-{name}"
    os.rename(place, away)
    shutil.rmtree(away, ignore_errors=True)


def overexposed_pixels(image: Floats) -> int:
    """How many pixels of a linear picture (H, W, 3) have R, G and B at 255 in 8-bit sRGB."""
    bright = image[(image > 0.98).all(axis=2)]  # 254.5 of 255 is 0.996 linear: the rest need not be encoded
    return int((np.round(255 * linear_to_srgb(np.clip(bright, 0, 1))) == 255).all(axis=1).sum())


def _row(item: Item, spec: Spec, capture: Capture, made: Path) -> dict[str, Any]:
    provenance = capture.provenance
    names = _names(made)
    facts = {
        "status": RENDERED,
        "files": {name: hashlib.sha256((made / name).read_bytes()).hexdigest() for name in names},
        "bytes": {name: (made / name).stat().st_size for name in names},
        "blender": provenance["blender"],
        "cycles": provenance["blender"],
        "device": provenance["device"],
        "exposure": provenance["exposure"],
        "clipped_samples": int(((capture.faults & Fault.CLIPPED) > 0).sum()),
        "overexposed_pixels": [overexposed_pixels(image) for image in capture.images],
        "object_share": float(capture.mask.mean()),
    }
    return dict.fromkeys(COLUMNS) | _known(item, spec) | facts


def _known(item: Item, spec: Spec | None) -> dict[str, Any]:
    """What the plan alone says of an item."""
    known: dict[str, Any] = {"id": item.id, "group": item.group, "split": item.split, "single": item.single}
    if spec is None:
        return known
    return known | {
        "spec_sha256": spec.digest(),
        "seed": spec.seed,
        "pictures": len(spec.light_directions()),
        "size": list(spec.resolution),
        "shape": spec.shape.name,
        "material": spec.material.kind,
        **identities(spec),
    }


def _names(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir())
