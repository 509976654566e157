"""The spec of a set: groups of captures, each a capture spec whose values may be drawn, checked and expanded into capture specs.

    set: bolts              # the set's name; this key marks a set spec
    seed: 1
    groups:
      - name: train
        split: train        # or validation, test; left out: decided later
        count: 100          # items for each combination of `each`
        each: {material.alpha: [0.05, 0.1]}
        single: false       # true: every item is one picture, a training picture of its own
        capture: {...}      # a capture spec (gen/spec.py) without name and seed; a value may be a draw (gen/sets/draws.py)

Item i of a group under combination c depends on the set's seed, the group's place, c and i alone: a larger count adds items and
changes none.
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from gen.errors import InputError
from gen.sets.draws import resolver
from gen.spec import Spec, spec_from
from gen.spec_parts import Part, Whole, YesNo
from gen.strict_yaml import first_complaint, read_yaml

MAX_ITEMS = 100_000
"""The most captures of a set."""

GIVEN = {"name": "the item's id", "seed": "drawn for every item"}
"""Keys of a capture spec that the set fills in."""


def _mapping(value: Any) -> Any:
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise ValueError("must hold 'key: value' pairs")
    return value


def _lists(value: Any) -> Any:
    for path, values in _mapping(value).items():
        if not re.fullmatch(r"[^.\s]+(\.[^.\s]+)*", path):
            raise ValueError(f"'{path}' is not a dotted path such as material.alpha")
        if not isinstance(values, list | tuple) or not values:
            raise ValueError(f"{path} must be a list of the values that it takes in turn")
    return value


class Group(Part):
    """Captures of one kind: `count` items for each combination of the values in `each`."""

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9-]{0,59}$", description="lower-case letters, digits and dashes")
    split: Literal["train", "validation", "test"] | None = Field(default=None, description="left out: decided later")
    count: Whole = Field(default=1, ge=1, le=MAX_ITEMS, description="items for each combination of `each`")
    each: Annotated[dict[str, tuple[Any, ...]], BeforeValidator(_lists)] = Field(
        default={}, description="dotted path in the capture: list of the values it takes; all combinations, the last path fastest"
    )
    single: YesNo = Field(default=False, description="every item is one picture, a training picture of its own")
    capture: Annotated[dict[str, Any], BeforeValidator(_mapping)] = Field(
        description="a capture spec without name and seed; any value may be a draw"
    )

    @model_validator(mode="after")
    def _paths_fit(self) -> Group:
        for key, reason in GIVEN.items():
            if key in self.capture or key in self.each:
                raise ValueError(f"{'capture' if key in self.capture else 'each'}.{key}: is {reason}; remove it")
        for first, second in itertools.combinations(self.each, 2):
            if first.startswith(second + "."):
                raise ValueError(f"each: {second} would overwrite {first}; write it before")
        return self

    def combinations(self) -> list[dict[str, Any]]:
        """The values of `each`, all combinations in written order, the last path changing fastest."""
        return [dict(zip(self.each, values, strict=True)) for values in itertools.product(*self.each.values())]

    def total(self) -> int:
        """How many items the group has."""
        return self.count * math.prod(len(values) for values in self.each.values())


class SetSpec(Part):
    """Many captures to be rendered."""

    name: str = Field(alias="set", pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$", description="the set's name; marks a set spec")
    seed: Whole = Field(default=0, ge=0, lt=2**63, description="of every item's draws")
    groups: tuple[Group, ...] = Field(min_length=1, max_length=1000)

    @model_validator(mode="after")
    def _groups_fit(self) -> SetSpec:
        names = [group.name for group in self.groups]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ValueError(f"groups[{i}].name: '{name}' is there already; ids are made of it")
        if self.total() > MAX_ITEMS:
            raise ValueError(f"groups: are {self.total()} items together, more than {MAX_ITEMS}; make several sets")
        return self

    def total(self) -> int:
        """How many items the set has."""
        return sum(group.total() for group in self.groups)

    def digest(self) -> str:
        """SHA-256 of what the set means, in hexadecimal: comments, and the order of keys where it has no meaning, do not count."""
        plain = self.model_dump(mode="json", by_alias=True)
        for group in plain["groups"]:
            group["each"] = list(group["each"].items())  # the order numbers the items
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def read_set(path_or_preset: str | Path) -> SetSpec:
    """The set spec in a YAML file, or the shipped preset of that name.

    Raises InputError, one line, where there is no such file or preset, where a key is missing, unknown or out of range, or where it is
    the spec of one capture.
    """
    from gen.presets import find_spec

    where = str(path_or_preset)
    data = read_yaml(find_spec(path_or_preset), "a set spec")
    if "set" not in data and "shape" in data:
        raise InputError(f"{where}: is the spec of one capture; a set spec starts with 'set: NAME' and has groups")
    return set_from(data, where)


def set_from(data: Any, where: str) -> SetSpec:
    """A SetSpec from plain values, its draws checked. where: named in the error.

    Raises InputError with the key path and what is allowed.
    """
    try:
        spec = SetSpec.model_validate(data)
    except ValidationError as error:
        raise first_complaint(error, data, where, _KNOWN, _SYNONYMS) from None
    for i, group in enumerate(spec.groups):
        first = {path: values[0] for path, values in group.each.items()}
        others = [{**first, path: value} for path, values in group.each.items() for value in values[1:]]
        for combination in (first, *others):  # every value once
            resolver(_placed(group, combination, f"{where}: groups[{i}]"), f"{where}: groups[{i}].capture")
    return spec


_KNOWN = {
    "": tuple(field.alias or key for key, field in SetSpec.model_fields.items()),
    "groups[]": tuple(Group.model_fields),
}
_SYNONYMS = {"name": "set", "items": "groups", "number": "count", "for_each": "each", "spec": "capture"}
"""What else one might call a key, for the hint in an error."""


def expand(spec: SetSpec, where: str, limit: int | None = None) -> Iterator[tuple[str, Group, Spec]]:
    """The items of a set in order: id, group, and the capture spec with every value resolved.

    where: named in errors. limit: at most that many, evenly spaced over the whole set, the first and the last among them. Raises
    InputError that names the group, the item and the key where a resolved spec is not valid.
    """
    chosen = set(evenly(spec.total(), limit))
    number = 0
    for g, group in enumerate(spec.groups):
        combinations, place = group.combinations(), f"{where}: group {group.name}"
        resolvers: dict[int, Any] = {}
        for n in range(group.total()):
            # Combinations change fastest: more items are appended, and the ids of the others stay.
            i, c = divmod(n, len(combinations))
            number += 1
            if number - 1 not in chosen:
                continue
            if c not in resolvers:
                resolvers[c] = resolver(_placed(group, combinations[c], place), f"{place}: capture")
            rng = np.random.default_rng(np.random.SeedSequence(spec.seed, spawn_key=(g, c, i)))
            name = f"{group.name}-{n:06d}"
            drawn = {"name": name, "seed": int(rng.integers(2**32)), **resolvers[c](rng)}
            yield name, group, _checked(drawn, group, f"{place}: item {name}")


def evenly(total: int, limit: int | None) -> list[int]:
    """Indices of at most `limit` of `total` things, evenly spaced, the first and the last among them; all of them without a limit.

    Raises InputError where the limit is below 1.
    """
    if limit is not None and limit < 1:
        raise InputError(f"the limit of a plan must be at least 1, got {limit}")
    if limit is None or limit >= total:
        return list(range(total))
    return sorted({round(k * (total - 1) / max(1, limit - 1)) for k in range(limit)})


def _placed(group: Group, combination: dict[str, Any], where: str) -> dict[str, Any]:
    """The group's capture with the values of a combination at their paths."""
    capture = copy.deepcopy(group.capture)
    for path, value in combination.items():
        *parents, last = path.split(".")
        node = capture
        for depth, key in enumerate(parents):
            node = node.setdefault(key, {})
            if not isinstance(node, dict):
                held = ".".join(parents[: depth + 1])
                raise InputError(f"{where}: each.{path}: {held} holds no 'key: value' pairs in the capture")
        node[last] = copy.deepcopy(value)
    return capture


def _checked(drawn: dict[str, Any], group: Group, where: str) -> Spec:
    spec = spec_from(drawn, where)
    count = len(spec.light_directions())
    if group.single and count != 1:
        raise InputError(f"{where}: lights: single is true, so one light is needed, there are {count}; say count: 1")
    return spec
