"""Plans: byte-identical, valid item by item, read back equal, refused where damaged; and what is the same object, material or lights."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_scenes import shapes
from gen.errors import InputError
from gen.presets import preset_names
from gen.sets.plan import Plan, identities, is_plan, is_set, plan_of, read_plan, write_plan
from gen.sets.set_spec import read_set
from gen.spec import spec_from
from gen.spec_parts import Orthographic

LIMIT = 40
SMOKE = plan_of("smoke")


@cache
def preset_plan(name: str) -> Plan:
    return plan_of(name, limit=LIMIT)


CLOSE_UP = {("group-cycles", "metal-relief"), ("group-cycles", "dark-relief")}
"""Groups whose object fills the picture: nothing is seen but surface."""


@pytest.mark.parametrize("name", preset_names("set"))
def test_presets_are_planned(name: str) -> None:
    plan = preset_plan(name)
    assert plan.text() == plan_of(name, limit=LIMIT).text()
    assert len(plan.items) == min(LIMIT, read_set(name).total()) == len({item.id for item in plan.items})
    assert plan.name == name
    for item in plan.items:
        spec = item.capture_spec()
        assert spec.name == item.id
        assert spec.plain() == item.spec
        assert not item.single or len(spec.light_directions()) == 1


@pytest.mark.parametrize("name", preset_names("set"))
def test_objects_of_the_presets_are_in_view(name: str) -> None:
    """The exact mesh, posed, of one item a group and shape: it covers a fair part of the picture's width and stays inside, or fills it."""
    one_each = {(item.group, item.spec["shape"]["name"]): item.capture_spec() for item in preset_plan(name).items}
    for (group, shape), spec in one_each.items():
        vertices = shapes.build(shape, **spec.shape.parameters).vertices @ spec.pose.matrix().T + spec.pose.translation_mm
        camera, W = spec.camera, spec.resolution[0]
        if isinstance(camera, Orthographic):
            half = np.abs(vertices[:, :2]).max() / camera.width_mm
        else:
            away = camera.distance_mm - vertices[:, 2]
            half = np.abs(vertices[:, :2] / away[:, None]).max() * camera.intrinsics(W, W)[0, 0] / W
        least, most = (0.5, 1.5) if (name, group) in CLOSE_UP else (0.1, 0.5)
        assert least < half < most, spec.name


def test_the_zoo_has_every_shape() -> None:
    names = [name for group in read_set("zoo").groups for name in group.each["shape.name"]]
    assert sorted(names) == sorted(shapes.SHAPES)
    assert read_set("zoo").total() == 12 * len(names)


def test_the_papers_training_set_is_what_the_paper_made() -> None:
    train, test = read_set("paper-train").groups
    assert (train.count, train.single, train.split) == (4000, True, "train")
    assert (test.count, test.split) == (26, "test")
    plan = preset_plan("paper-train")
    keys = [identities(item.capture_spec()) for item in plan.items]
    assert all(len({key[part] for key in keys}) == LIMIT for part in keys[0])
    drawn = plan_of("paper-train", limit=200).items
    for item in drawn:
        radius, length = item.spec["shape"]["radius"], item.spec["shape"]["length"]
        if item.group == "test":
            assert radius > 24 or length > 60  # outside the training set's box
    assert {item.split for item in drawn} == {"train", "test"}


def test_the_stack_differs_in_gloss_alone() -> None:
    items = preset_plan("paper-stack").items
    assert [item.spec["material"]["alpha"] for item in items] == [0.05, 0.1, 0.2, 0.4618, 0.7]
    keys = [identities(item.capture_spec()) for item in items]
    assert [len({key[part] for key in keys}) for part in ("object", "material_key", "lights_key")] == [1, 5, 1]
    ours, paper = keys[3], identities(spec_from({**_preset("paper-cylinder"), "name": "x"}, "x"))
    assert (ours["object"], ours["lights_key"]) == (paper["object"], paper["lights_key"])


def _preset(name: str) -> dict[str, Any]:
    from gen.spec import read_spec

    return read_spec(name).plain()


def test_a_part_of_a_plan_is_part_of_the_whole() -> None:
    whole = {item.id: item for item in SMOKE.items}
    for limit in (1, 4, 9):
        part = plan_of("smoke", limit=limit)
        assert len(part.items) == limit
        assert all(whole[item.id] == item for item in part.items)
        assert part.set_sha256 == SMOKE.set_sha256
        assert part.digest() != SMOKE.digest()
    with pytest.raises(InputError, match="must be at least 1"):
        plan_of("smoke", limit=0)


