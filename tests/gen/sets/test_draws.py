"""Draws: ranges, distributions against closed forms, determinism, and every refusal in one line that names the path."""

from __future__ import annotations

import colorsys
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from blender_scenes import shapes
from gen.errors import InputError
from gen.sets.draws import DRAWS, MAX_TRIES, resolve, resolver
from gen.spec import schema
from gen.spec_parts import Pose

EXAMPLES: dict[str, Any] = {
    "uniform": [2, 5],
    "log_uniform": [0.01, 0.5],
    "integer": [3, 9],
    "normal": [10, 2],
    "choice": ["a", {"uniform": [0, 1]}, {"name": "x", "size": {"integer": [1, 4]}}],
    "weighted": [[1, "a"], [3, {"uniform": [0, 1]}]],
    "colour": {"hue": [10, 50], "saturation": [0.2, 0.9], "value": [0.3, 0.8]},
    "rotation": "uniform",
}


def many(draw: Any, count: int = 2000, seed: int = 0) -> list[Any]:
    rng, function = np.random.default_rng(seed), resolver(draw, "x")
    return [function(rng) for _ in range(count)]


def test_there_is_an_example_of_every_draw() -> None:
    assert set(EXAMPLES) == set(DRAWS)


@pytest.mark.parametrize("kind", DRAWS)
def test_a_draw_depends_on_the_generator_alone(kind: str) -> None:
    draw = {kind: EXAMPLES[kind]}
    before = json.dumps(draw)
    first, again, other = (many(draw, 20, seed) for seed in (7, 7, 8))
    assert first == again != other
    assert json.dumps(draw) == before
    assert json.loads(json.dumps(first)) == first  # plain values: nothing of numpy's


def test_what_is_no_draw_stays_and_costs_no_randomness() -> None:
    rng = np.random.default_rng(1)
    value = {"b": [1, 2.5, "x", None, True], "a": {"percentile": 99.5, "level": 0.8}, "c": {"rotation_degrees": [0, 0, 0]}}
    assert resolve(value, rng) == value
    assert list(resolve(value, rng)) == ["b", "a", "c"]
    assert rng.uniform() == np.random.default_rng(1).uniform()


def test_the_order_of_keys_does_not_matter() -> None:
    draw = {"uniform": [0, 1]}
    a, b = (resolve(value, np.random.default_rng(3)) for value in ({"p": draw, "q": [draw]}, {"q": [draw], "p": draw}))
    assert a == b
    assert a["p"] != a["q"][0]


def test_distributions_are_what_they_are_called() -> None:
    assert stats.kstest(many({"uniform": [2, 5]}), stats.uniform(2, 3).cdf).pvalue > 0.01
    assert stats.kstest(many({"log_uniform": [0.01, 0.5]}), stats.loguniform(0.01, 0.5).cdf).pvalue > 0.01
    assert stats.kstest(many({"normal": [10, 2]}), stats.norm(10, 2).cdf).pvalue > 0.01
    counts = np.bincount(many({"integer": [0, 4]}), minlength=5)
    assert stats.chisquare(counts).pvalue > 0.01
    words = many({"weighted": [[0, "never"], [1, "a"], [3, "b"], [0, "never"]]})
    assert set(words) == {"a", "b"}
    assert stats.binomtest(words.count("b"), len(words), 0.75).pvalue > 0.01
    assert stats.binomtest(many({"choice": ["a", "b"]}).count("a"), 2000, 0.5).pvalue > 0.01


def test_random_rotations_favour_no_direction() -> None:
    """Archimedes: each coordinate of a point spread evenly over the sphere is spread evenly over [-1, 1]."""
    turns = np.stack([Pose(rotation_degrees=angles).matrix() for angles in many({"rotation": "uniform"})])
    for entry in turns.reshape(-1, 9).T:
        assert stats.kstest(entry, stats.uniform(-1, 2).cdf).pvalue > 0.001
    # The angle of an even rotation has density (1 - cos t) / pi on [0, pi] (Miles 1965).
    angle = np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert stats.kstest(angle, lambda t: (t - np.sin(t)) / np.pi).pvalue > 0.01


