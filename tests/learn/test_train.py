"""Training: every method runs, a stopped run goes on with the same bits, and a run is never overwritten."""

from __future__ import annotations

import csv
import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from gen.errors import InputError
from learn.bench import bench, report
from learn.config import Config, read_config
from learn.interrupts import Interrupts
from learn.logs import CsvLog, write_png
from learn.method import METHODS
from learn.methods.single import Specular
from learn.train import Summary, main, train
from learn.weights import load_weights
from tests.learn.small_runs import TIMES, smoke_config, with_text, write_tiny_pack


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_pack(tmp_path_factory.mktemp("pack") / "tiny.safetensors")


@pytest.fixture
def without_board(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine without the package tensorboard."""
    import learn.logs

    real = learn.logs.find_spec
    monkeypatch.setattr(learn.logs, "find_spec", lambda name: None if name == "tensorboard" else real(name))


def quiet(config: Config, run: Path, **how: Any) -> Summary:
    return train(config, run, device="cpu", progress=None, **how)


def ten_steps(pack: Path, **values: Any) -> Config:
    return smoke_config("specular", pack, **{"steps": 10, "log_every": 3, "sample_every": 0, "validate_every": 4, **values})


def rows_of(run: Path) -> list[dict[str, str]]:
    with (run / "log.csv").open(newline="") as stream:
        return [{key: value for key, value in row.items() if key not in TIMES} for row in csv.DictReader(stream)]


def must_be_the_same_run(one: Path, other: Path) -> None:
    for name in ("checkpoint", "weights", "best"):
        ours, theirs = (load_file(run / f"{name}.safetensors") for run in (one, other))
        assert ours.keys() == theirs.keys()
        for key, tensor in ours.items():
            assert torch.equal(tensor, theirs[key]), (name, key)
    assert rows_of(one) == rows_of(other)


@pytest.fixture(scope="module")
def straight(pack: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten steps without a stop."""
    run = tmp_path_factory.mktemp("straight") / "run"
    summary = quiet(ten_steps(pack), run)
    assert (summary.steps, summary.stopped) == (10, "finished")
    return run


@pytest.mark.parametrize("method", METHODS)
def test_every_methods_smoke_config_trains(method: str, pack: Path, tmp_path: Path) -> None:
    config = smoke_config(method, pack)
    summary = quiet(config, tmp_path / "run")
    run = tmp_path / "run"
    assert {path.name for path in run.iterdir()} == {
        ".lock", "config.toml", "log.csv", "tb", "samples", "checkpoint.safetensors", "weights.safetensors", "best.safetensors",
        "summary.json",
    }  # fmt: skip
    assert (run / "config.toml").read_text() == config.text
    assert [row["step"] for row in rows_of(run)] == ["1", "2", "3", "4"]
    assert [bool(row["validation_loss"]) for row in rows_of(run)] == [False, True, False, True]
    assert list((run / "tb").iterdir())
    sheet = cv2.imread(str(run / "samples" / "step_000004.png"))
    assert min(sheet.shape[:2]) >= 16
    assert json.loads((run / "summary.json").read_text())["steps"] == summary.steps == summary.of_steps == 4
    loaded = load_weights(run)
    assert (loaded.method, loaded.facts["seed"], loaded.facts["share_of_schedule"]) == (method, 1, 1.0)
    assert str(tmp_path) not in json.dumps(dict(loaded.facts))  # a path of this machine is nobody's business
    average = {
        key.removeprefix("average."): value for key, value in load_file(run / "checkpoint.safetensors").items() if key[0] == "a"
    }
    assert all(torch.equal(average[key], value) for key, value in loaded.model.state_dict().items())


@pytest.mark.usefixtures("without_board")
def test_ten_steps_are_five_and_five_more(pack: Path, straight: Path, tmp_path: Path) -> None:
    run, config = tmp_path / "run", ten_steps(pack)
    with pytest.raises(KeyboardInterrupt), told_to_stop(5, "forward"):
        quiet(config, run)
    torch.manual_seed(12345)  # what this process drew before must not matter
    assert quiet(config, run, resume=True).steps == 10
    must_be_the_same_run(run, straight)


class told_to_stop:
    """Specular's training gets Ctrl-C while it makes step `step` (from 0): in its forward, its backward, or its validation after it."""

    def __init__(self, step: int, where: str) -> None:
        self.step, self.where = step, where

    def __enter__(self) -> None:
        self.original = Specular.loss

        def loss(method: Specular, model: Any, batch: Any, progress: float) -> Any:
            result = self.original(method, model, batch, progress)
            now = round(progress * 10) == self.step and (model.training or self.where == "validation")
            if now and self.where == "backward":
                result[0].register_hook(self._signal)  # before any layer's own
            elif now:
                self._signal()
            return result

        Specular.loss = loss  # type: ignore[method-assign]

    def __exit__(self, *_: object) -> None:
        Specular.loss = self.original  # type: ignore[method-assign]

    def _signal(self, gradient: Any = None) -> None:
        os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.usefixtures("without_board")
@pytest.mark.parametrize(("step", "where"), [(0, "forward"), (6, "backward"), (10, "validation")])
def test_a_signal_leaves_a_checkpoint_and_says_how_to_go_on(
    pack: Path, straight: Path, tmp_path: Path, step: int, where: str
) -> None:
    run, config = tmp_path / "run", ten_steps(pack, validate_every=4)
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt) as caught, told_to_stop(step, where):
        quiet(config, run)
    assert signal.getsignal(signal.SIGINT) is handler
    done = step if where != "validation" else 4
    assert f"after step {done} of 10" in str(caught.value)
    assert f"degloss learn train smoke-specular -o {run} --resume --device cpu --data pack={pack}" in str(caught.value)
    assert quiet(config, run, resume=True).steps == 10
    must_be_the_same_run(run, straight)


