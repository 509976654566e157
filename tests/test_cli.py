"""The command line as a person meets it: help, one-line refusals with exit code 2, nothing half-written, one JSON object."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Capture
from gen.formats.render_folder import write_render

ROOT = Path(__file__).resolve().parent.parent
Synthetic = Callable[..., Capture]
COMMANDS = [
    [],
    ["demo"],
    ["doctor"],
    ["gen"],
    ["gen", "plan"],
    ["gen", "render"],
    ["gen", "render-chunk"],
    ["gen", "presets"],
    ["gen", "schema"],
    ["recon"],
    ["recon", "run"],
    ["recon", "methods"],
    ["recon", "bench"],
    ["recon", "capture"],
    ["recon", "lights"],
    ["recon", "inspect"],
    ["recon", "multiview"],
]


def degloss(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "degloss", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=120, **options)  # type: ignore[call-overload, no-any-return]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, synthetic: Synthetic) -> Path:
    """A small capture of ours on disk."""
    path = tmp_path_factory.mktemp("captures") / "sphere"
    write_render(synthetic("sphere", 32), path)
    return path


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help(command: list[str]) -> None:
    run = degloss(*command, "--help")
    assert run.returncode == 0
    assert run.stdout.startswith("Usage: degloss")
    assert run.stderr == ""


@pytest.mark.alone
def test_help_is_quick() -> None:
    """The best of several runs, less the start of the interpreter itself: a guard against heavy imports, not a stopwatch."""

    def best(command: list[str]) -> float:
        times = []
        for _ in range(5):
            start = time.perf_counter()
            subprocess.run(command, capture_output=True, check=True, cwd=ROOT)
            times.append(time.perf_counter() - start)
        return min(times)

    assert best([sys.executable, "-m", "degloss", "recon", "run", "--help"]) - best([sys.executable, "-c", "pass"]) < 1.0


def test_run_writes_and_prints(folder: Path, tmp_path: Path) -> None:
    run = degloss("recon", "run", folder, "-o", tmp_path / "out")
    assert run.returncode == 0, run.stderr
    assert "gloss removed" in run.stdout
    assert (tmp_path / "out" / "report.html").is_file()
    assert "read as linear" in run.stdout


def test_json_is_one_object(folder: Path, tmp_path: Path) -> None:
    run = degloss(
        "recon", "run", folder, "-o", tmp_path / "out", "--gloss", "none", "--inpaint", "none", "--lights", "1,2,4", "--json"
    )
    metrics = json.loads(run.stdout)
    assert metrics["lights"] == 3
    assert metrics["frames"] == ["001", "002", "004"]
    assert metrics == json.loads((tmp_path / "out" / "metrics.json").read_text())


def test_three_lights_by_the_papers_inverse(folder: Path, tmp_path: Path) -> None:
    run = degloss(
        "recon", "run", folder, "-o", tmp_path / "out", "--normals", "three-light", "--lights", "1,2,4", "--gloss", "none"
    )
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--gloss", "polish"], "--gloss polish: unknown gloss remover"),
        (["--inpaint", "tape"], "--inpaint tape"),
        (["--normals", "three-light"], "exactly three"),
        (["--threshold", "much"], "--threshold much"),
        (["--threshold", "-2"], "--threshold -2"),
        (["--dilate", "1.5"], "--dilate 1.5"),
        (["--dilate", "99999"], "--dilate 99999"),
        (["--lights", "1_0,2,3"], "numbers from 1"),
        (["--lights", "1,2,9"], "picture 9"),
        (["--lights", "1,1,2"], "twice"),
        (["--lights", "0,1,2"], "numbered from 1"),
        (["--lights", "a"], "numbers from 1"),
        (["--lights", "1,2"], "at least three"),
        (["--lights", "1,2,3"], "one plane"),
        (["--encoding", "gamma"], "encoding"),
        (["--no-such-option"], "no-such-option"),
    ],
)
def test_refusals(folder: Path, tmp_path: Path, options: list[str], says: str) -> None:
    run = degloss("recon", "run", folder, "-o", tmp_path / "out", *options)
    refused(run, says)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ["recon", "run", "/no/such/capture", "-o", "OUT"],
        ["gen", "render", "no-such-preset", "-o", "OUT"],
        ["recon", "walk"],
        ["gen", "render"],
    ],
    ids=" ".join,
)
def test_what_is_not_there(arguments: list[str], tmp_path: Path) -> None:
    refused(degloss(*[str(tmp_path / "out") if a == "OUT" else a for a in arguments]), "")
    assert list(tmp_path.iterdir()) == []


def test_output_that_cannot_be_written(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for place in (tmp_path / "file", tmp_path / "file" / "below", "/proc/degloss/out", "/dev/null"):
        refused(degloss("recon", "run", folder, "-o", place), str(place))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    refused(degloss("recon", "run", folder, "-o", tmp_path / "full"), "not an earlier measurement")
    assert (tmp_path / "full" / "thesis.txt").read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "full"]


def test_output_never_overwrites_its_input(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "set" / "capture")
    for place in ("set/capture", "set", "set/capture/../../set"):
        refused(degloss("recon", "run", tmp_path / "set" / "capture", "-o", tmp_path / place), "is or holds the capture")
    refused(degloss("recon", "run", folder, "-o", tmp_path / "set" / "capture"), "not an earlier measurement")
    assert (tmp_path / "set" / "capture" / "capture.json").is_file()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_read_only_folder(folder: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    refused(degloss("recon", "run", folder, "-o", tmp_path / "out"), "cannot be written")


@pytest.mark.parametrize("after", [0.12, 0.15, 0.18, 0.21, 0.24, 0.27, 0.3, 0.33])
def test_a_signal_while_it_starts_ends_it_with_a_code_of_its_own(tmp_path: Path, after: float) -> None:
    """Not with the alarm by which an interrupt comes again: what fails, or is done, in that moment ends as ever."""
    command = [sys.executable, "-m", "degloss", "recon", "run", str(tmp_path / "none"), "-o", str(tmp_path / "out")]
    for number in (signal.SIGINT, signal.SIGTERM):
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as run:
            time.sleep(after)
            run.send_signal(number)
            _, errors = run.communicate(timeout=20)
        assert run.returncode in (2, 130, -number), errors


@pytest.fixture(scope="module")
def longest_import() -> float:
    """Seconds for what takes longest to import: an interrupt meanwhile waits for its end."""
    start = time.monotonic()
    subprocess.run([sys.executable, "-c", "import torch, learn.weights"], check=True, cwd=ROOT)
    return time.monotonic() - start


@pytest.mark.alone
@pytest.mark.parametrize("after", [0.05, 0.3, 0.6, 1.2])
def test_a_signal_ends_it_with_a_sentence_and_nothing_left(
    folder: Path, tmp_path: Path, after: float, longest_import: float
) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        command = [sys.executable, "-m", "degloss", "recon", "run", str(folder), "-o", str(tmp_path / "out")]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as run:
            time.sleep(after)
            run.send_signal(number)
            start = time.monotonic()
            _, errors = run.communicate(timeout=20)
        assert time.monotonic() - start < 1 + longest_import
        assert run.returncode in (0, 130, -number), errors  # it may have been done, or not yet have begun
        if run.returncode == 130:
            assert errors.splitlines() == ["degloss: stopped; nothing was left half-written, run the same command again"]
        assert {p.name for p in tmp_path.iterdir()} <= {"out"}
        assert not (tmp_path / "out").exists() or (tmp_path / "out" / "report.html").is_file()


def test_an_interrupt_in_what_llvm_calls_back_is_not_lost() -> None:
    """Python prints an exception of a ctypes callback and goes on; compiling solvers is full of such."""
    code = (
        "import ctypes, os, signal, sys, time, types, degloss\n"
        "module = types.ModuleType('llvmlite.stand_in')\n"
        "exec('import os, signal\\ndef back():\\n os.kill(os.getpid(), signal.SIGINT)\\n for _ in range(1000): pass', module.__dict__)\n"
        "called = ctypes.CFUNCTYPE(None)(module.back)\n"
        "degloss.app = lambda words: (called(), time.sleep(5))\n"
        "degloss.main()"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 130
    assert run.stderr.splitlines() == ["degloss: stopped; nothing was left half-written, run the same command again"]


def test_what_a_killed_run_left_is_swept_by_the_next(folder: Path, tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    (tmp_path / f".out.{dead.pid}.abc.tmp").mkdir()
    (tmp_path / f".out.{os.getpid()}.abc.tmp").mkdir()  # of a run that is alive
    (tmp_path / ".out.notes").mkdir()
    odd = f".out.{10**30}.abc.tmp"
    (tmp_path / odd).mkdir()
    assert degloss("recon", "run", folder, "-o", tmp_path / "out", "--gloss", "none").returncode == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([f".out.{os.getpid()}.abc.tmp", odd, ".out.notes", "out"])


def test_files_of_others_in_a_result_are_never_lost(folder: Path, tmp_path: Path) -> None:
    assert degloss("recon", "run", folder, "-o", tmp_path / "out", "--gloss", "none").returncode == 0
    (tmp_path / "out" / "my notes.txt").write_text("mine")
    refused(degloss("recon", "run", folder, "-o", tmp_path / "out", "--gloss", "none"), "holds other files too")
    assert (tmp_path / "out" / "my notes.txt").read_text() == "mine"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_full_disk_on_stdout_is_one_line() -> None:
    with open("/dev/full", "w") as full:
        run = subprocess.run(
            [sys.executable, "-m", "degloss", "recon", "methods"], stdout=full, stderr=subprocess.PIPE, text=True, cwd=ROOT
        )
    assert run.returncode == 2
    assert len(run.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "setting", [{"COLUMNS": "0"}, {"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0"}, {"HOME": "/nowhere"}]
)
def test_odd_environments(setting: dict[str, str], folder: Path, tmp_path: Path) -> None:
    assert degloss("--help", env={**os.environ, **setting}).returncode == 0
    run = degloss("recon", "run", folder, "-o", tmp_path / "ünï e", "--gloss", "none", env={**os.environ, **setting})
    assert run.returncode == 0, run.stderr


def test_methods(tmp_path: Path) -> None:
    table = json.loads(degloss("recon", "methods", "--json").stdout)
    assert set(table) == {"--gloss", "--inpaint", "--normals", "--height"}
    assert "least-squares" in degloss("recon", "methods").stdout


def test_doctor_names_a_remedy_for_what_is_missing() -> None:
    run = degloss("doctor", "--json", env={**os.environ, "DEGLOSS_DATA": "/no/such/folder"})
    found = json.loads(run.stdout)
    assert {"bpy", "system libraries", "GPU", "torch", "report", "chromium", "reference data"} <= set(found)
    assert found["reference data"]["state"] == "missing"
    assert "DEGLOSS_DATA" in found["reference data"]["remedy"]
    assert all(part["remedy"] for part in found.values() if part["state"] == "missing")


def test_missing_part_is_one_line_with_the_remedy(tmp_path: Path) -> None:
    """A Python that cannot find bpy: the same line as the doctor's, no ImportError."""
    code = (
        "import sys, importlib.util as u; real = u.find_spec;"
        "u.find_spec = lambda name, *a: None if name == 'bpy' else real(name, *a);"
        f"sys.argv = ['degloss', 'demo', '-o', {str(tmp_path / 'out')!r}]; import degloss; degloss.main()"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=60)
    refused(run, "bpy is missing")
    assert "pip install" in run.stderr
    assert list(tmp_path.iterdir()) == []


def test_hostile_frame_name_is_text_in_the_report(synthetic: Synthetic, tmp_path: Path) -> None:
    base = synthetic("sphere", 24)
    names = ("<script>alert(1)</script>", *base.names[1:])
    hostile = Capture(images=base.images, lights=base.lights, mask=base.mask, names=names, source="<img src=x>")
    from recon.pipeline import measure

    measure(hostile).write(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<script>alert" not in page
    assert "<img src=x>" not in page
    assert np.array_equal(hostile.mask, base.mask)


def refused(run: subprocess.CompletedProcess[str], says: str) -> None:
    assert run.returncode == 2, (run.stdout, run.stderr)
    lines = run.stderr.strip().splitlines()
    assert len(lines) == 1, run.stderr
    assert lines[0].startswith("degloss: ")
    assert says in lines[0]
    assert run.stdout == ""
