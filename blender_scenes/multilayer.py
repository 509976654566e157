"""A reader of uncompressed scan-line OpenEXR files, single- and multi-part, with numpy alone.

Source: "OpenEXR File Layout" (openexr.com): header attributes, offset table, one chunk a scan line, channels in alphabetical order.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAGIC = 20000630
TILED, DEEP, MULTIPART = 0x200, 0x800, 0x1000
MAX_PIXELS = 1 << 28
TYPES: dict[int, np.dtype[Any]] = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}


@dataclass
class _Part:
    """name: empty in single-part files. channels: name and type, in the file's order. window: x0, y0, x1, y1, inclusive."""

    name: str = ""
    channels: list[tuple[str, np.dtype[Any]]] = field(default_factory=list)
    window: tuple[int, int, int, int] = (0, 0, -1, -1)
    compression: int = 0

    @property
    def width(self) -> int:
        return self.window[2] - self.window[0] + 1

    @property
    def height(self) -> int:
        return self.window[3] - self.window[1] + 1


def read_multilayer(path: Path) -> dict[str, NDArray[np.float32]]:
    """All channels, each (H, W) float32, rows top to bottom, by full name; the parts of a multi-part file are merged.

    Raises ValueError where the file is no OpenEXR, is compressed, tiled, deep or sub-sampled, or ends early.
    """
    data = path.read_bytes()
    if len(data) < 8 or struct.unpack_from("<I", data)[0] != MAGIC:
        raise ValueError(f"{path}: is not an OpenEXR file")
    flags = struct.unpack_from("<I", data, 4)[0]
    if flags & (TILED | DEEP):
        raise ValueError(f"{path}: holds tiles or deep pixels; only scan lines can be read")
    multipart = bool(flags & MULTIPART)
    try:
        return _read(data, multipart)
    except (struct.error, IndexError, OverflowError, ValueError) as error:
        raise ValueError(f"{path}: cannot be read ({error})") from error


def _read(data: bytes, multipart: bool) -> dict[str, NDArray[np.float32]]:
    parts, at = [], 8
    while True:
        part, at = _header(data, at)
        parts.append(part)
        if not multipart:
            break
        if data[at] == 0:
            at += 1
            break
    channels: dict[str, NDArray[np.float32]] = {}
    for number, part in enumerate(parts):
        offsets = struct.unpack_from(f"<{part.height}Q", data, at)
        at += 8 * part.height
        lines = _scan_lines(data, part, number if multipart else None, offsets)
        for i, (name, _) in enumerate(part.channels):
            full = f"{part.name}.{name}" if part.name and "." not in name else name
            channels[full] = lines[f"{i}"].astype(np.float32)
    return channels


def _scan_lines(data: bytes, part: _Part, number: int | None, offsets: tuple[int, ...]) -> NDArray[Any]:
    """The rows of one part as records of one field a channel. number: the part's, None in single-part files."""
    line = np.dtype([(f"{i}", kind, (part.width,)) for i, (_, kind) in enumerate(part.channels)])
    lines = np.zeros(part.height, line)
    for offset in offsets:
        if number is not None:
            if struct.unpack_from("<i", data, offset)[0] != number:
                raise ValueError("a scan line belongs to another part")
            offset += 4
        y, size = struct.unpack_from("<ii", data, offset)
        if size != line.itemsize or not part.window[1] <= y <= part.window[3]:
            raise ValueError("a scan line is damaged")
        lines[y - part.window[1]] = np.frombuffer(data, line, 1, offset + 8)[0]
    return lines


def _header(data: bytes, at: int) -> tuple[_Part, int]:
    part = _Part()
    while data[at] != 0:
        name, at = _text(data, at)
        kind, at = _text(data, at)
        size = struct.unpack_from("<i", data, at)[0]
        at += 4
        if size < 0 or at + size > len(data):
            raise ValueError("its header ends early")
        value = data[at : at + size]
        at += size
        if name == "channels" and kind == "chlist":
            part.channels = _channels(value)
        elif name == "dataWindow":
            part.window = struct.unpack("<4i", value)
        elif name == "compression":
            part.compression = value[0]
        elif name == "type" and value not in (b"scanlineimage", b"scanlineimage\0"):
            raise ValueError("only scan lines can be read")
        elif name == "name":
            part.name = value.rstrip(b"\0").decode("utf-8", "replace")
    if part.compression != 0:
        raise ValueError("it is compressed")
    if not part.channels or part.width <= 0 or part.height <= 0 or part.width * part.height > MAX_PIXELS:
        raise ValueError("it has no channels, or its data window is empty or too large")
    return part, at + 1


def _channels(value: bytes) -> list[tuple[str, np.dtype[Any]]]:
    found: list[tuple[str, np.dtype[Any]]] = []
    at = 0
    while value[at] != 0:
        name, at = _text(value, at)
        kind, _, x, y = struct.unpack_from("<iIii", value, at)
        at += 16
        if (x, y) != (1, 1) or kind not in TYPES:
            raise ValueError(f"channel {name} is sub-sampled or of an unknown type")
        found.append((name, TYPES[kind]))
    return found


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode("utf-8", "replace"), end + 1
