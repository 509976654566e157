"""Reading photographs into linear radiance, and writing the pictures that people look at.

PNG, TIFF, JPEG and EXR, told apart by their content and never by their name. Whole or refused: see `gen.picture_headers`.
"""

from __future__ import annotations

import io
import os
import struct
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen import large
from gen.capture import Bools, Fault, Floats
from gen.errors import InputError
from gen.files import library_silenced, memory, must_exist, writing
from gen.picture_headers import EXR, START, Header, damaged, inspect, require_picture
from gen.srgb import linear_to_srgb as linear_to_srgb
from gen.srgb import srgb_to_linear as srgb_to_linear
from gen.srgb import table

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
"""Names of files that a folder's reader takes for pictures end so (in any case of letters)."""

ENCODINGS = ("srgb", "linear")
MAX_BYTES = 4_000_000_000


@dataclass(frozen=True, eq=False)
class Picture:
    """One photograph in linear radiance.

    linear: (H, W, 3) float32; integers are divided by their top value, floats are as they stand, grey is repeated, NaN is 0.
    clipped: (H, W), a channel at the file's top value (255 or 65535; never in a file of floats).
    dark: (H, W), all three channels at or below black level 0. missing: (H, W), NaN or infinite, or fully transparent (alpha 0).
    encoding: "srgb" or "linear", how the file's numbers were read. said: whether the caller said so; otherwise it is the default
    of the file's kind (8-bit integers sRGB, 16-bit integers and floats linear). bits: of a sample.
    orientation: the EXIF value found, 1 to 8. It has been applied: the picture is upright as viewers show it.
    """

    linear: Floats
    clipped: Bools
    dark: Bools
    missing: Bools
    encoding: str
    said: bool
    bits: int
    orientation: int = 1

    @property
    def faults(self) -> NDArray[np.uint8]:
        """(H, W) sums of `gen.capture.Fault` flags. A missing sample is nothing else besides."""
        flags = np.zeros(self.missing.shape, np.uint8)
        flags[self.dark] |= np.uint8(Fault.DARK)
        flags[self.clipped] |= np.uint8(Fault.CLIPPED)
        flags[self.missing] = np.uint8(Fault.MISSING)
        return flags


@dataclass(frozen=True, eq=False)
class Frames:
    """K pictures of one view: images (K, H, W, 3) float32 linear, faults (K, H, W) uint8, and what they share; see `Picture`."""

    images: Floats
    faults: NDArray[np.uint8]
    encoding: str
    said: bool
    bits: int

    @property
    def reading(self) -> str:
        """How the numbers were read, in words for the record."""
        return f"{self.encoding} ({'as said' if self.said else f'default of {self.bits}-bit files'})"


def read_image(path: str | Path, encoding: str | None = None) -> Picture:
    """Read one photograph: PNG (grey, palette, RGB, with or without alpha), TIFF (8 or 16-bit, float), JPEG, EXR (R, G, B or Y).

    encoding: "srgb" or "linear" to say how the numbers are meant; None takes the default of the file's kind, and `Picture.said`
    records that. Of a TIFF with several pages the first is read. Raises InputError, one line that names the file, where it is
    missing, damaged, truncated, too large (`gen.files.MAX_PIXELS`, tested before decoding) or of a kind that is not read.
    """
    check_encoding(encoding)
    path = Path(path)
    raw, alpha, bits, orientation = _decode(path)
    used = encoding or ("srgb" if bits == 8 else "linear")
    missing = np.zeros(raw.shape[:2], bool) if alpha is None else alpha <= 0
    if raw.dtype.kind == "f":
        finite = np.isfinite(raw).all(axis=2)
        if not finite.all():
            missing = missing | ~finite
            raw = np.where(finite[..., None], raw, 0)
        clipped = np.zeros(missing.shape, bool)
    else:
        clipped = _any_channel(raw == np.iinfo(raw.dtype).max)
    dark = ~_any_channel(raw > 0)
    return Picture(_linear(raw, used), clipped, dark, missing, used, encoding is not None, bits, orientation)


