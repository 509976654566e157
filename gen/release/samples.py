"""One capture of a rendered set as a sample: its files, checked against the index before anything is parsed, and its facts."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from pydantic import TypeAdapter, ValidationError

from gen.errors import InputError
from gen.files import dumps
from gen.sets.screening import Verdict
from gen.sets.set_folder import Row
from gen.spec_materials import Material

MAX_CAPTURE = 50_000_000
"""The largest capture.json in bytes."""

_material: TypeAdapter[Any] = TypeAdapter(Material)


def read_checked(place: Path, file: str, row: Row) -> bytes:
    """The bytes of a file of an item's folder. Raises InputError where it is a link or not what the index says it is."""
    path = place / file
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        with open(descriptor, "rb", buffering=0) as stream:
            size = os.fstat(descriptor).st_size
            if size != row["bytes"][file]:
                raise InputError(f"{path}: has {size} bytes, {row['bytes'][file]} were written; render it again (--resume)")
            data = stream.readall() or b""
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the set with degloss gen verify") from error
    if hashlib.sha256(data).hexdigest() != row["files"][file]:
        raise InputError(f"{path}: its SHA-256 is not the one in the index; render it again (--resume)")
    return data


def read_index(place: Path, row: Row) -> tuple[dict[str, Any], bytes]:
    """capture.json of an item: what it says, and its bytes as they are released. Raises InputError where it is damaged.

    They are those of the folder, unless the spec names a file by its path on the machine that rendered, of which the name alone is kept.
    """
    if row["bytes"].get("capture.json", 0) > MAX_CAPTURE:
        raise InputError(f"{place / 'capture.json'}: is too large")
    data = read_checked(place, "capture.json", row)
    try:
        said = json.loads(data)
        spec, frames = said["provenance"]["spec"], said["frames"]
        bare = without_paths(spec)
        if len(frames) != row["pictures"] or not isinstance(bare, dict):
            raise ValueError
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{place / 'capture.json'}: is not the index of a rendered capture") from None
    if bare == spec:
        return said, data
    said["provenance"]["spec"] = bare
    return said, (dumps(said, indent=1) + "\n").encode()


def without_paths(value: Any) -> Any:
    """Plain values in which every text that is an absolute path is its last part."""
    if isinstance(value, dict):
        return {key: without_paths(part) for key, part in value.items()}
    if isinstance(value, list):
        return [without_paths(part) for part in value]
    if isinstance(value, str) and (value.startswith("/") or PureWindowsPath(value).is_absolute()):
        return PurePosixPath(value.replace("\\", "/")).name
    return value


def alpha_range(material: Mapping[str, Any]) -> tuple[float, float]:
    """The smallest and largest alpha of a spec's material, equal unless it is a texture; 0 without gloss."""
    try:
        alpha = _material.validate_python(material).job().get("alpha", 0.0)
    except ValidationError as error:
        raise InputError(f"material: cannot be read ({error.errors()[0]['msg']})") from None
    ends = (alpha["low"], alpha["high"]) if isinstance(alpha, dict) else (alpha, alpha)
    return float(min(ends)), float(max(ends))


def sample_facts(row: Row, index: Mapping[str, Any], split: str, verdicts: Sequence[Verdict]) -> bytes:
    """The field `json` of a sample: the same keys of the same types in every sample, so that columnar loaders take them."""
    frames, spec = index["frames"], index["provenance"]["spec"]
    facts = {
        "item": row["id"],
        "group": row["group"],
        "split": split,
        "single": row["single"],
        "pictures": row["pictures"],
        "width": row["size"][0],
        "height": row["size"][1],
        "fields": [PurePosixPath(frame["file"]).name for frame in frames],
        "directions": [[float(v) for v in frame["direction"]] for frame in frames],
        "intensities": [[float(v) for v in frame["intensity"]] for frame in frames],
        "light_kinds": [frame.get("kind", "sun") for frame in frames],
        "exposure": float(row["exposure"]),
        "shape": row["shape"],
        "material": row["material"],
        "alpha": list(alpha_range(spec["material"])),
        "seed": row["seed"],
        "object_share": float(row["object_share"]),
        "overexposed_pixels": [verdict.overexposed_pixels for verdict in verdicts],
        "clipped_samples": [verdict.clipped_samples for verdict in verdicts],
        "object": row["object"],
        "material_key": row["material_key"],
        "lights_key": row["lights_key"],
        "spec_sha256": row["spec_sha256"],
    }
    return json.dumps(facts, allow_nan=False).encode()


def picture_rows(
    row: Row,
    index: Mapping[str, Any],
    split: str,
    shard: str,
    verdicts: Sequence[Verdict],
    places: Mapping[str, tuple[int, int, str]],
) -> list[dict[str, Any]]:
    """The rows of pictures.parquet of one capture. places: offset, size and SHA-256 of each field in the shard."""
    low, high = alpha_range(index["provenance"]["spec"]["material"])
    rows = []
    for k, (frame, verdict) in enumerate(zip(index["frames"], verdicts, strict=True)):
        field = PurePosixPath(frame["file"]).name
        offset, size, digest = places[field]
        near = frame.get("position_mm")
        rows.append(
            {
                "item": row["id"],
                "picture": k + 1,
                "pictures": row["pictures"],
                "group": row["group"],
                "split": split,
                "single": row["single"],
                "shard": shard,
                "field": field,
                "offset": offset,
                "bytes": size,
                "sha256": digest,
                "view_sha256": places["view.exr"][2] if "view.exr" in places else None,
                "mask_sha256": places["mask.png"][2],
                "width": row["size"][0],
                "height": row["size"][1],
                "light_kind": frame.get("kind", "sun"),
                **dict(zip(("light_x", "light_y", "light_z"), map(float, frame["direction"]), strict=True)),
                **dict(zip(("intensity_r", "intensity_g", "intensity_b"), map(float, frame["intensity"]), strict=True)),
                **dict(zip(("position_x_mm", "position_y_mm", "position_z_mm"), near or [None] * 3, strict=True)),
                "mm_per_pixel": index["scale"]["mm_per_pixel"],
                "distance_mm": index["scale"]["distance_mm"],
                "shape": row["shape"],
                "material": row["material"],
                "alpha_low": low,
                "alpha_high": high,
                "exposure": row["exposure"],
                "object_share": row["object_share"],
                "overexposed_pixels": verdict.overexposed_pixels,
                "clipped_samples": verdict.clipped_samples,
                "seed": row["seed"],
                "object": row["object"],
                "material_key": row["material_key"],
                "lights_key": row["lights_key"],
                "spec_sha256": row["spec_sha256"],
                "blender": row["blender"],
                "device": row["device"],
            }
        )
    return rows
