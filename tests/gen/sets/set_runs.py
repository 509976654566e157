"""What the tests of campaigns share: a tiny set, its folder as bytes, runs of the command, and the processes that they start."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]

TINY = """\
# six items of one or two pictures
set: tiny
seed: 3
groups:
  - name: pair
    split: train
    count: 3
    capture:
      resolution: [32, 32]
      shape: {name: cylinder, radius: {uniform: [6, 10]}, length: 20, segments: 32}
      lights: {pattern: random, count: 2}
      camera: {kind: orthographic, width_mm: 30}
  - name: one
    count: 3
    single: true
    capture:
      resolution: [40, 32]
      shape: {name: rounded_box, width: {uniform: [8, 14]}, height: 10, depth: 9, radius: 1}
      pose: {rotation_degrees: {rotation: uniform}}
      lights: {pattern: random, count: 1}
      camera: {kind: orthographic, width_mm: 30}
      exposure: {percentile: 50, level: 0.9}
"""


def contents(folder: Path) -> dict[str, bytes | None]:
    """Every file of a set folder but its diary, and every folder (None), hidden ones included."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
        if path.name != "events.jsonl"
    }


def start(*arguments: object, **options: object) -> subprocess.Popen[str]:
    """The command `degloss gen ...`, started."""
    command = [sys.executable, "-m", "degloss", "gen", *map(str, arguments)]
    return subprocess.Popen(  # type: ignore[call-overload, no-any-return]
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, **options
    )


def run(*arguments: object, **options: object) -> tuple[int, str, str]:
    """The command's exit code, standard output and standard error."""
    with start(*arguments, **options) as process:
        out, err = process.communicate(timeout=120)
    return process.returncode, out, err


def wait_for(what: Callable[[], bool], process: subprocess.Popen[str], seconds: float = 60) -> None:
    """Wait until something is so, or the process has ended."""
    deadline = time.monotonic() + seconds
    while not what() and process.poll() is None:
        assert time.monotonic() < deadline, "it took too long"
        time.sleep(0.005)


def items(folder: Path) -> int:
    """How many items a set folder has so far."""
    return len(list((folder / "items").iterdir())) if (folder / "items").is_dir() else 0


def descendants(parent: int) -> dict[int, str]:
    """The command lines of the living processes that stem from `parent`, by their number."""
    parents: dict[int, int] = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, above = status.read_text().rsplit(")", 1)[1].split()[:2]
        except OSError:
            continue
        if state != "Z":
            parents[int(status.parent.name)] = int(above)
    found: dict[int, str] = {}
    generation = {parent}
    while generation:
        generation = {pid for pid, above in parents.items() if above in generation}
        for pid in generation:
            try:
                found[pid] = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
            except OSError:
                continue
    return found


def blenders(parent: int = os.getpid()) -> list[int]:
    """The render workers that stem from `parent`."""
    return [pid for pid, command in descendants(parent).items() if "blender_scenes" in command]


def gone(pids: list[int], seconds: float = 5) -> bool:
    """Whether processes end within that time."""
    deadline = time.monotonic() + seconds
    while any(_lives(pid) for pid in pids):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
