"""Ends what a run by Ray has started, however the run ended: `python -m gen.sets.ray_reaper`, with a pipe from the run as its input.

Where the run is killed, Ray's own agents go on looking for their head for a minute. This waits for the pipe to close, and until then notes
which processes stem from the run, since they can no longer be told from others when their parents are gone.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

LOOK_EVERY = 0.5
"""Seconds."""


@contextmanager
def reaped() -> Iterator[None]:
    """Nothing that is started in the block outlives it, nor this process."""
    with subprocess.Popen(
        [sys.executable, "-P", "-m", "gen.sets.ray_reaper"],
        stdin=subprocess.PIPE,
        start_new_session=True,  # an interrupt from the keyboard is not for it
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).resolve().parents[2]), *_given()])},
    ) as reaper:
        assert reaper.stdin is not None
        try:
            yield
        finally:
            reaper.stdin.close()


def wait_and_end() -> None:
    """Wait until standard input closes, then kill what stems from this process's parent and still lives."""
    parent = os.getppid()
    known: dict[int, str] = {}
    while not select.select([0], [], [], LOOK_EVERY)[0]:
        known |= _descendants(parent)
    known |= _descendants(parent)
    for pid, born in known.items():
        if _look(pid)[1] == born:
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)


def _descendants(parent: int) -> dict[int, str]:
    """The processes that stem from `parent`, but for this one, each with the time at which it began."""
    every = {int(place.name): _look(int(place.name)) for place in Path("/proc").glob("[0-9]*")}
    found: dict[int, str] = {}
    generation = {parent}
    while generation:
        generation = {pid for pid, (above, _) in every.items() if above in generation and pid != os.getpid()}
        found |= {pid: every[pid][1] for pid in generation}
    return found


def _look(pid: int) -> tuple[int, str]:
    """A process's parent and the time at which it began; (0, "") where there is none."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return 0, ""
    return int(words[1]), words[19]


def _given() -> list[str]:
    return list(filter(None, [os.environ.get("PYTHONPATH")]))


if __name__ == "__main__":
    wait_and_end()
