"""What a picture file says of itself before anything is decoded: its size, its bits, its orientation, and whether it is whole.

The decoders hand out partly decoded pictures for truncated or damaged files without an error, and believe any size that a header
claims. So the containers are walked here first. Sources: the PNG specification (W3C, third edition), ITU-T T.81 (JPEG),
TIFF 6.0 and BigTIFF, EXIF 2.3 (orientation).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gen.errors import InputError
from gen.files import MAX_PIXELS

PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
EXR = b"\x76\x2f\x31\x01"
START = 8
"""Bytes that tell the kinds apart."""


@dataclass(frozen=True)
class Header:
    """kind: "png", "jpeg" or "tiff". height, width: as stored, before the orientation is applied. bits: of a sample.

    floats: the samples are floating point. orientation: the EXIF value 1 to 8. orientation_at: where a TIFF keeps it.
    lzw: a TIFF compressed so, which carries no checksum.
    """

    kind: str
    height: int
    width: int
    bits: int
    floats: bool = False
    orientation: int = 1
    orientation_at: tuple[int, str] | None = None
    lzw: bool = False


def inspect(data: bytes, path: Path) -> Header:
    """The header of a PNG, JPEG or TIFF file that is whole. data: the file's bytes. path: for messages.

    Raises InputError where it is another kind of file, truncated or damaged, too large, or stored in a way that is not read.
    """
    if data.startswith(PNG):
        return _png(data, path)
    if data.startswith(JPEG):
        return _jpeg(data, path)
    require_picture(data[:START], path)
    return _tiff(data, path)


def require_picture(start: bytes, path: Path) -> None:
    """InputError unless a file begins as a PNG, JPEG or TIFF does. start: its first `START` bytes."""
    if not start.startswith((PNG, JPEG, *TIFF)):
        raise InputError(f"{path}: is not a picture that can be read; PNG, TIFF, JPEG and EXR are")


def check_size(height: int, width: int, path: Path) -> None:
    """InputError unless 0 < height * width <= MAX_PIXELS."""
    if height <= 0 or width <= 0:
        raise InputError(f"{path}: says that it is {width}x{height} pixels; the file is damaged")
    if height * width > MAX_PIXELS:
        raise InputError(f"{path}: is {width}x{height} pixels, more than the {MAX_PIXELS // 1_000_000} megapixels that are read")


def damaged(path: Path, why: str) -> InputError:
    """The error of a truncated or damaged picture."""
    return InputError(f"{path}: is damaged or truncated ({why}); copy or export it again")


# PNG

_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_PIECE = 1 << 20
_ADAM7 = ((0, 8, 0, 8), (0, 8, 4, 8), (4, 8, 0, 4), (0, 4, 2, 4), (2, 4, 0, 2), (0, 2, 1, 2), (1, 2, 0, 1))


def _png(data: bytes, path: Path) -> Header:
    width = height = bits = 0
    orientation, expected, got, ended = 1, 0, 0, False
    inflate = zlib.decompressobj()
    for n, (kind, body) in enumerate(_png_chunks(data, path)):
        if (n == 0) != (kind == b"IHDR"):
            raise damaged(path, "its header is not where it should be")
        if kind == b"IHDR":
            if len(body) != 13:
                raise damaged(path, "bad header")
            width, height, bits, colour, _, _, interlace = struct.unpack(">IIBBBBB", body)
            check_size(height, width, path)
            if colour not in _CHANNELS or bits not in (1, 2, 4, 8, 16) or interlace > 1:
                raise damaged(path, "bad header")
            expected = _png_bytes(height, width, bits * _CHANNELS[colour], bool(interlace))
        elif kind == b"eXIf":
            orientation = _exif_orientation(body)
        elif kind == b"acTL":
            raise InputError(f"{path}: is an animated PNG; save each picture as a file of its own")
        elif kind == b"IDAT":
            got += _inflate(inflate, body, expected - got, path)
        elif kind == b"IEND":
            ended = True
            break
    if not ended or got != expected or not inflate.eof:
        raise damaged(path, "the picture's data end early" if got < expected or not ended else "bad picture data")
    return Header("png", height, width, max(bits, 8), orientation=orientation)


def _png_chunks(data: bytes, path: Path) -> Iterator[tuple[bytes, memoryview]]:
    """(type, body) of every chunk, its checksum tested."""
    view, at = memoryview(data), len(PNG)
    while at < len(data):
        if at + 12 > len(data):
            raise damaged(path, "the file ends early")
        length = int.from_bytes(view[at : at + 4], "big")
        end = at + 12 + length
        if end > len(data):
            raise damaged(path, "the file ends early")
        if zlib.crc32(view[at + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise damaged(path, "a checksum is wrong")
        yield bytes(view[at + 4 : at + 8]), view[at + 8 : end - 4]
        at = end


def _png_bytes(height: int, width: int, bits: int, interlaced: bool) -> int:
    """Bytes that the picture's data inflate to: a filter byte and the packed samples for every row of every pass."""
    passes = _ADAM7 if interlaced else ((0, 1, 0, 1),)
    total = 0
    for y0, dy, x0, dx in passes:
        rows, columns = -(-(height - y0) // dy), -(-(width - x0) // dx)
        if rows > 0 and columns > 0:
            total += rows * (1 + (columns * bits + 7) // 8)
    return total


def _inflate(inflate: zlib._Decompress, body: memoryview, room: int, path: Path) -> int:
    """Inflate a chunk piece by piece, keeping only the count of bytes: so the stream's own checksum (Adler-32) is tested."""
    count, rest = 0, bytes(body)
    try:
        while not inflate.eof:
            piece = len(inflate.decompress(rest, _PIECE))
            count, rest = count + piece, inflate.unconsumed_tail
            if count > room:
                raise damaged(path, "it holds more data than its size allows")
            if not rest and piece < _PIECE:
                break
    except zlib.error as error:
        raise damaged(path, "bad picture data") from error
    return count


# JPEG

_NEXT_MARKER = re.compile(rb"\xff+[^\x00\xff\xd0-\xd7]")
_MAX_SCANS = 500
_JPEG_PACKED = 512
"""Pixels that one byte can stand for at most: a block of 64 takes a bit."""

_MAX_SCANNED = 10 * MAX_PIXELS
"""Scans of a progressive file times its pixels: cameras and editors write about ten scans, each of which costs a pass."""


def _jpeg(data: bytes, path: Path) -> Header:
    at, size, orientation, scans = 2, None, 1, 0
    while True:
        if data[at : at + 1] != b"\xff":
            raise damaged(path, "the file ends early" if at >= len(data) else "a segment is missing")
        while data[at : at + 1] == b"\xff":
            at += 1
        marker = data[at] if at < len(data) else -1
        at += 1
        if marker == 0xD9:
            break
        if marker == 0x01 or 0xD0 <= marker <= 0xD7:
            continue
        length = int.from_bytes(data[at : at + 2], "big")
        body = data[at + 2 : at + length]
        if length < 2 or at + length > len(data):
            raise damaged(path, "the file ends early")
        at += length
        if marker == 0xE1 and body.startswith(b"Exif\0\0"):
            orientation = _exif_orientation(body[6:])
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            found = _jpeg_frame(marker, body, path)
            if size not in (None, found):
                raise damaged(path, "two sizes are given")
            size = found
        elif marker == 0xDA:
            scans += 1
            following = _NEXT_MARKER.search(data, at)
            if following is None or size is None or scans > _MAX_SCANS:
                raise damaged(path, "the picture's data end early" if following is None else "bad header")
            if size[0] * size[1] > _JPEG_PACKED * len(data):
                raise damaged(path, f"{size[1]}x{size[0]} pixels do not come out of {len(data)} bytes")
            if scans * size[0] * size[1] > _MAX_SCANNED:
                raise InputError(
                    f"{path}: draws its picture {scans} times over, which takes too long; save it as a plain JPEG or PNG"
                )
            at = following.start()
    if size is None or scans == 0:
        raise damaged(path, "there is no picture in it")
    return Header("jpeg", *size, bits=8, orientation=orientation)


def _jpeg_frame(marker: int, body: bytes, path: Path) -> tuple[int, int]:
    if len(body) < 6:
        raise damaged(path, "bad header")
    bits, height, width, channels = struct.unpack(">BHHB", body[:6])
    if marker not in (0xC0, 0xC1, 0xC2) or bits != 8:
        raise InputError(
            f"{path}: is a kind of JPEG that is not read (lossless, arithmetic or {bits}-bit); save it as PNG or TIFF"
        )
    if channels == 4:
        raise InputError(f"{path}: is a CMYK JPEG, made for printing; save it as RGB")
    if channels not in (1, 3):
        raise InputError(f"{path}: is a JPEG of {channels} channels; save it as grey or RGB")
    check_size(height, width, path)
    return height, width


# TIFF and EXIF

_TYPES = {1: "B", 3: "H", 4: "I", 16: "Q", 13: "I", 18: "Q"}
_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC, _ORIENTATION, _SAMPLES, _PLANAR, _FORMAT = (
    256,
    257,
    258,
    259,
    262,
    274,
    277,
    284,
    339,
)
_MAX_VALUES = 10_000_000

_TIFF_PACKED = {1: 3, 5: 1400, 8: 1040, 32773: 64, 32946: 1040}
"""Compressions that are read, each with the bytes that one byte can stand for at most: none (but chroma may be subsampled), LZW (a full
table), deflate, PackBits."""


class _Directory:
    """The first image file directory of TIFF bytes: whole numbers by tag, and where each stands."""

    def __init__(self, data: bytes) -> None:
        self.order = "<" if data[:2] == b"II" else ">"
        big = data[2:4] in (b"+\0", b"\0+")
        self._data = data
        self.values: dict[int, tuple[int, ...]] = {}
        self.places: dict[int, tuple[int, str]] = {}
        (at,) = self._unpack("Q" if big else "I", 8 if big else 4, 1)
        (entries,) = self._unpack("Q" if big else "H", at, 1)
        at += 8 if big else 2
        if entries > 4096:
            raise struct.error("too many entries")
        for n in range(entries):
            entry = at + n * (20 if big else 12)
            tag, kind = self._unpack("H", entry, 2)
            (count,) = self._unpack("Q" if big else "I", entry + 4, 1)
            letter = _TYPES.get(kind)
            if letter is None:
                continue
            if count > _MAX_VALUES:
                raise struct.error("too many values")
            place = entry + (12 if big else 8)
            if count * struct.calcsize("=" + letter) > (8 if big else 4):
                (place,) = self._unpack("Q" if big else "I", place, 1)
            self.values[tag] = self._unpack(letter, place, count)
            self.places[tag] = (place, self.order + letter)

    def _unpack(self, letter: str, at: int, count: int) -> tuple[int, ...]:
        return struct.unpack_from(f"{self.order}{count}{letter}", self._data, at)

    def first(self, tag: int, default: int) -> int:
        found = self.values.get(tag)
        return found[0] if found else default


def _exif_orientation(block: bytes | memoryview) -> int:
    """The orientation in an EXIF block, 1 where there is none or the block is unreadable: the picture itself may be whole."""
    try:
        value = _Directory(bytes(block)).first(_ORIENTATION, 1)
    except (struct.error, OverflowError):
        return 1
    return value if 1 <= value <= 8 else 1


def _tiff(data: bytes, path: Path) -> Header:
    try:
        tags = _Directory(data)
    except (struct.error, OverflowError) as error:
        raise damaged(path, "its directory cannot be read") from error
    height, width = tags.first(_HEIGHT, 0), tags.first(_WIDTH, 0)
    check_size(height, width, path)
    _check_samples(tags, path)
    starts = tags.values.get(273) or tags.values.get(324) or ()
    counts = tags.values.get(279) or tags.values.get(325) or ()
    if not starts or len(starts) != len(counts):
        raise damaged(path, "it does not say where its data are")
    if any(start + count > len(data) or count == 0 for start, count in zip(starts, counts, strict=True)):
        raise damaged(path, "the file ends early")
    turn, packing = tags.first(_ORIENTATION, 1), tags.first(_COMPRESSION, 1)
    bits, floats = tags.first(_BITS, 1), tags.first(_FORMAT, 1) == 3
    size, segments = (width * bits * tags.first(_SAMPLES, 1) + 7) // 8 * height, list(zip(starts, counts, strict=True))
    if size > _TIFF_PACKED[packing] * min(sum(counts), len(data)):
        raise damaged(path, f"{width}x{height} pixels do not come out of {len(data)} bytes")
    if packing in (8, 32946):
        _check_deflated(data, segments, size, path)
    elif packing == 32773:
        _check_runs(data, segments, size // (3 if tags.first(_PHOTOMETRIC, 1) == 6 else 1), path)  # chroma may be subsampled
    turned = turn if 1 <= turn <= 8 else 1
    return Header("tiff", height, width, max(bits, 8), floats, turned, tags.places.get(_ORIENTATION), packing == 5)


def _check_deflated(data: bytes, segments: list[tuple[int, int]], size: int, path: Path) -> None:
    """InputError unless every segment inflates to its own end, checksum included: libtiff stops reading where it has enough."""
    total, room = 0, 2 * size + (1 << 24)  # tiles may reach over the edge
    for start, count in segments:
        inflate = zlib.decompressobj()
        total += _inflate(inflate, memoryview(data)[start : start + count], room - total, path)
        if not inflate.eof:
            raise damaged(path, "the picture's data end early")
    if total < size:
        raise damaged(path, "the picture's data end early")


def _check_runs(data: bytes, segments: list[tuple[int, int]], size: int, path: Path) -> None:
    """InputError unless the segments unpack (PackBits) to so many bytes at least: libtiff fills up what is missing."""
    total = 0
    for start, count in segments:
        at, end = start, start + count
        while at < end:
            lead = data[at]  # literals, a repeated byte, or nothing
            total += lead + 1 if lead < 128 else 257 - lead if lead > 128 else 0
            at += lead + 2 if lead < 128 else 2 if lead > 128 else 1
    if total < size:
        raise damaged(path, "the picture's data end early")


def _check_samples(tags: _Directory, path: Path) -> None:
    """InputError unless the decoder reads samples of this kind as they are meant; planar and CMYK ones it reads wrong."""
    all_bits, form = set(tags.values.get(_BITS) or (1,)), tags.first(_FORMAT, 1)
    bits, samples, photometric = max(all_bits), tags.first(_SAMPLES, 1), tags.first(_PHOTOMETRIC, 1)
    if photometric == 5:
        raise InputError(f"{path}: is a CMYK picture, made for printing; save it as RGB")
    if len(all_bits) > 1 or (bits, form) not in ((1, 1), (1, 4), (8, 1), (8, 4), (16, 1), (16, 4), (32, 3), (64, 3)):
        raise InputError(f"{path}: has samples of a kind that is not read; save 8 or 16-bit unsigned integers or 32-bit floats")
    if samples not in (1, 3, 4):
        raise InputError(f"{path}: has {samples} samples a pixel; save it as grey, RGB or RGBA")
    if tags.first(_COMPRESSION, 1) not in _TIFF_PACKED:
        raise InputError(f"{path}: is compressed in a way that is not read; save it uncompressed, with LZW or with deflate (ZIP)")
    if tags.first(_PLANAR, 1) != 1 and samples > 1:
        raise InputError(f"{path}: stores its channels one after another (planar); save it interleaved")
    if photometric not in ((0, 1, 2, 3, 6) if bits <= 8 else (1, 2)):
        raise InputError(f"{path}: stores colour in a way that is not read; save it as grey or RGB")
