"""Hostile weights, checkpoints and packs: code in place of numbers, headers that lie, networks as wide as memory."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.hostile.commands import Case, require_refusal
from tests.hostile.files import npz_of, pack_bytes, pickled, png, safetensors, safetensors_claiming

pytestmark = pytest.mark.skipif(find_spec("torch") is None, reason="torch is not installed")

WEIGHTS = {"format": "degloss weights", "version": "1", "method": "specular", "model": '{"width": 4}', "facts": "{}"}
ONE = {"w": np.ones(3, np.float32)}


def saved_by_torch(zipped: bool) -> bytes:
    import torch

    memory = io.BytesIO()
    torch.save({"w": torch.ones(3)}, memory, _use_new_zipfile_serialization=zipped)
    return memory.getvalue()


def saying(arrays: Mapping[str, np.ndarray[Any, Any]] = ONE, **metadata: str) -> bytes:
    return safetensors(arrays, WEIGHTS | metadata)


def sound(**changes: np.ndarray[Any, Any] | None) -> bytes:
    """Weights of a small network as they should be, but for some tensors; None takes one out."""
    from learn.method import create_method

    state = {name: tensor.numpy() for name, tensor in create_method("specular").build({"width": 4}).state_dict().items()}
    first = next(iter(state))
    state |= {first if name == "first" else name: array for name, array in changes.items()}  # type: ignore[misc]
    return saying({name: array for name, array in state.items() if array is not None})


def entry(shape: list[Any], begin: int, end: int, dtype: str = "F32") -> dict[str, Any]:
    return {"__metadata__": WEIGHTS, "w": {"dtype": dtype, "shape": shape, "data_offsets": [begin, end]}}


FILES: dict[str, tuple[Callable[[], bytes], str]] = {
    # what it is: (the file's bytes, what the line says)
    "nothing": (lambda: b"", "is empty"),
    "a pickle": (pickled, "not a safetensors file"),
    "a checkpoint of torch": (lambda: saved_by_torch(True), "not a safetensors file"),
    "an old checkpoint of torch": (lambda: saved_by_torch(False), "not a safetensors file"),
    "an archive with a pickle": (lambda: npz_of({"archive/data.pkl": pickled()}), "not a safetensors file"),
    "an archive of arrays": (lambda: npz_of({"w.npy": b"\x93NUMPY"}), "not a safetensors file"),
    "a picture": (png, "not a safetensors file"),
    "a header of exabytes": (lambda: safetensors_claiming({}, 2**63), "truncated or not a safetensors file"),
    "a header longer than the file": (lambda: safetensors_claiming({}, 5000), "truncated or not a safetensors file"),
    "a header that is no JSON": (lambda: safetensors_claiming(b"{{{{"), "not a safetensors file"),
    "a header nested 100,000 deep": (lambda: safetensors_claiming(b"[" * 100_000), "not a safetensors file"),
    "a header that is a list": (lambda: safetensors_claiming([]), "not a safetensors file"),
    "a header that is not UTF-8": (lambda: safetensors_claiming(b'{"\xff": 1}'), "not a safetensors file"),
    "a tensor beyond the end": (lambda: safetensors_claiming(entry([1000], 0, 4000), data=b"\0" * 8), "not a safetensors file"),
    "a tensor of exabytes": (
        lambda: safetensors_claiming(entry([2**40, 2**20], 0, 12), data=b"\0" * 12),
        "not a safetensors file",
    ),
    "a tensor below zero": (lambda: safetensors_claiming(entry([-3], 0, 12), data=b"\0" * 12), "not a safetensors file"),
    "a tensor of a kind that does not exist": (
        lambda: safetensors_claiming(entry([3], 0, 12, "F77"), data=b"\0" * 12),
        "not a safetensors file",
    ),
    "a tensor that ends before it begins": (
        lambda: safetensors_claiming(entry([3], 12, 0), data=b"\0" * 12),
        "not a safetensors file",
    ),
    "two tensors in one place": (
        lambda: safetensors_claiming(entry([3], 0, 12) | {"v": entry([3], 0, 12)["w"]}, data=b"\0" * 12),
        "not a safetensors file",
    ),
    "cut": (lambda: sound()[:-100], "not a safetensors file"),
    "other weights": (lambda: safetensors(ONE, {"format": "pt"}), "is not 'degloss weights'"),
    "another version": (lambda: saying(version="9"), "is not 'degloss weights'"),
    "an unknown method": (lambda: saying(method="magic"), "unknown method 'magic'"),
    "options that are no JSON": (lambda: saying(model="{"), ""),
    "options that are a list": (lambda: saying(model="[]"), ""),
    "options of a thousand pages": (lambda: saying(model=json.dumps({"width": [4] * 5000})), ""),
    "options nested deep": (lambda: saying(model="[" * 3000), ""),
    "an unknown option": (lambda: saying(model='{"depth": 4}'), "depth"),
    "a network as wide as memory": (lambda: saying(model='{"width": 100000000}'), ""),
    "a network of no width": (lambda: saying(model='{"width": 0}'), "width"),
    "a network of minus one": (lambda: saying(model='{"width": -1}'), "width"),
    "a width of 400 digits": (lambda: saying(model='{"width": ' + "9" * 400 + "}"), ""),
    "a width that is NaN": (lambda: saying(model='{"width": NaN}'), "width"),
    "a tensor missing": (lambda: sound(first=None), "is missing"),
    "a tensor too many": (lambda: sound(extra=np.ones(3, np.float32)), "is too many"),
    "a tensor of another shape": (lambda: sound(first=np.ones((1, 2), np.float32)), "the network has"),
    "a tensor of another kind": (lambda: sound(first=np.ones(3, np.float64)), "the network has"),
}


@pytest.mark.parametrize("what", FILES)
def test_hostile_weights_are_refused(what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data, says = FILES[what]

    def lay(folder: Path) -> None:
        (folder / "w.safetensors").write_bytes(data())
        (folder / "a.png").write_bytes(png())

    command = "learn predict HERE/w.safetensors HERE/a.png -o HERE/out --device cpu"
    require_refusal(Case(lay, command, "w.safetensors", says), tmp_path, capfd)
    assert not Path("loaded.txt").exists()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_weights_that_are_not_finite_are_refused(value: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from learn.method import create_method

    state = {name: tensor.numpy() for name, tensor in create_method("specular").build({"width": 4}).state_dict().items()}
    name = next(key for key, array in state.items() if array.dtype == np.float32)
    (tmp_path / "w.safetensors").write_bytes(saying({**state, name: np.full_like(state[name], value)}))
    case = Case(lambda _: None, "learn export HERE/w.safetensors -o HERE/w.onnx", "w.safetensors", "finite")
    require_refusal(case, tmp_path, capfd)


def test_weights_too_large_to_be_weights_are_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A hole of gigabytes costs nothing on the disk, and would fill the memory."""

    def lay(folder: Path) -> None:
        with (folder / "w.safetensors").open("wb") as file:
            file.write((1000).to_bytes(8, "little"))
            file.truncate(9_000_000_000)

    require_refusal(Case(lay, "learn export HERE/w.safetensors -o HERE/w.onnx", "w.safetensors", "too large"), tmp_path, capfd)