@pytest.mark.usefixtures("without_board")
def test_a_run_that_was_killed_is_resumed_with_the_same_bits(pack: Path, straight: Path, tmp_path: Path) -> None:
    """SIGKILL at a moment that nobody chose, while a checkpoint is written at every step."""
    run = tmp_path / "run"
    text = with_text(read_config("smoke-specular").text, "train", {"steps": "10", "log_every": "3", "sample_every": "0"})
    text = with_text(text, "train", {"validate_every": "4", "checkpoint_every": "1"})
    path = tmp_path / "config.toml"
    path.write_text(text)
    # Slowed down, or all would be over before the kill.
    slow = (
        "import sys, time, learn.methods.single as single, learn.logs\n"
        "learn.logs.find_spec = lambda name: None\n"
        "loss = single.Specular.loss\n"
        "single.Specular.loss = lambda *a: (time.sleep(0.05), loss(*a))[1]\n"
        "from learn.train import main; sys.exit(main(sys.argv[1:]))\n"
    )
    command = [sys.executable, "-c", slow, str(path), "-o", str(run), "--device", "cpu", "--data", f"pack={pack}"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        begin = time.monotonic()
        while not (run / "checkpoint.safetensors").exists() and time.monotonic() - begin < 60:
            time.sleep(0.01)
        time.sleep(0.1)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    if (run / "weights.safetensors").exists():
        assert load_weights(run).facts["steps"] >= 1
    (run / ".checkpoint.99999.tmp.safetensors").write_bytes(b"torn")
    with (run / "log.csv").open("a") as stream:
        stream.write("9,1.0")
    assert quiet(read_config(path, {"pack": str(pack)}), run, resume=True).steps == 10
    assert not [name for name in os.listdir(run) if ".tmp" in name]
    must_be_the_same_run(run, straight)


@pytest.mark.usefixtures("without_board")
def test_a_training_may_begin_with_given_weights(pack: Path, straight: Path, tmp_path: Path) -> None:
    given = load_file(straight / "weights.safetensors")
    still = {"steps": 1, "rate": 1e-12, "warm_up": 0}
    for name, start in (("new", {}), ("further", {"start": str(straight)})):
        quiet(ten_steps(pack, **still, **start), tmp_path / name)
        reached = load_file(tmp_path / name / "weights.safetensors")
        alike = all(
            torch.allclose(reached[key], tensor, atol=1e-6)
            for key, tensor in given.items()
            if "running" not in key and "tracked" not in key
        )
        assert alike == (name == "further")
    with pytest.raises(InputError, match=r"group.safetensors: train.start: the network of .* is another one"):
        quiet(ten_steps(pack, start="group"), tmp_path / "other")
    assert not (tmp_path / "other").exists()


@pytest.mark.usefixtures("without_board")
def test_the_clock_stops_a_run_and_more_minutes_go_on(pack: Path, straight: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    stopped = quiet(ten_steps(pack, minutes=0.001), run)
    assert stopped.stopped == "clock"
    assert 0 < stopped.steps < 10
    assert quiet(ten_steps(pack, minutes=0.001), run, resume=True).steps == stopped.steps
    assert quiet(ten_steps(pack), run, resume=True).stopped == "finished"
    weights, expected = (load_file(path / "weights.safetensors") for path in (run, straight))
    assert all(torch.equal(weights[key], expected[key]) for key in expected)


@pytest.mark.usefixtures("without_board")
def test_a_run_is_neither_overwritten_nor_resumed_with_another_config(pack: Path, straight: Path, tmp_path: Path) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in straight.iterdir()}
    with pytest.raises(InputError, match=r"is there already.*--resume"):
        quiet(ten_steps(pack), straight)
    with pytest.raises(InputError, match=r"another config \(seed was 1 and is 2\)"):
        quiet(replace(ten_steps(pack), seed=2), straight, resume=True)
    assert {path.name: path.stat().st_mtime_ns for path in straight.iterdir()}.keys() == before.keys()
    with pytest.raises(InputError, match="no run to resume"):
        quiet(ten_steps(pack), tmp_path / "none", resume=True)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "config.toml").write_text("[tool]\nname = 'mine'\n")
    with pytest.raises(InputError, match="unknown key 'tool'"):
        quiet(ten_steps(pack), tmp_path / "mine", resume=True)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="is a file"):
        quiet(ten_steps(pack), tmp_path / "file")
    with pytest.raises(InputError):  # data that is not there leaves no folder behind
        quiet(smoke_config("specular", tmp_path / "no.safetensors"), tmp_path / "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "mine"]


def test_two_trainings_never_write_into_one_folder(pack: Path, straight: Path) -> None:
    before = (straight / "config.toml").stat().st_mtime_ns
    with (straight / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # as another process holds it
        with pytest.raises(InputError, match="another training is writing there"):
            quiet(ten_steps(pack), straight, resume=True)
    assert (straight / "config.toml").stat().st_mtime_ns == before


@pytest.mark.usefixtures("without_board")
def test_a_loss_that_is_not_finite_ends_in_one_line(pack: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = Specular.loss

    def loss(method: Specular, model: Any, batch: Any, progress: float) -> Any:
        value, figures = original(method, model, batch, progress)
        return value * (torch.nan if progress >= 0.6 else 1), figures

    monkeypatch.setattr(Specular, "loss", loss)
    with pytest.raises(InputError, match="diverged"):
        quiet(ten_steps(pack, checkpoint_every=1), tmp_path / "run")
    monkeypatch.undo()
    kept = load_file(tmp_path / "run" / "checkpoint.safetensors")
    assert all(bool(tensor.isfinite().all()) for tensor in kept.values() if tensor.is_floating_point())


@pytest.mark.usefixtures("without_board")
def test_mixed_precision_learns_nearly_the_same_with_weights_in_float32(pack: Path, straight: Path, tmp_path: Path) -> None:
    mixed = quiet(ten_steps(pack, precision="bf16-mixed"), tmp_path / "run")
    exact = json.loads((straight / "summary.json").read_text())
    assert mixed.loss == pytest.approx(exact["loss"], rel=0.02)
    assert mixed.loss != exact["loss"]
    assert all(value.dtype != torch.bfloat16 for value in load_file(tmp_path / "run" / "checkpoint.safetensors").values())


def test_epochs_need_data_that_ends(pack: Path, tmp_path: Path) -> None:
    config = smoke_config("group", pack, steps=None, epochs=2)
    with pytest.raises(InputError, match=r"no epochs; give train\.steps"):
        quiet(config, tmp_path / "run")
    epochs = smoke_config("specular", pack, steps=None, epochs=2, warm_up=0, validate_every=0, sample_every=0)
    assert quiet(epochs, tmp_path / "run").steps == 6  # 6 training pictures in batches of 2, twice


def test_the_plain_command_says_errors_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["nothing", "-o", str(tmp_path / "run")]) == 2
    assert main(["smoke-specular", "-o", str(tmp_path / "run"), "--data", "pack"]) == 2
    assert main(["smoke-specular", "-o", str(tmp_path / "run"), "--device", "cuda:77"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert all(line.startswith("learn.train: ") for line in lines)
    assert not (tmp_path / "run").exists()


def test_the_bench_times_every_part(pack: Path) -> None:
    timing = bench(smoke_config("specular", pack), 2, "cpu")
    parts = (timing.data, timing.forward, timing.backward, timing.update)
    assert min(parts) > 0
    assert timing.pictures_per_second == pytest.approx(timing.pictures / sum(parts))
    assert timing.waiting_for_data == pytest.approx(timing.data / sum(parts))
    assert "pictures/s" in report(timing)


def test_a_figure_that_comes_late_widens_the_log_and_torn_rows_go(tmp_path: Path) -> None:
    log = CsvLog(tmp_path / "log.csv", 0)
    log.write({"step": 1, "loss": 0.5})
    log.write({"step": 2, "loss": 0.25, "late": 3})
    log.write({"step": 3, "late": 4})
    whole = "step,loss,late\n1,0.5,\n2,0.25,3\n3,,4\n"
    assert (tmp_path / "log.csv").read_text() == whole
    with (tmp_path / "log.csv").open("a") as stream:
        stream.write("4,0.1")
    CsvLog(tmp_path / "log.csv", 2).write({"step": 3, "loss": 1})
    assert (tmp_path / "log.csv").read_text() == "step,loss,late\n1,0.5,\n2,0.25,3\n3,1,\n"


def test_pngs_are_read_back_as_they_were(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", picture[:, ::-1])
    assert np.array_equal(cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)[..., ::-1], picture[:, ::-1])
    with pytest.raises(InputError, match="uint8"):
        write_png(tmp_path / "b.png", picture.astype(np.float32))


@pytest.mark.parametrize("when", ["before", "within"])
def test_an_interrupt_that_was_put_off_is_noted_once(when: str) -> None:
    """`degloss` puts off those that meet an import; an alarm in the midst of a checkpoint would break that off."""
    heard = []

    def put_off(number: int, frame: object) -> None:
        heard.append(number)
        if number == signal.SIGALRM:
            raise KeyboardInterrupt
        signal.setitimer(signal.ITIMER_REAL, 0.01)

    handlers = {number: signal.signal(number, put_off) for number in (signal.SIGINT, signal.SIGALRM)}
    try:
        if when == "before":
            os.kill(os.getpid(), signal.SIGINT)
        with Interrupts() as interrupts:
            if when == "within":
                os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.05)
            assert interrupts.asked
            with pytest.raises(KeyboardInterrupt), interrupts.allowed():
                pass
        assert heard == [signal.SIGINT, signal.SIGALRM][: 1 if when == "within" else 2]
        assert signal.getsignal(signal.SIGALRM) is put_off
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in handlers.items():
            signal.signal(number, handler)


def test_an_alarm_of_somebody_else_is_theirs() -> None:
    heard = []
    before = signal.signal(signal.SIGALRM, lambda number, frame: heard.append(number))
    try:
        with Interrupts() as interrupts, interrupts.allowed():
            signal.setitimer(signal.ITIMER_REAL, 0.005)
            time.sleep(0.03)
        assert heard == [signal.SIGALRM]
        assert not interrupts.asked
    finally:
        signal.signal(signal.SIGALRM, before)
