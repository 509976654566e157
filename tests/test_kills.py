"""Releases, trainings and benchmarks that are killed or interrupted at any moment: gone on with, they end as if nothing had happened.

Real commands, at moments drawn from the time that a whole run takes. One of each here, many under `make soak`; rendering has a campaign of
its own (tests/gen/sets/test_campaign_kills.py).
"""

from __future__ import annotations

import csv
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest

from gen.capture import Capture
from gen.formats.render_folder import write_render
from gen.sets.splits import write_splits
from tests.gen.release.conftest import contents
from tests.gen.sets.conftest import SET_SPEC, write_set
from tests.gen.sets.set_runs import ROOT, descendants, gone, wait_for

LONG = 20
"""Runs of a command that are ended before their time, under `make soak`; here one."""

SOON = 3.0
"""Seconds within which an interrupted command has ended."""

BENCH = """\
benchmark: small
seed: 1
gloss: [none, chromaticity]
draws: {count: 4, lights: 4}
"""


@dataclass(frozen=True)
class Command:
    """A command that can be gone on with. words: its arguments but the output's. begun: whether there is something to go on with.

    once: whether it refuses to be run on what is complete. made: what a run leaves, in a form in which two equal runs are equal.
    """

    words: list[str]
    begun: Callable[[Path], bool]
    made: Callable[[Path], object]
    once: bool = False

    def complete(self, output: Path) -> bool:
        """Whether there is nothing left to run."""
        return self.once and output.exists() and not self.begun(output)

    def start(self, output: Path, temporary: Path) -> subprocess.Popen[str]:
        resume = ["--resume"] if self.begun(output) else []
        command = [sys.executable, "-m", "degloss", *self.words, "-o", str(output), *resume]
        environment = {**os.environ, "TMPDIR": str(temporary), "OMP_NUM_THREADS": "1"}
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment)


def _release(folder: Path, synthetic: Callable[..., Capture]) -> Command:
    (folder / "set.yaml").write_text(SET_SPEC)
    write_splits(write_set(folder / "set.yaml", folder / "set", synthetic), (0.6, 0.2, 0.2))
    words = ["gen", "release", str(folder / "set"), "--version", "1.0.0", "--shard-mb", "1"]
    return Command(words, lambda output: (output.parent / f".{output.name}.partial").exists(), contents, once=True)


def _train(folder: Path, synthetic: Callable[..., Capture]) -> Command:
    if find_spec("torch") is None:
        pytest.skip("torch is not installed")
    from safetensors.torch import load_file

    from learn.config import read_config
    from tests.learn.small_runs import TIMES, with_text, write_tiny_pack

    pack = write_tiny_pack(folder / "tiny.safetensors")
    steps = {"steps": "60", "log_every": "3", "sample_every": "0", "validate_every": "20", "checkpoint_every": "5"}
    (folder / "config.toml").write_text(with_text(read_config("smoke-specular").text, "train", steps))

    def made(output: Path) -> object:
        with (output / "log.csv").open(newline="") as stream:
            rows = [{key: value for key, value in row.items() if key not in TIMES} for row in csv.DictReader(stream)]
        tensors = load_file(output / "weights.safetensors")
        return rows, {key: tensor.numpy().tobytes() for key, tensor in tensors.items()}

    words = ["learn", "train", str(folder / "config.toml"), "--device", "cpu", "--data", f"pack={pack}"]
    return Command(words, lambda output: (output / "config.toml").exists(), made)


def _bench(folder: Path, synthetic: Callable[..., Capture]) -> Command:
    for shape in ("sphere", "cylinder"):
        write_render(synthetic(shape, 48), folder / "captures" / shape)
    (folder / "bench.yaml").write_text(BENCH)

    def made(output: Path) -> object:
        rows = [json.loads(line) for line in (output / "results.jsonl").read_text().splitlines()]
        names = sorted(path.relative_to(output).as_posix() for path in output.rglob("*"))
        return [{key: value for key, value in row.items() if key != "seconds"} for row in rows], names

    words = ["recon", "bench", str(folder / "bench.yaml"), str(folder / "captures"), "--workers", "2"]
    return Command(words, lambda output: (output / "benchmark.json").exists(), made)


COMMANDS = {"release": _release, "train": _train, "bench": _bench}


@pytest.mark.parametrize(
    ("number", "times"),
    [
        pytest.param(signal.SIGKILL, 1, id="killed once"),
        pytest.param(signal.SIGKILL, LONG, id="killed often", marks=pytest.mark.soak),
        pytest.param(signal.SIGINT, LONG, id="interrupted often", marks=pytest.mark.soak),
    ],
)
@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_ended_early_goes_on_to_the_same(
    name: str, times: int, number: int, synthetic: Callable[..., Capture], tmp_path: Path
) -> None:
    source, outputs, temporary = (tmp_path / part for part in ("in", "out", "tmp"))
    for folder in (source, outputs, temporary):
        folder.mkdir()
    command, rng = COMMANDS[name](source, synthetic), random.Random(f"{name} {number}")
    begin = time.monotonic()
    finish(command, outputs / "whole", temporary)
    whole, seconds = command.made(outputs / "whole"), time.monotonic() - begin

    ended = runs = 0
    while ended < times:
        output = outputs / f"run-{runs}"
        runs += 1
        while ended < times and end_early(command, output, temporary, rng.uniform(0, seconds), number):
            ended += 1
        finish(command, output, temporary)
        assert command.made(output) == whole
        assert {path.name for path in outputs.iterdir()} == {"whole", *(f"run-{i}" for i in range(runs))}
    assert not [path for path in temporary.rglob("*") if not of_others(path)]


def end_early(command: Command, output: Path, temporary: Path, seconds: float, number: int) -> bool:
    """Send a command a signal after so long; whether it was still running."""
    resumed = command.begun(output)
    with command.start(output, temporary) as process:
        wait_for(lambda: hears(process.pid), process)
        time.sleep(seconds)
        started = list(descendants(process.pid))
        process.send_signal(number)
        begin = time.monotonic()
        out, err = process.communicate(timeout=30)
    assert gone(started), "processes outlive the command that started them"
    if process.returncode == 0 or (number == signal.SIGINT and process.returncode == -number):
        assert out, "it has not said what it made"  # Python listens no more when all is said
        return False
    if number == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
        return not command.complete(output)
    assert time.monotonic() - begin < SOON
    assert process.returncode == 130, err
    assert "Traceback" not in err, err
    assert resumed or not command.begun(output) or "--resume" in err, err
    return True


def of_others(path: Path) -> bool:
    """Whether a temporary file is none of ours: torch's empty folder, or what Python writes to try whether a folder can be written."""
    return path.name.startswith("torchinductor_") or (
        len(path.name) == 8 and path.is_file() and path.read_bytes() in (b"", b"blat")
    )


def hears(process: int) -> bool:
    """Whether a command has come so far that it takes signals as it wants: of these SIGTERM is one that Python leaves alone."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False
    return bool(int(status.split("SigCgt:")[1].split()[0], 16) >> (signal.SIGTERM - 1) & 1)


def finish(command: Command, output: Path, temporary: Path) -> None:
    """Run a command to its end, going on with what is there."""
    if command.complete(output):
        return
    with command.start(output, temporary) as process:
        _, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
