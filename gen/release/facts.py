"""What a release holds, counted from its own tables and read from the first capture of each group: what its documents say."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gen.errors import InputError
from gen.files import read_json
from gen.release.layout import PICTURES, REJECTED, SPLITS
from gen.release.tables import PICTURES as PICTURE_COLUMNS
from gen.release.tables import REJECTED as REJECTED_COLUMNS
from gen.release.tables import read_table
from gen.sets.set_folder import SetFolder
from gen.sets.splits import NAMES

LAYERS = {
    "R": "the glossy picture itself (R, G, B, and A: the share of the pixel that the object fills)",
    "diffuse.R": "diffuse layer",
    "specular.R": "specular layer",
    "matte.R": "matte twin: a Lambertian surface of the same albedo under the same light and shadows",
    "ks0.R": "the same surface with Ks = 0",
    "mirror.R": "what the same surface shows as a mirror",
    "shadow.V": "shadow: 0 lit, 1 attached, 2 cast",
    "faults.V": "why a pixel is no measurement: 1 dark, 2 clipped, 4 missing, added up; only where a capture has such pixels",
    "normal.X": "normal (x right, y up, z to the camera), unit vector",
    "depth.Z": "depth in metres along the camera's axis",
    "albedo.R": "albedo",
    "gloss.A": "gloss: alpha of the half-vector distribution",
    "specular_albedo.R": "specular reflectance",
}
"""Meaning of the channels, by the first of each layer."""


@dataclass(frozen=True)
class Facts:
    """Counts of items unless said otherwise. splits: (items, pictures) of each that is not empty. kinds: by number of pictures.

    shards: (file, split, number of pictures a capture). frame, view: channels of pictures' and views' EXRs with their sample type, "half or
    float" where groups differ. cropped: whether EXRs of any group store the object's box only. renderers: by (Blender, device, version of
    degloss). lights: kinds of light.
    named_files: whether specs name files of their maker (meshes, panoramas).
    """

    splits: Mapping[str, tuple[int, int]]
    kinds: Mapping[int, int]
    shards: tuple[tuple[str, str, int], ...]
    rejected: Mapping[str, int]
    shapes: Mapping[str, int]
    materials: Mapping[str, int]
    sizes: Mapping[tuple[int, int], int]
    lights: tuple[str, ...]
    alpha: tuple[float, float]
    frame: Mapping[str, str]
    view: Mapping[str, str]
    cropped: bool
    renderers: Mapping[tuple[str, str, str], int]
    by: tuple[str, ...]
    notes: tuple[str, ...]
    named_files: bool
    seed: int
    planned: int

    @property
    def items(self) -> int:
        """All captures."""
        return sum(items for items, _ in self.splits.values())

    @property
    def pictures(self) -> int:
        """All pictures."""
        return sum(pictures for _, pictures in self.splits.values())


def count_facts(built: Path, folder: SetFolder, named_files: bool) -> Facts:
    """Count what the tables in `built` hold. folder: the rendered set, of which one capture a group is read."""
    items: Counter[str] = Counter()
    pictures: Counter[str] = Counter()
    counted: dict[str, Counter[Any]] = {key: Counter() for key in ("pictures", "shape", "material", "size", "renderer")}
    shards: dict[str, tuple[str, int]] = {}
    lights: set[str] = set()
    low, high = float("inf"), 0.0
    first: dict[str, str] = {}
    for row in read_table(built / PICTURES, PICTURE_COLUMNS):
        pictures[row["split"]] += 1
        lights.add(row["light_kind"])
        if row["picture"] != 1:
            continue
        first.setdefault(row["group"], row["item"])
        items[row["split"]] += 1
        counted["pictures"][row["pictures"]] += 1
        counted["size"][row["width"], row["height"]] += 1
        for key in ("shape", "material"):
            counted[key][row[key]] += 1
        counted["renderer"][row["blender"] or "", row["device"] or ""] += 1
        shards[row["shard"]] = (row["split"], row["pictures"])
        low, high = min(low, row["alpha_low"]), max(high, row["alpha_high"])
    rejected = Counter(row["reason"] for row in read_table(built / REJECTED, REJECTED_COLUMNS))
    places = [folder.item_folder(item) for item in first.values()]
    frame, cropped = _channels([place / "frames/001.exr" for place in places])
    view, _ = _channels([path for place in places if (path := place / "view.exr").is_file()])
    program = _program(places[0])
    splits, said = read_json(built / SPLITS, "the splits of a set"), folder.about()
    return Facts(
        {name: (items[name], pictures[name]) for name in NAMES if items[name]},
        dict(sorted(counted["pictures"].items())),
        tuple((name, *shards[name]) for name in shards),
        dict(sorted(rejected.items())),
        _most(counted["shape"]),
        _most(counted["material"]),
        _most(counted["size"]),
        tuple(sorted(lights)),
        (low, high),
        frame,
        view,
        cropped,
        {(blender, device, program): count for (blender, device), count in _most(counted["renderer"]).items()},
        tuple(splits["by"]),
        tuple(splits["notes"]),
        named_files,
        said["seed"],
        said["items"],
    )


def _most(counts: Counter[Any]) -> dict[Any, int]:
    """The counts, the largest first, equal ones by name."""
    return dict(sorted(counts.items(), key=lambda entry: (-entry[1], entry[0])))


def _channels(paths: Iterable[Path]) -> tuple[dict[str, str], bool]:
    """The channels of EXRs with their sample types in words, and whether any stores a part of its frame only."""
    import OpenEXR

    kinds = {"float16": "half", "float32": "float", "uint32": "uint"}
    types: dict[str, set[str]] = {}
    cropped = False
    for path in paths:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            for name, channel in file.channels().items():
                types.setdefault(name, set()).add(kinds[channel.pixels.dtype.name])
            cropped |= "outside" in file.header()
    order = list(kinds.values())
    return {name: " or ".join(sorted(found, key=order.index)) for name, found in types.items()}, cropped


def _program(place: Path) -> str:
    said = json.loads((place / "capture.json").read_text(encoding="utf-8"))
    found = said["provenance"].get("versions", {}).get("degloss")
    if not isinstance(found, str | None):
        raise InputError(f"{place / 'capture.json'}: provenance.versions is not as degloss writes it")
    return found or ""
