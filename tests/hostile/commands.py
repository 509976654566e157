"""The command run within the test's own process, and what every refusal must be: one line, exit code 2, nothing left behind."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

import degloss

SIGNALS = (signal.SIGALRM, signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
MEGABYTES = 90
"""Memory that a refusal may take at most, beyond what the process has: libraries that are loaded on the way are in it."""

SECONDS = 20
"""Seconds of a processor that it may take."""


@dataclass(frozen=True)
class Case:
    """A hostile input of a command.

    lay: writes it into an empty folder. command: the words after `degloss`, HERE standing for that folder. names: what the line must
    name, the end of the file's path as a rule. says: what else it must say.
    """

    lay: Callable[[Path], object]
    command: str
    names: str
    says: str

    def words(self, folder: Path) -> list[str]:
        """The command line."""
        return [word.replace("HERE", str(folder)) for word in self.command.split()]


@dataclass(frozen=True)
class Outcome:
    """code: of the exit. seconds: of a processor. megabytes: by which memory grew at most, 0 where the system does not say."""

    code: int
    seconds: float
    megabytes: float


def run(*words: object) -> Outcome:
    """The command `degloss`, by its own entry, in this process; what it prints is the caller's to capture."""
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    before, sys.argv = sys.argv, ["degloss", *map(str, words)]
    code: object = 0
    resident, started = _forget_peak(), time.process_time()
    try:
        degloss.main()
    except SystemExit as end:
        code = end.code or 0
    finally:
        sys.argv = before
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert isinstance(code, int)
    return Outcome(code, time.process_time() - started, max(0.0, _memory("VmHWM") - resident))


def require_refusal(case: Case, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Lay a hostile input, run the command on it, and check the refusal."""
    case.lay(folder)
    before = tree(folder)
    capfd.readouterr()
    outcome = run(*case.words(folder))
    out, err = capfd.readouterr()
    assert outcome.code == 2, (out, err)
    assert out == ""
    require_line(err, case.names, case.says)
    assert tree(folder) == before
    assert outcome.megabytes < MEGABYTES
    assert outcome.seconds < SECONDS


def require_line(err: str, names: str, says: str) -> None:
    """One line on stderr that names the file and says what is wrong."""
    assert err.count("\n") == 1, err
    assert err.startswith("degloss: "), err
    assert names in err, err
    assert says in err, err
    assert len(err) < 10_000, err


def tree(folder: Path) -> dict[str, tuple[int, int]]:
    """Everything in a folder, hidden names too: (mode, size of a file) by path."""
    return {
        path.relative_to(folder).as_posix(): (path.lstat().st_mode, path.lstat().st_size if path.is_file() else 0)
        for path in folder.rglob("*")
    }


@contextmanager
def bound_by_permissions() -> Iterator[None]:
    """Files may be opened as their permissions say, also where the tests run as root, whom none stops: its right to pass them over is laid
    down for as long (capabilities(7))."""
    kernel = ctypes.CDLL(None, use_errno=True)
    head = (ctypes.c_uint32 * 2)(0x20080522, 0)  # _LINUX_CAPABILITY_VERSION_3, this thread
    held = (ctypes.c_uint32 * 6)()  # effective, permitted and inheritable, twice
    laid_down = 1 << 1 | 1 << 2  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH

    def settle(effective: int) -> None:
        held[0] = effective
        assert kernel.capset(head, held) == 0, os.strerror(ctypes.get_errno())

    assert kernel.capget(head, held) == 0, os.strerror(ctypes.get_errno())
    before = held[0]
    settle(before & ~laid_down)
    try:
        yield
    finally:
        settle(before)


def _forget_peak() -> float:
    """Megabytes of this process now, from which on the kernel's own high-water mark counts."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return float("inf")
    return _memory("VmRSS")


def _memory(field: str) -> float:
    try:
        text = Path("/proc/self/status").read_text(encoding="utf-8")
    except OSError:
        return 0.0
    return int(text.split(f"{field}:")[1].split()[0]) / 1024
