"""Hostile pictures through `degloss recon run`: PNG, JPEG, TIFF and EXR that are cut, lie, or are something else altogether."""

from __future__ import annotations

import gzip
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.hostile.commands import Case, require_refusal
from tests.hostile.files import (
    exr_bytes,
    exr_claiming,
    exr_of_nothing,
    jpeg,
    jpeg_claiming,
    lay_photographs,
    npz_of,
    pickled,
    png,
    png_claiming,
    png_of,
    tiff,
    tiff_with,
)

HEAD = struct.pack(">IIBBBBB", 8, 6, 8, 0, 0, 0, 0)
ROWS = zlib.compress(b"\0" * 9 * 6)
WINDOW = (np.zeros(2, np.int32), np.array([7, 5], np.int32))
FLAT = np.ones((6, 8), np.float32)


def after(data: bytes, mark: bytes, offset: int, new: bytes) -> bytes:
    """`data` with the bytes some way after a mark replaced."""
    at = data.index(mark) + len(mark) + offset
    return data[:at] + new + data[at + len(new) :]


def two_parts() -> bytes:
    import io

    import OpenEXR

    memory = io.BytesIO()
    parts = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage, "displayWindow": WINDOW}, {letter: np.ones(size, np.float32)}, name)
        for name, letter, size in (("a", "R", (6, 8)), ("b", "G", (3, 4)))
    ]
    with OpenEXR.File(parts) as file:
        file.write(memory)
    return memory.getvalue()


