"""The lights of a spec: every kind and pattern, what they say to the studio and to the capture; near light and shadow in a real render."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from blender_scenes.entries import Entries
from blender_scenes.light import parse_light
from gen.assemble import assemble, layers_of
from gen.errors import InputError
from gen.farm import Farm
from gen.render import render
from gen.spec import Spec, spec_from
from gen.spec_lights import LIGHT_KINDS, LIGHT_PATTERNS

LEAST: dict[str, Any] = {
    "name": "a",
    "resolution": [40, 40],
    "shape": {"name": "sphere", "radius": 10},
    "camera": {"kind": "orthographic", "width_mm": 30, "distance_mm": 200},
    "material": {"albedo": 0.5, "specular": 0.1, "alpha": 0.3},
    "exposure": 1.0,
}
ANY_LIGHT = {"kind": "approximate-substrate"}
EVERY: dict[str, dict[str, Any]] = {
    "sun": {"direction": [3, 0, 4]},
    "point": {"kind": "point", "position_mm": [0, 30, 40], "intensity": 2},
    "area": {"kind": "area", "position_mm": [0, 0, 50], "diameter_mm": 8, "intensity": [1, 2, 3]},
    "environment": {"kind": "environment", "map": "studio", "rotation_degrees": 30},
    "ambient": {"kind": "ambient", "intensity": 0.2},
    "several": {"kind": "several", "lights": [[0, 0, 1], {"kind": "ambient", "intensity": 0.5}]},
}
PATTERNS: dict[str, dict[str, Any]] = {
    "ring": {"pattern": "ring", "count": 4, "tilt_degrees": 30, "frontal": True},
    "hemisphere": {"pattern": "hemisphere", "count": 5},
    "random": {"pattern": "random", "count": 5},
}


def spec(lights: Any, **changes: Any) -> Spec:
    return spec_from({**LEAST, "lights": lights, **changes}, "x")


@pytest.mark.parametrize("kind", LIGHT_KINDS)
def test_every_kind_is_read_and_the_studio_takes_it(kind: str) -> None:
    found = spec([EVERY[kind]], material=ANY_LIGHT)
    assert found.light_kinds() == (kind,)
    assert spec_from(found.plain(), "x") == found
    (light,) = found.pictures()
    told = light.job()
    for one in told if isinstance(told, list) else [told]:
        parse_light(Entries("job: lights[0]", one))
    assert np.linalg.norm(found.light_directions(), axis=1) == pytest.approx(1)
    assert found.draws() == (1 if kind in ("sun", "point") else 64)
    assert ("lit" in layers_of(found)) == (kind in ("sun", "point"))


@pytest.mark.parametrize("pattern", LIGHT_PATTERNS)
def test_patterns_make_suns_near_lights_and_discs(pattern: str) -> None:
    given = PATTERNS[pattern]
    suns = spec(given)
    assert set(suns.light_kinds()) == {"sun"}
    assert suns.light_positions() is None
    near = spec({**given, "distance_mm": 80})
    assert set(near.light_kinds()) == {"point"}
    assert near.light_directions() == pytest.approx(suns.light_directions(), abs=1e-12)
    places = near.light_positions()
    assert places is not None
    assert np.linalg.norm(places, axis=1) == pytest.approx(80)
    discs = spec({**given, "distance_mm": 80, "diameter_mm": 10, "intensities": [1, [1, 2, 3], 1, 1, 1]}, material=ANY_LIGHT)
    assert set(discs.light_kinds()) == {"area"}
    assert discs.light_intensities()[1].tolist() == [1, 2, 3]


def test_several_suns_need_one_sample() -> None:
    several = {"kind": "several", "lights": [[0, 0, 1], EVERY["point"]]}
    assert spec([several]).draws() == 1
    assert spec([several], bounces=2, material={"kind": "lambertian"}).draws() == 64


def test_a_mixed_list_says_which_lights_are_near() -> None:
    found = spec([[0, 0, 1], EVERY["point"], EVERY["sun"]])
    assert found.light_kinds() == ("sun", "point", "sun")
    assert found.light_directions()[1] == pytest.approx([0, 0.6, 0.8])
    places = found.light_positions()
    assert places is not None
    assert np.isnan(places[[0, 2]]).all()
    assert places[1].tolist() == [0, 30, 40]


BAD = [
    ([{"kind": "lamp"}], r"lights\[0\]: must be one of 'sun', 'point'"),
    ([{"kind": "point"}], r"lights\[0\]\.position_mm: is missing"),
    ([{"kind": "point", "position": [1, 2, 3]}], r"lights\[0\]\.position: unknown key; did you mean 'position_mm'"),
    ([{"kind": "area", "position_mm": [0, 0, 0], "diameter_mm": 3}], r"must not be \[0, 0, 0\]"),
    ([{"kind": "several", "lights": []}], r"lights\[0\]\.lights: must have at least 1"),
    ({**PATTERNS["ring"], "diameter_mm": 3}, "diameter_mm needs distance_mm"),
    ({**PATTERNS["ring"], "intensities": [1, 2]}, r"intensities must hold one a light \(5\), it holds 2"),
    ({**PATTERNS["ring"], "distance_mm": -3}, r"lights\.distance_mm: must be greater than 0"),
]


@pytest.mark.parametrize(("lights", "message"), BAD, ids=[message for _, message in BAD])
def test_errors_are_one_line(lights: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        spec(lights)
    assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def farm() -> Any:
    with Farm() as opened:
        yield opened


@pytest.mark.render
def test_shadows_say_what_stands_in_the_light(farm: Farm) -> None:
    """A sphere's own dark side under a sun and under a near light; and what a spring throws on itself."""
    found = spec([[0.6, 0, 0.8], {"kind": "point", "position_mm": [-20, 0, 10]}])
    capture = render(found, farm=farm).capture
    shadow, normals, mask = capture.truth.shadow, capture.truth.normals, capture.mask
    assert shadow is not None
    assert normals is not None
    assert set(np.unique(shadow)) == {0, 1}
    sure = mask & (abs(normals @ np.array([0.6, 0, 0.8])) > 0.02)
    assert ((shadow[0] == 1) == (normals @ np.array([0.6, 0, 0.8]) < 0))[sure].all()
    point = 10 * normals  # of a sphere of radius 10 at the origin
    facing = ((np.array([-20, 0, 10]) - point) * normals).sum(-1)
    assert ((shadow[1] == 1) == (facing < 0))[mask & (abs(facing) > 0.6)].all()
    view = {"resolution": [80, 80], "camera": {"kind": "orthographic", "width_mm": 70}}
    spring = render(spec([[0, 0.95, 0.3], [0, 0, 1]], shape={"name": "helical_spring"}, **view), farm=farm).capture.truth
    assert spring.shadow is not None
    assert (spring.shadow[0] == 2).sum() > 20
    assert (spring.shadow[1] == 2).sum() < 5  # what the camera sees, a light behind it reaches, but for grazing pixels


