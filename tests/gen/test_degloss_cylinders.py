"""The project's own small public set: what its header promises, asked of its plan."""

from __future__ import annotations

import colorsys
from collections import defaultdict

import numpy as np

from gen.sets.plan import identities, plan_of
from gen.spec import Spec

LEVELS = [0.05, 0.1, 0.2, 0.3, 0.4618]


def test_splits_share_nothing_and_each_has_every_level_of_gloss() -> None:
    found: dict[str, list[Spec]] = defaultdict(list)
    for item in plan_of("degloss-cylinders").items:
        assert item.split is not None
        found[item.split].append(item.capture_spec())
    assert {name: len(specs) for name, specs in found.items()} == {"train": 40, "validation": 10, "test": 20}
    keys = {name: [identities(spec) for spec in specs] for name, specs in found.items()}
    for column in ("object", "material_key", "lights_key"):
        everything = [one[column] for ones in keys.values() for one in ones]
        assert len(set(everything)) == len(everything) == 70, column
    for specs in found.values():
        alphas = [spec.material.width() for spec in specs]
        assert sorted(set(alphas)) == LEVELS
        assert len({alphas.count(level) for level in LEVELS}) == 1
    ranges = {name: {key: extent(specs, key) for key in ("radius", "length")} for name, specs in found.items()}
    for spec in found["test"]:
        outside = [
            not ranges["train"][key][0] <= float(spec.shape.parameters[key]) <= ranges["train"][key][1]
            for key in ("radius", "length")
        ]
        assert all(outside), spec.shape
    hues = {name: [360 * colorsys.rgb_to_hsv(*spec.material.albedo)[0] for spec in specs] for name, specs in found.items()}
    assert max(hues["train"]) < min(hues["validation"]) < max(hues["validation"]) < min(hues["test"])
    for specs in found.values():
        for spec in specs:
            lights = spec.light_directions()
            assert lights.shape == (5, 3)
            np.testing.assert_array_equal(lights[0], (0, 0, 1))
            assert spec.half
            assert spec.shape.name == "cylinder"


def extent(specs: list[Spec], key: str) -> tuple[float, float]:
    values = [float(spec.shape.parameters[key]) for spec in specs]
    return min(values), max(values)
