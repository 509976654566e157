"""True normals and depth beside photographs, in the files that data sets use for them."""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Bools, Floats, Truth
from gen.errors import InputError
from gen.files import must_exist, read_numbers
from gen.images import read_raw

NORMALS = (
    "Normal_gt.mat",
    "Normal_gt.npy",
    "normal_gt.npy",
    "normal_gt.npz",
    "Normal_gt.npz",
    "Normal_gt.png",
    "normals.png",
    "normal_map.png",
    "normal.txt",
    "Normal_gt.txt",
)
"""Files that may hold the true normals; the first that is there is read."""

DEPTHS = ("depth_gt.npz", "depth_gt.npy")

MAX_HEADER = 65_536
"""Bytes before the numbers of a .npy file, at most."""

LONGEST = 1e3
FARTHEST_MM = 1e9
"""A normal with a component that long, or a depth that large, is none."""

COMPRESSED = 15
"""The kind of a MATLAB element that is packed."""

MATLAB_NUMBERS = ("double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")


def read_truth(folder: Path, mask: Bools) -> Truth:
    """The true normals and depth of a photographed object, as far as they lie in `folder`.

    Normals: one of `NORMALS`; frame x right, y up, z to the viewer; pictures hold (n + 1) / 2 of their top value in R, G, B; text
    holds a row a pixel, row by row; arrays are (H, W, 3), under the key `Normal_gt` (.mat), `normal` or `Normal_gt` (.npz).
    They are made unit length, and zero outside the mask. Depth: `depth_gt.npz` (key `depth` or `depth_gt`) or `.npy`,
    millimetres along -z. Raises InputError where such a file is damaged, of another size, or holds something else.
    """
    return Truth(normals=_normals(folder, mask), depth=_depth(folder, mask))


def _normals(folder: Path, mask: Bools) -> Floats | None:
    path = next((folder / name for name in NORMALS if (folder / name).exists()), None)
    if path is None:
        return None
    shape = (*mask.shape, 3)
    given: NDArray[Any]
    if path.suffix == ".mat":
        given = _mat(path, shape)
    elif path.suffix in (".npy", ".npz"):
        given = _array(path, ("normal", "Normal_gt", "normals"), shape)
    elif path.suffix == ".txt":
        given = read_numbers(path, "true normals, x y z a row", 3, limit=500_000_000)
        if given.size != mask.size * 3:
            raise InputError(f"{path}: holds {len(given)} normals for {mask.size} pixels")
        given = given.reshape(shape)
    else:
        raw = read_raw(path)
        if raw.dtype.kind == "f" or raw.shape != shape:
            raise InputError(f"{path}: must be an 8 or 16-bit picture of {mask.shape[1]}x{mask.shape[0]} pixels (true normals)")
        given = 2.0 * raw / np.iinfo(raw.dtype).max - 1
    with np.errstate(invalid="ignore"):  # NaN is no normal either
        near = (np.abs(given) < LONGEST).all(axis=2, keepdims=True)
    n = np.where(mask[..., None] & near, given, 0).astype(np.float64)
    length = np.linalg.norm(n, axis=2)
    known = mask & (length > 0.1)
    if not known.any() or not 0.9 < np.median(length[known]) < 1.1:
        raise InputError(f"{path}: does not hold unit normals inside the mask")
    return np.where(known[..., None], n / np.where(known, length, 1)[..., None], 0).astype(np.float32)


def _depth(folder: Path, mask: Bools) -> Floats | None:
    path = next((folder / name for name in DEPTHS if (folder / name).exists()), None)
    if path is None:
        return None
    millimetres = _array(path, ("depth", "depth_gt"), mask.shape)
    known = mask & (millimetres > 0) & (millimetres < FARTHEST_MM)
    if not known.any():
        raise InputError(f"{path}: holds no positive depth inside the mask")
    return np.where(known, millimetres / 1000, np.nan).astype(np.float32)


