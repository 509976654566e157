"""What is known of the weights that are shipped, from their headers alone: no torch is needed to list them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gen.errors import InputError
from learn import weights
from learn.method import METHODS


def shipped_weights() -> dict[str, dict[str, Any]]:
    """Of each method whose weights are shipped: file, card, bytes, options and facts, read from the header alone (no torch needed)."""
    table = {}
    for name in METHODS:
        path = weights.SHIPPED / f"{name}.safetensors"
        if path.is_file():
            said = _metadata(path)
            card = path.with_suffix(".md")
            table[name] = {"file": str(path), "bytes": path.stat().st_size, "card": str(card) if card.is_file() else None, **said}
    return table


def _metadata(path: Path) -> dict[str, Any]:
    """What the header of a file of weights says: "options" and "facts"."""
    try:
        with path.open("rb") as stream:
            length = int.from_bytes(stream.read(8), "little")
            said = json.loads(stream.read(min(length, weights.MAX_HEADER)))["__metadata__"]
        return {"options": json.loads(said["model"]), "facts": json.loads(said["facts"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is damaged; install degloss again") from error
