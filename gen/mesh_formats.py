"""How much a mesh file claims to hold, found before a reader is let loose on it."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

from gen.errors import InputError

FORMATS = (".glb", ".obj", ".stl", ".ply")
"""The endings of the meshes that are read."""

MAX_FACES = 5_000_000
MAX_NODES = 100_000


def check_size(path: Path, data: bytes) -> None:
    """InputError where the file is no GLB, OBJ, STL or PLY at sight, claims more than `MAX_FACES`, or needs other files."""
    {".glb": _glb, ".obj": _obj, ".stl": _stl, ".ply": _ply}[path.suffix.lower()](path, data)


def _too_many(path: Path, faces: float) -> None:
    if faces > MAX_FACES:
        raise InputError(f"{path}: has more than {MAX_FACES // 10**6} million faces; simplify it")


def _obj(path: Path, data: bytes) -> None:
    if b"\0" in data:
        raise InputError(f"{path}: is not an OBJ file (not text)")
    _too_many(path, data.count(b"\nf ") + data.count(b"\nf\t"))


def _stl(path: Path, data: bytes) -> None:
    if data[:5].lower() == b"solid" and b"facet" in data[:2000]:
        _too_many(path, data.count(b"endfacet"))
        return
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else -1
    if count < 0 or len(data) < 84 + 50 * count:
        raise InputError(f"{path}: is not a whole STL file")
    _too_many(path, count)


def _ply(path: Path, data: bytes) -> None:
    end = data[:100_000].find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise InputError(f"{path}: is not a PLY file (no header)")
    for what, count in re.findall(rb"element\s+(\S+)\s+(\d{1,18})", data[:end]):
        if int(count) > len(data):
            raise InputError(f"{path}: is not a whole PLY file ({int(count)} of {what.decode(errors='replace')})")
        _too_many(path, int(count) if what == b"face" else 0)


def _glb(path: Path, data: bytes) -> None:
    broken = InputError(f"{path}: is not a whole GLB file")
    if len(data) < 20 or data[:4] != b"glTF" or struct.unpack_from("<I", data, 4)[0] != 2:
        raise broken
    size, kind = struct.unpack_from("<I4s", data, 12)
    if kind != b"JSON" or 20 + size > len(data):
        raise broken
    try:
        content = json.loads(data[20 : 20 + size])
        lists = {key: content.get(key, []) for key in ("accessors", "buffers", "nodes", "meshes")}
        instances = [node.get("mesh") for node in lists["nodes"]]
        counts = [int(accessor["count"]) for accessor in lists["accessors"]]
        buffers = [buffer.get("uri", "") for buffer in lists["buffers"]]
        faces = [sum(_faces(primitive, counts) for primitive in mesh["primitives"]) for mesh in lists["meshes"]]
        total = sum(faces[i] for i in instances if i is not None)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError):
        raise broken from None
    if any(buffers):
        raise InputError(f"{path}: keeps its data in other files; export it as one GLB with everything inside")
    if any(count < 0 or count > len(data) for count in counts) or len(instances) > MAX_NODES:
        raise broken
    _too_many(path, max(total, sum(faces)))


def _faces(primitive: dict[str, Any], counts: list[int]) -> float:
    key = primitive.get("indices", primitive["attributes"]["POSITION"])
    return counts[key] / 3