def changed_pack(change: Callable[[dict[str, Any]], object]) -> bytes:
    """The sound pack with another header before the same numbers."""
    data = pack_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    change(header)
    return safetensors_claiming(header, data=data[8 + length :])


def facts(**changes: Any) -> Callable[[], bytes]:
    def change(header: dict[str, Any]) -> None:
        table = json.loads(header["__metadata__"]["facts"])
        header["__metadata__"]["facts"] = json.dumps(table | changes)

    return lambda: changed_pack(change)


def listed(name: str, **changes: Any) -> Callable[[], bytes]:
    return lambda: changed_pack(lambda header: header[name].update(changes))


PACKS: dict[str, tuple[Callable[[], bytes], str]] = {
    "nothing": (lambda: b"", "is empty"),
    "a pickle": (pickled, "not a safetensors file"),
    "a header of exabytes": (lambda: safetensors_claiming({}, 2**63), "not a safetensors file"),
    "a header nested 100,000 deep": (lambda: safetensors_claiming(b"[" * 100_000), "not valid JSON"),
    "an array twice": (lambda: safetensors_claiming(b'{"a": 1, "a": 2}'), "is there twice"),
    "cut": (lambda: pack_bytes()[:-20], "truncated or damaged"),
    "bytes to spare": (lambda: pack_bytes() + b"\0", "follow the last array"),
    "weights": (lambda: sound(), "not a pack"),
    "an array of exabytes": (listed("combined", shape=[2**40, 4, 4, 3]), "its shape asks for"),
    "an array below zero": (listed("combined", shape=[-2, 4, 4, 3]), "whole numbers"),
    "an array of another kind": (listed("combined", dtype="F77"), "a kind that is not read"),
    "an array over another": (listed("combined", data_offsets=[8, 392]), ""),
    "an array of another size": (listed("mask", shape=[2, 2, 8]), "the others ask for"),
    "facts that are no JSON": (lambda: changed_pack(lambda header: header["__metadata__"].update(facts="{")), "facts"),
    "no items": (facts(items=[]), "facts"),
    "an item of no frames": (facts(items=[{"frames": [0, 0]}, {"frames": [0, 2]}]), "range of frames"),
    "an item beyond the end": (facts(items=[{"frames": [0, 9]}, {"frames": [9, 18]}]), "range of frames"),
    "an item of frames in words": (facts(items=[{"frames": "all"}, {"frames": [0, 2]}]), "range of frames"),
    "a split that is a list": (facts(items=[{"frames": [0, 1], "split": []}, {"frames": [1, 2], "split": {}}]), ""),
}