@pytest.mark.render
def test_ks0_and_half_precision(farm: Farm) -> None:
    """Ks = 0 keeps the diffuse part at full strength and Schlick's sheen; half precision stores what it says."""
    glossy = render(
        spec([[0.3, 0, 1]], ks0=True, half=True, material={"albedo": 0.5, "specular": 0.4, "alpha": 0.2}), farm=farm
    ).capture
    truth = glossy.truth
    assert truth.ks0 is not None
    assert truth.diffuse is not None
    assert truth.specular is not None
    facing = truth.normals[..., 2] > 0.7  # type: ignore[index]
    assert (truth.ks0[0][facing] / truth.diffuse[0][facing]) == pytest.approx(1 / 0.6, abs=0.02)
    assert np.array_equal(truth.diffuse, truth.diffuse.astype(np.float16).astype(np.float32))
    assert np.array_equal(glossy.images, truth.diffuse + truth.specular)


def test_half_precision_that_would_overflow_is_refused() -> None:
    found = spec([[0, 0, 1]], half=True)
    layer = np.full((1, 40, 40, 3), 1e5, np.float32)
    view = {
        "coverage": np.ones((40, 40)),
        "normal": np.zeros((40, 40, 3)),
        "depth": np.ones((40, 40)),
        "albedo": layer[0],
        "gloss": np.ones((40, 40)),
    }
    shot = {
        **view,
        "diffuse": layer,
        "specular": layer.copy(),
        "matte": layer.copy(),
        "lit": layer[..., 0],
        "box": np.array([0, 0, 40, 40]),
    }
    with pytest.raises(InputError, match="more than half precision holds"):
        assemble(found, [shot], {})
