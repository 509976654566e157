"""A hidden folder for what a process is working on, inside the folder that it works for, so that whoever comes next can sweep it.

`kill -9` cannot be answered: the next process removes what a dead one left. Whether one is dead is told by a file that each
locks for as long as it lives; where processes of several machines share a file system that does not enforce locks between them, by the
time at which the file was last touched.
"""

from __future__ import annotations

import os
import re
import shutil
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

TOUCHED_EVERY = 30.0
DEAD_AFTER = 600.0
"""Seconds: how often a living process touches its lock file, and how long another machine's must have lain untouched."""

NAME = re.compile(r"\.work\.(?P<host>[A-Za-z0-9-]+)\.(?P<process>\d+)\.(?P<token>[0-9a-f]{8})")


@contextmanager
def work_folder(parent: Path) -> Iterator[Path]:
    """A new hidden folder in `parent`, which is removed when the block ends; those of dead processes are removed before and after."""
    lock, descriptor = _locked(parent)
    folder = lock.with_suffix("")
    ended = threading.Event()
    threading.Thread(target=_touch, args=(lock, ended), daemon=True).start()
    try:
        folder.mkdir()
        sweep(parent, lock)
        yield folder
    finally:
        ended.set()
        _remove(folder)
        lock.unlink(missing_ok=True)
        os.close(descriptor)
        sweep(parent)


def sweep(parent: Path, own: Path | None = None) -> None:
    """Remove what dead processes left in `parent`. own: a lock file of this process, to tell the file system's time by."""
    if own is not None:
        with suppress(OSError):
            os.utime(own)
    for place in sorted(parent.iterdir()):
        match = NAME.fullmatch(place.name.removesuffix(".lock"))
        if match is None or (own is not None and place.name.removesuffix(".lock") == own.stem) or place.is_symlink():
            continue
        if place.suffix == ".lock":
            _sweep_one(place, match["host"], own)
        elif not place.with_name(f"{place.name}.lock").exists():
            _remove(place)


def elsewhere(folder: Path) -> Path:
    """The folder outside that goes with a work folder: for sockets, whose paths must be short. Swept with it."""
    match = NAME.fullmatch(folder.name)
    assert match is not None
    place = tempfile.gettempdir()
    return Path(place if len(place) < 24 else "/tmp", f"degloss-ray-{match['token']}")


def _locked(parent: Path) -> tuple[Path, int]:
    """A new lock file that this process holds, and its descriptor (not inherited by what it starts)."""
    while True:
        lock = parent / f".work.{_host()}.{os.getpid()}.{os.urandom(4).hex()}.lock"
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        if _lock(descriptor) is not False and lock.exists():
            return lock, descriptor
        os.close(descriptor)  # another process took it for a dead one's before it was locked


def _sweep_one(lock: Path, host: str, own: Path | None) -> None:
    try:
        descriptor = os.open(lock, os.O_RDWR | os.O_NOFOLLOW)
    except OSError:
        return
    try:
        locked = _lock(descriptor)
        untouched = 0.0 if own is None else own.stat().st_mtime - os.fstat(descriptor).st_mtime
        if locked is False or ((locked is None or host != _host()) and untouched < DEAD_AFTER):
            return  # it lives
        _remove(lock.with_suffix(""))
        lock.unlink(missing_ok=True)
    finally:
        os.close(descriptor)


def _lock(descriptor: int) -> bool | None:
    """Lock a file. False where another process has it, None where the file system knows no locks."""
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname())[:40] or "host"


def _remove(folder: Path) -> None:
    shutil.rmtree(elsewhere(folder), ignore_errors=True)
    shutil.rmtree(folder, ignore_errors=True)


def _touch(lock: Path, ended: threading.Event) -> None:
    while not ended.wait(TOUCHED_EVERY):
        with suppress(OSError):
            os.utime(lock)
