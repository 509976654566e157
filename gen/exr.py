"""Layered OpenEXR files: named float channels in, named float channels out. Radiance and normals, never colour-managed."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from gen.files import MAX_PIXELS, library_silenced, memory, must_exist, writing

HALF_MAX = 65504.0
"""The largest finite half-precision number."""


MOST_PACKED = 2000
FREE = 1 << 25
"""A file of some bytes may claim `FREE` bytes of samples and `MOST_PACKED` for each of its own: nothing but zeros gets near it (ZIP ends at
1030, ZSTD at 1930 to one); only the wavelets of HTJ2K would pack an empty picture smaller."""

OUTSIDE = "outside"
"""The header attribute with what each channel holds outside the data window, as JSON."""


def write_exr(
    path: Path,
    channels: Mapping[str, NDArray[Any]],
    half: tuple[str, ...] = (),
    header: Mapping[str, Any] | None = None,
    crop: bool = False,
) -> None:
    """Write named channels, each (H, W), as one ZIP-compressed scan-line EXR, by a temporary name.

    half: names of the channels stored as half precision (10 mantissa bits, at most 65504); all others are float32. header: extra
    attributes. crop: store only the box of pixels outside which every channel holds one value, as the file's data window; the display
    window is the whole picture, and `read_exr` gives it back bit for bit. Raises InputError where shapes differ or a half channel would
    overflow.
    """
    import OpenEXR

    shapes = {array.shape for array in channels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise InputError(f"{path}: all channels of an EXR must share one (H, W), got {sorted(map(str, shapes))}")
    ready: dict[str, Any] = {}
    for name, array in channels.items():
        if name in half:
            finite = array[np.isfinite(array)]
            if finite.size and float(np.abs(finite).max()) > HALF_MAX:
                raise InputError(f"{path}: channel {name} holds values above 65504, which half precision cannot; store float32")
        # A non-contiguous array is written wrong without any error: hence ascontiguousarray.
        ready[name] = np.ascontiguousarray(array, dtype=np.float16 if name in half else np.float32)
    attributes = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **dict(header or {})}
    if crop:
        attributes |= _cropped(ready)
    memory = io.BytesIO()  # the library knows neither every file name that Python does, nor a full disk
    with OpenEXR.File(attributes, ready) as file:
        file.write(memory)
    with writing(path) as temporary:
        temporary.write_bytes(memory.getbuffer())


def _cropped(ready: dict[str, Any]) -> dict[str, Any]:
    """Cut the channels to their common box, in place; the header's attributes that say so."""
    (H, W), outside = next(iter(ready.values())).shape, {}
    used = np.zeros((H, W), bool)
    for name, array in ready.items():
        corner = array[0, 0]
        outside[name] = float(corner) if np.isfinite(corner) else str(corner)
        used |= ~np.isnan(array) if np.isnan(corner) else array != corner
    rows, columns = np.flatnonzero(used.any(axis=1)), np.flatnonzero(used.any(axis=0))
    y0, y1 = (int(rows[0]), int(rows[-1])) if len(rows) else (0, 0)
    x0, x1 = (int(columns[0]), int(columns[-1])) if len(columns) else (0, 0)
    for name, array in ready.items():
        ready[name] = np.ascontiguousarray(array[y0 : y1 + 1, x0 : x1 + 1])
    return {
        "dataWindow": (np.array([x0, y0], np.int32), np.array([x1, y1], np.int32)),
        "displayWindow": (np.array([0, 0], np.int32), np.array([W - 1, H - 1], np.int32)),
        OUTSIDE: json.dumps(outside, sort_keys=True),
    }


