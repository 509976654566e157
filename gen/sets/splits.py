"""Dividing a set into training, validation and test so that no two of them share an object, a material or a light set.

Items that share a key hang together; what hangs together, directly or through others, goes into one split. What the plan says of an
item stands.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gen.errors import InputError
from gen.files import read_json, write_json
from gen.sets.screening import kept_items, screening_of
from gen.sets.set_folder import SetFolder

SPLITS = "splits.json"
NAMES = ("train", "validation", "test")
SHARES = (0.8, 0.1, 0.1)
"""Of the pictures, for each of `NAMES`, where nobody says others."""

KEYS = {"object": "object", "material": "material_key", "lights": "lights_key"}
"""What items may share, and the column of the index that says so."""

WORDS = {"object": ("object", "objects"), "material": ("material", "materials"), "lights": ("light set", "light sets")}

UNEVEN = 0.1
"""A split whose share of the pictures is off by more than this is spoken of."""


@dataclass(frozen=True)
class Split:
    """A division of a set. splits: ids of each of `NAMES`, in plan order. pictures: kept ones of each. notes: what a user should know."""

    by: tuple[str, ...]
    fractions: tuple[float, float, float]
    seed: int
    splits: Mapping[str, tuple[str, ...]]
    pictures: Mapping[str, int]
    groups: int
    notes: tuple[str, ...] = ()

    def plain(self) -> dict[str, Any]:
        """As it stands in `splits.json`."""
        return {
            "by": list(self.by),
            "fractions": list(self.fractions),
            "seed": self.seed,
            "splits": {name: list(ids) for name, ids in self.splits.items()},
            "counts": {name: {"items": len(ids), "pictures": self.pictures[name]} for name, ids in self.splits.items()},
            "groups": self.groups,
            "notes": list(self.notes),
        }


def write_splits(folder: SetFolder, fractions: Sequence[float] = SHARES, seed: int = 0, by: Sequence[str] = tuple(KEYS)) -> Split:
    """Divide a set and keep the result in its `splits.json`, by a temporary name; see `divide`. A set without screening is screened first.

    fractions: of the kept pictures, for training, validation and test. by: names of `KEYS`.
    """
    found = divide(folder.rows(), kept_items(screening_of(folder)), fractions, seed, by)
    write_json(Path(folder.path) / SPLITS, found.plain())
    return found


def read_splits(folder: SetFolder) -> dict[str, tuple[str, ...]]:
    """The ids of each split. Raises InputError where the set was not divided, or the file is damaged."""
    path = Path(folder.path) / SPLITS
    if not path.exists():
        raise InputError(f"{path}: the set is not divided yet; run degloss gen split {folder.path} first")
    table = read_json(path, "the splits of a set")
    splits = table.get("splits") if isinstance(table, dict) else None
    if not isinstance(splits, dict) or not all(
        isinstance(ids, list) and all(isinstance(name, str) for name in ids) for ids in splits.values()
    ):
        raise InputError(f"{path}: does not hold the ids of each split; run degloss gen split again")
    return {name: tuple(ids) for name, ids in splits.items()}


def check_options(fractions: Sequence[float], seed: int, by: Sequence[str]) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    """The fractions and names of `KEYS` that a set is divided by. Raises InputError where these are none, or the seed is below 0."""
    numbers = [float(f) for f in fractions]
    if len(numbers) != 3 or not all(math.isfinite(f) and f >= 0 for f in numbers) or abs(sum(numbers) - 1) > 1e-6:
        raise InputError(f"--fractions {','.join(f'{f:g}' for f in numbers)}: must be three numbers from 0 that add up to 1")
    if seed < 0:
        raise InputError(f"--seed {seed}: must be at least 0")
    unknown = [key for key in by if key not in KEYS]
    if unknown or not by or len(set(by)) != len(by):
        raise InputError(f"--by {','.join(by)}: must name one or more of {', '.join(KEYS)}, each once")
    return (numbers[0], numbers[1], numbers[2]), tuple(by)


def divide(
    rows: Sequence[Mapping[str, Any]],
    kept: Mapping[str, int],
    fractions: Sequence[float] = SHARES,
    seed: int = 0,
    by: Sequence[str] = tuple(KEYS),
) -> Split:
    """Divide the items of an index. rows: its rows; kept: the kept pictures of each item that has any.

    The largest groups go first, each to the split that lacks most; equal ones in an order drawn by the seed. Raises InputError where
    the arguments are wrong, nothing is kept, or the items hang together so that they cannot be divided as asked.
    """
    shares, keys = check_options(fractions, seed, by)
    items = [row for row in rows if row["id"] in kept]
    if not items:
        raise InputError("no picture of the set was kept, so there is nothing to divide; see degloss gen screen")
    columns = [[f"{key}:{row[KEYS[key]]}" for key in keys] for row in items]
    labels = components(columns)
    pictures = [kept[row["id"]] for row in items]
    chosen: list[str | None] = [row["split"] for row in items]
    members: dict[int, list[int]] = {}
    for i, label in enumerate(labels):
        members.setdefault(label, []).append(i)
    free: list[list[int]] = []
    for group in members.values():
        said = {name for i in group if (name := chosen[i]) is not None}
        left = [i for i in group if chosen[i] is None]
        if left and len(said) > 1:
            raise InputError(
                f"{items[left[0]]['id']} hangs together with items that the plan puts into {' and '.join(sorted(said))} "
                f"(shared: {', '.join(keys)}), so it fits into neither; name a split for it in the set's spec, or let them share more: "
                f"{_remedy(keys, columns)}"
            )
        if left and said:
            for i in left:
                chosen[i] = next(iter(said))
        elif left:
            free.append(group)
    have = {name: sum(n for n, split in zip(pictures, chosen, strict=True) if split == name) for name in NAMES}
    for group, name in _place(free, pictures, have, shares, seed, keys, columns):
        for i in group:
            chosen[i] = name
    splits = {name: tuple(str(row["id"]) for row, split in zip(items, chosen, strict=True) if split == name) for name in NAMES}
    counts = {name: sum(kept[item] for item in ids) for name, ids in splits.items()}
    notes = shared(keys, columns, chosen)
    total = sum(pictures)
    largest = max((sum(pictures[i] for i in group) for group in free), default=0)
    off = max((abs(counts[name] / total - share) for name, share in zip(NAMES, shares, strict=True)), default=0.0)
    if free and off > UNEVEN and largest > UNEVEN * total:
        notes.append(
            f"the largest group of items that hang together holds {largest} of {total} pictures, so the fractions are not met; "
            f"to meet them, let the splits share more: {_remedy(keys, columns)}"
        )
    return Split(keys, shares, seed, splits, counts, len(members), tuple(notes))


def components(keys: Sequence[Sequence[str]]) -> list[int]:
    """The number of the group of each item, where items with a common key are in one group, directly or through others.

    keys: of each item. Groups are numbered from 0 as they come. Union-find with path halving (Tarjan and van Leeuwen, 1984).
    """
    parent = list(range(len(keys)))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    first: dict[str, int] = {}
    for i, names in enumerate(keys):
        for name in names:
            parent[root(i)] = root(first.setdefault(name, i))
    numbers: dict[int, int] = {}
    return [numbers.setdefault(root(i), len(numbers)) for i in range(len(keys))]


def _place(
    free: list[list[int]],
    pictures: Sequence[int],
    have: Mapping[str, int],
    shares: tuple[float, float, float],
    seed: int,
    keys: tuple[str, ...],
    columns: Sequence[Sequence[str]],
) -> list[tuple[list[int], str]]:
    """A split for each free group."""
    if not free:
        return []
    sizes = [sum(pictures[i] for i in group) for group in free]
    total = sum(sizes) + sum(have.values())
    targets = {name: share * total for name, share in zip(NAMES, shares, strict=True)}
    filled = dict(have)
    empty = [name for name in NAMES if targets[name] > 0 and not filled[name]]
    if len(free) < len(empty):
        count = sum(map(len, free))
        raise InputError(
            f"the {count} items to divide hang together in {len(free)} group{'s' * (len(free) > 1)} "
            f"({_culprit(keys, columns, free)}), too few for {', '.join(empty)}; let the splits share more: {_remedy(keys, columns)}"
        )
    order = np.random.default_rng(seed).permutation(len(free))
    placed = []
    ranked = sorted(order.tolist(), key=lambda g: -sizes[g])
    for n, g in enumerate(ranked):
        empty = [name for name in NAMES if targets[name] > 0 and not filled[name]]
        open_to = empty if len(ranked) - n <= len(empty) else [name for name in NAMES if targets[name] > 0]
        name = max(open_to, key=lambda split: targets[split] - filled[split])
        filled[name] += sizes[g]
        placed.append((free[g], name))
    return placed


def _culprit(keys: tuple[str, ...], columns: Sequence[Sequence[str]], free: list[list[int]]) -> str:
    items = [i for group in free for i in group]
    counts = [(len({columns[i][k] for i in items}), key) for k, key in enumerate(keys)]
    return ", ".join(f"{n} {WORDS[key][n > 1]}" for n, key in counts)


def _remedy(keys: tuple[str, ...], columns: Sequence[Sequence[str]]) -> str:
    """The longest choice of fewer keys, by what divides best."""
    if len(keys) == 1:
        return f"by {keys[0]} alone is already the least; render more of it"
    groups = {}
    for leave in range(len(keys)):
        some = [k for k in range(len(keys)) if k != leave]
        groups[tuple(keys[k] for k in some)] = len(set(components([[row[k] for k in some] for row in columns])))
    best = max(groups, key=lambda choice: groups[choice])
    if groups[best] < len(NAMES):
        single = {key: len({row[k] for row in columns}) for k, key in enumerate(keys)}
        best = (max(single, key=lambda key: single[key]),)
    return f"--by {','.join(best)}"


def shared(keys: Sequence[str], columns: Sequence[Sequence[str]], chosen: Sequence[str | None]) -> list[str]:
    """What two splits have in common, which only the plan itself can bring about, one line each.

    keys: names of `KEYS`. columns: their values of each item. chosen: its split.
    """
    notes = []
    for a, first in enumerate(NAMES):
        for second in NAMES[a + 1 :]:
            for k, key in enumerate(keys):
                both = [{row[k] for row, split in zip(columns, chosen, strict=True) if split == name} for name in (first, second)]
                common = len(both[0] & both[1])
                if common:
                    notes.append(f"{first} and {second} share {common} {WORDS[key][common > 1]}, as the plan says")
    return notes


def unsaid(said: Any, rows: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """What is wrong with the `by` and `notes` of a splits.json, one line each without the file's name.

    said: its content. rows: of the items that are divided, their split and the columns in `KEYS`.
    """
    by, notes = _texts(said, "by"), _texts(said, "notes")
    if not by or notes is None:
        yield "does not say by what the set is divided (by, notes)"
        return
    if strange := [key for key in by if key not in KEYS]:
        yield f"is divided by {strange[0]!r:.40}; there are {', '.join(KEYS)}"
        return
    parts = list(rows)
    columns = [[f"{key}:{row[KEYS[key]]}" for key in by] for row in parts]
    for note in shared(by, columns, [row["split"] for row in parts]):
        if note not in notes:
            yield f"{note.removesuffix(', as the plan says')}, and it does not say so"


def _texts(table: Any, key: str) -> list[str] | None:
    found = table.get(key) if isinstance(table, dict) else None
    return found if isinstance(found, list) and all(isinstance(text, str) for text in found) else None
