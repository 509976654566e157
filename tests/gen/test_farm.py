"""The farm against workers that crash, hang, lie and never start, and against a real Blender that is killed.

The faults are played by a small program that speaks the worker's protocol and is started the way an installed Blender is.
"""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from gen.errors import InputError, MissingPart
from gen.farm import Farm
from gen.worker import Worker, WorkerLost

ROOT = Path(__file__).resolve().parents[2]

PROGRAM = """\
#!{python}
import json, os, sys, time
from pathlib import Path
arguments = sys.argv[sys.argv.index("--") + 1 :]
read, write = (int(arguments[arguments.index(name) + 1]) for name in ("--in", "--out"))
here = Path(__file__).parent
print("the chatter that Blender prints", flush=True)
if (here / "broken").exists():
    print("libXi.so.6: cannot open shared object file", file=sys.stderr)
    sys.exit(1)
with open(here / "pids", "a") as pids:
    pids.write(f"{{os.getpid()}}\\n")
if (here / "mortal").exists() and len((here / "pids").read_text().split()) <= int((here / "mortal").read_text()):
    os.kill(os.getpid(), 9)
def say(reply):
    os.write(write, (json.dumps(reply) + "\\n").encode())
say({{"ready": True, "blender": "0.0", "device": "cpu", "pid": os.getpid()}})
for line in os.fdopen(read):
    job = json.loads(line)
    with open(here / "tries", "a") as tries:
        tries.write(job["id"] + "\\n")
    kind = job["id"].split("-")[0]
    count = (here / "tries").read_text().split().count(job["id"])
    if kind == "crash" or (kind == "shaky" and count == 1):
        print("Segmentation fault in Cycles", flush=True)
        os.abort()
    if kind in ("hang", "stuck"):
        time.sleep(1000)
    if kind == "nonsense":
        os.write(write, b"Fra:1 Mem:8M\\n")
        continue
    if kind == "input":
        say({{"id": job["id"], "ok": False, "kind": "input", "error": "job: alpha must be positive"}})
        continue
    if kind == "fails" and count < 3:
        say({{"id": job["id"], "ok": False, "kind": "failure", "error": "RuntimeError: no"}})
        continue
    say({{"id": job["id"], "ok": True, "seconds": 0.5, "route": "memory"}})
"""


@pytest.fixture
def blender(tmp_path: Path) -> Path:
    """A program that plays the worker."""
    program = tmp_path / "blender"
    program.write_text(PROGRAM.format(python=sys.executable))
    program.chmod(0o755)
    return program


def pids(blender: Path) -> list[int]:
    return [int(word) for word in (blender.parent / "pids").read_text().split()]