def _array(path: Path, keys: tuple[str, ...], shape: tuple[int, ...]) -> NDArray[Any]:
    """One plain array of `shape` from a .npy file or an .npz archive. Its header is read first, so that no size is believed."""
    must_exist(path, "true values")
    try:
        if path.suffix == ".npy":
            with path.open("rb") as stream:
                return _plain_array(io.BytesIO(stream.read(math.prod(shape) * 16 + MAX_HEADER)), shape, path)
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            name = next((f"{key}.npy" for key in keys if f"{key}.npy" in names), None)
            if name is None:
                raise InputError(f"{path}: has no array named {' or '.join(keys)}, but {', '.join(names[:8])}")
            about = archive.getinfo(name)
            if about.file_size > math.prod(shape) * 16 + MAX_HEADER or about.compress_type not in (0, zipfile.ZIP_DEFLATED):
                raise InputError(f"{path}: array {name} is larger than the pictures ask for, or packed in a way that is not read")
            with archive.open(about) as member:
                return _plain_array(member, shape, path)
    except InputError:
        raise
    except Exception as error:  # zipfile and numpy raise a dozen kinds on damaged files
        raise InputError(f"{path}: is damaged or truncated ({error})") from error


def _plain_array(stream: IO[bytes], shape: tuple[int, ...], path: Path) -> NDArray[Any]:
    form: Any = np.lib.format  # untyped in numpy's own stubs
    read = form.read_array_header_1_0 if form.read_magic(stream) == (1, 0) else form.read_array_header_2_0
    found, column_major, dtype = read(stream)
    if dtype.hasobject or dtype.kind not in "fiu":
        raise InputError(f"{path}: holds Python objects or text instead of numbers; save a plain array")
    if found != shape:
        raise InputError(f"{path}: is an array of shape {found}, the pictures ask for {shape}")
    size = int(np.prod(shape)) * dtype.itemsize
    data = stream.read(size)
    if len(data) != size:
        raise InputError(f"{path}: is damaged or truncated (the array ends early)")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if column_major else "C")


def _small_mat(path: Path, room: int) -> bytes:
    """The bytes of a MATLAB file whose variables, unpacked, are no larger than `room`. Raises InputError where they are, zlib.error
    or struct.error where it is damaged.

    Source: MAT-File Format (The MathWorks), level 5: a header of 128 bytes, then elements, each with its kind and its length.
    """
    large = InputError(f"{path}: holds far more than true normals; save Normal_gt alone")
    if path.stat().st_size > room:
        raise large
    data = path.read_bytes()
    order, at = ("<" if data[126:128] == b"IM" else ">"), 128
    while at + 8 <= len(data) and data[126:128] in (b"IM", b"MI"):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        at += 8
        if kind == COMPRESSED:
            inflate, rest = zlib.decompressobj(), data[at : at + length]
            while rest and not inflate.eof:
                room -= len(inflate.decompress(rest, 1 << 20))
                rest = inflate.unconsumed_tail
                if room < 0:
                    raise large
        at += length
    return data


def _mat(path: Path, shape: tuple[int, ...]) -> NDArray[Any]:
    from scipy.io import loadmat, whosmat

    must_exist(path, "true normals")
    try:
        data = _small_mat(path, 64 * math.prod(shape) + (1 << 25))
        found = {name: (size, kind) for name, size, kind in whosmat(io.BytesIO(data))}  # type: ignore[arg-type] # streams too
        size, kind = found.get("Normal_gt", ((), ""))
        if size != shape or kind not in MATLAB_NUMBERS:
            held = ", ".join(f"{name} {size} {kind}" for name, (size, kind) in [*found.items()][:8])
            raise InputError(f"{path}: must hold Normal_gt, numbers of shape {shape}, holds {held or 'nothing'}")
        loaded = loadmat(io.BytesIO(data), variable_names=["Normal_gt"])  # type: ignore[arg-type] # streams too
        given = np.asarray(loaded["Normal_gt"])
    except InputError:
        raise
    except NotImplementedError as error:
        raise InputError(f"{path}: is a MATLAB 7.3 file; save it with -v7, or as Normal_gt.npy") from error
    except Exception as error:  # scipy raises a dozen kinds on damaged files
        raise InputError(f"{path}: is damaged or truncated ({error})") from error
    if given.dtype.kind not in "fiu" or given.shape != shape:
        raise InputError(f"{path}: Normal_gt is not an array of real numbers of shape {shape}")
    return given
