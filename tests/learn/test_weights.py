"""Files of weights: the same network comes back, and nothing in them is trusted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import nn

import learn.weights
from gen.errors import InputError
from learn.config import read_config
from learn.method import METHODS, create_method
from learn.weights import FORMAT, VERSION, find_weights, load_weights, open_device, save_weights
from tests.learn.test_checkpoint import damage

FACTS = {"seed": 1, "seconds": 3.5, "versions": {"torch": "2"}}


def build(name: str) -> tuple[nn.Module, dict[str, Any]]:
    options = dict(read_config(f"smoke-{name}").model)
    torch.manual_seed(0)
    return create_method(name).build(options), options


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    model, options = build("specular")
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    save_weights(path, model, "specular", options, FACTS)
    return path


@pytest.fixture
def weights(written: Path, tmp_path: Path) -> Path:
    path = tmp_path / "w.safetensors"
    path.write_bytes(written.read_bytes())
    return path


@pytest.mark.parametrize("name", METHODS)
def test_every_methods_network_comes_back_as_it_was(tmp_path: Path, name: str) -> None:
    model, options = build(name)
    with torch.no_grad():
        for buffer in model.buffers():
            buffer += 1
    path = tmp_path / "w.safetensors"
    save_weights(path, model, name, options, FACTS)
    state = torch.random.get_rng_state()
    loaded = load_weights(path)
    assert torch.equal(torch.random.get_rng_state(), state)  # reading draws nothing
    assert (loaded.method, loaded.options, loaded.facts, loaded.path) == (name, options, FACTS, path)
    assert not loaded.model.training
    assert not any(parameter.requires_grad for parameter in loaded.model.parameters())
    assert all(tensor.device.type == "cpu" for tensor in (*loaded.model.parameters(), *loaded.model.buffers()))
    for key, tensor in model.state_dict().items():
        assert torch.equal(tensor, loaded.model.state_dict()[key])


def test_a_run_a_method_or_a_file_names_weights(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = weights.parent / "run"
    run.mkdir()
    with pytest.raises(InputError, match=r"without weights\.safetensors"):
        find_weights(run)
    (run / "weights.safetensors").write_bytes(weights.read_bytes())
    assert load_weights(run).path == run / "weights.safetensors"
    monkeypatch.setattr(learn.weights, "SHIPPED", weights.parent)
    with pytest.raises(InputError, match="no weights of this method"):
        find_weights("diffuse")
    weights.rename(weights.parent / "specular.safetensors")
    assert load_weights("specular").method == "specular"
    with pytest.raises(InputError, match="no such file"):
        find_weights("speculum")


@pytest.mark.parametrize(
    "how",
    [
        "empty", "truncated", "a byte short", "huge header", "no JSON", "pickle", "torch pickle", "other file", "folder", "missing",
    ],
)  # fmt: skip
def test_a_damaged_file_is_refused_in_one_line(weights: Path, how: str) -> None:
    damage(weights, how)
    with pytest.raises(InputError) as caught:
        load_weights(weights)
    assert str(weights) in str(caught.value)
    assert len(str(caught.value)) < 600
    assert not weights.with_name("exploded").exists()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"method": "gloss"}, "unknown method"),
        ({"version": "2"}, "version"),
        ({"format": "degloss pack"}, "degloss weights"),
        ({"model": "nonsense"}, "not JSON"),
        ({"model": "[1]"}, "not a table"),
        ({"model": json.dumps({"width": 8, "stem": 2, "x": "y" * 5000})}, "too long"),
        ({"model": json.dumps({"width": 8, "stem": 2, "depth": 3})}, "depth"),
        ({"model": json.dumps({"width": "8", "stem": 2})}, "width"),
        ({"model": json.dumps({"width": 10**9, "stem": 2})}, "width"),
        ({"model": json.dumps({"width": 128, "stem": 2})}, "the network has"),
        ({"model": json.dumps({"width": -8, "stem": 2})}, "width"),
        ({"method": "diffuse", "model": json.dumps({"width": 16, "stem": 2})}, "the network has"),
        ({"method": "lime"}, "tensors"),
        ({"facts": "{"}, "facts"),
    ],
)
def test_facts_that_do_not_fit_are_refused(weights: Path, changes: dict[str, str], says: str) -> None:
    with safe_open(weights, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
        metadata = dict(file.metadata())
    assert (metadata["format"], metadata["version"]) == (FORMAT, VERSION)
    save_file(tensors, weights, {**metadata, **changes})
    with pytest.raises(InputError, match=says) as caught:
        load_weights(weights)
    assert str(caught.value).startswith(str(weights))


def test_values_that_are_not_finite_are_neither_written_nor_read(weights: Path) -> None:
    with safe_open(weights, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
        metadata = dict(file.metadata())
    first = next(iter(tensors))
    tensors[first].view(-1)[0] = torch.nan
    save_file(tensors, weights, metadata)
    with pytest.raises(InputError, match="not finite"):
        load_weights(weights)
    model, options = build("specular")
    with torch.no_grad():
        next(model.parameters()).fill_(torch.inf)
    with pytest.raises(InputError, match="not finite"):
        save_weights(weights.with_name("new.safetensors"), model, "specular", options, {})
    assert not weights.with_name("new.safetensors").exists()


def test_a_file_that_is_too_large_is_not_read(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learn.weights, "MAX_BYTES", 1000)
    with pytest.raises(InputError, match="too large"):
        load_weights(weights)


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:-1", "cuda:x", "cuda:²", "cuda:99", "mps", "", "cpu:0"])
def test_devices_that_are_not_there_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="device"):
        open_device(name)
    assert open_device("cpu").type == "cpu"