@pytest.mark.parametrize("what", PACKS)
def test_a_hostile_pack_is_refused(what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data, says = PACKS[what]
    case = Case(
        lambda folder: (folder / "data.safetensors").write_bytes(data()),
        "learn eval specular HERE/data.safetensors --split test --device cpu",
        "data.safetensors",
        says,
    )
    require_refusal(case, tmp_path, capfd)


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that has made one step: config, pack and run."""
    from learn.train import train
    from tests.learn.small_runs import smoke_config, write_tiny_pack

    folder = tmp_path_factory.mktemp("begun")
    pack = write_tiny_pack(folder / "pack.safetensors")
    config = smoke_config("specular", pack, steps=1, epochs=None, validate_every=0, sample_every=0)
    (folder / "config.toml").write_text(config.text)
    train(config, folder / "run", False, "cpu", progress=None)
    return folder


def state(path: Path, **changes: str) -> bytes:
    from safetensors import safe_open
    from safetensors.torch import save

    with safe_open(path, framework="pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
        metadata = dict(file.metadata())
    return save(tensors, metadata | changes)


CHECKPOINTS: dict[str, tuple[Callable[[Path], bytes], str]] = {
    "nothing": (lambda path: b"", "is empty"),
    "a pickle": (lambda path: pickled(), "not a safetensors file"),
    "a checkpoint of torch": (lambda path: saved_by_torch(True), "not a safetensors file"),
    "cut": (lambda path: path.read_bytes()[:-64], "not a safetensors file"),
    "weights": (lambda path: sound(), "not a checkpoint"),
    "a state that is no JSON": (lambda path: state(path, state="{"), "not JSON"),
    "a state that is a list": (lambda path: state(path, state="[]"), "not a table"),
    "an empty state": (lambda path: state(path, state="{}"), ""),
    "a state of words": (lambda path: state(path, state='{"step": "three", "seconds": []}'), ""),
    "a state of NaN": (lambda path: state(path, state='{"step": NaN}'), ""),
}


@pytest.mark.parametrize("what", CHECKPOINTS)
def test_a_hostile_checkpoint_is_refused(what: str, begun: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    import shutil

    data, says = CHECKPOINTS[what]

    def lay(folder: Path) -> None:
        shutil.copytree(begun / "run", folder / "run")
        (folder / "run" / "checkpoint.safetensors").write_bytes(data(begun / "run" / "checkpoint.safetensors"))
        (folder / "run" / ".lock").touch()

    command = f"learn train {begun}/config.toml -o HERE/run --resume --device cpu --data pack={begun}/pack.safetensors"
    require_refusal(Case(lay, command, "run", says), tmp_path, capfd)
    assert not Path("loaded.txt").exists()


def test_an_archive_inside_weights_is_not_opened(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A file that is a safetensors file to one reader and an archive to another: only the first is asked."""
    (tmp_path / "w.safetensors").write_bytes(saying(method="magic") + npz_of({"a": b"b"}))
    assert zipfile.is_zipfile(tmp_path / "w.safetensors")
    case = Case(lambda _: None, "learn export HERE/w.safetensors -o HERE/w.onnx", "w.safetensors", "not a safetensors file")
    require_refusal(case, tmp_path, capfd)
