"""From a set folder to a pack (`gen.sets.pack`): one capture at a time, each written to its place in a file of known size."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Truth
from gen.errors import InputError
from gen.exr import HALF_MAX
from gen.files import dumps, writing
from gen.sets.pack import ALWAYS, DTYPES, FORMAT, VERSION, header_bytes
from gen.sets.screening import kept_items, screening_of
from gen.sets.set_folder import SetFolder
from gen.sets.shrink import shrink
from gen.sets.splits import SPLITS, read_splits

DEFAULT_LAYERS = ("combined", "diffuse", "specular", "matte", "normals", "depth", "albedo", "gloss")
EXACT = ("normals", "depth", "lights", "intensities")
"""Float32 whatever the radiance is: a normal in halves is off by up to .03 degrees, and heights are small differences of depths."""

COPIED = ("id", "group", "single", "seed", "shape", "exposure", "object", "material_key", "lights_key")
"""What the facts of an item take from its row of the index."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Packed:
    """What was written. size: (h, w) in pixels. bytes: of the file."""

    items: int
    frames: int
    size: tuple[int, int]
    bytes: int


def pack_set(
    folder: SetFolder,
    output: Path,
    size: int | None = None,
    layers: Sequence[str] = DEFAULT_LAYERS,
    dtype: Literal["half", "float"] = "half",
    split: str | None = None,
    kept_only: bool = True,
    limit: int | None = None,
    progress: Progress | None = None,
) -> Packed:
    """Pack the rendered items of a set into one file, by a temporary name, in the memory of one capture.

    size: the longer side of a picture in pixels, a whole fraction of every item's (see `gen.sets.shrink`); None keeps it. layers:
    "combined" and names of `gen.capture.Truth`; mask, valid, lights, intensities and item are always there. dtype: of all floats but
    `EXACT`. split: the items of one split of `gen split`. kept_only: without the items that screening leaves out. limit: the first so
    many items. Raises InputError where nothing is left, an item lacks a layer, sizes differ, or a value does not fit into half
    precision.
    """
    names = layer_names(layers)
    rows = _chosen(folder, split, kept_only, limit)
    size_out, factors = _shrinking(rows, size)
    ends = np.cumsum([row["pictures"] for row in rows]).tolist()
    counts = {"F": ends[-1], "N": len(rows)}
    tensors: dict[str, tuple[str, tuple[int, ...]]] = {}
    for name, array in _arrays(_read(folder, rows[0], factors[0]), names, 0).items():
        lead = counts[_lead(name)]
        tensors[name] = (_kind(name, array, dtype), (lead, *array.shape[1:]))
    facts = {"set": folder.plan().name, "dtype": dtype, "items": list(_facts(folder, rows, factors, ends))}
    opening, places = header_bytes(tensors, {"format": FORMAT, "version": VERSION, "facts": dumps(facts)})
    total = max(places[name] + math.prod(shape) * DTYPES[kind].itemsize for name, (kind, shape) in tensors.items())
    with writing(output) as temporary, temporary.open("w+b") as stream:
        os.posix_fallocate(stream.fileno(), 0, total)  # a full disk is found now and not after hours
        stream.write(opening)
        for i, row in enumerate(rows):
            capture = _read(folder, row, factors[i])
            first = ends[i] - row["pictures"]
            if capture.count != row["pictures"] or capture.size != size_out:
                raise InputError(f"{row['id']}: is not what the index says of it; check the set with degloss gen verify")
            for name, array in _arrays(capture, names, i).items():
                kind, shape = tensors[name]
                if array.shape[1:] != shape[1:]:
                    raise InputError(
                        f"{row['id']}: {name} is {array.shape}, that of {rows[0]['id']} asks for {shape[1:]} a frame"
                    )
                at = places[name] + (first if _lead(name) == "F" else i) * math.prod(shape[1:]) * DTYPES[kind].itemsize
                _put(stream, at, array, kind, f"{row['id']}: {name}")
            del capture, array  # the next one is read in their place
            if progress is not None:
                progress(i + 1, len(rows))
    return Packed(len(rows), ends[-1], size_out, total)


def layer_names(layers: Sequence[str]) -> tuple[str, ...]:
    """The layers to pack, without those that are always there. Raises InputError where a name is unknown or comes twice."""
    known = ("combined", *Truth.PER_LIGHT, *Truth.PER_VIEW)
    for name in layers:
        if name not in known and name not in ALWAYS:
            raise InputError(f"--layers: there is no layer '{name}'; there are {', '.join(known)}")
    if len(set(layers)) != len(layers):
        raise InputError(f"--layers {','.join(layers)}: a layer is named twice")
    return tuple(name for name in layers if name not in ALWAYS)