def test_colours_have_the_hue_that_was_asked_for() -> None:
    for rgb in many({"colour": {"hue": [350, 370], "saturation": [0.5, 0.9], "value": [0.3, 0.8]}}, 200):
        hue, saturation, value = colorsys.rgb_to_hsv(*rgb)
        assert min(hue, 1 - hue) * 360 <= 10.001
        assert 0.4999 <= saturation <= 0.9001
        assert 0.2999 <= value <= 0.8001
    spread = np.array(many({"colour": {}}, 500))
    assert spread.min() >= 0
    assert spread.max() <= 1
    assert len({int(colorsys.rgb_to_hsv(*rgb)[0] * 6) for rgb in spread}) == 6


reals = st.floats(-1e6, 1e6, allow_subnormal=False)


@settings(max_examples=200, deadline=None)
@given(st.tuples(reals, reals), st.integers(0, 2**32))
def test_draws_stay_in_their_range(ends: tuple[float, float], seed: int) -> None:
    low, high = sorted(ends)
    rng = np.random.default_rng(seed)
    assert low <= resolve({"uniform": [low, high]}, rng) <= high
    assert math.floor(low) <= resolve({"integer": [math.floor(low), math.ceil(high)]}, rng) <= math.ceil(high)
    low, high = (abs(end) + 1e-9 for end in ends)
    assert min(low, high) <= resolve({"log_uniform": sorted([low, high])}, rng) <= max(low, high)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 40), st.integers(0, 2**32), st.sampled_from(sorted(DRAWS)))
def test_the_first_draws_do_not_depend_on_how_many_follow(count: int, seed: int, kind: str) -> None:
    assert many({kind: EXAMPLES[kind]}, count, seed) == many({kind: EXAMPLES[kind]}, count + 5, seed)[:count]


numbers = st.one_of(st.integers(-5, 5), st.floats(), st.booleans(), st.just(10**400))
keys = st.sampled_from([*DRAWS, "sample", "name", "hue", "radius"])
anything = st.recursive(
    st.one_of(numbers, st.none(), st.text(max_size=3), st.sampled_from(["uniform", "sphere"])),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys | st.integers(), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None)
@given(anything, st.integers(0, 9))
def test_anything_is_resolved_or_refused_in_one_line(value: Any, seed: int) -> None:
    message = "f.yaml: capture"
    try:
        json.dumps(resolve(value, np.random.default_rng(seed), "f.yaml: capture"))
    except InputError as error:
        message = str(error)
    assert message.startswith("f.yaml: capture")
    assert "\n" not in message


