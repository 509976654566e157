"""The entries of a JSON object, taken one by one, each checked; what nobody took is refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blender_scenes.errors import JobError

Numbers = NDArray[np.float64]

_REQUIRED = object()


class Entries:
    """The entries of one JSON object: each method takes one by its key; `close` refuses what nobody took.

    where: named in errors. Every method raises JobError, one line, where the entry is missing (and has no default) or not as asked.
    """

    def __init__(self, where: str, given: object) -> None:
        if not isinstance(given, Mapping):
            raise JobError(f"{where} must be an object, got {short(given)}")
        self.where = where
        self.given = given
        self.taken: set[str] = set()

    def _name(self, key: str) -> str:
        return f"{self.where}: {key}" if self.where == "job" else f"{self.where}.{key}"

    def value(self, key: str, default: Any = _REQUIRED) -> Any:
        self.taken.add(key)
        if key not in self.given and default is _REQUIRED:
            raise JobError(f"{self._name(key)} is missing")
        return self.given.get(key, default)

    def entry(self, key: str, default: Any = _REQUIRED) -> Entries:
        return Entries(self._name(key), self.value(key, default))

    def text(self, key: str, default: Any = _REQUIRED) -> Any:
        value = self.value(key, default)
        if value is not default and not isinstance(value, str):
            raise JobError(f"{self._name(key)} must be a text, got {short(value)}")
        return value

    def flag(self, key: str, default: Any = _REQUIRED) -> bool:
        value = self.value(key, default)
        if not isinstance(value, bool):
            raise JobError(f"{self._name(key)} must be true or false, got {short(value)}")
        return value

    def number(
        self, key: str, low: float = -math.inf, high: float = math.inf, whole: bool = False, default: Any = _REQUIRED
    ) -> float:
        return float(self.numbers(key, (), low, high, whole, default))

    def numbers(
        self,
        key: str,
        shape: tuple[int, ...],
        low: float = -math.inf,
        high: float = math.inf,
        whole: bool = False,
        default: Any = _REQUIRED,
    ) -> Numbers:
        value = self.value(key, default)
        what = "a number" if shape == () else f"numbers of shape {'x'.join(map(str, shape))}"
        try:
            array = np.asarray(value)
            right = array.shape == shape and array.dtype.kind in "iuf" and bool(np.isfinite(array).all())
        except ValueError:
            right = False
        if not right:
            raise JobError(f"{self._name(key)} must be {what}, all finite, got {short(value)}")
        if array.min() < low or array.max() > high:
            raise JobError(f"{self._name(key)} must be from {low:g} to {high:g}, got {short(value)}")
        if whole and (array != np.round(array)).any():
            raise JobError(f"{self._name(key)} must be whole, got {short(value)}")
        return array.astype(np.float64)

    def close(self) -> None:
        unknown = sorted(str(key) for key in self.given if key not in self.taken)
        if unknown:
            raise JobError(f"{self._name(unknown[0])} is unknown; there are {', '.join(sorted(self.taken))}")


def short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