def read_frames(paths: Sequence[Path], encoding: str | None = None) -> Frames:
    """Read the pictures of one capture, several at a time. See `read_image`.

    Raises InputError as that does, and where the pictures differ in size, default encoding or EXIF orientation, or would not fit
    into this machine's memory.
    """
    if not paths:
        raise InputError("there are no pictures to read")
    first = read_image(paths[0], encoding)
    H, W = first.clipped.shape
    need = len(paths) * H * W * 13
    if need > memory():
        raise InputError(
            f"{paths[0].parent}: {len(paths)} pictures of {W}x{H} need {need / 1e9:.0f} GB of memory; crop or shrink them"
        )
    images = large.empty((len(paths), H, W, 3), np.float32)
    faults = large.empty((len(paths), H, W), np.uint8)

    def put(k: int) -> None:
        picture = read_image(paths[k], encoding) if k else first
        require_alike(picture, first, paths[k], paths[0])
        images[k], faults[k] = picture.linear, picture.faults
        large.release(images)

    put(0)
    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        try:
            for _ in pool.map(put, range(1, len(paths))):
                pass
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return Frames(images, faults, first.encoding, encoding is not None, first.bits)


def read_mask(path: Path, size: tuple[int, int] | None = None) -> Bools:
    """(H, W) bool, true where a mask picture is white: above half of its range in a channel, and not transparent.

    A mask whose largest value is 1 is read as 0 and 1. size: the (H, W) that it must have. Raises InputError as `read_image`
    does, and where the mask is empty or of another size.
    """
    raw, alpha, _, _ = _decode(path)
    top = 1 if raw.dtype.kind == "f" or raw.max() == 1 else np.iinfo(raw.dtype).max
    mask = _any_channel(raw > top / 2)
    if alpha is not None:
        mask &= alpha > 0
    if size is not None and mask.shape != tuple(size):
        h, w = mask.shape
        raise InputError(f"{path}: the mask is {w}x{h} pixels, the pictures are {size[1]}x{size[0]}; they must have one size")
    if not mask.any():
        raise InputError(f"{path}: the mask is empty; white pixels must mark the object")
    return mask


def read_raw(path: Path) -> NDArray[Any]:
    """(H, W, 3) samples as they stand in the file (uint8, uint16 or float32), for data other than radiance: normal maps."""
    return _decode(Path(path))[0]


def write_png(path: Path, picture: NDArray[Any]) -> None:
    """Write a uint8 or uint16 picture, (H, W) grey, (H, W, 3) RGB or (H, W, 4) RGBA, as PNG, by a temporary name.

    Raises InputError where the place cannot be written or the array is something else.
    """
    import cv2

    picture = np.asarray(picture)
    channels = 1 if picture.ndim == 2 else picture.shape[-1]
    if (
        picture.dtype not in (np.uint8, np.uint16)
        or picture.ndim not in (2, 3)
        or channels not in (1, 3, 4)
        or 0 in picture.shape
    ):
        raise InputError(f"{path}: a PNG is written from a uint8 or uint16 picture, got {picture.dtype} of shape {picture.shape}")
    if picture.ndim == 3 and channels > 1:
        picture = cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2BGR if channels == 3 else cv2.COLOR_RGBA2BGRA)
    done, data = cv2.imencode(".png", np.ascontiguousarray(picture))
    if not done:
        raise InputError(f"{path}: a picture of shape {picture.shape} cannot be written as PNG")
    with writing(path) as temporary:
        temporary.write_bytes(data.tobytes())


def check_encoding(encoding: str | None) -> None:
    """InputError unless `encoding` is "srgb", "linear" or None."""
    if encoding is not None and encoding not in ENCODINGS:
        raise InputError(f"encoding {encoding!r} is unknown; say srgb or linear")


