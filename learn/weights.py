"""Weights as files: safetensors with the network's options and the facts of its training; the shipped ones by their method's name.

Nothing in a file is executed: no pickle is read, sizes are bounded before anything is allocated, and every tensor is checked against
the network that the options name.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gen.errors import InputError
from gen.files import must_exist, writing
from gen.parts import import_whole, require
from learn.method import METHODS, create_method

if TYPE_CHECKING:
    from torch import Tensor, nn

FORMAT = "degloss weights"
VERSION = "1"
SHIPPED = Path(__file__).parent / "weights"
"""Where the shipped weights lie."""

MAX_BYTES = 200_000_000
"""The largest file of weights that is read."""

MAX_HEADER = 10_000_000
"""The longest header of a safetensors file that is read, in bytes."""

MAX_OPTIONS = 4000
"""The longest options of a network, in characters of JSON: with short options no network takes long to lay out."""


@dataclass(frozen=True, eq=False)
class Loaded:
    """Weights that were read. model: in evaluation mode, without gradients. options: the network's. facts: of its training."""

    method: str
    model: nn.Module
    options: Mapping[str, Any]
    facts: Mapping[str, Any]
    path: Path


def save_weights(path: Path, model: nn.Module, method: str, options: Mapping[str, Any], facts: Mapping[str, Any]) -> None:
    """Write a network's parameters and buffers, by a temporary name. options: what `create_method(method).build` makes it from.

    facts: data, seed, steps, seconds, device, config, share of the schedule, versions: anything that JSON holds. Raises InputError
    where a value is not finite or the place cannot be written.
    """
    tensors = dict(model.state_dict())
    must_be_finite(tensors, f"{path}: not written")
    metadata = {
        "format": FORMAT,
        "version": VERSION,
        "method": method,
        "model": json.dumps(dict(options)),
        "facts": json.dumps(facts),
    }
    write_tensors(path, tensors, metadata)


def load_weights(name_or_path: str | Path, device: str = "cpu") -> Loaded:
    """The network of a weights file, of a run's folder (its weights.safetensors), or the shipped one of a method's name.

    Raises MissingPart without torch; InputError, one line, where the file is missing, too large, damaged, not of this format, or does
    not fit the network that it names.
    """
    require("torch")
    import_whole("torch")
    import torch

    path = find_weights(name_or_path)
    tensors, metadata = read_tensors(path, "weights of a network", MAX_BYTES)
    if metadata.get("format") != FORMAT or metadata.get("version") != VERSION:
        found = f"{metadata.get('format')!s:.40} {metadata.get('version')!s:.10}"
        raise InputError(f"{path}: is not '{FORMAT}' of version {VERSION} but '{found}'; degloss learn train writes them")
    name = metadata.get("method", "")
    if name not in METHODS:
        raise InputError(f"{path}: is of an unknown method {name[:40]!r}; there are {', '.join(METHODS)}")
    options, facts = _table(metadata, "model", path, MAX_OPTIONS), _table(metadata, "facts", path, MAX_HEADER)
    method = create_method(name)
    try:
        with torch.device("meta"):  # the options may ask for any size: compare before memory is taken
            expected = method.build(options).state_dict()
        must_match(tensors, expected, f"{path}: its tensors are not those of the method {name!r}")
        with torch.random.fork_rng(devices=[]):
            model = method.build(options)
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from error
    except (TypeError, ValueError, RuntimeError, ArithmeticError, MemoryError) as error:
        raise InputError(f"{path}: its options make no network ({str(error)[:200]})") from error
    must_be_finite(tensors, str(path))
    model.load_state_dict(tensors)
    return Loaded(name, model.requires_grad_(False).eval().to(open_device(device)), options, facts, path)


