"""The config of a training: a TOML file, read strictly, and the shipped ones by name.

Training runs where only torch and numpy are beside it, so this reads with the standard library's tomllib and checks by itself.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from gen.errors import InputError
from learn.method import METHODS

FOLDER = Path(__file__).parent / "configs"
"""Where the shipped configs lie."""

MAX_BYTES = 1_000_000
"""The largest config that is read."""

CHOICES: Mapping[str, tuple[str, ...]] = {
    "optimiser": ("adam", "adamw"),
    "schedule": ("constant", "cosine"),
    "precision": ("32-true", "bf16-mixed"),
}

LIMITS: Mapping[str, tuple[float, float]] = {
    "batch": (1, 1 << 20),
    "epochs": (1, 10**6),
    "steps": (1, 10**9),
    "minutes": (0.001, 10**6),
    "rate": (1e-12, 10),
    "weight_decay": (0, 10),
    "warm_up": (0, 10**9),
    "ema": (0, 0.999999),
    "clip": (0, 10**6),
    "log_every": (1, 10**9),
    "checkpoint_every": (1, 10**9),
    "sample_every": (0, 10**9),
    "validate_every": (0, 10**9),
    "validation_batches": (1, 10**6),
    "threads": (0, 4096),
}
"""The least and the greatest value of each number of [train]."""

FREE = ("minutes", "log_every", "checkpoint_every", "sample_every", "threads", "prefetch")
"""Keys of [train] that may change when a run is resumed: what they say does not change the weights."""


@dataclass(frozen=True)
class Train:
    """The table [train].

    batch: what one process takes a step. epochs or steps: the length of the schedule (exactly one). minutes: stop by the clock, all
    sessions of a run together. rate: the peak learning rate. warm_up: steps of linear rise. ema: decay of the averaged weights, 0 for
    none. start: weights that the training goes on from, a file or a method's name for the shipped ones; None begins with new ones. clip:
    the largest norm of the gradient, 0 for any. *_every: in steps; sample_every and validate_every take 0 for never.
    threads: of torch on a CPU, 0 leaves them alone. prefetch: a thread of its own makes the next batch during a step.
    """

    batch: int
    epochs: int | None = None
    steps: int | None = None
    minutes: float | None = None
    rate: float = 1e-4
    optimiser: str = "adam"
    weight_decay: float = 0.0
    schedule: str = "constant"
    warm_up: int = 0
    ema: float = 0.0
    start: str | None = None
    precision: str = "32-true"
    clip: float = 0.0
    log_every: int = 50
    checkpoint_every: int = 1000
    sample_every: int = 1000
    validate_every: int = 1000
    validation_batches: int = 4
    threads: int = 0
    prefetch: bool = False


@dataclass(frozen=True)
class Config:
    """A whole config. model: options of the method's network. data: options of its source, overrides applied.

    name: the file's. text: the file as it is, which a run keeps a copy of. overridden: the keys of data that the file does not say.
    """

    method: str
    seed: int
    model: Mapping[str, Any]
    data: Mapping[str, Any]
    train: Train
    name: str = field(compare=False)
    text: str = field(compare=False, repr=False)
    overridden: tuple[str, ...] = field(compare=False, default=())


def config_names() -> tuple[str, ...]:
    """The names of the shipped configs."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def read_config(name_or_path: str | Path, data_overrides: Mapping[str, Any] | None = None) -> Config:
    """The config of a file, or the shipped one of that name. data_overrides: values of [data] that take the place of the file's.

    Raises InputError, one line with file and key, where the file is missing, too large, not TOML, has a key that does not exist, a value
    of another type or out of its limits, or not exactly one of epochs and steps.
    """
    shipped = not Path(name_or_path).is_file() and str(name_or_path) in config_names()
    path = FOLDER / f"{name_or_path}.toml" if shipped else Path(name_or_path)
    if not path.is_file():
        raise InputError(f"{path}: is neither a file nor a shipped config; those are {', '.join(config_names())}")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: is too large for a config ({path.stat().st_size} bytes)")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}; a config)") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text (a config)") from error
    return parse_config(text, str(name_or_path), data_overrides)


