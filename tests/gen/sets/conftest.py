"""Set folders without a renderer: a real plan, captures in closed form, and the index that goes with them."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.capture import Capture, Fault
from gen.formats.render_folder import write_files, write_render
from gen.sets.plan import Item, identities, plan_of, write_plan
from gen.sets.set_folder import COLUMNS, FORMAT, INDEX, ITEM, ITEMS, PLAN, SET, VERSION, SetFolder, row_text

SET_SPEC = """\
# Six single pictures, three stacks of five, two test captures
set: closed-form
seed: 5
groups:
  - name: one
    count: 6
    single: true
    capture:
      resolution: [24, 24]
      shape: {name: sphere, radius: {uniform: [10, 20]}}
      material: {kind: substrate, albedo: {uniform: [0.2, 0.5]}, specular: 0.05, alpha: {uniform: [0.3, 0.5]}}
      lights: {pattern: random, count: 1, max_tilt_degrees: 40}
      camera: {kind: orthographic, width_mm: 60}
      exposure: 1.0
  - name: stack
    count: 3
    capture:
      resolution: [24, 24]
      shape: {name: cylinder, radius: {uniform: [10, 20]}}
      material: {kind: substrate, albedo: {uniform: [0.2, 0.5]}, specular: 0.05, alpha: {uniform: [0.3, 0.5]}}
      lights: {pattern: random, count: 5, max_tilt_degrees: 40}
      camera: {kind: orthographic, width_mm: 60}
      exposure: 1.0
      clip: true
  - name: test
    split: test
    count: 2
    capture:
      resolution: [24, 24]
      shape: {name: sphere, radius: {uniform: [21, 25]}}
      material: {kind: substrate, albedo: {uniform: [0.2, 0.5]}, specular: 0.05, alpha: {uniform: [0.3, 0.5]}}
      lights: {pattern: random, count: 1, max_tilt_degrees: 40}
      camera: {kind: orthographic, width_mm: 60}
      exposure: 1.0
"""
OVEREXPOSED = ("one-000001", "one-000004", "stack-000000")
"""Items that are made with a white patch of six pixels in their first picture."""
QUARANTINED = "one-000005"

SetMaker = Callable[[Path], SetFolder]


@pytest.fixture(scope="session")
def finished_set(tmp_path_factory: pytest.TempPathFactory, synthetic: Callable[..., Capture]) -> SetFolder:
    """A whole set, to be read only."""
    place = tmp_path_factory.mktemp("sets")
    (place / "set.yaml").write_text(SET_SPEC)
    return write_set(place / "set.yaml", place / "set", synthetic)


@pytest.fixture
def set_folder(finished_set: SetFolder, tmp_path: Path) -> SetFolder:
    """A copy of it, to be changed."""
    shutil.copytree(finished_set.path, tmp_path / "set")
    return SetFolder(tmp_path / "set")


def write_set(spec: Path, folder: Path, synthetic: Callable[..., Capture]) -> SetFolder:
    """What a campaign would leave of a set spec, its captures in closed form."""
    plan = plan_of(spec)
    folder.mkdir()
    write_plan(plan, folder / PLAN)
    head = {"format": FORMAT, "version": VERSION, "name": plan.name, "seed": plan.seed, "set_sha256": plan.set_sha256}
    (folder / SET).write_text(json.dumps({**head, "plan_sha256": plan.digest(), "items": len(plan.items)}))
    rows = [_quarantined(item) if item.id == QUARANTINED else _rendered(item, folder, synthetic) for item in plan.items]
    (folder / INDEX).write_text("".join(row_text(row) + "\n" for row in rows))
    return SetFolder(folder)


def _rendered(item: Item, folder: Path, synthetic: Callable[..., Capture]) -> dict[str, Any]:
    spec = item.capture_spec()
    made = synthetic(
        spec.shape.name, spec.resolution[0], spec.light_directions(), spec.material.albedo, 0.05, spec.material.width()
    )
    provenance = {"exposure": 1.0, "spec": spec.plain(), "spec_sha256": spec.digest()}
    truth, patch = made.truth, np.zeros(made.images.shape, np.float32)
    if item.id in OVEREXPOSED:
        patch[0, 10:12, 11:14] = 3
    truth = replace(truth, specular=truth.specular + patch)
    images = truth.diffuse + truth.specular
    faults = np.zeros(images.shape[:3], np.uint8)
    if spec.clip:
        faults = np.where((images >= 1).any(axis=3), int(Fault.CLIPPED), 0).astype(np.uint8)
        images = np.minimum(images, np.float32(1))
    capture = replace(made, images=images, faults=faults, truth=truth, provenance=provenance)
    place = folder / ITEMS / item.id
    write_render(capture, place)
    files = {p.relative_to(place).as_posix(): p.read_bytes() for p in sorted(place.rglob("*")) if p.is_file()}
    row = (
        dict.fromkeys(COLUMNS)
        | _known(item)
        | {
            "status": "rendered",
            "spec_sha256": spec.digest(),
            "pictures": capture.count,
            "size": [24, 24],
            "shape": spec.shape.name,
            "material": spec.material.kind,
            "files": {name: hashlib.sha256(data).hexdigest() for name, data in files.items()},
            "bytes": {name: len(data) for name, data in files.items()},
            "exposure": 1.0,
            "clipped_samples": int((faults > 0).sum()),
            "overexposed_pixels": [6 if item.id in OVEREXPOSED and k == 0 else 0 for k in range(capture.count)],
            "object_share": float(capture.mask.mean()),
            **identities(spec),
        }
    )
    (place / ITEM).write_text(row_text(row) + "\n")
    return row


def store_half_and_cropped(folder: SetFolder, item: str) -> None:
    """Write the files of an item as a spec with half, crop and soft edges would have it, and what the index says of them."""
    place, capture = folder.item_folder(item), folder.capture(item)
    kept = (place / ITEM).read_text()
    shutil.rmtree(place)
    place.mkdir()
    coverage = np.where(capture.mask, 0.75, 0).astype(np.float32)
    write_files(replace(capture, source=item), place, coverage, half=True, crop=True)
    files = {p.relative_to(place).as_posix(): p.read_bytes() for p in sorted(place.rglob("*")) if p.is_file()}
    row = json.loads(kept)
    row["files"] = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    row["bytes"] = {name: len(data) for name, data in files.items()}
    (place / ITEM).write_text(row_text(row) + "\n")
    (folder.path / INDEX).write_text((folder.path / INDEX).read_text().replace(kept, row_text(row) + "\n"))


def _quarantined(item: Item) -> dict[str, Any]:
    unknown = {"status": "quarantined", "error": "it broke", "files": {}, "bytes": {}, "overexposed_pixels": []}
    return dict.fromkeys(COLUMNS) | _known(item) | unknown


def _known(item: Item) -> dict[str, Any]:
    return {"id": item.id, "group": item.group, "split": item.split, "single": item.single, "seed": item.spec["seed"]}
