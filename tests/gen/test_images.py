"""Reading photographs: against Pillow, tifffile and a PNG encoder written here from the specification; and refusing damaged files."""

from __future__ import annotations

import io
import struct
import time
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageOps

from gen.capture import Fault
from gen.errors import InputError
from gen.exr import write_exr
from gen.images import linear_to_srgb, read_frames, read_image, read_mask, read_raw, srgb_to_linear, write_png

RNG = np.random.default_rng(0)
RGB8 = RNG.integers(1, 255, (21, 34, 3)).astype(np.uint8)
RGB16 = RNG.integers(1, 65535, (21, 34, 3)).astype(np.uint16)
SMOOTH = np.linspace(20, 230, 48)[None, :, None] * np.ones((40, 1, 3)) + np.array([0, 10, 20])


def png(rows: np.ndarray, colour: int, extra: tuple[tuple[bytes, bytes], ...] = ()) -> bytes:
    """A PNG of (H, W, C) samples with filter 0, from the specification."""
    height, width = rows.shape[:2]
    packed = rows.astype(">u2") if rows.dtype == np.uint16 else rows
    lines = b"".join(b"\0" + packed[y].tobytes() for y in range(height))
    header = struct.pack(">IIBBBBB", width, height, 8 * rows.dtype.itemsize, colour, 0, 0, 0)
    return join_png(((b"IHDR", header), *extra, (b"IDAT", zlib.compress(lines)), (b"IEND", b"")))


def join_png(chunks: tuple[tuple[bytes, bytes], ...]) -> bytes:
    text = b"\x89PNG\r\n\x1a\n"
    for kind, body in chunks:
        text += struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    return text


def saved(image: Image.Image, kind: str, **options: object) -> bytes:
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


def tiff(array: np.ndarray, **options: object) -> bytes:
    stream = io.BytesIO()
    if array.ndim == 3 and "photometric" not in options:
        options["photometric"] = "rgb"
    tifffile.imwrite(stream, array, **options)
    return stream.getvalue()


def put(folder: Path, data: bytes, name: str = "picture.png") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


# The transfer function


@pytest.mark.parametrize(
    ("encoded", "linear"), [(0, 0), (1, 1), (0.5, 0.21404114), (0.04045, 0.0031308), (0.735356983, 0.5), (10 / 255, 0.00303527)]
)
def test_srgb_has_the_published_values(encoded: float, linear: float) -> None:
    assert srgb_to_linear(np.array(encoded)) == pytest.approx(linear, abs=2e-7)
    assert linear_to_srgb(np.array(linear)) == pytest.approx(encoded, abs=2e-6)


@given(st.floats(-2, 3))
def test_srgb_there_and_back(value: float) -> None:
    # The standard's rounded constants leave a jump of 1e-8 at the knee.
    assert linear_to_srgb(srgb_to_linear(np.array(value))) == pytest.approx(value, abs=1e-6)


def test_srgb_keeps_float32_and_rises() -> None:
    v = np.linspace(0, 1, 4097, dtype=np.float32)
    assert srgb_to_linear(v).dtype == linear_to_srgb(v).dtype == np.float32
    assert (np.diff(srgb_to_linear(v)) > 0).all()
    assert (np.diff(linear_to_srgb(v)) > 0).all()


# PNG


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA"])
def test_png_of_every_8_bit_mode_agrees_with_pillow(tmp_path: Path, mode: str) -> None:
    image = Image.fromarray(RGB8).convert(mode)
    picture = read_image(put(tmp_path, saved(image, "PNG")))
    wanted = np.asarray(image.convert("RGB")) / 255
    assert picture.encoding == "srgb"
    assert not picture.said
    assert picture.bits == 8
    np.testing.assert_allclose(picture.linear, srgb_to_linear(wanted), atol=1e-7)


@pytest.mark.parametrize("colour", [0, 2, 4, 6])
def test_16_bit_png_is_linear_and_exact(tmp_path: Path, colour: int) -> None:
    channels = {0: 1, 2: 3, 4: 2, 6: 4}[colour]
    samples = RNG.integers(1, 65535, (9, 14, channels)).astype(np.uint16)
    picture = read_image(put(tmp_path, png(samples, colour)))
    wanted = np.repeat(samples[..., :1], 3, 2) if channels < 3 else samples[..., :3]
    assert (picture.encoding, picture.bits) == ("linear", 16)
    np.testing.assert_array_equal(picture.linear, (wanted / 65535).astype(np.float32))