def _decode(path: Path) -> tuple[NDArray[Any], NDArray[Any] | None, int, int]:
    """((H, W, 3) uint8, uint16 or float32, RGB, upright; alpha (H, W) or None; bits; EXIF orientation)."""
    must_exist(path, "a picture")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: is larger than {MAX_BYTES // 1_000_000_000} GB")
        with path.open("rb") as stream:
            start = stream.read(START)
            if start.startswith(EXR):
                return _decode_exr(path)
            require_picture(start, path)  # before the rest of what may be anything is read
            data = start + stream.read()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    header = inspect(data, path)
    if header.orientation_at is not None and header.orientation != 1:
        place, layout = header.orientation_at
        editable = bytearray(data)
        struct.pack_into(layout, editable, place, 1)  # The decoder applies it for some kinds of TIFF and not for others.
        data = bytes(editable)
    decoded = _upright(_decode_bytes(data, header, path), header.orientation)
    channels = decoded.shape[2] if decoded.ndim == 3 else 1
    alpha = decoded[..., 3].copy() if channels == 4 else None
    return _to_rgb(decoded, channels), alpha, header.bits, header.orientation


_one_jpeg = threading.Lock()


def _decode_bytes(data: bytes, header: Header, path: Path) -> NDArray[Any]:
    import cv2

    buffer = np.frombuffer(data, np.uint8)
    decoded: NDArray[Any] | None
    # What libjpeg prints is its only sign of damage: one file at a time, so that it is this file's.
    with _one_jpeg if header.kind == "jpeg" else nullcontext(), library_silenced() as output:
        try:
            decoded = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)
        except (cv2.error, MemoryError) as error:
            raise damaged(path, "it cannot be decoded") from error
        printed = output() if header.kind == "jpeg" else ""
        if header.lzw and header.bits == 8 and decoded is not None and not _pillow_agrees(data):
            decoded = None
    if decoded is None:
        raise damaged(path, "it cannot be decoded")
    if "orrupt JPEG" in printed or "remature end" in printed:
        raise damaged(path, "bad picture data")
    kind = {8: np.uint8, 16: np.uint16}.get(header.bits) if not header.floats else {32: np.float32, 64: np.float64}[header.bits]
    if decoded.shape[:2] != (header.height, header.width) or decoded.dtype != kind:
        raise InputError(f"{path}: is stored in a way that is not read; save it as plain PNG or TIFF")
    return decoded


def _pillow_agrees(data: bytes) -> bool:
    """Whether an 8-bit LZW TIFF decodes to its end: cv2 reads on over wrong codes, Pillow stops. Beyond its own limit it is not asked."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data)) as image:
            image.load()
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        return True
    except Exception:  # it raises half a dozen kinds on damaged files
        return False
    return True


def _to_rgb(decoded: NDArray[Any], channels: int) -> NDArray[Any]:
    import cv2

    if decoded.dtype == np.float64:
        with np.errstate(over="ignore"):  # what is beyond float32 becomes infinite, and so a missing sample
            decoded = decoded.astype(np.float32)
    code = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}[channels]
    rgb: NDArray[Any] = cv2.cvtColor(np.ascontiguousarray(decoded), code)
    return rgb


def _decode_exr(path: Path) -> tuple[Floats, Floats | None, int, int]:
    from gen.exr import read_exr, stack

    channels = read_exr(path)
    rgb = stack(channels, "", "RGB")
    if rgb is None and "Y" in channels:
        rgb = np.repeat(channels["Y"][..., None], 3, axis=2)
    if rgb is None:
        raise InputError(f"{path}: holds neither R, G, B nor Y, but {', '.join(sorted(channels)[:8])}")
    return rgb, channels.get("A"), 32, 1


def _upright(stored: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Apply the EXIF orientation (EXIF 2.3, tag 0x0112)."""
    if orientation >= 5:
        stored = stored.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        stored = stored[::-1]
    if orientation in (2, 3, 6, 7):
        stored = stored[:, ::-1]
    return stored


def _linear(raw: NDArray[Any], encoding: str) -> Floats:
    import cv2

    if raw.dtype == np.uint8:
        linear: Floats = cv2.LUT(raw, table(8, encoding))
        return linear
    if raw.dtype == np.uint16:
        return np.take(table(16, encoding), raw)
    return np.asarray(srgb_to_linear(raw) if encoding == "srgb" else raw, dtype=np.float32)


def _any_channel(flags: Bools) -> Bools:
    """`flags.any(axis=2)` of (H, W, 3), which numpy does slowly along so short an axis."""
    result: Bools = flags[..., 0] | flags[..., 1] | flags[..., 2]
    return result


def require_alike(picture: Picture, first: Picture, path: Path, first_path: Path) -> None:
    """InputError unless a picture has the size, EXIF orientation and encoding of the first of its stack. The paths are for messages."""
    (h, w), (H, W) = picture.clipped.shape, first.clipped.shape
    if (h, w) != (H, W):
        raise InputError(f"{path}: is {w}x{h} pixels, but {first_path.name} is {W}x{H}; all pictures must have one size")
    if picture.orientation != first.orientation:
        raise InputError(
            f"{path}: its EXIF orientation is {picture.orientation}, that of {first_path.name} is {first.orientation}; "
            "turn all pictures the same way"
        )
    if picture.encoding != first.encoding:
        raise InputError(
            f"{path}: would be read as {picture.encoding} and {first_path.name} as {first.encoding}; "
            "say which holds for all, srgb or linear"
        )
