"""Splits share nothing, keep what the plan says, and come near the fractions."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gen.cli import app
from gen.errors import InputError
from gen.sets.set_folder import SetFolder
from gen.sets.splits import KEYS, NAMES, components, divide, read_splits, write_splits


def call(*tokens: str | Path) -> None:
    app([str(token) for token in tokens], exit_on_error=False, result_action="return_value")


def table(*keys: tuple[int, int, int], split: str | None = None) -> list[dict[str, Any]]:
    return [
        {"id": f"item-{i:04d}", "split": split, "object": f"o{o}", "material_key": f"m{m}", "lights_key": f"l{light}"}
        for i, (o, m, light) in enumerate(keys)
    ]


def reference(rows: list[dict[str, Any]], by: tuple[str, ...]) -> np.ndarray:
    """The group of each item, by scipy on the graph of items and keys."""
    names = sorted({(key, row[KEYS[key]]) for row in rows for key in by})
    number = {name: len(rows) + n for n, name in enumerate(names)}
    edges = [(i, number[key, row[KEYS[key]]]) for i, row in enumerate(rows) for key in by]
    i, j = np.array(edges).T
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(len(rows) + len(names),) * 2)
    return connected_components(graph, directed=False)[1][: len(rows)]


keys = st.lists(st.tuples(st.integers(0, 25), st.integers(0, 25), st.integers(0, 25)), min_size=1, max_size=40)
choices = st.lists(st.sampled_from(sorted(KEYS)), min_size=1, max_size=3, unique=True).map(tuple)


@settings(max_examples=150, deadline=None)
@given(keys, choices)
def test_groups_are_the_connected_components(keys: list[tuple[int, int, int]], by: tuple[str, ...]) -> None:
    rows = table(*keys)
    found = components([[f"{key}:{row[KEYS[key]]}" for key in by] for row in rows])
    expected = reference(rows, by)
    assert len(set(zip(found, expected.tolist(), strict=True))) == len(set(found)) == len(set(expected.tolist()))


@settings(max_examples=150, deadline=None)
@given(keys, choices, st.integers(0, 1000), st.sampled_from([(0.8, 0.1, 0.1), (0.5, 0.5, 0.0), (1.0, 0.0, 0.0), (0.2, 0.3, 0.5)]))
def test_no_two_splits_share_anything(
    keys: list[tuple[int, int, int]], by: tuple[str, ...], seed: int, fractions: tuple[float, float, float]
) -> None:
    rows = table(*keys)
    wanted = sum(share > 0 for share in fractions)
    groups = len(set(reference(rows, by).tolist()))
    kept = {row["id"]: 1 + i % 5 for i, row in enumerate(rows)}
    if groups < wanted:
        with pytest.raises(InputError, match="too few for"):
            divide(rows, kept, fractions, seed, by)
        return
    found = divide(rows, kept, fractions, seed, by)
    assert sorted(name for ids in found.splits.values() for name in ids) == sorted(kept)
    assert [bool(found.splits[name]) for name in NAMES] == [share > 0 for share in fractions]
    assert found.groups == groups
    of = {name: split for split, ids in found.splits.items() for name in ids}
    for key in by:
        holders: dict[str, set[str]] = {}
        for row in rows:
            holders.setdefault(row[KEYS[key]], set()).add(of[row["id"]])
        assert all(len(splits) == 1 for splits in holders.values())
    assert found.plain() == divide(rows, kept, fractions, seed, by).plain()
    assert found.pictures == {name: sum(kept[item] for item in ids) for name, ids in found.splits.items()}


def test_fractions_are_met_where_items_share_nothing() -> None:
    rows = table(*((i, i, i) for i in range(1000)))
    kept = {row["id"]: 5 for row in rows}
    found = divide(rows, kept)
    assert found.pictures == {"train": 4000, "validation": 500, "test": 500}
    assert found.notes == ()
    other = divide(rows, kept, seed=1)
    assert other.pictures == found.pictures
    assert other.splits != found.splits


def test_the_plan_has_the_last_word_and_draws_others_along() -> None:
    rows = table((0, 0, 0), (1, 1, 1), (2, 1, 2), *((i, i, i) for i in range(10, 40)))
    rows[1]["split"] = "test"  # and item 2 shares its material
    rows[10]["split"] = "validation"
    found = divide(rows, {row["id"]: 1 for row in rows})
    assert {"item-0001", "item-0002"} <= set(found.splits["test"])
    assert "item-0010" in found.splits["validation"]
    assert found.notes == ()


def test_what_only_the_plan_can_share_is_said() -> None:
    rows = table((0, 0, 0), (1, 0, 1), (2, 2, 1))
    for row, split in zip(rows, NAMES, strict=True):
        row["split"] = split
    assert divide(rows, {row["id"]: 1 for row in rows}).notes == (
        "train and validation share 1 material, as the plan says",
        "validation and test share 1 light set, as the plan says",
    )
    rows += [{**rows[0], "id": "between", "split": None, "object": "o2"}]
    with pytest.raises(InputError, match=r"between hangs together with items that the plan puts into .*name a split for it"):
        divide(rows, {row["id"]: 1 for row in rows})


def test_one_light_set_for_all_is_said_with_the_remedy() -> None:
    rows = table(*((i, i, 0) for i in range(20)))
    kept = {row["id"]: 1 for row in rows}
    with pytest.raises(
        InputError,
        match=r"the 20 items to divide hang together in 1 group \(20 objects, 20 materials, 1 light set\).*: --by object,material",
    ):
        divide(rows, kept)
    assert divide(rows, kept, by=("object", "material")).pictures == {"train": 16, "validation": 2, "test": 2}
    rows = table(*((i, 0, 0) for i in range(20)))
    with pytest.raises(InputError, match=r"let the splits share more: --by object$"):
        divide(rows, kept)
    rows = table(*((i, i, 0 if i < 19 else i) for i in range(22)))
    found = divide(rows, {row["id"]: 1 for row in rows}, (0.5, 0.25, 0.25))
    assert "the largest group of items that hang together holds 19 of 22 pictures" in found.notes[0]
    assert "--by object,material" in found.notes[0]


def test_only_kept_pictures_count(set_folder: SetFolder) -> None:
    found = write_splits(set_folder, (0.6, 0.2, 0.2), by=("object",))
    assert (set_folder.path / "screening.jsonl").exists()
    ids = [name for split in found.splits.values() for name in split]
    assert sorted(ids) == sorted(
        ["one-000000", "one-000002", "one-000003", *(f"stack-00000{i}" for i in range(3)), "test-000000", "test-000001"]
    )
    assert {"test-000000", "test-000001"} <= set(found.splits["test"])
    assert sum(found.pictures.values()) == 3 + 15 + 2
    order = [row["id"] for row in set_folder.rows()]
    assert all(list(ids) == sorted(ids, key=order.index) for ids in found.splits.values())


def test_the_file_is_what_was_found_and_is_read_back(set_folder: SetFolder, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="is not divided yet; run degloss gen split"):
        read_splits(set_folder)
    call("split", set_folder.path, "--by", "object,material", "--fractions", "0.6,0.2,0.2", "--seed", "4", "--json")
    printed = json.loads(capsys.readouterr().out)
    stored = json.loads((set_folder.path / "splits.json").read_text())
    assert stored == {key: printed[key] for key in stored}
    assert (stored["by"], stored["fractions"], stored["seed"]) == (["object", "material"], [0.6, 0.2, 0.2], 4)
    assert Counter({name: part["items"] for name, part in stored["counts"].items()}) == Counter(
        {name: len(ids) for name, ids in read_splits(set_folder).items()}
    )
    call("split", set_folder.path)
    assert "groups by object, material, lights" in capsys.readouterr().out
    (set_folder.path / "splits.json").write_text('{"splits": {"train": [1]}}')
    with pytest.raises(InputError, match="does not hold the ids of each split"):
        read_splits(set_folder)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--fractions", "0.8,0.1"], "--fractions 0.8,0.1: must be three numbers from 0 that add up to 1"),
        (["--fractions", "0.8,0.1,0.2"], "must be three numbers from 0"),
        (["--fractions", "1.1,0,-0.1"], "must be three numbers from 0"),
        (["--fractions", "nan,0,1"], "must be three numbers from 0"),
        (["--fractions", "most,some,few"], "must be three numbers such as"),
        (["--by", "colour"], "--by colour: must name one or more of object, material, lights"),
        (["--by", ""], "must name one or more"),
        (["--by", "object,object"], "each once"),
        (["--seed=-1"], "--seed -1: must be at least 0"),
    ],
)
def test_bad_options_are_one_line_and_write_nothing(set_folder: SetFolder, options: list[str], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        call("split", set_folder.path, *options)
    assert not (set_folder.path / "splits.json").exists()