def test_another_seed_is_another_set() -> None:
    other = plan_of("smoke", seed=2)
    assert other.set_sha256 != SMOKE.set_sha256
    assert plan_of("smoke", seed=1).text() == SMOKE.text()
    assert {item.spec["seed"] for item in other.items}.isdisjoint(item.spec["seed"] for item in SMOKE.items)
    for seed in (-1, 2**63):
        with pytest.raises(InputError, match=f"--seed {seed}: must be from 0"):
            plan_of("smoke", seed=seed)


def test_progress_is_told() -> None:
    told: list[tuple[int, int]] = []
    plan_of("smoke", progress=lambda done, total: told.append((done, total)))
    assert told == [(k + 1, 10) for k in range(10)]


def test_a_plan_written_is_the_plan_read(tmp_path: Path) -> None:
    path = tmp_path / "plan.jsonl"
    write_plan(SMOKE, path)
    assert read_plan(path) == SMOKE
    assert hashlib.sha256(path.read_bytes()).hexdigest() == SMOKE.digest()
    header, *rows = map(json.loads, path.read_text().splitlines())
    assert header == {
        "format": "degloss plan", "version": 1, "name": "smoke", "seed": 1, "set_sha256": read_set("smoke").digest(), "items": 10,
    }  # fmt: skip
    assert [row["id"] for row in rows] == [item.id for item in SMOKE.items]
    assert [p.name for p in tmp_path.iterdir()] == ["plan.jsonl"]


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 30))
def test_chunks_are_balanced_parts(count: int) -> None:
    chunks = [SMOKE.chunk(k, count) for k in range(count)]
    assert sorted(item.id for chunk in chunks for item in chunk) == sorted(item.id for item in SMOKE.items)
    assert max(map(len, chunks)) - min(map(len, chunks)) <= 1
    for index in (-1, count):
        with pytest.raises(InputError, match=f"chunk {index} of {count}"):
            SMOKE.chunk(index, count)


def test_kinds_of_files_are_told_apart(tmp_path: Path) -> None:
    plan, broken, binary = tmp_path / "plan.jsonl", tmp_path / "broken.yaml", tmp_path / "x.png"
    write_plan(SMOKE, plan)
    broken.write_text("set: [")
    binary.write_bytes(bytes(range(256)))
    assert [is_set(x) for x in ("smoke", "paper-sphere", "nothing", plan, broken, binary, tmp_path)] == [True, *[False] * 6]
    assert [is_plan(x) for x in (plan, "smoke", broken, binary, tmp_path, tmp_path / "none")] == [True, *[False] * 5]
    with pytest.raises(InputError, match="is not a plan; `degloss gen plan` makes one"):
        read_plan(broken)
    with pytest.raises(InputError, match=r"x\.png: "):
        read_plan(binary)


LINES = SMOKE.text().splitlines()


def changed(number: int, **entries: Any) -> str:
    lines = LINES.copy()
    lines[number] = json.dumps({**json.loads(lines[number]), **entries})
    return "\n".join(lines)


DAMAGED = [
    ("\n".join(LINES[:-1]), "holds 9 items, its first line says 10; it was cut short"),
    ("\n".join(LINES)[:-30], "line 11: is not an item"),
    ("\n".join([*LINES, LINES[-1]]), "line 12: the first line says 10 items, more follow"),
    ("\n".join([*LINES[:-1], LINES[1]]), "the id captures-000000 is there twice"),
    ("", "is empty"),
    (changed(0, version=2), "is a plan of version 2, this program reads version 1"),
    (changed(0, items=-1), "line 1: must hold format, items"),
    (changed(0, seed=True), "line 1: must hold format, items"),
    (changed(0, extra=1), "line 1: must hold format, items"),
    (changed(1, extra=1), "line 2: is not an item"),
    (changed(1, id="../../etc-000000"), "line 2: id must be the group's name"),
    (changed(1, group="..", id="..-000000"), "line 2: group must be lower-case letters"),
    (changed(1, id=3), "line 2: id must be the group's name"),
    (changed(2, split="tset"), "line 3: split must be null or one of train"),
    (changed(2, split=["train"]), "line 3: split must be null or one of train"),
    (changed(2, single=1), "line 3: split must be null or one of train"),
    (changed(3, spec=[1]), "line 4: spec must be a capture spec whose name is the item's id"),
    (changed(3, spec={"name": "other"}), "line 4: spec must be a capture spec whose name is the item's id"),
    ("\n".join([*LINES, ""]).replace('"bounces": 0', '"bounces": NaN', 1), "line 2: is not an item"),
    ("\n".join([*LINES, ""]).replace('"bounces": 0', '"bounces": 1e999', 1), "line 2: is not an item"),
    ("[" * 100_000, "is not a plan"),
]


