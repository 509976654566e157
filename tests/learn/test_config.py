"""Configs: the shipped ones, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch.optim.lr_scheduler import CosineAnnealingLR

from gen.errors import InputError
from learn.config import config_names, determinants, difference, parse_config, parse_overrides, read_config, with_minutes
from learn.method import METHODS
from learn.schedule import rate_factor

GOOD = """
method = "specular"
seed = 3
[model]
width = 8
[data]
pack = "sets/a.safetensors"
[train]
batch = 2
steps = 10
"""


@pytest.mark.parametrize("name", config_names())
def test_every_shipped_config_is_read(name: str) -> None:
    config = read_config(name)
    assert config.method in METHODS
    assert name == "group" or name.endswith(f"-{config.method}")


def test_every_method_has_a_paper_or_a_group_config_and_a_smoke_one() -> None:
    assert {"paper-lime", "paper-specular", "paper-diffuse", "group", *(f"smoke-{name}" for name in METHODS)} <= set(
        config_names()
    )


@pytest.mark.parametrize("method", ["lime", "specular", "diffuse"])
def test_the_papers_schedule_is_the_papers(method: str) -> None:
    train = read_config(f"paper-{method}").train
    assert (train.batch, train.epochs, train.rate, train.optimiser, train.schedule) == (32, 300, 1e-4, "adam", "constant")
    assert (train.ema, train.clip, train.weight_decay, train.warm_up, train.precision) == (0, 0, 0, 0, "32-true")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("seed = 3", "sed = 3", "'sed'"),
        ("seed = 3", "seed = -1", "seed"),
        ("seed = 3", "seed = true", "seed"),
        ("seed = 3", "seed = 99999999999", "seed"),
        ('"specular"', '"gloss"', "method"),
        ('"specular"', "1", "method"),
        ("batch = 2", "batch = 0", "train.batch"),
        ("batch = 2", "batch = 2.5", "train.batch"),
        ("batch = 2", 'batch = "2"', "train.batch"),
        ("batch = 2", "batch = true", "train.batch"),
        ("batch = 2\n", "", "train.batch"),
        ("steps = 10", "steps = 10\nepochs = 2", "epochs and steps"),
        ("steps = 10\n", "", "epochs and steps"),
        ("steps = 10", "steps = 10\nrate = nan", "train.rate"),
        ("steps = 10", "steps = 10\nrate = -1e-4", "train.rate"),
        ("steps = 10", "steps = 10\nrate = inf", "train.rate"),
        ("steps = 10", "steps = 10\nema = 1.0", "train.ema"),
        ("steps = 10", "steps = 10\nclip = -1", "train.clip"),
        ("steps = 10", "steps = 10\nwarm_up = 10", "train.warm_up"),
        ("steps = 10", "steps = 10\nlog_every = 0", "train.log_every"),
        ("steps = 10", 'steps = 10\noptimiser = "sgd"', "train.optimiser"),
        ("steps = 10", "steps = 10\nschedule = 1", "train.schedule"),
        ("steps = 10", 'steps = 10\nprecision = "16"', "train.precision"),
        ("steps = 10", "steps = 10\nmomentum = 0.9", "train.momentum"),
        ("steps = 10", "steps = ", "not valid TOML"),
        ("[model]\nwidth = 8", "model = 8", "model"),
    ],
)
def test_a_wrong_key_or_value_is_named_in_one_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in GOOD
    path = tmp_path / "wrong.toml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_config(path)
    assert str(path) in str(caught.value)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_config_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="smoke-lime"):
        read_config("paper-limes")
    with pytest.raises(InputError, match="neither a file"):
        read_config(tmp_path)
    (tmp_path / "a.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not UTF-8"):
        read_config(tmp_path / "a.toml")
    (tmp_path / "b.toml").write_text("#" * 1_000_001)
    with pytest.raises(InputError, match="too large"):
        read_config(tmp_path / "b.toml")


def test_overrides_take_the_place_of_values_and_are_read_as_toml_or_text() -> None:
    words = ["pack=/elsewhere/a.safetensors", "crop=64", "flip=false", "lights=[0, 1]", "note=a=b"]
    overrides = parse_overrides(words)
    assert overrides == {"pack": "/elsewhere/a.safetensors", "crop": 64, "flip": False, "lights": [0, 1], "note": "a=b"}
    config = parse_config(GOOD, "good", overrides)
    assert config.data["pack"] == "/elsewhere/a.safetensors"
    assert config.overridden == tuple(overrides)
    for wrong in ("pack", "=3", "a b=3", "x\ny=2"):
        with pytest.raises(InputError, match="KEY=VALUE"):
            parse_overrides([wrong])


def test_a_run_may_move_and_say_more_but_not_learn_differently() -> None:
    config = parse_config(GOOD, "good")
    free = replace(config, train=replace(config.train, minutes=3.0, log_every=7, checkpoint_every=2, sample_every=0, threads=2))
    moved = parse_config(GOOD, "good", {"pack": "/elsewhere/a.safetensors"})
    for same in (free, moved):
        assert difference(determinants(config), determinants(same)) is None
    for other, key in [
        (replace(config, seed=4), "seed"),
        (replace(config, train=replace(config.train, rate=2e-4)), "train.rate"),
        (replace(config, train=replace(config.train, ema=0.5)), "train.ema"),
        (parse_config(GOOD, "good", {"pack": "sets/b.safetensors"}), "data.pack"),
        (parse_config(GOOD, "good", {"crop": 64}), "data.crop"),
        (parse_config(GOOD.replace("width = 8", "width = 9"), "good"), "model.width"),
    ]:
        said = difference(determinants(config), determinants(other))
        assert said is not None
        assert said.startswith(f"{key} was ")


def test_minutes_from_the_command_line_are_checked() -> None:
    config = parse_config(GOOD, "good")
    assert with_minutes(config, None) is config
    assert with_minutes(config, 2).train.minutes == 2
    for wrong in (0, -1, float("nan"), float("inf")):
        with pytest.raises(InputError, match="--minutes"):
            with_minutes(config, wrong)


def test_the_cosine_is_torchs_and_warm_up_rises_to_the_peak() -> None:
    optimiser = torch.optim.SGD([torch.zeros(1, requires_grad=True)], lr=1.0)
    scheduler = CosineAnnealingLR(optimiser, T_max=50)
    for step in range(50):
        assert rate_factor(step, 50, "cosine", 0) == pytest.approx(optimiser.param_groups[0]["lr"], abs=1e-12)
        assert rate_factor(step, 50, "constant", 0) == 1
        optimiser.step()
        scheduler.step()
    rise = [rate_factor(step, 50, "cosine", 10) for step in range(11)]
    assert rise[:10] == pytest.approx([(i + 1) / 10 for i in range(10)])
    assert rise[10] == 1
    assert 0 < rate_factor(49, 50, "cosine", 10) < 0.01
