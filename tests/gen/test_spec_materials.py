"""Materials of a spec: every kind is read, written, refused in clear words, and taken by the studio as it is meant."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from blender_scenes.entries import Entries
from blender_scenes.materials import MATERIALS as STUDIO
from blender_scenes.materials import parse
from blender_scenes.materials.texture import PATTERNS, Texture
from gen.errors import InputError
from gen.sets.plan import identities
from gen.spec import Spec, schema, spec_from
from gen.spec_materials import MATERIALS

LEAST: dict[str, Any] = {"name": "a", "shape": {"name": "sphere"}, "camera": {"kind": "orthographic", "width_mm": 60}}
NOISE = {"texture": "noise", "scale_mm": 4, "low": 0.2, "high": 0.6}
FULL: dict[str, dict[str, Any]] = {
    "approximate-substrate": {"albedo": [0.1, 0.2, 0.3], "specular": 0.1, "alpha": 0.9},
    "blinn-phong": {"albedo": NOISE, "specular": [50, 0, 1], "exponent": 80, "normalised": True},
    "blinn-phong-lobe": {"albedo": 0.3, "specular": 2, "alpha": NOISE},
    "lambertian": {"albedo": {**NOISE, "low": [0, 0.5, 1], "detail": 4, "seed": 7}},
    "metal": {"specular": [0.9, 0.5, 0.3], "alpha": 1.3},
    "oren-nayar": {"albedo": 0.4, "specular": 0.02, "alpha": NOISE, "sigma_degrees": 30},
    "principled": {"albedo": NOISE, "alpha": 0.3, "metallic": 0.5, "ior": 1.3, "coat": 1, "coat_alpha": 0.1, "sheen": 0.2},
    "substrate": {"albedo": {**NOISE, "texture": "spots", "share": 0.3}, "specular": 0.1, "alpha": NOISE},
    "two-lobe": {"albedo": 0.4, "specular": 0.1, "alpha": 0.05, "alpha2": 0.4, "mix": 0.25},
}


def spec(material: dict[str, Any], **changes: Any) -> Spec:
    return spec_from({**LEAST, "material": material, **changes}, "f.yaml")


def test_a_spec_may_name_what_the_studio_has() -> None:
    """All but the mirror, which has no truth of its own."""
    assert set(MATERIALS) == set(STUDIO) - {"mirror"}
    assert set(FULL) == set(MATERIALS)
    textures = schema()["$defs"]["ColourTexture"]["properties"]["texture"]["enum"]
    assert set(textures) == set(PATTERNS)


@pytest.mark.parametrize("kind", MATERIALS)
@pytest.mark.parametrize("filled", [False, True])
def test_every_kind_is_read_written_and_taken_by_the_studio(kind: str, filled: bool) -> None:
    found = spec({"kind": kind, **(FULL[kind] if filled else {})})
    assert spec_from(found.plain(), "x") == found
    entry = found.material.job()
    made = parse(Entries("job: material", entry))
    assert entry["kind"] == found.material.kind == kind
    assert made.one_light == found.material.one_light
    assert (made.without_gloss() is not None) == found.material.layered
    width = found.material.width()
    assert isinstance(made.gloss, Texture) if width is None else made.gloss == pytest.approx(width)
    given = FULL[kind].get("specular" if kind == "metal" else "albedo", 0.5) if filled else (0.9 if kind == "metal" else 0.5)
    if isinstance(given, dict):
        assert made.albedo.scale == 4
        assert made.albedo.low == pytest.approx(np.broadcast_to(given["low"], 3))
    else:
        assert made.albedo == pytest.approx(np.broadcast_to(given, 3))


def test_exponents_and_angles_are_told_as_the_studio_wants_them() -> None:
    assert spec({"kind": "blinn-phong", "exponent": 18}).material.width() == pytest.approx((2 / 20) ** 0.5)
    assert spec({"kind": "oren-nayar", "sigma_degrees": 90 / np.pi}).material.job()["sigma"] == pytest.approx(0.5)


BAD = [
    ({"kind": "wood"}, "material: must hold 'kind:' with one of approximate-substrate, blinn-phong"),
    ({"kind": 3}, "material: must hold 'kind:' with one of"),
    ({"kind": "metal", "albedo": 0.5}, "material.albedo: unknown key; there are kind, specular, alpha"),
    ({"kind": "metal", "roughness": 0.5}, "material.roughness: unknown key"),
    ({"kind": "blinn-phong", "shininess": 5}, "material.shininess: unknown key; did you mean 'exponent'?"),
    ({"kind": "blinn-phong", "exponent": 5, "alpha": 0.1}, "material: alpha and exponent both say"),
    ({"kind": "blinn-phong", "exponent": 0.5}, "material.exponent: must be at least 1, got 0.5"),
    ({"kind": "blinn-phong", "specular": 2e4}, "material.specular: must lie between 0 and 10000"),
    ({"kind": "oren-nayar", "sigma": 0.3}, "material.sigma: unknown key; did you mean 'sigma_degrees'?"),
    ({"kind": "approximate-substrate", "alpha": 1.5}, "material.alpha: must be at most 1, got 1.5"),
    ({"kind": "two-lobe", "mix": 2}, "material.mix: must be at most 1, got 2"),
    ({"kind": "lambertian", "albedo": {**NOISE, "high": 3}}, "material.albedo.high: must lie between 0 and 1"),
    ({"kind": "lambertian", "albedo": {**NOISE, "texture": "wood"}}, "material.albedo.texture: must be 'noise', 'cells'"),
    ({"kind": "lambertian", "albedo": {**NOISE, "scale": 3}}, "material.albedo.scale: unknown key; did you mean 'scale_mm'?"),
    ({"kind": "lambertian", "albedo": {"texture": "noise", "low": 0, "high": 1}}, "material.albedo.scale_mm: is missing"),
    ({"kind": "lambertian", "albedo": {**NOISE, "share": 0.3}}, "material.albedo: share belongs to stripes and spots"),
    ({"albedo": {**NOISE, "texture": "cells", "detail": 3}}, "material.albedo: detail belongs to noise"),
    ({"alpha": {**NOISE, "high": 30}}, "material.alpha: low and high must lie from 0.001 to 10"),
    ({"alpha": {**NOISE, "low": [1, 2, 3]}}, "material.alpha.low: must be a number"),
    ({"specular": NOISE}, "material.specular: must be one number (grey) or three [r, g, b]"),
]


@pytest.mark.parametrize(("material", "message"), BAD, ids=[message[10:50] for _, message in BAD])
def test_errors_name_the_key_and_what_is_allowed(material: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        spec(material)
    assert str(error.value).startswith("f.yaml: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 250


AMBIENT = {"kind": "ambient"}


@pytest.mark.parametrize("kind", MATERIALS)
def test_what_a_material_cannot_do_is_refused_early(kind: str) -> None:
    model = MATERIALS[kind]
    asks: list[tuple[dict[str, Any], str, bool]] = [
        ({"lights": [AMBIENT]}, "material.kind: ", model.one_light),
        ({"lights": [{"kind": "several", "lights": [[0, 0, 1], AMBIENT]}]}, "not under ambient", model.one_light),
        ({"lights": [{"kind": "several", "lights": [[0, 0, 1], [0, 1, 1]]}]}, "", False),
        ({"bounces": 1}, "bounces: ", model.one_light),
        ({"ks0": True}, "ks0: means nothing", not model.layered),
        ({"lime": True}, "lime: means nothing", not model.layered),
    ]
    for ask, message, refused in asks:
        if refused:
            with pytest.raises(InputError, match=message) as error:
                spec({"kind": kind}, **ask)
            assert len(str(error.value)) < 250
        else:
            spec({"kind": kind}, **ask)


def test_the_same_material_in_other_words_is_the_same() -> None:
    key = {
        name: identities(spec(material))["material_key"]
        for name, material in {
            "exponent": {"kind": "blinn-phong", "exponent": 18},
            "alpha": {"kind": "blinn-phong", "alpha": (2 / 20) ** 0.5},
            "lobe": {"kind": "blinn-phong-lobe", "exponent": 18},
            "texture": {"albedo": NOISE},
            "seeds": {"albedo": {**NOISE, "seed": 1}},
        }.items()
    }
    assert key["exponent"] == key["alpha"]
    assert len(set(key.values())) == 4