@pytest.mark.parametrize(("text", "message"), DAMAGED, ids=[message[:50] for _, message in DAMAGED])
def test_damaged_plans_are_refused_with_the_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.jsonl"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_plan(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_spec_changed_in_the_file_is_refused_when_it_is_used(tmp_path: Path) -> None:
    path = tmp_path / "plan.jsonl"
    path.write_text(changed(1, spec={**SMOKE.items[0].spec, "supersampling": 99}))
    with pytest.raises(InputError, match="plan: item captures-000000: supersampling: must be at most 8, got 99"):
        read_plan(path).items[0].capture_spec()


def test_a_single_item_has_one_picture(tmp_path: Path) -> None:
    path = tmp_path / "plan.jsonl"
    path.write_text(changed(1, single=True))
    with pytest.raises(InputError, match="plan: item captures-000000: is single, and has 3 pictures"):
        read_plan(path).items[0].capture_spec()


BASE: dict[str, Any] = {
    "name": "a",
    "shape": {"name": "cylinder", "radius": 20},
    "material": {"alpha": 0.2},
    "lights": [[0, 0, 1], {"direction": [1, 0, 1], "intensity": 2}],
    "camera": {"kind": "orthographic", "width_mm": 60},
}
SAME: list[dict[str, Any]] = [
    {"name": "b", "seed": 5, "resolution": [9, 9], "exposure": 1.0, "clip": True, "pose": {"translation_mm": [1, 2, 3]}},
    {"shape": {"name": "cylinder", "radius": 20.0, "length": 50, "segments": 512}},
    {"material": {"roughness": 0.2, "remap": False, "kind": "substrate", "albedo": 0.5}},
    {"lights": [{"direction": [2, 0, 2], "intensity": 2.0}, {"kind": "sun", "direction": [0, 0, 7]}]},
]
OTHER: list[tuple[str, dict[str, Any]]] = [
    ("object", {"shape": {"name": "cylinder", "radius": 20.1}}),
    ("object", {"shape": {"name": "sphere", "radius": 20}}),
    ("material_key", {"material": {"alpha": 0.2, "albedo": [0.5, 0.5, 0.4]}}),
    ("material_key", {"material": {"alpha": 0.3}}),
    ("lights_key", {"lights": [[0, 0, 1], {"direction": [1, 0, 1], "intensity": 1}]}),
    ("lights_key", {"lights": [[0, 0, 1], {"direction": [1, 0.01, 1], "intensity": 2}]}),
    ("lights_key", {"lights": [{"kind": "point", "position_mm": [0, 0, 1]}, {"direction": [1, 0, 1], "intensity": 2}]}),
    ("lights_key", {"lights": [[0, 0, 1], {"kind": "point", "position_mm": [100, 0, 100], "intensity": 2}]}),
]


@pytest.mark.parametrize("change", SAME, ids=[next(iter(change)) for change in SAME])
def test_identities_do_not_depend_on_wording_or_view(change: dict[str, Any]) -> None:
    keys = identities(spec_from(BASE, "x"))
    assert set(keys) == {"object", "material_key", "lights_key"}
    assert all(len(key) == 12 and int(key, 16) >= 0 for key in keys.values())
    assert identities(spec_from({**BASE, **change}, "x")) == keys


@pytest.mark.parametrize(("part", "change"), OTHER, ids=[f"{part} {i}" for i, (part, _) in enumerate(OTHER)])
def test_identities_tell_apart_what_differs_and_only_that(part: str, change: dict[str, Any]) -> None:
    a, b = identities(spec_from(BASE, "x")), identities(spec_from({**BASE, **change}, "x"))
    assert [key for key in a if a[key] != b[key]] == [part]
