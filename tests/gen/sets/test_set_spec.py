"""Set specs: what is read, what is refused and in which words, and that an item depends on nothing but its place."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gen.errors import InputError
from gen.presets import describe_presets, find_spec, preset_kind, preset_names
from gen.sets.set_spec import MAX_ITEMS, evenly, expand, read_set, set_from
from gen.spec import read_spec
from gen.strict_yaml import parse_yaml

CAPTURE = """\
    capture:
      resolution: [32, 32]
      shape: {name: sphere, radius: {uniform: [5, 9]}, segments: 16}
      material: {alpha: {log_uniform: [0.05, 0.5]}}
      lights: {pattern: random, count: 1}
      camera: {kind: orthographic, width_mm: 30}
"""
LEAST = "set: a\ngroups:\n  - name: one\n    count: 3\n" + CAPTURE


def read(text: str) -> Any:
    return set_from(parse_yaml(text, "f.yaml", "a set"), "f.yaml")


def items(text: str, limit: int | None = None) -> dict[str, Any]:
    return {name: spec for name, _, spec in expand(read(text), "f.yaml", limit)}


def test_a_set_is_expanded_into_valid_specs_of_their_own_names_and_seeds() -> None:
    made = items(LEAST)
    assert list(made) == ["one-000000", "one-000001", "one-000002"]
    assert all(spec.name == name for name, spec in made.items())
    assert len({spec.seed for spec in made.values()}) == 3
    assert len({spec.shape.parameters["radius"] for spec in made.values()}) == 3
    assert len({tuple(spec.light_directions()[0]) for spec in made.values()}) == 3


def test_every_combination_comes_and_more_items_change_none() -> None:
    text = LEAST.replace("count: 3", "count: COUNT\n    each: {shape.segments: [16, 24], lights.count: [1, 2, 3]}")
    few, more = items(text.replace("COUNT", "2")), items(text.replace("COUNT", "5"))
    assert list(few) == list(more)[:12]
    assert all(more[name] == spec for name, spec in few.items())
    found = [(spec.shape.parameters["segments"], spec.lights.count) for spec in few.values()]
    assert found == list(itertools.product([16, 24], [1, 2, 3])) * 2
    assert len({spec.seed for spec in more.values()}) == 30


def test_an_item_does_not_depend_on_other_groups() -> None:
    second = "  - name: two\n    count: 2\n" + CAPTURE
    alone = items(LEAST + second)
    changed = items(LEAST.replace("count: 3", "count: 9").replace("[5, 9]", "[6, 7]") + second)
    assert [alone[f"two-{i:06d}"] for i in range(2)] == [changed[f"two-{i:06d}"] for i in range(2)]
    assert alone["one-000000"].seed != alone["two-000000"].seed
    assert items("seed: 1\n" + LEAST)["one-000000"] != items("seed: 2\n" + LEAST)["one-000000"]


def test_values_of_each_may_be_sections_and_draws() -> None:
    each = "    each: {material: [{alpha: 0.1}, {roughness: {uniform: [0.1, 0.2]}}], material.specular: [0.1, {uniform: [0.3, 0.4]}]}\n"
    made = list(items(LEAST.replace("count: 3\n", "count: 1\n" + each)).values())
    assert [spec.material.alpha for spec in made] == [0.1, 0.1, None, None]
    assert 0.1 <= made[2].material.roughness <= 0.2
    assert [spec.material.specular[0] == 0.1 for spec in made] == [True, False, True, False]


def test_the_digest_tells_meanings_apart_and_not_spellings() -> None:
    a = read(LEAST).digest()
    turned = LEAST.replace("name: sphere, radius: {uniform: [5, 9]}", "radius: {uniform: [5, 9]}, name: sphere")
    assert turned != LEAST
    assert read("# a comment\n" + turned).digest() == a
    assert read("seed: 0\n" + LEAST).digest() == a
    each = ["each: {shape.segments: [16], lights.count: [1, 2]}", "each: {lights.count: [1, 2], shape.segments: [16]}"]
    digests = {read(LEAST.replace("count: 3", f"count: 3\n    {line}")).digest() for line in each}
    assert len({a, read("seed: 1\n" + LEAST).digest(), *digests}) == 4


@settings(max_examples=100, deadline=None)
@given(st.integers(1, 5000), st.integers(1, 5000))
def test_a_limit_is_spread_over_the_whole(total: int, limit: int) -> None:
    chosen = evenly(total, limit)
    assert len(chosen) == min(total, limit) == len(set(chosen))
    assert chosen == sorted(chosen)
    assert chosen[0] == 0
    assert chosen[-1] < total
    if limit > 1:
        assert chosen[-1] == total - 1
        steps = [b - a for a, b in itertools.pairwise(chosen)]
        assert max(steps, default=0) - min(steps, default=0) <= 1


GROUP = "set: a\ngroups:\n  - name: one\n"
BAD = [
    (LEAST.replace("set: a", "set: ../a"), "f.yaml: set: must match"),
    (LEAST.replace("groups", "gruops"), "f.yaml: gruops: unknown key; did you mean 'groups'?"),
    (LEAST.replace("count: 3", "cuont: 3"), "f.yaml: groups[0].cuont: unknown key; did you mean 'count'?"),
    (LEAST.replace("count: 3", "count: 0"), "f.yaml: groups[0].count: must be at least 1, got 0"),
    (LEAST.replace("count: 3", "count: 2.5"), "f.yaml: groups[0].count: must be a whole number"),
    (LEAST.replace("count: 3", "split: tset"), "f.yaml: groups[0].split: must be 'train', 'validation' or 'test', got 'tset'"),
    (LEAST.replace("count: 3", "single: 1"), "f.yaml: groups[0].single: must be true or false, got 1"),
    (LEAST.replace("name: one", "name: One"), "f.yaml: groups[0].name: must match"),
    (LEAST.replace("name: one", "name: -one"), "f.yaml: groups[0].name: must match"),
    (LEAST + "  - name: one\n" + CAPTURE, "f.yaml: groups[1].name: 'one' is there already"),
    (LEAST.replace("count: 3", "each: {a: 3}"), "f.yaml: groups[0].each: a must be a list of the values"),
    (LEAST.replace("count: 3", "each: {a: []}"), "f.yaml: groups[0].each: a must be a list of the values"),
    (LEAST.replace("count: 3", "each: {a..b: [1]}"), "f.yaml: groups[0].each: 'a..b' is not a dotted path"),
    (LEAST.replace("count: 3", "each: [a]"), "f.yaml: groups[0].each: must hold 'key: value' pairs"),
    (LEAST.replace("count: 3", "each: {seed: [1]}"), "f.yaml: groups[0]: each.seed: is drawn for every item; remove it"),
    (LEAST.replace("count: 3", "each: {a.b: [1], a: [2]}"), "f.yaml: groups[0]: each: a would overwrite a.b"),
    (LEAST.replace("count: 3", "each: {lights.count.a: [1]}"), "f.yaml: groups[0]: each.lights.count.a: lights.count holds no"),
    (LEAST.replace("count: 3", "each: {shape.radius: [1, {uniform: [2, 1]}]}"), "groups[0].capture.shape.radius.uniform: is reversed"),
    (LEAST.replace("[5, 9]", "[9, 5]"), "f.yaml: groups[0].capture.shape.radius.uniform: is reversed; write [5, 9]"),
    (LEAST.replace("      camera", "      name: x\n      camera"), "f.yaml: groups[0]: capture.name: is the item's id; remove it"),
    (GROUP + "    capture: 3\n", "f.yaml: groups[0].capture: must hold 'key: value' pairs"),
    (GROUP + "    capture: {1: 3}\n", "f.yaml: groups[0].capture: must hold 'key: value' pairs"),
    (GROUP + "    capture: {when: 2020-01-01}\n", "f.yaml: groups[0].capture.when: must be a text, a number"),
    (GROUP, "f.yaml: groups[0].capture: is missing"),
    ("set: a\n", "f.yaml: groups: is missing"),
    ("set: a\ngroups: []\n", "f.yaml: groups: must have at least 1 entries, has 0"),
    ("set: a\ngroups: 3\n", "f.yaml: groups: must be a list"),
    (LEAST.replace("count: 3", f"count: {MAX_ITEMS}\n    each: {{a: [1, 2]}}"), f"groups: are {2 * MAX_ITEMS} items together"),
    (
        LEAST.replace("count: 3", "each: {" + ", ".join(f"p{i}: [1, 2, 3, 4, 5, 6, 7, 8]" for i in range(40)) + "}"),
        "items together, more than",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD, ids=[message[:50] for _, message in BAD])
def test_errors_name_the_key_and_what_is_allowed(text: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        read(text)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


WRONG_ITEMS = [
    ("log_uniform: [0.05, 0.5]", "uniform: [20, 30]", "material.alpha: must be at most 10, got 2"),
    ("alpha:", "aplha:", "material.aplha: unknown key; did you mean 'alpha'?"),
    ("name: sphere", "name: spere", "shape.name: unknown shape 'spere'"),
    ("width_mm: 30", "width_mm: 30, distance_mm: 4", "camera.distance_mm: the object reaches"),
    (
        "count: 3\n",
        "count: 3\n    single: true\n    each: {lights.count: [2]}\n",
        "lights: single is true, so one light is needed",
    ),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG_ITEMS, ids=[message for *_, message in WRONG_ITEMS])
def test_errors_of_a_resolved_spec_name_group_item_and_key(old: str, new: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        items(LEAST.replace(old, new))
    assert str(error.value).startswith(f"f.yaml: group one: item one-000000: {message}")


def test_sets_and_captures_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "many.yaml"
    path.write_text(LEAST)
    with pytest.raises(InputError, match=r"many.yaml: is the spec of a set .* `degloss gen render .*many.yaml -o FOLDER`"):
        read_spec(path)
    with pytest.raises(InputError, match=r"paper-sphere: is the spec of one capture; a set spec starts with 'set: NAME'"):
        read_set("paper-sphere")
    with pytest.raises(InputError, match=r"nothing: is neither a file nor a preset; the presets are .*paper-train"):
        read_set("nothing")
    assert read_set(path).digest() == read(LEAST).digest()


@pytest.mark.parametrize("name", preset_names())
def test_presets_are_of_the_kind_that_they_say(name: str) -> None:
    assert preset_kind(name) == ("set" if "set" in parse_yaml(find_spec(name).read_text(), name, "a spec") else "capture")
    assert name in preset_names(preset_kind(name))
    assert read_set(name).name == name if preset_kind(name) == "set" else read_spec(name).name == name
    assert len(describe_presets()[name]) > 20
    assert {"paper-stack", "paper-train", "smoke", "zoo"} <= set(preset_names("set"))
