"""Long use in one process: memory and open files stay flat. Short here, long under `make soak`."""

from __future__ import annotations

import gc
import os
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Capture
from recon.pipeline import measure

Synthetic = Callable[..., Capture]


def resident() -> int:
    """Megabytes of this process in memory."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) // 1024
    raise AssertionError("no VmRSS")


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="this system has no /proc")
@pytest.mark.parametrize("runs", [9, pytest.param(200, marks=pytest.mark.soak)])
def test_measuring_again_and_again_leaks_nothing(runs: int, synthetic: Synthetic, tmp_path: Path) -> None:
    capture = synthetic("sphere", 96)
    memory, files = [], []
    for _ in range(runs):
        measure(capture).write(tmp_path / "out")
        gc.collect()
        memory.append(resident())
        files.append(open_files())
    third = runs // 3
    assert np.median(memory[-third:]) - np.median(memory[third : 2 * third]) < 20
    assert files[-1] <= files[third]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.render
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="this system has no /proc")
@pytest.mark.parametrize("runs", [20, pytest.param(400, marks=pytest.mark.soak)])
def test_rendering_again_and_again_stays_bounded(runs: int) -> None:
    """Five pictures a run. Blender itself grows by some 0.4 MB a job, so the farm replaces a worker before that adds up."""
    from gen.farm import Farm
    from gen.render import render
    from gen.spec import read_spec

    spec = read_spec("small-sphere")
    memory = []
    others = set(worker_memory())
    with Farm() as farm:
        for _ in range(runs):
            render(spec, farm=farm)
            memory += [size for pid, size in worker_memory().items() if pid not in others]  # none where it was just replaced
    assert 50 < max(memory) < 600
    growth = np.diff(memory[len(memory) // 2 :])
    # Megabytes a run. What a replaced worker gives back does not count; the allocator's own ups and downs do, both of them.
    assert growth[growth > -30].sum() / len(growth) < 3
    assert not set(worker_memory()) - others


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="this system has no /proc")
@pytest.mark.parametrize(
    ("method", "steps"),
    [("specular", 60), *(pytest.param(name, 1000, marks=pytest.mark.soak) for name in ("specular", "group"))],
)
def test_training_on_and_on_leaks_nothing(method: str, steps: int, tmp_path: Path) -> None:
    """With a log, samples, validation and checkpoints all the time; looked at fifty times a second."""
    pytest.importorskip("torch")
    from learn.train import train
    from tests.learn.small_runs import smoke_config, write_tiny_pack

    often = {"log_every": 10, "sample_every": 25, "validate_every": 20, "checkpoint_every": 10}
    config = smoke_config(method, write_tiny_pack(tmp_path / "tiny.safetensors"), steps=steps, **often)
    memory, files, over = [], [], threading.Event()

    def watch() -> None:
        while not over.wait(0.02):
            memory.append(resident())
            files.append(open_files())

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        assert train(config, tmp_path / "run", device="cpu", progress=None).steps == steps
    finally:
        over.set()
        watcher.join()
    third = len(memory) // 3
    assert np.median(memory[-third:]) - np.median(memory[third : 2 * third]) < 20
    assert np.median(files[-third:]) <= np.median(files[third : 2 * third])  # a file is open now and then while it is written


def worker_memory() -> dict[int, int]:
    """Megabytes of every worker process that this process started, by its number."""
    found = {}
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            text = status.read_text()
            command = (status.parent / "cmdline").read_bytes()
        except OSError:
            continue
        if b"blender_scenes" in command and "VmRSS" in text and f"PPid:\t{os.getpid()}\n" in text:
            found[int(status.parent.name)] = int(text.split("VmRSS:")[1].split()[0]) // 1024
    return found
