"""Shared by the tests of training: a tiny pack, and the smoke configs on it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gen.sets.pack import DTYPES, FORMAT, VERSION, header_bytes
from learn.config import Config, parse_config, read_config

ITEMS, FRAMES, SIDE = 4, 2, 24

TIMES = ("seconds", "pictures_per_second", "waiting_for_data")
"""Columns of a log that no two runs share."""


def write_tiny_pack(path: Path) -> Path:
    """Random layers of 4 items with 2 pictures each, everything that any method asks for."""
    rng = np.random.default_rng(0)
    count, per_view = ITEMS * FRAMES, (ITEMS, SIDE, SIDE)
    diffuse = rng.random((count, SIDE, SIDE, 3), np.float32) * 0.5
    specular = rng.random((count, SIDE, SIDE, 3), np.float32) ** 8
    arrays: dict[str, np.ndarray[Any, Any]] = {
        "combined": diffuse + specular,
        "diffuse": diffuse,
        "specular": specular,
        "mirror": specular,
        "valid": np.ones((count, SIDE, SIDE), np.bool_),
        "lights": np.tile(np.array([0, 0, 1], np.float32), (count, 1)),
        "intensities": np.ones((count, 3), np.float32),
        "item": np.repeat(np.arange(ITEMS, dtype=np.int32), FRAMES),
        "mask": np.ones(per_view, np.bool_),
        "albedo": np.full((*per_view, 3), 0.5, np.float32),
        "specular_albedo": np.full((*per_view, 3), 0.3, np.float32),
        "gloss": np.full(per_view, 0.2, np.float32),
    }
    kinds = {dtype: name for name, dtype in DTYPES.items()}
    items = [
        {"id": f"item-{i}", "split": "validation" if i == 0 else "train", "frames": [i * FRAMES, (i + 1) * FRAMES]}
        for i in range(ITEMS)
    ]
    tensors = {name: (kinds[array.dtype], array.shape) for name, array in arrays.items()}
    opening, places = header_bytes(tensors, {"format": FORMAT, "version": VERSION, "facts": json.dumps({"items": items})})
    path.write_bytes(opening + b"".join(arrays[name].tobytes() for name in sorted(arrays, key=lambda name: places[name])))
    return path


def smoke_config(method: str, pack: Path, **train: Any) -> Config:
    """The shipped smoke config of a method on that pack. train: values of [train] in place of its own."""
    config = read_config(f"smoke-{method}", {} if method == "group" else {"pack": str(pack)})
    return replace(config, train=replace(config.train, **train))


def with_text(text: str, table: str, values: Mapping[str, str]) -> str:
    """A config's text with lines of one table set to other TOML values."""
    head, mark, rest = text.partition(f"[{table}]\n")
    kept = [line for line in rest.splitlines() if line.partition("=")[0].strip() not in values]
    changed = head + mark + "\n".join([*(f"{key} = {value}" for key, value in values.items()), *kept]) + "\n"
    parse_config(changed, "changed")
    return changed
