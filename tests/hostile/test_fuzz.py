"""Every reader under damaged files: it reads them or raises InputError, and nothing else ever comes out.

Short and seeded here, so that every run of the suite sees the same; as long as one likes, and guided by coverage, under `make soak`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from tests.hostile.damage import STEPS, Step, damaged, read_or_refused
from tests.hostile.readers import READERS, Reader

ROOT = Path(__file__).resolve().parents[2]
LEARNED = ("weights", "checkpoint")
"""Readers that need torch."""

SLOW = ("weights", "stl-text", "set-spec", "capture-spec", "true-normals-mat", "obj", "ply", "ply-text", "view", "frame")
"""Readers that take milliseconds a file: fewer of them in the suite."""

SECONDS = float(os.environ.get("DEGLOSS_FUZZ_SECONDS", "10"))
"""Of the long campaign, a reader."""

steps = st.lists(
    st.tuples(st.sampled_from(STEPS), st.integers(0, 1 << 20), st.integers(0, (1 << 64) - 1)), min_size=1, max_size=6
)


def laid(name: str, folder: Path) -> tuple[Reader, bytes]:
    """A reader, and its sound file in the folder."""
    if name in LEARNED and find_spec("torch") is None:
        pytest.skip("torch is not installed")
    READERS[name].lay(folder)
    return READERS[name], (folder / READERS[name].file).read_bytes()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    reader, data = laid(name, tmp_path)
    assert read_or_refused(reader, tmp_path, data) or name == "cameras", "it is sound before it is damaged"

    @seed(7)
    @settings(
        max_examples=6 if name in SLOW else 20,
        deadline=None,
        database=None,
        derandomize=False,
        suppress_health_check=list(HealthCheck),
    )
    @given(steps)
    def under(done: list[Step]) -> None:
        read_or_refused(reader, tmp_path, damaged(data, done, reader.grammar))

    under()


@pytest.mark.soak
@pytest.mark.parametrize("name", READERS)
def test_a_long_campaign_guided_by_coverage_finds_nothing(name: str, tmp_path: Path) -> None:
    """atheris (libFuzzer on Python's own bytecode) in a process of its own, so that what kills the process is a finding too."""
    if find_spec("atheris") is None:
        pytest.skip("atheris is not installed: pip install atheris")
    if name in LEARNED and find_spec("torch") is None:
        pytest.skip("torch is not installed")
    done = subprocess.run(
        [sys.executable, "-m", "tests.hostile.campaign", name, str(SECONDS), str(tmp_path)],
        capture_output=True,
        text=True,
        errors="replace",
        cwd=ROOT,
        timeout=SECONDS * 5 + 300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    assert "Done" in done.stderr
