"""Shards: ustar archives whose every byte follows from the names and contents in them (POSIX.1-1988, times and owners 0)."""

from __future__ import annotations

import hashlib
import tarfile
from functools import lru_cache
from typing import IO

from gen.errors import InputError

BLOCK = tarfile.BLOCKSIZE
RECORD = tarfile.RECORDSIZE


def header(name: str, size: int) -> bytes:
    """The 512 bytes before a regular file of that name and size. Raises InputError where the name does not fit."""
    info = tarfile.TarInfo(name)
    info.size, info.mode = size, 0o644  # all else is 0 or empty as it is made
    try:
        return info.tobuf(tarfile.USTAR_FORMAT, "ascii", "strict")
    except ValueError as error:
        raise InputError(f"{name}: cannot stand in a shard ({error})") from error


@lru_cache(maxsize=BLOCK)
def _zeros(count: int) -> bytes:
    return bytes(count)


def padding(size: int) -> bytes:
    """The zeros that follow a file of that size."""
    return _zeros(-size % BLOCK)


def ending(length: int) -> bytes:
    """The zeros that end a shard of that length so far: two blocks, then up to a whole record."""
    return bytes(2 * BLOCK + -(length + 2 * BLOCK) % RECORD)


class ShardWriter:
    """Writes files one after another into a stream, and hashes what it writes."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._digest, self.length = stream, hashlib.sha256(), 0

    def add(self, name: str, data: bytes) -> int:
        """Append a file; the offset of its first byte in the shard."""
        self._put(header(name, len(data)))
        offset = self.length
        self._put(data)
        self._put(padding(len(data)))
        return offset

    def end(self) -> str:
        """Write the end of the shard; the SHA-256 of the whole, in hexadecimal."""
        self._put(ending(self.length))
        return self._digest.hexdigest()

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._digest.update(data)
        self.length += len(data)