def test_interlaced_png(tmp_path: Path) -> None:
    """Adam7 by hand: the seven passes of the specification, on sizes where some passes are empty."""
    for height, width in ((21, 34), (1, 1), (3, 2), (9, 4)):
        a = RNG.integers(0, 255, (height, width, 3)).astype(np.uint8)
        passes = [(0, 8, 0, 8), (0, 8, 4, 8), (4, 8, 0, 4), (0, 4, 2, 4), (2, 4, 0, 2), (0, 2, 1, 2), (1, 2, 0, 1)]
        parts = [a[y0::dy, x0::dx] for y0, dy, x0, dx in passes]
        body = b"".join(b"\0" + row.tobytes() for part in parts if part.size for row in part)
        header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 1)
        data = join_png(((b"IHDR", header), (b"IDAT", zlib.compress(body)), (b"IEND", b"")))
        np.testing.assert_array_equal(read_raw(put(tmp_path, data)), a)


def test_the_encoding_can_be_said_and_is_recorded(tmp_path: Path) -> None:
    eight, sixteen = put(tmp_path, png(RGB8, 2), "a.png"), put(tmp_path, png(RGB16, 2), "b.png")
    linear, srgb = read_image(eight, "linear"), read_image(sixteen, "srgb")
    assert linear.said
    assert srgb.said
    assert (linear.encoding, srgb.encoding) == ("linear", "srgb")
    np.testing.assert_array_equal(linear.linear, (RGB8 / 255).astype(np.float32))
    np.testing.assert_allclose(srgb.linear, srgb_to_linear(RGB16 / 65535), atol=1e-7)
    assert read_frames([eight], "linear").reading == "linear (as said)"
    assert read_frames([eight]).reading == "srgb (default of 8-bit files)"
    with pytest.raises(InputError, match="srgb or linear"):
        read_image(eight, "gamma")


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535)])
def test_clipped_dark_and_missing(tmp_path: Path, dtype: type, top: int) -> None:
    a = np.full((1, 5, 4), 9, dtype)
    a[..., 3] = top
    a[0, 0, 1] = top  # one channel at the top
    a[0, 1, :3] = 0  # all at zero
    a[0, 2, :2] = 0  # not all
    a[0, 3] = (top, 0, 0, 0)  # transparent
    picture = read_image(put(tmp_path, png(a, 6)))
    assert picture.clipped.tolist() == [[True, False, False, True, False]]
    assert picture.dark.tolist() == [[False, True, False, False, False]]
    assert picture.missing.tolist() == [[False, False, False, True, False]]
    assert picture.faults.tolist() == [[Fault.CLIPPED, Fault.DARK, 0, Fault.MISSING, 0]]


# TIFF, JPEG, EXR


@pytest.mark.parametrize(
    ("array", "options"),
    [
        (RGB8, {}),
        (RGB16, {}),
        (RGB16[..., 0], {}),
        (RGB8[..., 0], {}),
        (RGB16, {"compression": "zlib", "predictor": True}),
        (RGB16, {"tile": (16, 16)}),
        (RGB16, {"bigtiff": True}),
        (RGB16, {"byteorder": ">"}),
        (RGB16, {"rowsperstrip": 5}),
        ((RGB16 / 65535).astype(np.float32) * 3, {}),
        ((RGB16[..., 0] / 65535).astype(np.float32) - 0.5, {}),
        ((RGB16 / 65535).astype(np.float32), {"compression": "zlib"}),
        (RGB16 / 65535, {}),
        (np.dstack([RGB16, np.full_like(RGB16[..., 0], 65535)]), {"extrasamples": ["unassalpha"]}),
        (np.dstack([RGB8, np.full_like(RGB8[..., 0], 255)]), {"extrasamples": ["unassalpha"]}),
    ],
    ids=lambda v: "-".join(v) or "plain" if isinstance(v, dict) else f"{v.dtype}{v.shape}",
)
def test_tiff_agrees_with_what_tifffile_wrote(tmp_path: Path, array: np.ndarray, options: dict[str, object]) -> None:
    picture = read_image(put(tmp_path, tiff(array, **options), "a.tif"), "linear")
    top = 1 if array.dtype.kind == "f" else np.iinfo(array.dtype).max
    wanted = array[..., :3] if array.ndim == 3 else np.repeat(array[..., None], 3, 2)
    np.testing.assert_array_equal(picture.linear, (wanted / top).astype(np.float32))
    assert read_image(tmp_path / "a.tif").encoding == ("srgb" if array.dtype == np.uint8 else "linear")