def _whole(header: Mapping[str, Any], name: str, pixels: NDArray[np.float32], path: Path) -> NDArray[np.float32]:
    """A channel of a file that `write_exr` cropped, in its whole picture; any other as it is."""
    if OUTSIDE not in header:
        return pixels
    (x0, y0), (x1, y1) = ([int(v) for v in corner] for corner in header["dataWindow"])
    (left, top), (right, bottom) = ([int(v) for v in corner] for corner in header["displayWindow"])
    W, H = right + 1, bottom + 1
    try:
        value = float(json.loads(header[OUTSIDE])[name])
    except (ValueError, KeyError, TypeError, RecursionError):
        value = 0.0
    if (left, top) != (0, 0) or not (0 <= x0 <= x1 < W and 0 <= y0 <= y1 < H) or W * H > MAX_PIXELS:
        raise InputError(f"{path}: its data window does not lie in its display window")
    whole = np.full((H, W), value, np.float32)
    whole[y0 : y1 + 1, x0 : x1 + 1] = pixels
    return whole


def read_exr(path: Path) -> dict[str, NDArray[Any]]:
    """All channels of an EXR, parts merged, as float32 (H, W) arrays by their full names.

    Raises InputError where the file is missing, truncated, too large, or not an EXR.
    """
    import OpenEXR

    data = _bytes(path)
    OpenEXR.setMaxImageSize(65535, 65535)
    channels: dict[str, NDArray[Any]] = {}
    try:
        with library_silenced(), OpenEXR.File(io.BytesIO(data), separate_channels=True, header_only=True) as file:
            _check_headers([part.header for part in file.parts], len(data), path)
        with library_silenced(), OpenEXR.File(io.BytesIO(data), separate_channels=True) as file:
            for part in file.parts:
                for name, channel in part.channels.items():
                    pixels = np.asarray(channel.pixels)
                    if pixels.ndim != 2:
                        raise InputError(f"{path}: channel {name} is not a plane of samples")
                    channels[name] = _whole(part.header, name, pixels.astype(np.float32), path)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path}: is damaged or truncated ({_first_line(error)})") from error
    if not channels:
        raise InputError(f"{path}: is damaged or truncated (no channels could be read)")
    if len({array.shape for array in channels.values()}) != 1:
        raise InputError(f"{path}: its parts have different sizes")
    return channels


def _bytes(path: Path) -> bytes:
    must_exist(path, "an EXR picture")
    try:
        with path.open("rb") as stream:
            start = stream.read(4)
            if start != b"\x76\x2f\x31\x01":
                raise InputError(f"{path}: is not an OpenEXR file")
            if path.stat().st_size > memory() // 4:
                raise InputError(f"{path}: is larger than this machine's memory can hold beside what is made of it")
            return start + stream.read()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def _check_headers(headers: Sequence[Mapping[str, Any]], size: int, path: Path) -> None:
    """InputError where the parts of a file of `size` bytes claim more than is read, or than so few bytes can hold of a picture."""
    import OpenEXR

    total = 0
    for header in headers:
        if header["type"] not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
            raise InputError(f"{path}: holds deep data (many samples a pixel), which are not read; flatten it")
        (x0, y0), (x1, y1) = header["dataWindow"]
        pixels = (int(x1) - int(x0) + 1) * (int(y1) - int(y0) + 1)
        if pixels > MAX_PIXELS:
            raise InputError(f"{path}: is larger than {MAX_PIXELS // 1_000_000} megapixels")
        total += 4 * pixels * len(header["channels"])
    if total > memory() // 2:
        raise InputError(f"{path}: needs {total / 1e9:.0f} GB of memory; store fewer channels or a smaller picture")
    if total > FREE + MOST_PACKED * size:
        raise InputError(f"{path}: claims {total / 1e6:.0f} MB in a file of {size / 1e6:.3g} MB, which no picture packs into")


def stack(channels: Mapping[str, NDArray[Any]], name: str, letters: str) -> NDArray[np.float32] | None:
    """(H, W, len(letters)) of the channels `name.letter` (plain letters where name is ""), or None where one is missing."""
    keys = [f"{name}.{letter}" if name else letter for letter in letters]
    if any(key not in channels for key in keys):
        return None
    return np.stack([channels[key] for key in keys], axis=-1).astype(np.float32)


def unstack(name: str, letters: str, array: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The reverse of `stack`: {"name.letter": (H, W)} of an (H, W, len(letters)) array."""
    return {(f"{name}.{letter}" if name else letter): array[..., i] for i, letter in enumerate(letters)}


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
