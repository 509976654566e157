"""The worker's protocol: bad jobs get their line and the next job its picture; the worker never outlives its parent."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.render


def without(*keys: str) -> Any:
    """A change that removes the entry at the end of a path of keys."""

    def change(job: dict[str, Any]) -> None:
        for key in keys[:-1]:
            job = job[key]
        del job[keys[-1]]

    return change


def put(value: object, *keys: Any) -> Any:
    """A change that sets the entry at the end of a path of keys."""

    def change(job: Any) -> None:
        for key in keys[:-1]:
            job = job[key]
        job[keys[-1]] = value

    return change


BAD = {
    "resolution is missing": without("resolution"),
    "resolution must be numbers of shape 2": put(64, "resolution"),
    "resolution must be from 1 to 16384": put([0, 4], "resolution"),
    "resolution must be whole": put([4.5, 4], "resolution"),
    "resolution times supersampling is 38400x640": lambda job: job.update(resolution=[600, 10], supersampling=64),
    "resolution times supersampling is 8000x8000": put([8000, 8000], "resolution"),
    "supersampling must be from": put(0, "supersampling"),
    "camera must be an object": put(None, "camera"),
    "camera.kind 'fish' is unknown": put("fish", "camera", "kind"),
    "camera.width must be from": put(-1, "camera", "width"),
    "camera.width must be a number, all finite": put(float("nan"), "camera", "width"),
    "camera.distance must be a number": put("far", "camera", "distance"),
    "camera.K must be": put({"kind": "perspective", "K": [[9, 1, 0], [0, 9, 0], [0, 0, 1]], "distance": 200}, "camera"),
    "camera.K must be numbers of shape 3x3": put({"kind": "perspective", "K": [[9, 1], [0]], "distance": 200}, "camera"),
    "before the camera": put(10, "camera", "distance"),
    "shape teapot: unknown": put("teapot", "shape", "name"),
    "shape sphere: unknown parameter size": put({"size": 3}, "shape", "parameters"),
    "shape sphere: radius must be a number": put({"radius": float("inf")}, "shape", "parameters"),
    "shape.parameters must be an object": put([3], "shape", "parameters"),
    "pose.rotation is not a rotation": put([[1, 0, 0], [0, 1, 0], [0, 0, -1]], "pose", "rotation"),
    "pose.turn is unknown": put(3, "pose", "turn"),
    "material.kind 'wood' is unknown": put("wood", "material", "kind"),
    "material.diffuse must be from 0 to 1": put([0.5, 0.5, 1.5], "material", "diffuse"),
    "material.alpha must be from": put(0, "material", "alpha"),
    "material.alpha must be a number": put(True, "material", "alpha"),
    "lights must be a list of 1": put([], "lights"),
    "lights[1].direction must be a unit vector": put([0, 0, 2], "lights", 1, "direction"),
    "lights[0].intensity must be from": put([1, -1, 1], "lights", 0, "intensity"),
    "lights[0].colour is unknown": put(1, "lights", 0, "colour"),
    "light is unknown": put([], "light"),
    "out must be a path": put("/there/is/no/such/folder/x.npz", "out"),
    "out must be a path in a folder that is there, got 5": put(5, "out"),
}


def test_bad_jobs_get_a_line_and_the_worker_lives_on(worker, job) -> None:
    good = job("sphere", "orthographic", size=(16, 16))
    out = worker.folder / "never.npz"
    for message, change in BAD.items():
        bad = json.loads(json.dumps({**good, "id": "bad", "out": str(out)}))
        change(bad)
        answer = worker.ask(bad)
        assert (answer["id"], answer["ok"], answer.get("kind")) == ("bad", False, "input"), (message, answer)
        assert message in answer["error"]
        assert "\n" not in answer["error"]
    for line in ("{", "[1, 2]", "null", '"' + "x" * 100_000, "[" * 100_000, "\x00\xff"):
        worker.send(line)
        answer = worker.reply()
        assert (answer["id"], answer["ok"], answer["kind"]) == (None, False, "input")
        assert len(answer["error"]) < 500
    assert not list(worker.folder.iterdir())
    assert worker.render(good)["coverage"].any()


def test_ready_line_and_order(worker, job) -> None:
    assert worker.ready == {"ready": True, "blender": worker.ready["blender"], "device": "cpu", "pid": worker.process.pid}
    assert worker.ready["blender"].startswith(("4.", "5."))
    asked = [
        {**job("sphere", "orthographic", size=(8, 8)), "id": i, "out": str(worker.folder / f"{i}.npz")} for i in ("x", "y", "z")
    ]
    for one in asked:
        worker.send(json.dumps(one))
    for one in asked:
        answer = worker.reply()
        assert (answer["id"], answer["ok"]) == (one["id"], True)
        assert answer["seconds"] > 0
        Path(one["out"]).unlink()


def test_memory_stays_level(worker, job) -> None:
    def resident() -> float:
        return int(Path(f"/proc/{worker.process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6

    if not Path("/proc/self/statm").exists():
        pytest.skip("no /proc here to read a process's memory from")
    asked = {**job("cylinder", "orthographic", size=(48, 48)), "out": str(worker.folder / "m.npz")}
    asked["lights"] = asked["lights"][:2]
    for _ in range(10):
        worker.ask(asked)
    before = resident()
    for _ in range(40):
        assert worker.ask(asked)["ok"]
    (worker.folder / "m.npz").unlink()
    assert resident() - before < 20


def test_worker_ends_when_its_input_closes(start) -> None:
    client = start()
    assert client.close() == 0


MIDDLE = """
import subprocess, sys, time
jobs, replies = sys.argv[1:]
command = [sys.executable, "-m", "blender_scenes", "--worker", "--in", jobs, "--out", replies]
worker = subprocess.Popen(command, pass_fds=(int(jobs), int(replies)))
time.sleep(100)
"""


def test_worker_ends_when_its_parent_dies(python) -> None:
    """Even while somebody else still holds the other ends of its pipes."""
    python("")
    jobs_out, jobs = os.pipe()
    replies, replies_in = os.pipe()
    middle = subprocess.Popen(
        [sys.executable, "-c", MIDDLE, str(jobs_out), str(replies_in)],
        cwd=Path(__file__).resolve().parents[2],
        pass_fds=(jobs_out, replies_in),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        os.close(replies_in)
        pid = json.loads(os.read(replies, 4096))["pid"]
        assert pid != middle.pid
        os.kill(middle.pid, signal.SIGKILL)
        middle.wait()
        # The worker holds the last writing end of its replies: their end is its end.
        began = time.monotonic()
        assert os.read(replies, 4096) == b""
        assert time.monotonic() - began < 10
    finally:
        middle.kill()
        middle.wait()
        for fd in (jobs_out, jobs, replies):
            os.close(fd)


def run(arguments: list[str], **more: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], cwd=Path(__file__).resolve().parents[2], capture_output=True, text=True, timeout=120, **more
    )


def test_command_line_gives_the_worker_s_arrays(worker, job, tmp_path) -> None:
    """As a module, and as a file after `--`, which is how `blender -b --python` starts it (from any folder)."""
    asked = job("cylinder", "perspective", size=(24, 24))
    (tmp_path / "job.json").write_text(json.dumps(asked))
    layers = worker.render(asked)
    script = Path(__file__).resolve().parents[2] / "blender_scenes" / "__main__.py"
    for arguments in (["-m", "blender_scenes"], ["-P", str(script), "--"], [str(script), "-b", "--"]):
        done = run([*arguments, str(tmp_path / "job.json"), "-o", str(tmp_path / "out.npz"), "--threads", "2"])
        assert (done.returncode, done.stdout) == (0, ""), done.stderr
        with np.load(tmp_path / "out.npz") as file:
            assert set(file) == set(layers)
            for name in file:
                assert file[name].tobytes() == layers[name].tobytes()
        (tmp_path / "out.npz").unlink()


def test_command_line_errors_are_one_line(job, tmp_path, python) -> None:
    python("")
    good, bad = tmp_path / "good.json", tmp_path / "bad.json"
    good.write_text(json.dumps(job("sphere", "orthographic", size=(8, 8))))
    bad.write_text(json.dumps(job("teapot", "orthographic")))
    (tmp_path / "broken.json").write_text("{")
    for arguments, message in (
        ([str(bad), "-o", str(tmp_path / "x.npz")], "shape teapot: unknown"),
        ([str(tmp_path / "broken.json"), "-o", str(tmp_path / "x.npz")], "is not JSON"),
        ([str(tmp_path / "none.json")], "cannot be read"),
        ([str(good)], "names no 'out'"),
        ([str(good), "-o", str(tmp_path / "none" / "x.npz")], "cannot be written"),
        (["--worker", "--in", "77", "--out", "78"], "descriptor 77 is not open"),
    ):
        done = run(["-m", "blender_scenes", *arguments])
        assert done.returncode == 2, done.stderr
        assert message in done.stderr
        assert len(done.stderr.splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.json", "broken.json", "good.json"]
    assert run(["-m", "blender_scenes"]).returncode == 2


def test_missing_bpy_names_the_remedy(job, tmp_path) -> None:
    """Where bpy, or a library under it, cannot be loaded, one line says what to install."""
    (tmp_path / "bpy.py").write_text("raise ImportError('libXi.so.6: cannot open shared object file: No such file or directory')")
    (tmp_path / "job.json").write_text(json.dumps(job("sphere", "orthographic")))
    for arguments in ([str(tmp_path / "job.json"), "-o", str(tmp_path / "x.npz")], ["--worker"]):
        done = run(
            ["-m", "blender_scenes", *arguments], env={**os.environ, "PYTHONPATH": str(tmp_path)}, stdin=subprocess.DEVNULL
        )
        assert done.returncode == 2
        assert len(done.stderr.splitlines()) == 1
        assert "libXi.so.6" in done.stderr
        assert "apt-get install -y libx11-6" in done.stderr