@pytest.mark.parametrize("compression", ["tiff_lzw", "packbits", "tiff_adobe_deflate"])
def test_compressed_tiff_from_pillow(tmp_path: Path, compression: str) -> None:
    np.testing.assert_array_equal(read_raw(put(tmp_path, saved(Image.fromarray(RGB8), "TIFF", compression=compression))), RGB8)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (tiff(RGB16.transpose(2, 0, 1).copy(), planarconfig="separate"), "planar"),
        (tiff(np.ascontiguousarray(RGB16[..., :2]), photometric="minisblack", extrasamples=["unassalpha"]), "2 samples"),
        (tiff(RGB16.astype(np.uint32)), "kind"),
        (tiff((RGB16 / 65535).astype(np.float16)), "kind"),
        (tiff(RGB16.astype(np.int16)), "kind"),
        (tiff(RGB16[..., 0], photometric="miniswhite"), "colour"),
        (saved(Image.fromarray(RGB8).convert("CMYK"), "TIFF"), "CMYK"),
        (saved(Image.fromarray(RGB8).convert("CMYK"), "JPEG"), "CMYK"),
        (saved(Image.fromarray(RGB8), "GIF"), "PNG, TIFF, JPEG and EXR"),
        (saved(Image.fromarray(RGB8), "BMP"), "PNG, TIFF, JPEG and EXR"),
        (saved(Image.fromarray(RGB8), "PNG", save_all=True, append_images=[Image.fromarray(RGB8[::-1])]), "animated"),
    ],
    ids=["planar", "grey-alpha", "uint32", "float16", "int16", "white-is-0", "cmyk-tiff", "cmyk-jpeg", "gif", "bmp", "apng"],
)
def test_kinds_that_are_not_read_are_refused(tmp_path: Path, data: bytes, why: str) -> None:
    with pytest.raises(InputError, match=why) as error:
        read_image(put(tmp_path, data))
    assert "picture.png" in str(error.value)


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"subsampling": 0}, {"restart_marker_rows": 1}], ids=str)
@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_jpeg_agrees_with_pillow(tmp_path: Path, mode: str, options: dict[str, object]) -> None:
    data = saved(Image.fromarray(SMOOTH.astype(np.uint8)).convert(mode), "JPEG", quality=92, **options)
    wanted = np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)
    assert np.abs(read_raw(put(tmp_path, data)).astype(int) - wanted).max() <= 2


def test_exr_of_colour_grey_and_holes(tmp_path: Path) -> None:
    a = RNG.normal(1, 2, (6, 7, 3)).astype(np.float32)
    a[2, 3, 1], a[4, 4, 0] = np.nan, np.inf
    write_exr(tmp_path / "a.exr", {letter: a[..., i] for i, letter in enumerate("RGB")})
    picture = read_image(tmp_path / "a.exr")
    holes = ~np.isfinite(a).all(axis=2)
    assert picture.encoding == "linear"
    assert not picture.clipped.any()
    np.testing.assert_array_equal(picture.missing, holes)
    np.testing.assert_array_equal(picture.linear[~holes], a[~holes])
    assert (picture.linear[holes] == 0).all()
    grey = np.abs(a[..., 2])
    write_exr(tmp_path / "y.exr", {"Y": grey, "A": (grey > 1).astype(np.float32)})
    picture = read_image(tmp_path / "y.exr")
    np.testing.assert_array_equal(picture.linear, np.repeat(grey[..., None], 3, 2))
    np.testing.assert_array_equal(picture.missing, grey <= 1)
    write_exr(tmp_path / "n.exr", {"normal.X": grey})
    with pytest.raises(InputError, match=r"n\.exr: holds neither R, G, B nor Y"):
        read_image(tmp_path / "n.exr")


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["PNG", "JPEG", "TIFF", "TIFF16"])
def test_exif_orientation_is_applied_as_pillow_applies_it(tmp_path: Path, kind: str, orientation: int) -> None:
    stored = SMOOTH.astype(np.uint8)
    stored[:16, :16] = (200, 30, 30)
    upright = Image.fromarray(stored)
    upright.getexif()[0x0112] = orientation
    wanted = np.asarray(ImageOps.exif_transpose(upright)).astype(int)
    if kind == "TIFF16":
        data = tiff(stored.astype(np.uint16) * 257, extratags=[(274, "H", 1, orientation, True)])
        wanted = wanted * 257
    else:
        exif = Image.Exif()
        exif[0x0112] = orientation
        data = saved(Image.fromarray(stored), kind, exif=exif)
    path = put(tmp_path, data)
    assert read_image(path).orientation == orientation
    found = read_raw(path).astype(int)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).mean() < (5 if kind == "JPEG" else 1e-9)