BAD = [
    ({"a": {"uniform": [2, 1]}}, "x.a.uniform: is reversed; write [1, 2]"),
    ({"a": {"uniform": [1]}}, "x.a.uniform: must be two finite numbers [lowest, highest], got [1]"),
    ({"a": {"uniform": [0, math.nan]}}, "x.a.uniform: must be two finite numbers"),
    ({"a": {"uniform": [0, math.inf]}}, "x.a.uniform: must be two finite numbers"),
    ({"a": {"uniform": [False, True]}}, "x.a.uniform: must be two finite numbers"),
    ({"a": {"uniform": 3}}, "x.a.uniform: must be two finite numbers"),
    ({"a": [0, {"log_uniform": [0, 1]}]}, "x.a[1].log_uniform: both ends must be greater than 0"),
    ({"a": {"log_uniform": [-2, -1]}}, "x.a.log_uniform: both ends must be greater than 0"),
    ({"a": {"integer": [0.5, 2]}}, "x.a.integer: both ends must be whole numbers"),
    ({"a": {"integer": [3, 2]}}, "x.a.integer: is reversed"),
    ({"a": {"normal": [3, 0]}}, "x.a.normal: the standard deviation must be greater than 0"),
    ({"a": {"choice": []}}, "x.a.choice: must be a list of the values to choose from"),
    ({"a": {"choice": [1, {"uniform": [1, 0]}]}}, "x.a.choice[1].uniform: is reversed"),
    ({"a": {"weighted": [1, 2]}}, "x.a.weighted[0]: must be [weight, value]"),
    ({"a": {"weighted": [[-1, 2]]}}, "x.a.weighted[0]: must be [weight, value]"),
    ({"a": {"weighted": [[0, 2]]}}, "x.a.weighted: the weights must have a finite sum greater than 0"),
    ({"a": {"weighted": [[1, {"uniform": [1, 0]}]]}}, "x.a.weighted[0][1].uniform: is reversed"),
    ({"a": {"colour": [1, 2]}}, "x.a.colour: must hold hue, saturation, value"),
    ({"a": {"colour": {"hu": [1, 2]}}}, "x.a.colour.hu: unknown key; did you mean 'hue'?"),
    ({"a": {"colour": {"hue": [2, 1]}}}, "x.a.colour.hue: is reversed"),
    ({"a": {"colour": {"value": [0, 2]}}}, "x.a.colour.value: must lie from 0 to 1"),
    ({"a": {"rotation": "any"}}, "x.a.rotation: must be uniform"),
    ({"a": {"unifrom": [0, 1]}}, "x.a: there is no draw 'unifrom'; did you mean 'uniform'?"),
    ({"a": {"uniform": [0, 1], "integer": [0, 1]}}, "x.a: a draw (uniform) stands alone; take 'integer' out of it"),
    ({"shape": {"name": "sphere", "sample": False}}, "x.shape.sample: must be true"),
    ({"shape": {"sample": True}}, "x.shape.sample: belongs in a shape, beside its name"),
    ({"shape": {"name": "spere", "sample": True}}, "x.shape.name: unknown shape 'spere'; there are capsule"),
    ({"shape": {"name": "sphere", "sample": True, "lenght": 3}}, "x.shape.lenght: unknown parameter of sphere; there are radius"),
    ({"shape": {"name": "sphere", "sample": True, "radius": -3}}, f"x.shape: {MAX_TRIES} samples were refused; the last: radius must"),
    ({"shape": {"name": "sphere", "sample": True, "radius": [3]}}, "the last: radius must be a number"),
    ({"a": {1: 2}}, "x.a: the key 1 must be a text"),
]  # fmt: skip


@pytest.mark.parametrize(("value", "message"), BAD, ids=[message[:45] for _, message in BAD])
def test_what_is_wrong_is_named_with_its_path(value: Any, message: str) -> None:
    with pytest.raises(InputError) as error:
        resolve(value, np.random.default_rng(0), "x")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_branch_that_is_not_taken_is_checked_too() -> None:
    with pytest.raises(InputError, match="is reversed"):
        resolver({"weighted": [[1, 0], [1e-300, {"uniform": [1, 0]}]]}, "x")


@pytest.mark.parametrize("name", shapes.SHAPES)
def test_shapes_are_sampled(name: str) -> None:
    rng = np.random.default_rng(4)
    drawn = resolve({"name": name, "sample": True}, rng)
    parameters = {key: value for key, value in drawn.items() if key != "name"}
    assert drawn["name"] == name
    assert set(parameters) <= set(shapes.parameters(name))
    expected = shapes.sample(name, np.random.default_rng(4))
    assert parameters == pytest.approx(expected, rel=1e-5)
    assert shapes.build(name, **parameters).radius > 0


def test_given_parameters_take_the_place_of_sampled_ones() -> None:
    drawn = many({"name": {"choice": ["sphere", "cylinder"]}, "sample": True, "radius": {"uniform": [3, 4]}, "segments": 16}, 20)
    assert {shape["name"] for shape in drawn} == {"sphere", "cylinder"}
    assert all(3 <= shape["radius"] <= 4 and shape["segments"] == 16 for shape in drawn)


def test_what_a_shape_refuses_is_drawn_again() -> None:
    """A capsule must be longer than two radii: with this radius, most of the sampler's lengths are too short."""
    drawn = many({"name": "capsule", "sample": True, "radius": 24, "segments": 16}, 20)
    assert all(shape["length"] > 48 for shape in drawn)
    lengths = [shapes.sample("capsule", np.random.default_rng(k))["length"] for k in range(100)]
    assert sum(length > 48 for length in lengths) < 50


def test_no_key_of_a_spec_is_taken_for_a_draw() -> None:
    names = {key for name in shapes.SHAPES for key in shapes.parameters(name)}
    sections = [schema(), *schema()["$defs"].values()]
    names |= {key for section in sections for key in section.get("properties", {})}
    assert len(names) > 50
    assert not names & {*DRAWS, "sample"}