PICTURES: dict[str, tuple[Callable[[], bytes], str]] = {
    # what it is: (the file's bytes, what the line says)
    "png: its signature alone": (lambda: png()[:8], "damaged or truncated"),
    "png: cut in its header": (lambda: png()[:20], "damaged or truncated"),
    "png: cut in its pixels": (lambda: png()[:-40], "damaged or truncated"),
    "png: without its end": (lambda: png()[:-12], "damaged or truncated"),
    "png: a wrong checksum": (lambda: png()[:60] + b"\xff" + png()[61:], "checksum"),
    "png: a chunk of two gigabytes": (lambda: png()[:8] + b"\x7f\xff\xff\xff" + png()[12:], "ends early"),
    "png: no pixels wide": (lambda: png_claiming(0, 6, b""), "0x6 pixels"),
    "png: claims 200,000 pixels a side": (lambda: png_claiming(200_000, 200_000, b"\0" * 99), "megapixels"),
    "png: claims 14,000 pixels a side": (lambda: png_claiming(14_000, 14_000, b"\0" * 999, 16, 6), "end early"),
    "png: unpacks to 100 times its size": (lambda: png_claiming(8, 6, b"\0" * 50_000_000), "more data than its size"),
    "png: pixels before the header": (lambda: png_of([(b"IDAT", ROWS), (b"IHDR", HEAD), (b"IEND", b"")]), "header is not where"),
    "png: two headers": (
        lambda: png_of([(b"IHDR", HEAD), (b"IHDR", HEAD), (b"IDAT", ROWS), (b"IEND", b"")]),
        "header is not where",
    ),
    "png: of three bits": (lambda: png_claiming(8, 6, b"\0" * 60, 3), "bad header"),
    "png: of a colour that does not exist": (lambda: png_claiming(8, 6, b"\0" * 60, 8, 5), "bad header"),
    "png: animated": (lambda: png_of([(b"IHDR", HEAD), (b"acTL", b"\0" * 8), (b"IDAT", ROWS), (b"IEND", b"")]), "animated"),
    "png: packed with something else": (
        lambda: png_of([(b"IHDR", HEAD), (b"IDAT", b"junk" * 9), (b"IEND", b"")]),
        "bad picture data",
    ),
    "jpeg: its start alone": (lambda: jpeg()[:3], "damaged or truncated"),
    "jpeg: cut in a table": (lambda: jpeg()[:100], "damaged or truncated"),
    "jpeg: cut in its pixels": (lambda: jpeg()[:-30], "damaged or truncated"),
    "jpeg: nothing between start and end": (lambda: b"\xff\xd8\xff\xd9", "there is no picture in it"),
    "jpeg: claims 14,000 pixels a side": (lambda: jpeg_claiming(14_000), "do not come out of"),
    "jpeg: claims 60,000 pixels a side": (lambda: jpeg_claiming(60_000), "megapixels"),
    "jpeg: draws itself 490 times over": (lambda: jpeg_claiming(2500, True, 480) + b"\0" * 20_000, "times over"),
    "jpeg: draws itself 600 times over": (lambda: jpeg_claiming(64, True, 600), "bad header"),
    "jpeg: no rows": (lambda: after(jpeg(), b"\xff\xc0", 3, b"\0\0"), "pixels; the file is damaged"),
    "jpeg: of 12 bits": (lambda: after(jpeg(), b"\xff\xc0", 2, b"\x0c"), "12-bit"),
    "jpeg: lossless": (lambda: jpeg().replace(b"\xff\xc0", b"\xff\xc3", 1), "lossless"),
    "jpeg: of four inks": (lambda: after(jpeg(), b"\xff\xc0", 7, b"\x04"), "CMYK"),
    "jpeg: two sizes": (lambda: jpeg()[:2] + b"\xff\xc0\x00\x0b\x08\x00\x09\x00\x09\x01\x01\x11\x00" + jpeg()[2:], "two sizes"),
    "tiff: its mark alone": (lambda: tiff()[:4], "directory cannot be read"),
    "tiff: cut in its pixels": (lambda: tiff()[:-60], "damaged or truncated"),
    "tiff: a directory beyond the end": (lambda: tiff()[:4] + b"\xff\xff\xff\x7f" + tiff()[8:], "directory cannot be read"),
    "tiff: claims 13,000 pixels a side": (lambda: tiff_with({256: 13_000, 257: 13_000}), "do not come out of"),
    "tiff: claims so much LZW": (lambda: tiff_with({256: 13_000, 257: 13_000, 278: 13_000}, "tiff_lzw"), "do not come out of"),
    "tiff: claims so much PackBits": (
        lambda: tiff_with({256: 13_000, 257: 13_000, 278: 13_000}, "packbits"),
        "do not come out of",
    ),
    "tiff: claims so much deflate": (lambda: tiff_with({256: 13_000, 257: 13_000}, "tiff_adobe_deflate"), "do not come out of"),
    "tiff: PackBits that end early": (lambda: tiff_with({257: 24, 278: 24}, "packbits"), "end early"),
    "tiff: claims 4 billion pixels a side": (lambda: tiff_with({256: 2**32 - 1, 257: 2**32 - 1}), "megapixels"),
    "tiff: no pixels": (lambda: tiff_with({256: 0}), "0x16 pixels"),
    "tiff: pixels beyond the end": (lambda: tiff_with({273: 2**31}), "ends early"),
    "tiff: samples of no bits": (lambda: after(tiff_with({258: 8}), struct.pack("<HH", 258, 4), 0, b"\0\0\0\0"), ""),
    "tiff: of five inks": (lambda: tiff_with({262: 5}), "CMYK"),
    "tiff: in planes": (lambda: tiff_with({284: 2}), "planar"),
    "tiff: packed as a fax": (lambda: tiff_with({259: 4}), "compressed in a way"),
    "tiff: of seven samples": (lambda: tiff_with({277: 7}), "7 samples"),
    "exr: its mark alone": (lambda: b"\x76\x2f\x31\x01", "damaged or truncated"),
    "exr: cut in its header": (lambda: exr_bytes({"R": FLAT})[:60], "damaged or truncated"),
    "exr: cut in its pixels": (lambda: exr_bytes({"R": FLAT, "G": FLAT, "B": FLAT})[:-9], "damaged or truncated"),
    "exr: claims 60,000 pixels a side": (lambda: exr_claiming(60_000, 60_000), "megapixels"),
    "exr: claims 14,000 pixels a side in 40 channels": (lambda: exr_claiming(14_000, 14_000, 40), ""),
    "exr: claims 4,000 pixels a side": (lambda: exr_claiming(4000, 4000, 3), ""),
    "exr: kilobytes of nothing that fill a disk": (lambda: exr_of_nothing(2048), "no picture packs into"),
    "exr: two parts of two sizes": (two_parts, "different sizes"),
    "exr: no colour": (lambda: exr_bytes({"Z": FLAT}), "holds neither R, G, B nor Y"),
    "exr: a picture of another kind after its mark": (lambda: b"\x76\x2f\x31\x01" + png(), "damaged or truncated"),
    "text": (lambda: b"not a picture\n", "not a picture that can be read"),
    "nothing": (lambda: b"", "is empty"),
    "a pickle": (pickled, "not a picture that can be read"),
    "an archive": (lambda: npz_of({"a": b"b"}), "not a picture that can be read"),
    "a compressed picture": (lambda: gzip.compress(png()), "not a picture that can be read"),
    "a page": (lambda: b"<!DOCTYPE html><html>", "not a picture that can be read"),
    "a drawing": (lambda: b"<svg xmlns='http://www.w3.org/2000/svg'/>", "not a picture that can be read"),
}


@pytest.mark.parametrize("what", PICTURES)
def test_a_hostile_picture_is_refused(what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data, says = PICTURES[what]

    def lay(folder: Path) -> None:
        (folder / "photos").mkdir()
        lay_photographs(folder / "photos")
        (folder / "photos" / "2.png").write_bytes(data())

    require_refusal(Case(lay, "recon run HERE/photos -o HERE/out", "photos/2.png", says), tmp_path, capfd)


@pytest.mark.parametrize("size", [3_900_000_000, 4_100_000_000])
def test_the_rest_of_what_is_no_picture_is_not_read(size: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A hole of gigabytes in a file costs nothing on the disk, and would fill the memory."""

    def lay(folder: Path) -> None:
        (folder / "photos").mkdir()
        lay_photographs(folder / "photos")
        with (folder / "photos" / "2.png").open("r+b") as file:
            file.write(b"\0" * 8)
            file.truncate(size)

    require_refusal(Case(lay, "recon run HERE/photos -o HERE/out", "photos/2.png", ""), tmp_path, capfd)
