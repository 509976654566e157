"""Builders of files: small sound ones, and hostile ones that claim to be huge, hold code, or lead elsewhere."""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gen.images import write_png
from gen.sets.pack import DTYPES, FORMAT, VERSION, header_bytes

LIGHTS = np.array([[0, 0, 1], [0.5, 0, 0.9], [-0.5, 0, 0.9], [0, 0.5, 0.9], [0, -0.5, 0.9]])


def rows(values: np.ndarray[Any, Any]) -> str:
    """A table of numbers as text."""
    return "".join(" ".join(str(v) for v in row) + "\n" for row in values)


def lay_photographs(folder: Path) -> None:
    """Five 8x6 pictures of 16 bits, their lights and a mask."""
    rng = np.random.default_rng(0)
    for k in range(5):
        write_png(folder / f"{k + 1}.png", rng.integers(1, 60000, (6, 8, 3)).astype(np.uint16))
    write_png(folder / "mask.png", np.full((6, 8), 255, np.uint8))
    (folder / "lights.txt").write_text(rows(LIGHTS))


def picture(seed: int = 1, size: tuple[int, int] = (6, 8)) -> np.ndarray[Any, Any]:
    """(H, W, 3) uint8."""
    return np.random.default_rng(seed).integers(1, 250, (*size, 3)).astype(np.uint8)


def png() -> bytes:
    """A small sound PNG."""
    return encoded(".png")


def jpeg() -> bytes:
    """A small sound JPEG."""
    return encoded(".jpg")


def encoded(suffix: str) -> bytes:
    """A small sound picture as OpenCV writes it."""
    import cv2

    done, data = cv2.imencode(suffix, picture())
    assert done
    return data.tobytes()


def tiff(compression: str | None = None) -> bytes:
    """A small sound TIFF."""
    import tifffile
    from PIL import Image

    memory = io.BytesIO()
    if compression == "lzw":
        Image.fromarray(picture()).save(memory, "TIFF", compression="tiff_lzw")
    else:
        tifffile.imwrite(memory, picture(), photometric="rgb", compression=compression)
    return memory.getvalue()


def safetensors(arrays: Mapping[str, np.ndarray[Any, Any]], metadata: Mapping[str, str]) -> bytes:
    """A sound safetensors file, by the library."""
    from safetensors.numpy import save

    return save(dict(arrays), dict(metadata))


def pack_bytes() -> bytes:
    """A sound pack of two items with one 4x4 frame each."""
    arrays: dict[str, np.ndarray[Any, Any]] = {
        "combined": np.ones((2, 4, 4, 3), np.float32),
        "valid": np.ones((2, 4, 4), np.bool_),
        "lights": np.tile(np.array([0, 0, 1], np.float32), (2, 1)),
        "intensities": np.ones((2, 3), np.float32),
        "item": np.arange(2, dtype=np.int32),
        "mask": np.ones((2, 4, 4), np.bool_),
    }
    kinds = {dtype: name for name, dtype in DTYPES.items()}
    tensors = {name: (kinds[array.dtype], array.shape) for name, array in arrays.items()}
    facts = json.dumps({"items": [{"id": f"i{i}", "split": "train", "frames": [i, i + 1]} for i in range(2)]})
    opening, places = header_bytes(tensors, {"format": FORMAT, "version": VERSION, "facts": facts})
    return opening + b"".join(arrays[name].tobytes() for name in sorted(arrays, key=lambda name: places[name]))


def box() -> Any:
    """A trimesh box of 10 x 8 x 6."""
    import trimesh

    return trimesh.creation.box((10, 8, 6))


def exported(kind: str, **options: Any) -> bytes:
    """The box as trimesh writes it."""
    data = box().export(file_type=kind, **options)
    return data.encode() if isinstance(data, str) else bytes(data)


def glb() -> bytes:
    return exported("glb")


def obj() -> bytes:
    return exported("obj")


def stl(kind: str = "binary") -> bytes:
    return exported("stl" if kind == "binary" else "stl_ascii")


def ply(kind: str = "binary") -> bytes:
    return exported("ply", encoding="binary" if kind == "binary" else "ascii")


# Files that lie


def png_of(chunks: Sequence[tuple[bytes, bytes]]) -> bytes:
    """A PNG of these chunks, their checksums right."""
    body = b"".join(struct.pack(">I", len(b)) + t + b + struct.pack(">I", zlib.crc32(t + b)) for t, b in chunks)
    return b"\x89PNG\r\n\x1a\n" + body


