"""Checkpoints and the moving average: exact, whole or not there, and nothing trusted."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file
from torch import nn
from torch.optim.swa_utils import AveragedModel

from gen.errors import InputError
from learn.checkpoint import FORMAT, VERSION, Parts, random_state, read_state, restore, write_checkpoint
from learn.ema import MovingAverage

CPU = torch.device("cpu")


def small_network(channels: int = 4) -> nn.Module:
    return nn.Sequential(
        nn.Conv2d(3, channels, 3), nn.BatchNorm2d(channels), nn.ReLU(), nn.Dropout(0.5), nn.Conv2d(channels, 1, 1)
    )


def parts_of(network: nn.Module, average: MovingAverage | None = None) -> Parts:
    return Parts(network, torch.optim.AdamW(network.parameters(), 1e-2), average.network if average else None, CPU)


def steps(parts: Parts, average: MovingAverage | None, numbers: range) -> None:
    for n in numbers:
        batch = torch.randn(4, 3, 8, 8)
        parts.optimiser.zero_grad()
        parts.network(batch).square().mean().backward()
        parts.optimiser.step()
        if average:
            average.update(parts.network, n)


def trained(seed: int = 0) -> tuple[Parts, MovingAverage]:
    torch.manual_seed(seed)
    network = small_network()
    average = MovingAverage(network, 0.9)
    parts = parts_of(network, average)
    steps(parts, average, range(2))
    return parts, average


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    parts, _ = trained()
    write_checkpoint(tmp_path / "checkpoint.safetensors", parts, {"step": 2}, random_state(CPU))
    return tmp_path / "checkpoint.safetensors"


def test_going_on_from_a_checkpoint_gives_the_same_bits(tmp_path: Path) -> None:
    parts, average = trained()
    write_checkpoint(tmp_path / "c.safetensors", parts, {"step": 2, "note": "ö"}, random_state(CPU))
    steps(parts, average, range(2, 5))

    torch.manual_seed(99)
    network = small_network()
    other_average = MovingAverage(network, 0.9)
    other = parts_of(network, other_average)
    state, tensors = read_state(tmp_path / "c.safetensors")
    assert state == {"step": 2, "note": "ö"}
    restore(tmp_path / "c.safetensors", tensors, other)
    steps(other, other_average, range(2, 5))
    for ours, theirs in ((parts.network, network), (average.network, other_average.network)):
        for name, value in ours.state_dict().items():
            assert torch.equal(value, theirs.state_dict()[name]), name
    for a, b in zip(parts.network.parameters(), network.parameters(), strict=True):
        for key in ("exp_avg", "exp_avg_sq", "step"):
            assert torch.equal(parts.optimiser.state[a][key], other.optimiser.state[b][key])


def test_weights_that_are_not_finite_leave_the_earlier_checkpoint(checkpoint: Path) -> None:
    before = checkpoint.read_bytes()
    parts, _ = trained()
    with torch.no_grad():
        next(parts.network.parameters())[0] = torch.nan
    with pytest.raises(InputError, match="diverged"):
        write_checkpoint(checkpoint, parts, {"step": 3}, random_state(CPU))
    assert checkpoint.read_bytes() == before
    assert [path.name for path in checkpoint.parent.iterdir()] == [checkpoint.name]


class Bomb:
    """Leaves a file behind where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def damage(path: Path, how: str) -> None:
    data = bytearray(path.read_bytes())
    match how:
        case "empty":
            path.write_bytes(b"")
        case "truncated":
            path.write_bytes(data[: len(data) // 2])
        case "a byte short":
            path.write_bytes(data[:-1])
        case "huge header":
            path.write_bytes((1 << 62).to_bytes(8, "little") + data[8:])
        case "no JSON":
            data[8:40] = b"[" * 32
            path.write_bytes(data)
        case "pickle":
            path.write_bytes(pickle.dumps(Bomb(path.with_name("exploded"))))
        case "torch pickle":
            torch.save(Bomb(path.with_name("exploded")), path)
        case "other file":
            save_file({"a": torch.zeros(2)}, path)
        case "state":
            save_file({"a": torch.zeros(2)}, path, {"format": FORMAT, "version": VERSION, "state": "[" * 100_000})
        case "folder":
            path.unlink()
            path.mkdir()
        case "missing":
            path.unlink()


@pytest.mark.parametrize(
    "how",
    [
        "empty", "truncated", "a byte short", "huge header", "no JSON", "pickle", "torch pickle", "other file", "state", "folder",
        "missing",
    ],
)  # fmt: skip
def test_a_damaged_file_is_refused_in_one_line(checkpoint: Path, how: str) -> None:
    damage(checkpoint, how)
    with pytest.raises(InputError) as caught:
        read_state(checkpoint)
    assert str(caught.value).startswith(str(checkpoint))
    assert len(str(caught.value)) < 600
    assert not checkpoint.with_name("exploded").exists()


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("network.0.weight", torch.zeros(5, 3, 3, 3), "does not fit the network"),
        ("network.0.weight", torch.zeros(4, 3, 3, 3, dtype=torch.float16), "float16"),
        ("network.0.weight", torch.full((4, 3, 3, 3), torch.inf), "not finite"),
        ("network.0.weight", None, "is missing"),
        ("network.9.weight", torch.zeros(1), "too many"),
        ("average.1.running_mean", None, "moving average"),
        ("optimiser.0.weight.exp_avg", torch.zeros(2), "optimiser"),
        ("optimiser.0.weight.exp_avg", None, "optimiser"),
        ("optimiser.7.weight.exp_avg", torch.zeros(2), "unknown parameter"),
        ("random.cpu", torch.zeros(3, dtype=torch.uint8), "random generators"),
        ("random.cpu", torch.zeros(3), "random generators"),
        ("random.cpu", None, "random generators"),
        ("else", torch.zeros(1), "unknown tensor"),
    ],
)
def test_tensors_that_do_not_fit_are_named(checkpoint: Path, name: str, value: torch.Tensor | None, says: str) -> None:
    _, tensors = read_state(checkpoint)
    if value is None:
        del tensors[name]
    else:
        tensors[name] = value
    parts, _ = trained(1)
    before = {key: tensor.clone() for key, tensor in parts.network.state_dict().items()}
    with pytest.raises(InputError, match=says) as caught:
        restore(checkpoint, tensors, parts)
    assert str(checkpoint) in str(caught.value)
    for key, tensor in parts.network.state_dict().items():
        assert torch.equal(tensor, before[key])


def test_the_moving_average_is_torchs_with_its_buffers() -> None:
    torch.manual_seed(0)
    network = small_network()
    average = MovingAverage(network, 0.9)

    def toward(old: Any, new: Any, count: Any) -> Any:
        decay = min(0.9, (1 + n) / (10 + n))
        return old * decay + new * (1 - decay) if old.is_floating_point() else new

    reference = AveragedModel(network, avg_fn=toward, use_buffers=True)
    reference.n_averaged += 1  # else the first update copies
    parts = parts_of(network)
    for n in range(30):
        steps(parts, None, range(1))
        average.update(network, n)
        reference.update_parameters(network)
    for name, value in average.network.state_dict().items():
        expected = reference.module.state_dict()[name]
        assert torch.allclose(value, expected, rtol=1e-5, atol=1e-6), name
        assert value.dtype == expected.dtype
    assert average.network.state_dict()["1.num_batches_tracked"] == 30
    assert not average.network.training
