"""Arrays that may be larger than memory: from `LARGE` on they lie in a file without a name, of which only what is worked on is in memory.

The file is gone with the last use of the array, or with the process, however that ends. It lies in the folder that TMPDIR names, else in
/var/tmp: on many systems /tmp is itself memory.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gen.errors import InputError

LARGE = 1 << 28
"""Bytes from which an array lies in a file: five pictures of 4.5 megapixels, in floats, do."""

STRIP = 20_000_000
"""Samples (pixels times pictures) that are worked on at a time: what is made of each by the way stays under some hundred MB."""


def empty(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array that is to be filled. Raises InputError where there is no room on the disk for it."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    return np.empty(shape, dtype) if size < LARGE else np.ndarray(shape, dtype, _mapped(size))


def zeros(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of zeros. Errors as for `empty`."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    return np.zeros(shape, dtype) if size < LARGE else np.ndarray(shape, dtype, _mapped(size))


def copy(array: NDArray[Any]) -> NDArray[Any]:
    """A copy of an array (K, ...), one of its K after another. Errors as for `empty`."""
    result = empty(array.shape, array.dtype)
    for k, part in enumerate(array):
        result[k] = part
        release(array, result)
    return result


def release(*arrays: NDArray[Any] | None) -> None:
    """Take what lies in files out of memory, till it is looked at again; the values stay. Arrays that lie in none are passed over."""
    for array in arrays:
        base: Any = array
        while isinstance(base, np.ndarray):
            base = base.base
        if isinstance(base, mmap.mmap):
            base.madvise(mmap.MADV_DONTNEED)


def strips(shape: tuple[int, ...]) -> Iterator[slice]:
    """The rows of pictures (K, H, W, ...) in strips of about `STRIP` samples: one strip holds all where they are fewer."""
    count, height, width = shape[:3]
    step = max(STRIP // (count * width), 1)
    for start in range(0, height, step):
        yield slice(start, min(start + step, height))


def _mapped(size: int) -> mmap.mmap:
    """Zeros in a file that has no name."""
    said = os.environ.get("TMPDIR")
    folder = Path(said or ("/var/tmp" if os.access("/var/tmp", os.W_OK) else tempfile.gettempdir()))
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, size)  # else a full disk would end the process at the first write
            return mmap.mmap(file.fileno(), size)
    except OSError as error:
        raise InputError(
            f"{folder}: has no room for {size / 1e9:.1f} GB of working files ({error.strerror or error}); make room, or set TMPDIR"
        ) from error