def png_claiming(width: int, height: int, data: bytes, bits: int = 8, colour: int = 0) -> bytes:
    """A PNG that says it is so large. data: what is packed into it."""
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return png_of([(b"IHDR", head), (b"IDAT", zlib.compress(data, 9)), (b"IEND", b"")])


def jpeg_claiming(side: int, progressive: bool = False, scans: int = 0) -> bytes:
    """A JPEG of 16x16 pixels whose header says side x side, its last scan repeated so many times."""
    import cv2

    flags = [cv2.IMWRITE_JPEG_PROGRESSIVE, int(progressive)]
    done, encoded = cv2.imencode(".jpg", np.zeros((16, 16, 3), np.uint8), flags)
    assert done
    data = bytearray(encoded.tobytes())
    at = data.find(b"\xff\xc2" if progressive else b"\xff\xc0")
    struct.pack_into(">HH", data, at + 5, side, side)
    last = bytes(data[data.rfind(b"\xff\xda") : -2])
    return bytes(data[:-2]) + scans * last + b"\xff\xd9"


def tiff_with(changes: Mapping[int, int], compression: str = "raw", side: int = 16) -> bytes:
    """An RGB TIFF by Pillow, some of its tags set to other whole numbers."""
    from PIL import Image

    memory = io.BytesIO()
    Image.fromarray(np.zeros((side, side, 3), np.uint8)).save(memory, "TIFF", compression=compression)
    data = bytearray(memory.getvalue())
    (at,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, at)
    for k in range(count):
        entry = at + 2 + 12 * k
        tag = struct.unpack_from("<H", data, entry)[0]
        if tag in changes:
            struct.pack_into("<HII", data, entry + 2, 4, 1, changes[tag])
    return bytes(data)


def exr_bytes(channels: Mapping[str, np.ndarray[Any, Any]], **header: Any) -> bytes:
    """An EXR of one part as the library writes it."""
    import OpenEXR

    memory = io.BytesIO()
    attributes = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with OpenEXR.File(attributes, {name: np.ascontiguousarray(array) for name, array in channels.items()}) as file:
        file.write(memory)
    return memory.getvalue()


def exr_claiming(width: int, height: int, channels: int = 3) -> bytes:
    """An EXR of 16x16 pixels whose data window says so many."""
    data = bytearray(exr_bytes({f"c{k}": np.zeros((16, 16), np.float32) for k in range(channels)}))
    kind = b"dataWindow\0box2i\0"
    struct.pack_into("<4i", data, data.find(kind) + len(kind) + 4, 0, 0, width - 1, height - 1)
    return bytes(data)


def exr_of_nothing(side: int) -> bytes:
    """A few kilobytes that a wavelet decoder makes into eight channels of side x side zeros."""
    import OpenEXR

    zeros = np.zeros((side, side), np.float16)
    return exr_bytes(dict.fromkeys("ABCDEFGH", zeros), compression=OpenEXR.HTJ2K256_COMPRESSION)


def npz_of(files: Mapping[str, bytes]) -> bytes:
    """A zip archive, packed well."""
    import zipfile

    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return memory.getvalue()


def npy_header(length: int) -> bytes:
    """A .npy of version 2 whose header is so many blanks."""
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", length) + b" " * length


def mat_of_nothing(megabytes: int) -> bytes:
    """A MATLAB file with one packed variable of so many megabytes of zeros in place of its name."""
    size = megabytes << 20
    inner = struct.pack("<II", 14, size + 64) + struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIiiiI", 5, 12, 6, 8, 3, 0)
    packed = zlib.compress(inner + struct.pack("<II", 1, size) + b"\0" * size, 9)
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(packed)) + packed


def pickled() -> bytes:
    """A pickle that would write a file beside the test, were it ever loaded."""
    import pickle

    class Trap:
        def __reduce__(self) -> Any:
            return Path("loaded.txt").write_text, ("it was",)

    return pickle.dumps(Trap())


def safetensors_claiming(header: object, length: int | None = None, data: bytes = b"") -> bytes:
    """A safetensors file of this header. length: what it says of the header's length."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return (len(text) if length is None else length).to_bytes(8, "little") + text + data


def glb_of(content: object, data: bytes = b"") -> bytes:
    """A GLB of this JSON and these bytes."""
    text = content if isinstance(content, bytes) else json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<I4s", len(text), b"JSON") + text
    if data:
        chunk += struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk


def ply_of(header: str, data: bytes = b"") -> bytes:
    """A PLY of these header lines."""
    return f"ply\n{header}\nend_header\n".encode() + data


def large_picture() -> bytes:
    """A sound PNG that the networks take: 64 pixels a side."""
    import cv2

    return cv2.imencode(".png", picture(2, (64, 64)))[1].tobytes()
