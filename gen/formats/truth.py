"""True normals and depth beside photographs, in the files that data sets use for them."""

from __future__ import annotations

import zipfile
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
    n = np.where(mask[..., None] & np.isfinite(given).all(axis=2, keepdims=True), given, 0).astype(np.float64)
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
    known = mask & np.isfinite(millimetres) & (millimetres > 0)
    if not known.any():
        raise InputError(f"{path}: holds no positive depth inside the mask")
    return np.where(known, millimetres / 1000, np.nan).astype(np.float32)


def _array(path: Path, keys: tuple[str, ...], shape: tuple[int, ...]) -> NDArray[Any]:
    """One plain array of `shape` from a .npy file or an .npz archive. Its header is read first, so that no size is believed."""
    must_exist(path, "true values")
    try:
        if path.suffix == ".npy":
            with path.open("rb") as stream:
                return _plain_array(stream, shape, path)
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            name = next((f"{key}.npy" for key in keys if f"{key}.npy" in names), None)
            if name is None:
                raise InputError(f"{path}: has no array named {' or '.join(keys)}, but {', '.join(names[:8])}")
            with archive.open(name) as member:
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


def _mat(path: Path, shape: tuple[int, ...]) -> NDArray[Any]:
    from scipy.io import loadmat, whosmat

    must_exist(path, "true normals")
    try:
        found = {name: size for name, size, _ in whosmat(str(path))}
        if found.get("Normal_gt") != shape:
            raise InputError(f"{path}: must hold Normal_gt of shape {shape}, holds {found or 'nothing'}")
        given = np.asarray(loadmat(str(path), variable_names=["Normal_gt"])["Normal_gt"])
    except InputError:
        raise
    except NotImplementedError as error:
        raise InputError(f"{path}: is a MATLAB 7.3 file; save it with -v7, or as Normal_gt.npy") from error
    except Exception as error:  # scipy raises a dozen kinds on damaged files
        raise InputError(f"{path}: is damaged or truncated ({error})") from error
    if given.dtype.kind not in "fiu" or given.shape != shape:
        raise InputError(f"{path}: Normal_gt is not an array of real numbers of shape {shape}")
    return given