# Damage


def whole_files(folder: Path) -> dict[str, bytes]:
    big = np.kron(RGB8, np.ones((4, 4, 1), np.uint8))
    write_exr(folder / "whole.exr", {letter: big[..., i] / 255 for i, letter in enumerate("RGB")})
    return {
        "png": png(big, 2),
        "png16": png(np.kron(RGB16, np.ones((4, 4, 1), np.uint16)), 2),
        "jpeg": saved(Image.fromarray(big), "JPEG"),
        "progressive": saved(Image.fromarray(big), "JPEG", progressive=True),
        "tiff": tiff(big),
        "tiff-deflate": tiff(big, compression="zlib"),
        "tiff-lzw": saved(Image.fromarray(big), "TIFF", compression="tiff_lzw"),
        "tiff-float": tiff(big.astype(np.float32)),
        "exr": (folder / "whole.exr").read_bytes(),
    }


KINDS = ("png", "png16", "jpeg", "progressive", "tiff", "tiff-deflate", "tiff-lzw", "tiff-float", "exr")


@pytest.mark.parametrize("kind", KINDS)
def test_a_truncated_file_is_refused_wherever_it_ends_and_in_silence(
    tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    data = whole_files(tmp_path)[kind]
    read_image(put(tmp_path, data, "whole"))
    for length in sorted({1, 3, 8, 20, *np.linspace(30, len(data) - 1, 25).astype(int), len(data) - 2}):
        with pytest.raises(InputError, match="cut: ") as error:
            read_image(put(tmp_path, data[:length], "cut"))
        assert "\n" not in str(error.value)
    seen = capfd.readouterr()
    assert seen.out + seen.err == ""


@pytest.mark.parametrize("kind", ["png", "png16"])
def test_one_wrong_byte_anywhere_in_a_png_is_refused(tmp_path: Path, kind: str) -> None:
    data = whole_files(tmp_path)[kind]
    for at in np.linspace(0, len(data) - 1, 60).astype(int):
        wrong = bytearray(data)
        wrong[at] ^= 0x15
        with pytest.raises(InputError):
            read_image(put(tmp_path, bytes(wrong)))


@pytest.mark.parametrize(
    "data",
    [
        saved(Image.fromarray(np.kron(RGB8, np.ones((4, 4, 1), np.uint8))), "TIFF", compression="tiff_lzw"),
        tiff(np.kron(RGB8, np.ones((4, 4, 1), np.uint8)), compression="zlib"),
        tiff(np.kron(RGB16, np.ones((4, 4, 1), np.uint16)), compression="zlib"),
        tiff(np.kron(RGB16, np.ones((4, 4, 1), np.uint16)), compression="zlib", predictor=True, tile=(16, 32)),
    ],
    ids=["lzw", "deflate-8", "deflate-16", "tiles"],
)
def test_damage_inside_a_compressed_tiff_is_refused(tmp_path: Path, data: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    """What the decoder reads on over, handing out a picture of which the rest is wrong."""
    read_image(put(tmp_path, data))
    middle = len(data) // 2
    for wrong in (b"\0" * 40, b"\xff" * 40, np.random.default_rng(1).bytes(40)):
        with pytest.raises(InputError, match="damaged"):
            read_image(put(tmp_path, data[:middle] + wrong + data[middle + 40 :]))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", KINDS)
def test_changed_bytes_end_in_one_line_or_in_a_picture(tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]) -> None:
    """Headers with any value at all: no other error, no crash, nothing printed. Pictures without checksums may pass."""
    data, rng = whole_files(tmp_path)[kind], np.random.default_rng(7)
    lines: list[str] = []
    for _ in range(150):
        wrong = bytearray(data)
        for at in rng.integers(0, min(len(data), 700 if rng.random() < 0.7 else len(data)), rng.integers(1, 4)):
            wrong[at] = rng.integers(0, 256)
        path = put(tmp_path, bytes(wrong))
        try:
            picture = read_image(path)
        except InputError as error:
            lines.append(str(error))
        else:
            assert np.isfinite(picture.linear).all()
            assert picture.linear.shape == (*picture.missing.shape, 3)
    assert len(lines) > 5
    assert all("picture.png: " in line and "\n" not in line for line in lines)
    assert capfd.readouterr() == ("", "")


def test_a_png_with_data_missing_but_checksums_right_is_refused(tmp_path: Path) -> None:
    header = struct.pack(">IIBBBBB", 30, 20, 8, 2, 0, 0, 0)
    for rows in (0, 19, 21):
        body = zlib.compress(b"\0" * (91 * rows))
        with pytest.raises(InputError, match="damaged"):
            read_image(put(tmp_path, join_png(((b"IHDR", header), (b"IDAT", body), (b"IEND", b"")))))
    whole = zlib.compress(b"\0" * (91 * 20))
    for body in (whole[:-4], whole[:-4] + b"abcd"):  # the stream's own checksum
        with pytest.raises(InputError, match="damaged"):
            read_image(put(tmp_path, join_png(((b"IHDR", header), (b"IDAT", body), (b"IEND", b"")))))
    read_image(put(tmp_path, join_png(((b"IHDR", header), (b"IDAT", whole[:5]), (b"IDAT", whole[5:]), (b"IEND", b"")))))


@pytest.mark.parametrize("kind", ["jpeg", "progressive"])
def test_a_jpeg_with_a_hole_is_refused(tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]) -> None:
    data = whole_files(tmp_path)[kind]
    middle = len(data) // 2
    with pytest.raises(InputError, match="damaged"):
        read_image(put(tmp_path, data[:middle] + data[middle + len(data) // 6 :]))
    with pytest.raises(InputError, match="damaged"):
        read_image(put(tmp_path, data[:middle] + b"\xff\xd9"))
    assert capfd.readouterr().err == ""


def test_the_kind_of_a_file_is_told_by_its_content(tmp_path: Path) -> None:
    np.testing.assert_array_equal(read_raw(put(tmp_path, tiff(RGB16), "looks_like.png")), RGB16)
    for data in (b"hello, world\n" * 20, b"\0" * 500, b"{}"):
        with pytest.raises(InputError, match=r"text\.png: is not a picture"):
            read_image(put(tmp_path, data, "text.png"))
    with pytest.raises(InputError, match="empty"):
        read_image(put(tmp_path, b"", "none.png"))
    with pytest.raises(InputError, match="no such file"):
        read_image(tmp_path / "absent.png")
    with pytest.raises(InputError, match="is a folder"):
        read_image(tmp_path)


def test_a_size_is_tested_before_anything_is_decoded(tmp_path: Path) -> None:
    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    huge_png = join_png(((b"IHDR", header), (b"IDAT", zlib.compress(b"\0" * 1000)), (b"IEND", b"")))
    jpeg = bytearray(saved(Image.fromarray(RGB8), "JPEG"))
    at = jpeg.index(b"\xff\xc0") + 5
    jpeg[at : at + 4] = b"\xff\xff\xff\xff"
    huge_tiff = bytearray(tiff(RGB8))
    for tag in (b"\x00\x01", b"\x01\x01"):
        huge_tiff[huge_tiff.index(tag, 8) + 8 : huge_tiff.index(tag, 8) + 12] = struct.pack("<I", 60000)
    for data in (huge_png, bytes(jpeg), bytes(huge_tiff)):
        with pytest.raises(InputError, match="megapixels"):
            read_image(put(tmp_path, data))


def test_a_decompression_bomb_takes_no_memory(tmp_path: Path) -> None:
    header = struct.pack(">IIBBBBB", 10, 10, 8, 0, 0, 0, 0)
    bomb = join_png(((b"IHDR", header), (b"IDAT", zlib.compress(b"\0" * 100_000_000, 9)), (b"IEND", b"")))
    path = put(tmp_path, bomb)
    tracemalloc.start()
    with pytest.raises(InputError, match="more data than its size allows"):
        read_image(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10_000_000


def test_a_broken_colour_profile_neither_harms_nor_prints(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = png(RGB8, 2, ((b"iCCP", b"bad\0\0" + zlib.compress(b"nonsense")), (b"tEXt", b"a\0b")))
    np.testing.assert_array_equal(read_raw(put(tmp_path, data)), RGB8)
    assert capfd.readouterr().err == ""


# Many pictures, masks, writing


def test_frames_come_in_order_and_equal_single_reading(tmp_path: Path) -> None:
    paths = [put(tmp_path, png(RNG.integers(0, 256, (8, 9, 3)).astype(np.uint8), 2), f"{k}.png") for k in range(17)]
    frames = read_frames(paths[::-1])
    for k, path in enumerate(paths[::-1]):
        np.testing.assert_array_equal(frames.images[k], read_image(path).linear)
        np.testing.assert_array_equal(frames.faults[k], read_image(path).faults)
    assert frames.images.dtype == np.float32
    assert (frames.encoding, frames.said, frames.bits) == ("srgb", False, 8)


def test_frames_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 3
    first = put(tmp_path, png(RGB8, 2), "a.png")
    for data, why in (
        (png(RGB8[:-1], 2), "one size"),
        (png(RGB16, 2), "srgb or linear"),
        (saved(Image.fromarray(RGB8), "PNG", exif=exif), "orientation"),
        (png(RGB8, 2)[:-30], "damaged"),
    ):
        with pytest.raises(InputError, match=why) as error:
            read_frames([first, put(tmp_path, data, "b.png")])
        assert str(error.value).startswith(str(tmp_path / "b.png"))
    put(tmp_path, png(RGB16, 2), "b.png")
    assert read_frames([first, tmp_path / "b.png"], "linear").images.shape == (2, *RGB8.shape)
    with pytest.raises(InputError, match="no pictures"):
        read_frames([])


def test_five_pictures_of_a_camera_are_read_quickly(tmp_path: Path) -> None:
    y, x = np.mgrid[:512, :612]
    base = 30000 + 20000 * np.sin(x / 50) * np.cos(y / 70)
    paths = [tmp_path / f"{k}.png" for k in range(5)]
    for path in paths:
        write_png(path, np.clip(base[..., None] + RNG.normal(0, 40, (512, 612, 3)), 0, 65535).astype(np.uint16))
    seconds = []
    for _ in range(3):
        start = time.process_time()
        read_frames(paths)
        seconds.append(time.process_time() - start)
    assert min(seconds) < 0.5  # CPU seconds of all threads; about 0.15 on a machine of 2024


def test_masks(tmp_path: Path) -> None:
    shape = np.zeros((6, 8), np.uint8)
    shape[2:5, 3:7] = 1
    rgba = np.dstack([np.full((6, 8, 3), 255, np.uint8), shape * 255])
    for name, array in {
        "grey": shape * 255,
        "rgb": np.dstack([shape * 255] * 3),
        "ones": shape,
        "alpha": rgba,
        "noisy": shape * 199 + 20,
    }.items():
        write_png(tmp_path / f"{name}.png", array.astype(np.uint8))
        np.testing.assert_array_equal(read_mask(tmp_path / f"{name}.png", (6, 8)), shape == 1)
    write_png(tmp_path / "sixteen.png", shape.astype(np.uint16) * 65535)
    np.testing.assert_array_equal(read_mask(tmp_path / "sixteen.png"), shape == 1)
    put(tmp_path, saved(Image.fromarray(shape * 255).convert("1"), "PNG"), "bits.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "bits.png"), shape == 1)
    for dark in (0, 3, 127):
        write_png(tmp_path / "dark.png", np.full((6, 8), dark, np.uint8))
        with pytest.raises(InputError, match=r"dark\.png: the mask is empty"):
            read_mask(tmp_path / "dark.png")
    with pytest.raises(InputError, match="the mask is 8x6 pixels, the pictures are 9x6"):
        read_mask(tmp_path / "grey.png", (6, 9))


@pytest.mark.parametrize(
    "array",
    [RGB8, RGB16, RGB8[..., 0], RGB16[..., 1], np.dstack([RGB8, RGB8[..., :1]]), RGB8[::2, ::-1]],
    ids=lambda a: f"{a.dtype}{a.shape}",
)
def test_write_png_is_read_by_others(tmp_path: Path, array: np.ndarray) -> None:
    write_png(tmp_path / "deep" / "a.png", array)
    if array.dtype == np.uint8:
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "deep" / "a.png")), array)
    wanted = array[..., :3] if array.ndim == 3 else np.repeat(array[..., None], 3, 2)
    np.testing.assert_array_equal(read_raw(tmp_path / "deep" / "a.png"), wanted)
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["a.png"]


def test_write_png_refuses_what_it_cannot_write(tmp_path: Path) -> None:
    for array in (RGB8 / 255, np.zeros((0, 4), np.uint8), np.zeros((4, 4, 2), np.uint8), np.zeros((2, 4, 4, 3), np.uint8)):
        with pytest.raises(InputError, match="uint8 or uint16"):
            write_png(tmp_path / "a.png", array)
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot be written"):
        write_png(tmp_path / "file" / "a.png", RGB8)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
