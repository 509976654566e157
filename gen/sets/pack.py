"""The pack: a whole set of captures in one file of plain arrays, which training maps into memory with numpy alone.

The file is a safetensors file (8 bytes of little-endian header length, a JSON header, raw arrays end to end), so any safetensors
reader opens it. F frames of N items, all h x w pixels, frames of an item one after another:

    combined, diffuse, specular, matte, ...   (F, h, w, 3) float16 or float32   linear radiance, layers of each frame
    shadow                                    (F, h, w) uint8                   flags of each sample
    valid                                     (F, h, w) bool                    false where clipped, dark or missing
    lights, intensities                       (F, 3) float32                    as in a Capture
    item                                      (F,) int32                        the item that a frame belongs to
    mask                                      (N, h, w) bool
    normals, albedo, depth, gloss             (N, h, w[, 3]) float              per view

`__metadata__` holds {"format": "degloss pack", "version": "1", "facts": JSON text}; the facts say of every item its id, group, split,
shape, material and frames. This module needs numpy and the standard library only; `gen.sets.packing` writes the file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from gen.files import must_exist, no_key_twice

FORMAT = "degloss pack"
VERSION = "1"
METADATA = "__metadata__"
MAX_HEADER = 100_000_000
"""Bytes of the largest header that is read, as in the safetensors library."""

DTYPES: Mapping[str, np.dtype[Any]] = {
    "BOOL": np.dtype(np.bool_),
    "U8": np.dtype(np.uint8),
    "I32": np.dtype("<i4"),
    "F16": np.dtype("<f2"),
    "F32": np.dtype("<f4"),
}
"""The kinds of numbers that a pack holds, by safetensors' names."""

ALWAYS = {"valid": "FHW", "lights": "F3", "intensities": "F3", "item": "F", "mask": "NHW"}
"""The arrays of every pack: their axes (F frames, N items, H, W, 3)."""

LAYERS = {
    "combined": "FHW3",
    "diffuse": "FHW3",
    "specular": "FHW3",
    "matte": "FHW3",
    "shadow": "FHW",
    "normals": "NHW3",
    "depth": "NHW",
    "albedo": "NHW3",
    "gloss": "NHW",
}
"""The layers whose axes are known by name; any other begins with F or N."""


@dataclass(frozen=True, eq=False)
class Pack:
    """An open pack. arrays: by name, views of the mapped file, read-only. items: the facts of each item, in order. facts: of the whole.

    Indexing takes an array by name: `pack["matte"][pack.frames(i)]` are the matte layers of item i, (K, h, w, 3).
    """

    path: Path
    arrays: Mapping[str, NDArray[Any]]
    items: tuple[Mapping[str, Any], ...]
    facts: Mapping[str, Any]

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self.arrays:
            raise InputError(f"{self.path}: has no array '{name}', but {', '.join(self.arrays)}; pack it with --layers")
        return self.arrays[name]

    @property
    def count(self) -> int:
        """F, the number of frames."""
        return len(self.arrays["item"])

    @property
    def size(self) -> tuple[int, int]:
        """(h, w)."""
        return int(self.arrays["mask"].shape[1]), int(self.arrays["mask"].shape[2])

    def frames(self, item: int) -> slice:
        """Where the frames of an item lie."""
        first, end = self.items[item]["frames"]
        return slice(first, end)

    def of_split(self, split: str) -> list[int]:
        """The items of a split, by number."""
        return [i for i, item in enumerate(self.items) if item.get("split") == split]


def read_pack(path: str | Path) -> Pack:
    """Open a pack. Nothing is read but the header and the small arrays; pixels are mapped and come when they are used.

    Raises InputError, one line, where the file is missing, truncated, not a pack, or its header contradicts itself or the file.
    """
    path = Path(path)
    header, data = _open(path)
    metadata = header.pop(METADATA, None)
    if not isinstance(metadata, dict) or metadata.get("format") != FORMAT:
        raise InputError(f"{path}: is a safetensors file, but not a pack; write one with degloss gen pack")
    if metadata.get("version") != VERSION:
        raise InputError(
            f"{path}: is a pack of version {str(metadata.get('version'))[:20]}, this program reads {VERSION}; pack it again"
        )
    arrays = _arrays(header, data, path)
    facts = _facts(metadata.get("facts"), path)
    _check_shapes(arrays, facts["items"], path)
    return Pack(path, arrays, tuple(facts["items"]), {key: value for key, value in facts.items() if key != "items"})


def header_bytes(tensors: Mapping[str, tuple[str, tuple[int, ...]]], metadata: Mapping[str, str]) -> tuple[bytes, dict[str, int]]:
    """The opening of a safetensors file and where each array lies in the file.

    tensors: name -> (key of `DTYPES`, shape). Returns (length and header, {name: offset from the start of the file}). Wide numbers come
    first, so that every array is aligned without a gap, which the format does not allow. Raises InputError where the header is too long.
    """
    order = sorted(tensors, key=lambda name: -DTYPES[tensors[name][0]].itemsize)
    header: dict[str, Any] = {METADATA: dict(metadata)}
    begin, relative = 0, {}
    for name in order:
        dtype, shape = tensors[name]
        end = begin + math.prod(shape) * DTYPES[dtype].itemsize
        header[name] = {"dtype": dtype, "shape": list(shape), "data_offsets": [begin, end]}
        relative[name], begin = begin, end
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    if len(text) > MAX_HEADER:
        raise InputError(f"the facts of so many items do not fit into one header ({len(text)} bytes); pack fewer with --limit")
    opening = len(text).to_bytes(8, "little") + text
    return opening, {name: len(opening) + offset for name, offset in relative.items()}