def find_weights(name_or_path: str | Path) -> Path:
    """Where weights lie: a file, a run's folder, or a method's name. Raises InputError where there is nothing."""
    path = Path(name_or_path)
    if path.is_dir() and (path / "weights.safetensors").is_file():
        return path / "weights.safetensors"
    if str(name_or_path) in METHODS and not path.is_file():
        shipped = SHIPPED / f"{name_or_path}.safetensors"
        if not shipped.is_file():
            raise InputError(
                f"{name_or_path}: no weights of this method are installed; give a file that degloss learn train wrote"
            )
        return shipped
    if path.is_dir():
        raise InputError(f"{path}: is a folder without weights.safetensors; give a run of degloss learn train, or a file")
    if not path.exists():
        raise InputError(f"{path}: there is no such file of weights; a path, or one of {', '.join(METHODS)}")
    return path


def open_device(name: str) -> Any:
    """The torch device of "auto" (a GPU where there is one), "cpu", "cuda" or "cuda:1". Raises InputError where it is not there."""
    import torch

    kind, colon, number = name.partition(":")
    if name == "auto":
        return torch.device("cuda:0" if torch.cuda.is_available() else "cpu")
    if name == "cpu":
        return torch.device("cpu")
    if kind != "cuda" or (colon and not (number.isascii() and number.isdigit())):
        raise InputError(f"device {name!r}: must be auto, cpu, cuda or cuda:NUMBER")
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if int(number or 0) >= count:
        raise InputError(
            f"device {name!r}: there {'is' if count == 1 else 'are'} {count} GPU{'' if count == 1 else 's'} here; use --device cpu"
        )
    return torch.device(f"cuda:{int(number or 0)}")


def read_tensors(path: Path, what: str, limit: int) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The tensors and the metadata of a safetensors file. limit: its largest size in bytes.

    Raises InputError where it is missing, larger than the limit, or not a whole safetensors file.
    """
    from safetensors import SafetensorError, safe_open

    must_exist(path, what)
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            length = int.from_bytes(stream.read(8), "little")
        if size > limit:
            raise InputError(f"{path}: is too large for {what} ({size} bytes, at most {limit})")
        if size < 10 or not 2 <= length <= min(size - 8, MAX_HEADER):
            raise InputError(f"{path}: is truncated or not a safetensors file ({what})")
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata() or {})  # noqa: SIM118 - no mapping
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}; {what})") from error
    except (SafetensorError, RuntimeError, ValueError, TypeError, KeyError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is damaged or not a safetensors file ({str(error)[:200]}; {what})") from error


def write_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Write a safetensors file, by a temporary name, on the disk before it takes its place. Tensors that share memory are written twice."""
    from safetensors.torch import save

    plain = {name: tensor.detach().to("cpu").clone().contiguous() for name, tensor in tensors.items()}
    with writing(path) as temporary, temporary.open("wb") as stream:
        stream.write(save(plain, dict(metadata)))
        stream.flush()
        os.fsync(stream.fileno())


def must_match(found: Mapping[str, Tensor], expected: Mapping[str, Tensor], what: str) -> None:
    """Raise InputError unless both have the same names, shapes and kinds of numbers. what: the beginning of the message."""
    for name in sorted({*found, *expected}):
        if name not in found:
            raise InputError(f"{what}: {name[:80]!r} is missing")
        if name not in expected:
            raise InputError(f"{what}: {name[:80]!r} is too many")
        there, here = found[name], expected[name]
        if there.shape != here.shape or there.dtype != here.dtype:
            raise InputError(
                f"{what}: {name[:80]!r} is {tuple(there.shape)} {there.dtype}, the network has {tuple(here.shape)} {here.dtype}"
            )


def must_be_finite(tensors: Mapping[str, Tensor], what: str) -> None:
    """Raise InputError where a tensor holds NaN or infinity. what: the beginning of the message."""
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not bool(tensor.isfinite().all()):
            raise InputError(f"{what}: {name[:80]!r} holds values that are not finite")


def _table(metadata: Mapping[str, str], key: str, path: Path, limit: int) -> dict[str, Any]:
    text = metadata.get(key, "")
    if len(text) > limit:
        raise InputError(f"{path}: its {key!r} is too long ({len(text)} characters, at most {limit})")
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: its {key!r} is not JSON ({str(error)[:100]})") from error
    if not isinstance(value, dict):
        raise InputError(f"{path}: its {key!r} is not a table")
    return value
