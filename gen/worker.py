"""One worker process that holds a Blender: how it is started, asked, watched and ended.

Jobs and replies are JSON lines on descriptors of their own, since Blender prints to standard output as it likes.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from gen.errors import InputError
from gen.parts import BLENDERS_PLACES

KEEPS_MEMORY = {"MALLOC_MMAP_THRESHOLD_": 1 << 25, "MALLOC_TRIM_THRESHOLD_": 1 << 26, "MALLOC_TOP_PAD_": 1 << 24}
"""What a worker is told of memory, in bytes (glibc's mallopt; elsewhere it means nothing): keep up to 64 MiB of what a render gave back,
since asking the system for it again, and having it zeroed, takes a tenth of a small render's time. The caller's own settings come first."""


class WorkerLost(Exception):
    """A worker process crashed, hung or spoke nonsense. ended: its exit code where it ended by itself."""

    def __init__(self, reason: str, ended: int | None = None) -> None:
        super().__init__(reason)
        self.ended = ended


class Worker:
    """One Blender in a process of its own.

    blender: path of an installed Blender, or None for the bpy module in this Python. threads: of Cycles, 0 for all cores.
    start_timeout: seconds until it must answer. device: "auto", "cpu" or "gpu". scratch: a folder for what Blender leaves behind, by
    default the system's. Raises InputError where the program cannot be started at all.
    """

    def __init__(
        self,
        blender: str | None = None,
        threads: int = 0,
        start_timeout: float = 180.0,
        device: str = "cpu",
        scratch: Path | None = None,
    ) -> None:
        self._buffer = b""
        self.jobs_done = 0
        self.info: Mapping[str, Any] = {}
        self._start_timeout = start_timeout
        self._log = tempfile.TemporaryFile(dir=scratch)  # noqa: SIM115 - bpy prints here as it likes; closed in `kill`
        self._scratch = tempfile.TemporaryDirectory(
            prefix="degloss-blender-", dir=scratch, ignore_cleanup_errors=True
        )  # for what Blender leaves
        jobs_out, self._to = os.pipe()
        self._from, replies_in = os.pipe()
        try:
            self._process = subprocess.Popen(
                [*_command(blender), "--worker", *_options(jobs_out, replies_in, threads, device)],
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
                pass_fds=(jobs_out, replies_in),
                env=_environment(blender) | dict.fromkeys(BLENDERS_PLACES, self._scratch.name),
                start_new_session=True,  # so that a launcher's children can be ended with it, and Ctrl-C is ours to handle
            )
        except OSError as error:
            for fd in (self._to, self._from):
                os.close(fd)
            self._log.close()
            self._scratch.cleanup()
            raise InputError(f"{_command(blender)[0]}: cannot be started ({error.strerror})") from error
        finally:
            os.close(jobs_out)
            os.close(replies_in)
        os.set_blocking(self._to, False)

    def wait_until_ready(self) -> None:
        """Wait for the worker's first line."""
        reply = self._receive(time.monotonic() + self._start_timeout)
        if reply.get("ready") is not True:
            raise WorkerLost(str(reply.get("error", "its first line does not say that it is ready")), 1)
        self.info = reply

    def ask(self, job: Mapping[str, Any], timeout: float) -> Mapping[str, Any]:
        """The worker's reply to a job. Raises WorkerLost where none came within `timeout` seconds."""
        deadline = time.monotonic() + timeout
        line = memoryview((json.dumps(job) + "\n").encode())
        while line:
            self._wait_for(self._to, select.POLLOUT, deadline)
            try:
                line = line[os.write(self._to, line) :]
            except BlockingIOError:
                continue
            except OSError:
                raise self._lost() from None
        reply = self._receive(deadline)
        if reply.get("id") != job["id"] or not isinstance(reply.get("ok"), bool):
            raise WorkerLost("answered with a line that is no reply to its job")
        self.jobs_done += 1
        return reply

    def close(self) -> None:
        """Let the worker end by itself, briefly; then end it."""
        if self._to >= 0:
            os.close(self._to)
            self._to = -1
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=3)
        self.kill()

    def kill(self) -> None:
        """End the process and all it started, now."""
        self.end_process()
        for fd in (self._to, self._from):
            if fd >= 0:
                os.close(fd)
        self._to = self._from = -1
        self._log.close()
        self._scratch.cleanup()

    def end_process(self) -> None:
        """Kill the process group and wait for it; whoever reads from the worker then sees its end. Safe from any thread."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _receive(self, deadline: float) -> Mapping[str, Any]:
        while b"\n" not in self._buffer:
            self._wait_for(self._from, select.POLLIN, deadline)
            chunk = os.read(self._from, 1 << 16)
            if not chunk:
                raise self._lost()
            self._buffer += chunk
        line, self._buffer = self._buffer.split(b"\n", 1)
        try:
            reply = json.loads(line)
        except ValueError:
            reply = None
        if not isinstance(reply, dict):
            raise WorkerLost(f"spoke nonsense on its descriptor: {line[:80]!r}")
        return reply

    def _wait_for(self, fd: int, event: int, deadline: float) -> None:
        poll = select.poll()
        poll.register(fd, event)
        if not poll.poll(max(0.0, deadline - time.monotonic()) * 1000):
            raise WorkerLost("did not answer in time")

    def _lost(self) -> WorkerLost:
        try:
            code = self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            return WorkerLost("closed its descriptors without ending")
        size = os.fstat(self._log.fileno()).st_size
        tail = os.pread(self._log.fileno(), 4000, max(0, size - 4000)).decode("utf-8", "replace").strip().splitlines()
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        return WorkerLost(how + (f": {tail[-1].strip()}" if tail else ""), code)


def _package() -> Path:
    from blender_scenes import shapes  # the part that needs no bpy

    return Path(shapes.__file__).resolve().parent.parent


def _command(blender: str | None) -> list[str]:
    if blender is None:
        # -P keeps the current folder off the path: a stray numpy.py there must not be imported.
        return [sys.executable, "-P", "-m", "blender_scenes"]
    script = str(_package() / "__main__.py")
    return [blender, "-b", "--factory-startup", "--python-exit-code", "1", "--python", script, "--"]


def _options(jobs: int, replies: int, threads: int, device: str) -> list[str]:
    return ["--in", str(jobs), "--out", str(replies), "--threads", str(threads), "--device", device]


def _environment(blender: str | None) -> dict[str, str]:
    around = {name: str(size) for name, size in KEEPS_MEMORY.items()} | os.environ
    if blender is not None:
        return around
    paths = [str(_package().parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**around, "PYTHONPATH": os.pathsep.join(paths)}