def _open(path: Path) -> tuple[dict[str, Any], NDArray[np.uint8]]:
    """The header, and the bytes after it as a read-only map."""
    must_exist(path, "a pack")
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            length = int.from_bytes(stream.read(8), "little")
            if size < 8 or not 2 <= length <= min(size - 8, MAX_HEADER):
                raise InputError(f"{path}: is truncated or not a safetensors file (its header would be {length} bytes of {size})")
            text = stream.read(length)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}; a pack)") from error
    try:
        header = json.loads(text.decode("utf-8"), object_pairs_hook=no_key_twice)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: its header is not valid JSON ({error})") from error
    if not isinstance(header, dict):
        raise InputError(f"{path}: its header is not a table of arrays")
    if size == 8 + length:
        return header, np.empty(0, np.uint8)
    try:
        return header, np.memmap(path, np.uint8, "r", offset=8 + length)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be mapped into memory ({error})") from error


def _arrays(header: Mapping[str, Any], data: NDArray[np.uint8], path: Path) -> dict[str, NDArray[Any]]:
    """Views of `data`, every one inside it, none over another, no byte left over."""
    places = []
    for name, entry in header.items():
        at = f"{path}: array {name[:60]!r}"
        if not isinstance(entry, dict) or entry.get("dtype") not in DTYPES:
            known = ", ".join(DTYPES)
            raise InputError(f"{at} is of a kind that is not read; a pack holds {known}")
        shape, offsets = entry.get("shape"), entry.get("data_offsets")
        if not _whole(shape) or len(shape) > 8 or not _whole(offsets) or len(offsets) != 2:
            raise InputError(f"{at}: shape and data_offsets must be short lists of whole numbers from 0")
        begin, end = offsets
        need = math.prod(shape) * DTYPES[entry["dtype"]].itemsize
        if not begin <= end <= len(data):
            raise InputError(f"{at} lies at bytes {begin} to {end} of {len(data)}: the file is truncated or damaged")
        if end - begin != need:
            raise InputError(f"{at} has {end - begin} bytes, its shape asks for {need}")
        places.append((begin, end, name, DTYPES[entry["dtype"]], tuple(shape)))
    places.sort(key=lambda place: place[:2])
    reached = 0
    for begin, end, name, _, _ in places:
        if begin != reached:
            what = "overlaps the array before it" if begin < reached else "leaves a gap before it"
            raise InputError(f"{path}: array {name[:60]!r} {what} (byte {begin}, expected {reached}); the file is damaged")
        reached = end
    if reached != len(data):
        raise InputError(f"{path}: {len(data) - reached} bytes follow the last array; the file is damaged")
    views = {name: data[begin:end].view(dtype).reshape(shape) for begin, end, name, dtype, shape in places}
    return {name: views[name] for name in header}


def _facts(text: object, path: Path) -> dict[str, Any]:
    try:
        facts = json.loads(text) if isinstance(text, str) else None
    except (ValueError, RecursionError):
        facts = None
    items = facts.get("items") if isinstance(facts, dict) else None
    if not isinstance(items, list) or not items or not all(isinstance(item, dict) for item in items):
        raise InputError(f"{path}: lacks the facts of its items; pack it again")
    return dict(facts)  # type: ignore[arg-type] # it is a dict where its items are a list


def _check_shapes(arrays: Mapping[str, NDArray[Any]], items: list[dict[str, Any]], path: Path) -> None:
    """That the arrays fit one another and the facts."""
    missing = [name for name in ALWAYS if name not in arrays]
    if missing:
        raise InputError(f"{path}: lacks the array {missing[0]!r}; pack it again")
    mask, item = arrays["mask"], arrays["item"]
    if mask.ndim != 3 or item.ndim != 1 or 0 in mask.shape or len(item) == 0 or item.dtype != DTYPES["I32"]:
        raise InputError(f"{path}: mask {mask.shape} and item {item.shape} are not (N, h, w) and (F,) with at least one of each")
    axes = {"F": len(item), "N": len(items), "H": mask.shape[1], "W": mask.shape[2], "3": 3}
    for name, array in arrays.items():
        letters = {**ALWAYS, **LAYERS}.get(name)
        leads = {tuple(axes[letter] for letter in (letters or first))[: None if letters else 3] for first in ("FHW", "NHW")}
        found = array.shape if letters else array.shape[:3]
        if found not in leads:
            wanted = " or ".join(str(lead) for lead in sorted(leads))
            raise InputError(f"{path}: array {name[:60]!r} is {array.shape}, the others ask for {wanted}")
    at = 0
    for i, facts in enumerate(items):
        if not isinstance(facts.get("split"), str | None):
            raise InputError(f"{path}: the facts of item {i} name a split that is no text; pack it again")
        frames = facts.get("frames")
        if not _whole(frames) or len(frames) != 2 or frames[0] != at or not at < frames[1] <= len(item):
            raise InputError(f"{path}: the facts of item {i} name no range of frames that follows {at} within {len(item)}")
        if (item[at : frames[1]] != i).any():
            raise InputError(f"{path}: frames {at} to {frames[1] - 1} are not those of item {i}; the file is damaged")
        at = frames[1]
    if at != len(item):
        raise InputError(f"{path}: {len(item) - at} frames belong to no item; the file is damaged")


def _whole(value: Any) -> TypeGuard[list[int]]:
    """Whether it is a list of whole numbers from 0."""
    return isinstance(value, list) and all(type(n) is int and 0 <= n < 1 << 62 for n in value)