def parse_config(text: str, name: str, data_overrides: Mapping[str, Any] | None = None) -> Config:
    """The config of a TOML text; `name` stands for it in messages. Raises InputError as `read_config` does."""
    try:
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise InputError(f"{name}: is not valid TOML ({error})") from error
    for key in table:
        if key not in ("method", "seed", "model", "data", "train"):
            raise InputError(f"{name}: unknown key {key!r}; a config has method, seed, [model], [data], [train]")
    method, seed = table.get("method"), table.get("seed", 0)
    if not isinstance(method, str) or method not in METHODS:
        raise InputError(f"{name}: method = {_shown(method)} must be one of {', '.join(METHODS)}")
    if type(seed) is not int or not 0 <= seed < 1 << 31:
        raise InputError(f"{name}: seed = {_shown(seed)} must be a whole number from 0 to {(1 << 31) - 1}")
    parts = {key: table.get(key, {}) for key in ("model", "data", "train")}
    for key, part in parts.items():
        if not isinstance(part, dict):
            raise InputError(f"{name}: {key} must be a table: [{key}]")
    overrides = dict(data_overrides or {})
    return Config(
        method,
        seed,
        MappingProxyType(parts["model"]),
        MappingProxyType({**parts["data"], **overrides}),
        _train(parts["train"], name),
        name,
        text,
        tuple(overrides),
    )


def with_minutes(config: Config, minutes: float | None) -> Config:
    """The config with another limit of the clock; None leaves it. Raises InputError where it is not a sensible number."""
    if minutes is None:
        return config
    low, high = LIMITS["minutes"]
    if not low <= minutes <= high:
        raise InputError(f"--minutes {minutes:g} must lie from {low:g} to {high:g}")
    return replace(config, train=replace(config.train, minutes=float(minutes)))


def parse_overrides(words: Iterable[str]) -> dict[str, Any]:
    """Values of [data] from words KEY=VALUE: VALUE as TOML reads it, else as text. Raises InputError where a word has no '='."""
    found: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or not key.replace("_", "a").replace("-", "a").isalnum():
            raise InputError(f"--data {_shown(word)}: must be KEY=VALUE, as in pack=sets/train.safetensors")
        try:
            found[key] = tomllib.loads(f"value = {value}")["value"]
        except (tomllib.TOMLDecodeError, RecursionError, ValueError):
            found[key] = value
    return found


def determinants(config: Config) -> dict[str, Any]:
    """What decides a run's weights, as plain JSON values: resuming asks for the same. A file may lie elsewhere, under the same name."""
    train = {f.name: getattr(config.train, f.name) for f in fields(Train) if f.name not in FREE}
    data = {key: value.rpartition("/")[2] if isinstance(value, str) else value for key, value in config.data.items()}
    table = {"method": config.method, "seed": config.seed, "model": dict(config.model), "data": data, "train": train}
    plain: dict[str, Any] = json.loads(json.dumps(table, default=str))
    return plain


def difference(there: Any, here: Any, at: str = "") -> str | None:
    """The first key at which two tables of `determinants` differ, with both values, or None."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted({*there, *here}):
            found = difference(there.get(key), here.get(key), f"{at}.{key}" if at else key)
            if found:
                return found
        return None
    return None if there == here else f"{at} was {_shown(there)} and is {_shown(here)}"


def _train(table: Mapping[str, Any], name: str) -> Train:
    kinds = {f.name: str(f.type) for f in fields(Train)}
    for key, value in table.items():
        if key not in kinds:
            raise InputError(f"{name}: unknown key train.{key}; there are {', '.join(kinds)}")
        at = f"{name}: train.{key} = {_shown(value)}"
        if key in CHOICES:
            if value not in CHOICES[key]:
                raise InputError(f"{at} must be one of {', '.join(CHOICES[key])}")
            continue
        if kinds[key] == "bool":
            if type(value) is not bool:
                raise InputError(f"{at} must be true or false")
            continue
        if kinds[key].startswith("str"):
            if not isinstance(value, str):
                raise InputError(f"{at} must be text")
            continue
        whole = kinds[key].startswith("int")
        if type(value) is not int and (whole or type(value) is not float):
            raise InputError(f"{at} must be a {'whole number' if whole else 'number'}")
        low, high = LIMITS[key]
        if not low <= value <= high:
            raise InputError(f"{at} must lie from {low:g} to {high:g}")
    for f in fields(Train):
        if f.default is MISSING and f.name not in table:
            raise InputError(f"{name}: train.{f.name} is missing")
    if ("epochs" in table) == ("steps" in table):
        raise InputError(f"{name}: [train] must have exactly one of epochs and steps (minutes beside it stops by the clock)")
    values: dict[str, Any] = {key: float(value) if kinds[key].startswith("float") else value for key, value in table.items()}
    train = Train(**values)
    if train.steps is not None and train.warm_up >= train.steps:
        raise InputError(f"{name}: train.warm_up = {train.warm_up} must be less than steps = {train.steps}")
    return train


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