def _chosen(folder: SetFolder, split: str | None, kept_only: bool, limit: int | None) -> Sequence[Mapping[str, Any]]:
    """The rows of the items to pack."""
    if limit is not None and limit < 1:
        raise InputError(f"--limit {limit}: must be at least 1")
    rows = [row for row in folder.rows() if row["status"] == "rendered"]
    if kept_only:
        kept = kept_items(screening_of(folder))
        rows = [row for row in rows if row["id"] in kept]
    if split is not None:
        splits = read_splits(folder)
        if split not in splits:
            raise InputError(f"--split {split}: the set is divided into {', '.join(splits)}")
        rows = [row for row in rows if row["id"] in set(splits[split])]
    if not rows:
        raise InputError(f"{folder.path}: no item is left to pack{f' in the split {split}' if split else ''}")
    return rows[:limit]


def _shrinking(rows: Sequence[Mapping[str, Any]], size: int | None) -> tuple[tuple[int, int], list[int]]:
    """The (h, w) that all items come to, and the factor of each."""
    if size is not None and size < 1:
        raise InputError(f"--size {size}: must be at least 1")
    factors: list[int] = []
    sizes: dict[tuple[int, int], str] = {}
    for row in rows:
        W, H = row["size"]
        factor = 1 if size is None else max(H, W) // size
        if size is not None and (factor < 1 or max(H, W) != factor * size or H % factor or W % factor):
            side = max(H, W)
            fit = [side // n for n in range(1, side + 1) if not (H % n or W % n)]
            near = sorted(sorted(fit, key=lambda s: abs(s - size))[:4])
            raise InputError(
                f"--size {size}: {row['id']} has {W}x{H} pixels, which shrink by whole factors only; choose one of "
                f"{', '.join(map(str, near))}"
            )
        factors.append(factor)
        sizes.setdefault((H // factor, W // factor), row["id"])
    if len(sizes) > 1:
        found = " and ".join(f"{w}x{h} ({item})" for (h, w), item in list(sizes.items())[:2])
        raise InputError(f"the items differ in size: {found}; a pack has one, choose it with --size")
    return next(iter(sizes)), factors


def _read(folder: SetFolder, row: Mapping[str, Any], factor: int) -> Capture:
    return shrink(folder.capture(row["id"]), factor)


def _arrays(capture: Capture, names: Sequence[str], number: int) -> dict[str, NDArray[Any]]:
    """What a capture, item `number`, brings into each array: K or 1 entries along the first axis."""
    found: dict[str, NDArray[Any]] = {}
    for name in names:
        layer = capture.images if name == "combined" else getattr(capture.truth, name)
        if layer is None:
            have = ", ".join(["combined", *capture.truth.names()])
            raise InputError(f"{capture.source}: has no layer '{name}', but {have}; say with --layers which to pack")
        found[name] = layer[None] if name in Truth.PER_VIEW else layer
    return {
        **found,
        "valid": capture.valid,
        "lights": capture.lights,
        "intensities": capture.intensities,
        "item": np.full(capture.count, number),
        "mask": capture.mask[None],
    }


def _lead(name: str) -> str:
    """Whether an array has an entry a frame, "F", or an item, "N"."""
    return "N" if name in Truth.PER_VIEW or ALWAYS.get(name, "F").startswith("N") else "F"


def _kind(name: str, array: NDArray[Any], dtype: str) -> str:
    """The key of `gen.sets.pack.DTYPES` that an array is stored as."""
    if array.dtype.kind == "f":
        return "F16" if dtype == "half" and name not in EXACT else "F32"
    return {"b": "BOOL", "u": "U8", "i": "I32"}[array.dtype.kind]


def _put(stream: IO[bytes], at: int, array: NDArray[Any], kind: str, what: str) -> None:
    if kind == "F16":
        peak = float(np.abs(array, where=np.isfinite(array), out=np.zeros(array.shape, array.dtype)).max())
        if peak > HALF_MAX:
            raise InputError(f"{what} reaches {peak:.6g}, half precision ends at {HALF_MAX:g}; pack with --dtype float")
    stream.seek(at)
    stream.write(np.ascontiguousarray(array, DTYPES[kind]).tobytes())


def _facts(
    folder: SetFolder, rows: Sequence[Mapping[str, Any]], factors: Sequence[int], ends: Sequence[int]
) -> Iterator[dict[str, Any]]:
    """The facts of each item: what the index and the plan say of it, its split, its frames and how it was shrunk."""
    divided = (folder.path / SPLITS).exists()
    splits = {item: name for name, ids in read_splits(folder).items() for item in ids} if divided else {}
    planned = {item.id: item for item in folder.plan().items}
    for row, factor, end in zip(rows, factors, ends, strict=True):
        if row["id"] not in planned:
            raise InputError(f"{row['id']}: is in the index but not in the plan; check the set with degloss gen verify")
        material = planned[row["id"]].capture_spec().material
        yield {
            **{key: row[key] for key in COPIED},
            "split": splits.get(row["id"], row["split"]),
            "frames": [end - row["pictures"], end],
            "material": material.kind,
            "alpha": material.width() if hasattr(material, "width") else None,
            "shrunk": factor,
        }