def running(pid: int) -> bool:
    """Whether a process lives (one that has ended and waits for its parent does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def all_gone(numbers: list[int], seconds: float = 10) -> bool:
    deadline = time.monotonic() + seconds
    while any(map(running, numbers)):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def jobs(*names: str) -> list[dict[str, str]]:
    return [{"id": name} for name in names]


def test_one_bad_job_costs_no_other(blender: Path) -> None:
    names = ["a", "crash-1", "b", "shaky-1", "nonsense-1", "fails-1", "input-1", "c", "d"]
    with Farm(2, str(blender), timeout=20) as farm:
        outcomes = {outcome.job["id"]: outcome for outcome in farm.run(jobs(*names))}
    assert set(outcomes) == set(names)
    assert {name for name, outcome in outcomes.items() if not outcome.ok} == {"crash-1", "nonsense-1", "input-1"}
    crash = outcomes["crash-1"]
    assert (crash.kind, crash.tries) == ("failure", 3)
    assert crash.error == "the worker was ended by SIGABRT: Segmentation fault in Cycles"
    assert "spoke nonsense" in outcomes["nonsense-1"].error
    assert (outcomes["input-1"].kind, outcomes["input-1"].tries) == ("input", 1)
    assert outcomes["shaky-1"].tries == 2
    assert outcomes["fails-1"].tries == 3
    assert outcomes["a"].seconds == 0.5
    assert outcomes["a"].blender == "0.0"
    assert all_gone(pids(blender))


def test_a_hanging_worker_is_replaced(blender: Path) -> None:
    began = time.monotonic()
    with Farm(1, str(blender), timeout=0.4, tries=2) as farm:
        outcomes = list(farm.run(jobs("hang-1", "a")))
    assert [outcome.ok for outcome in outcomes] == [False, True]
    assert outcomes[0].error == "the worker did not answer in time"
    assert time.monotonic() - began < 10
    assert len(pids(blender)) == 3
    assert all_gone(pids(blender))


def test_workers_are_kept_between_runs_and_replaced_when_old(blender: Path) -> None:
    with Farm(1, str(blender), jobs_per_worker=3) as farm:
        for _ in range(3):
            assert all(outcome.ok for outcome in farm.run(jobs("a", "b")))
    assert len(pids(blender)) == 2


def test_workers_grow_old_over_runs_of_one_job_too(blender: Path) -> None:
    with Farm(1, str(blender), jobs_per_worker=3) as farm:
        for _ in range(7):
            assert all(outcome.ok for outcome in farm.run(jobs("a")))
    assert len(pids(blender)) == 3


def test_leaving_in_the_middle_leaves_nothing_behind(blender: Path) -> None:
    with suppress(KeyError), Farm(3, str(blender)) as farm:
        for outcome in farm.run(jobs("hang-1", "hang-2", "a", "b")):
            assert outcome.ok
            raise KeyError
    assert pids(blender)
    assert all_gone(pids(blender))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_no_orphans_when_the_parent_is_interrupted_or_killed(blender: Path, number: int) -> None:
    kind = "hang" if number == signal.SIGINT else "a"  # a killed parent cannot end a hung worker: the real one watches its parent
    code = f"""
        import signal, time
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell hands it down ignored
        from gen.farm import Farm
        with Farm(2, {str(blender)!r}) as farm:
            for outcome in farm.run([{{"id": "{kind}-1"}}, {{"id": "{kind}-2"}}]):
                pass
            time.sleep(100)
    """
    parent = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)], cwd=ROOT, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 30
    while not (blender.parent / "tries").exists() or len((blender.parent / "tries").read_text().split()) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    parent.send_signal(number)
    parent.wait(20)
    assert all_gone(pids(blender))


def test_a_kill_at_the_start_is_none_of_the_jobs_tries(blender: Path) -> None:
    (blender.parent / "mortal").write_text("3")
    with Farm(1, str(blender), tries=1) as farm:
        assert [outcome.ok for outcome in farm.run(jobs("a", "b"))] == [True, True]
    assert len(pids(blender)) == 4
    (blender.parent / "mortal").write_text("1000")
    with (
        pytest.raises(InputError, match=r"does not start: the worker was ended by SIGKILL.*, 4 times in a row"),
        Farm(1, str(blender)) as farm,
    ):
        list(farm.run(jobs("a")))


def test_jobs_are_taken_as_they_are_needed(blender: Path) -> None:
    """A generator of any length: no more is taken from it than the workers and the outcomes that wait can hold."""
    taken = []

    def endless() -> Iterator[dict[str, str]]:
        for n in itertools.count():
            taken.append(n)
            yield {"id": f"a-{n}"}

    with Farm(2, str(blender)) as farm:
        for n, outcome in enumerate(farm.run(endless())):
            assert outcome.ok
            time.sleep(0.01)
            assert len(taken) <= n + 1 + 2 * 2 + 2
            if n == 50:
                break
        assert [outcome.job["id"] for outcome in farm.run(jobs("b"))] == ["b"]  # the workers are still good for others
    assert all_gone(pids(blender))


def test_what_the_generator_of_jobs_raises_ends_the_run(blender: Path) -> None:
    def broken() -> Iterator[dict[str, str]]:
        yield {"id": "a"}
        raise KeyError("no more")

    (blender.parent / "pids").touch()  # a worker may be ended before it has said its number
    with pytest.raises(KeyError, match="no more"), Farm(2, str(blender)) as farm:
        list(farm.run(broken()))
    assert all_gone(pids(blender))


def test_a_blender_that_does_not_start_is_one_line(blender: Path) -> None:
    (blender.parent / "broken").touch()
    with (
        pytest.raises(InputError, match=r"does not start: libXi.so.6: cannot open shared object file"),
        Farm(2, str(blender)) as farm,
    ):
        list(farm.run(jobs("a", "b", "c")))


def test_options_are_checked() -> None:
    with pytest.raises(InputError, match="--blender /nowhere/blender: there is no such program"):
        Farm(1, "/nowhere/blender")
    with pytest.raises(InputError, match="--workers 0"):
        Farm(0)


def test_a_python_without_bpy_says_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "bpy.py").write_text(
        "raise ImportError('libXrender.so.1: cannot open shared object file: No such file or directory')\n"
    )
    code = "from gen.farm import Farm\nwith Farm() as farm:\n    list(farm.run([{'id': 'a'}]))"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60)
    last = run.stderr.strip().splitlines()[-1]
    assert last.startswith(MissingPart.__module__ + ".MissingPart: system libraries")
    assert "apt-get install" in last
    assert "libXrender.so.1" in last


@pytest.mark.render
def test_a_real_worker_that_is_killed_or_stopped_is_lost() -> None:
    for number, reason in ((signal.SIGKILL, "was ended by SIGKILL"), (signal.SIGSTOP, "did not answer in time")):
        worker = Worker(threads=1)
        try:
            worker.wait_until_ready()
            assert str(worker.info["blender"])[0].isdigit()
            os.kill(int(worker.info["pid"]), number)
            with pytest.raises(WorkerLost, match=reason):
                worker.ask({"id": "a"}, timeout=0.5)
        finally:
            worker.kill()
        assert all_gone([int(worker.info["pid"])])


@pytest.mark.render
def test_a_real_worker_ends_with_its_parent() -> None:
    code = """
        import os, sys, time
        from gen.worker import Worker
        worker = Worker(threads=1)
        worker.wait_until_ready()
        print(worker.info["pid"], flush=True)
        time.sleep(100)
    """
    parent = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert running(pid)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert all_gone([pid])
