"""`kill -9` of workers, of the whole run, of Ray's actors, at any moment: what goes on with --resume ends with the same bytes.

Few kills here, many under `make soak`.
"""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from gen.sets.campaign import Engine, render_set
from gen.sets.plan import Plan, plan_of, read_plan, write_plan
from tests.gen.sets.set_runs import TINY, blenders, contents, descendants, gone, items, run, start, wait_for

pytestmark = pytest.mark.render

SOAK = TINY.replace("count: 3\n", "count: 12\n")


@pytest.fixture(scope="module", params=["tiny", pytest.param("large", marks=pytest.mark.soak)])
def large(request: pytest.FixtureRequest) -> bool:
    """Whether this is the long version."""
    return bool(request.param == "large")


@pytest.fixture(scope="module")
def plan_file(large: bool, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plan")
    (folder / "set.yaml").write_text(SOAK if large else TINY)
    write_plan(plan_of(folder / "set.yaml"), folder / "PLAN.jsonl")
    return folder / "PLAN.jsonl"


@pytest.fixture(scope="module")
def plan(plan_file: Path) -> Plan:
    return read_plan(plan_file)


@pytest.fixture(scope="module")
def whole(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "set"
    render_set(plan, folder, Engine(2))
    return folder


def test_a_run_that_is_killed_goes_on(large: bool, plan: Plan, plan_file: Path, whole: Path, tmp_path: Path) -> None:
    """Killed at the start of Blender, between items, in the midst of one, and when all but the index is done."""
    folder, kills, rng = tmp_path / "set", 0, random.Random(1)
    (tmp_path / "tmp").mkdir()
    environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp")}
    while kills < (50 if large else 3):
        if items(folder) == len(plan.items):
            (folder / "index.jsonl").unlink(missing_ok=True)
            for place in rng.sample(sorted((folder / "items").iterdir()), len(plan.items) // 2):
                (place / "item.json").unlink()  # as after a power cut
        with start("render", plan_file, "-o", folder, "--workers", "2", "--resume", env=environment) as process:
            there = items(folder)
            if kills % 3:
                wait_for(lambda n=there: items(folder) > n, process)  # type: ignore[misc]
                time.sleep(rng.uniform(0, 0.2))
            else:
                wait_for(lambda p=process: bool(blenders(p.pid)), process)  # type: ignore[misc]
                time.sleep(rng.uniform(0, 2))
            started = list(descendants(process.pid))
            process.kill()
            process.communicate()
        kills += 1
        assert gone(started), "workers outlive the run that started them"
        for name, data in contents(folder).items():
            if not name.startswith(".") and "items/" not in name:
                assert data == contents(whole)[name], name
    render_set(plan, folder, Engine(2), resume=True)
    assert contents(folder) == contents(whole)
    assert list((tmp_path / "tmp").iterdir()) == []


def test_workers_that_are_killed_are_replaced(large: bool, plan: Plan, whole: Path, tmp_path: Path) -> None:
    over, killed, rng = threading.Event(), [], random.Random(2)

    others = set(blenders())  # workers that other tests keep

    def kill() -> None:
        while not over.wait(rng.uniform(0.7, 1.2) if large else 0.05):
            ready = [
                pid for pid in set(blenders()) - others if pid not in killed and (large or items(tmp_path / "set") > len(killed))
            ]
            if ready and len(killed) < (50 if large else 2):
                killed.append(rng.choice(sorted(ready)))
                with suppress(ProcessLookupError):
                    os.kill(killed[-1], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        for attempt in range(100 if large else 3):
            tally = render_set(plan, tmp_path / "set", Engine(2), resume=attempt > 0)
            if not tally.quarantined and tally.indexed:
                break
    finally:
        over.set()
        killer.join()
    assert killed
    assert contents(tmp_path / "set") == contents(whole)
    assert set(blenders()) <= others


def test_ray_gives_the_same_bytes_though_an_actor_is_killed(plan: Plan, plan_file: Path, whole: Path, tmp_path: Path) -> None:
    """A real Ray on this machine, two actors."""
    pytest.importorskip("ray")
    folder = tmp_path / "set"
    before = set(Path("/tmp").glob("degloss-ray-*"))
    with start("render", plan_file, "-o", folder, "--engine", "ray", "--workers", "2") as process:
        wait_for(lambda: items(folder) > 0, process)
        started = descendants(process.pid)
        actors = [pid for pid, command in started.items() if command.startswith("ray::Renderer")]
        for pid in actors[:1]:
            os.kill(pid, signal.SIGKILL)
        out, err = process.communicate(timeout=120)
    assert actors
    assert process.returncode == 0, err
    assert f"{len(plan.items)} items, {sum(len(item.capture_spec().light_directions()) for item in plan.items)} pictures" in out
    assert err == ""
    assert gone(list(started))
    assert contents(folder) == contents(whole)
    assert set(Path("/tmp").glob("degloss-ray-*")) <= before


@pytest.mark.soak
def test_a_run_by_ray_that_is_killed_goes_on(plan_file: Path, whole: Path, tmp_path: Path) -> None:
    pytest.importorskip("ray")
    folder = tmp_path / "set"
    before = set(Path("/tmp").glob("degloss-ray-*"))
    with start("render", plan_file, "-o", folder, "--engine", "ray", "--workers", "2") as process:
        wait_for(lambda: items(folder) > 2, process)
        started = descendants(process.pid)
        process.kill()
        process.communicate()
    assert gone(list(started), 30)
    code, _, err = run("render", plan_file, "-o", folder, "--workers", "2", "--resume")
    assert code == 0, err
    assert contents(folder) == contents(whole)
    assert set(Path("/tmp").glob("degloss-ray-*")) <= before
