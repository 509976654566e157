"""Specs: what is read, what is refused and in which words, and that a spec written is the spec read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gen.errors import InputError
from gen.presets import describe_presets, preset_names
from gen.spec import Spec, read_spec, schema, spec_from, with_seed
from gen.strict_yaml import parse_yaml
from gen.substrate import alpha_from_roughness

LEAST = "name: a\nshape: {name: sphere}\ncamera: {kind: orthographic, width_mm: 60}\n"


def read(text: str) -> Spec:
    return spec_from(parse_yaml(text, "f.yaml", "a spec"), "f.yaml")


@pytest.mark.parametrize("name", preset_names("capture"))
def test_presets_are_specs(name: str) -> None:
    spec = read_spec(name)
    assert spec.name == name
    assert len(describe_presets()[name]) > 20
    assert read(spec.yaml()) == spec
    assert np.linalg.matrix_rank(spec.light_directions()) == 3


def test_the_least_spec_is_the_papers_light_and_pbrts_material() -> None:
    spec = read(LEAST)
    assert spec.light_directions().shape == (5, 3)
    assert spec.light_directions()[0].tolist() == [0, 0, 1]
    assert spec.material.albedo == spec.material.specular == (0.5, 0.5, 0.5)
    assert spec.material.width() == pytest.approx(0.4618, abs=1e-4)


@pytest.mark.parametrize(
    ("material", "alpha"),
    [
        ("{alpha: 0.03}", 0.03),
        ("{roughness: 0.2}", alpha_from_roughness(0.2)),
        ("{roughness: 0.2, remap: true}", alpha_from_roughness(0.2)),
        ("{roughness: 0.2, remap: false}", 0.2),
    ],
)
def test_gloss_has_three_names(material: str, alpha: float) -> None:
    assert read(LEAST + f"material: {material}").material.width() == alpha


def test_explicit_lights_may_be_bare_directions() -> None:
    spec = read(LEAST + "lights: [[0, 0, 2], {direction: [3, 0, 4], intensity: 2}, {direction: [0, 1, 1], intensity: [1, 2, 3]}]")
    assert spec.light_directions() == pytest.approx(np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0.5**0.5, 0.5**0.5]]))
    assert spec.light_intensities().tolist() == [[1, 1, 1], [2, 2, 2], [1, 2, 3]]


def test_rotation_turns_about_x_then_y_then_z() -> None:
    pose = read(LEAST + "pose: {rotation_degrees: [90, 90, 0]}").pose
    # x: (0, 1, 0) -> (0, 0, 1); then y: (0, 0, 1) -> (1, 0, 0).
    assert pose.matrix() @ [0, 1, 0] == pytest.approx([1, 0, 0], abs=1e-12)
    assert pose.matrix() @ pose.matrix().T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(pose.matrix()) == pytest.approx(1)


def test_a_field_of_view_is_a_focal_length_is_a_matrix() -> None:
    start = "name: a\nshape: {name: sphere}\nresolution: [200, 100]\ncamera: {kind: perspective, distance_mm: 300, "
    cameras = [
        read(start + end).camera
        for end in ("fov_degrees: 90}", "focal_px: 100}", "K: [[100, 0, 99.5], [0, 100, 49.5], [0, 0, 1]]}")
    ]
    for camera in cameras:
        assert camera.kind == "perspective"
        # 90 degrees across 200 pixels: the edges, half a pixel beyond the outermost centres, are seen at 45 degrees.
        assert camera.intrinsics(200, 100) == pytest.approx(np.array([[100, 0, 99.5], [0, 100, 49.5], [0, 0, 1]]))


def test_the_digest_tells_meanings_apart_and_not_spellings() -> None:
    a, b = read(LEAST), read(LEAST + "seed: 0\npose: {translation_mm: [0, 0, 0]}")
    assert a.digest() == b.digest()
    assert a.digest() != with_seed(a, 1).digest()


BAD = [
    ("resolutoin: 3", "resolutoin: unknown key; did you mean 'resolution'?"),
    ("material: {Kd: 0.3}", "material.Kd: unknown key; did you mean 'albedo'?"),
    ("material: {rougness: .2}", "material.rougness: unknown key; did you mean 'roughness'?"),
    ("material: {albedo: 3}", "material.albedo: must lie between 0 and 1"),
    ("material: {albedo: [1, 2]}", "material.albedo: must be one number (grey) or three [r, g, b]"),
    ("material: {alpha: .1, roughness: .2}", "material: alpha and roughness both say"),
    ("material: {alpha: .1, remap: true}", "material: remap belongs to roughness"),
    ("material: {alpha: 0}", "material.alpha: must be at least 0.001, got 0"),
    ("material: {alpha: true}", "material.alpha: must be a number, got True"),
    ("material: {kind: wood}", "material: must hold 'kind:' with one of approximate-substrate, blinn-phong"),
    ("lights: []", "lights: must have at least 1 entries"),
    ("lights: 3", "lights: must be a list of directions, or hold 'pattern:' with one of ring"),
    ("lights: {pattern: rang}", "lights: must be a list of directions, or hold 'pattern:' with one of ring"),
    ("lights: {pattern: ring, count: 4}", "lights.tilt_degrees: is missing"),
    ("lights: {pattern: ring, count: 4, tilt: 35}", "lights.tilt: unknown key; did you mean 'tilt_degrees'?"),
    ("lights: {pattern: ring, count: 4, tilt_degrees: 95}", "lights.tilt_degrees: must be less than 90, got 95"),
    ("lights: {pattern: random, count: 500}", "500 lights at least 15 degrees apart do not fit"),
    ("lights: [[0, 0, 1], [0, 0, 0]]", "lights[1]: must not be [0, 0, 0]"),
    ("lights: [[0, 0, 1], {direction: [1, 2]}]", "lights[1].direction: must be three numbers"),
    ("lights: [{directon: [1, 2, 3]}]", "lights[0].directon: unknown key; did you mean 'direction'?"),
    ("lights: [{direction: [1, 2, 3], intensity: -1}]", "lights[0].intensity: must be greater than 0"),
    ("exposure: 0", "exposure: must be a finite number greater than 0"),
    ("exposure: .nan", "exposure: must be a finite number greater than 0"),
    ("exposure: bright", "exposure: must be auto, a number, or {percentile"),
    ("exposure: {percentle: 3}", "exposure.percentle: unknown key; did you mean 'percentile'?"),
    ("clip: 1", "clip: must be true or false, got 1"),
    ("seed: 1.5", "seed: must be a whole number, got 1.5"),
    ("resolution: [3]", "resolution: must be [width, height]"),
    ("resolution: [8192, 100000]", "resolution: must be [width, height]"),
    ("resolution: [8192, 8192]\nsupersampling: 8", "supersampling: 8 x 8192 pixels is more than 16384"),
    ("supersampling: 9", "supersampling: must be at most 8, got 9"),
    ("pose: {rotation: [1, 2, 3]}", "pose.rotation: unknown key; did you mean 'rotation_degrees'?"),
    ("pose: [1]", "pose: must hold 'key: value' pairs"),
    ("pose: {translation_mm: [0, 0, 2000]}", "camera.distance_mm: the object reaches 2025 mm"),
    ("name: b", 'found duplicate key "name"'),
    ("seed: &x 1", "line 4: anchors and aliases"),
    ("seed: !!python/object:os.system x", "line 4: tags (!) of YAML are not read"),
    ("seed: [", "is not valid YAML"),
    ("\tseed: 1", "is not valid YAML"),
    ("seed: " + "[" * 500, "nested more than 20 deep"),
]


@pytest.mark.parametrize(("line", "message"), BAD, ids=[line[:40] for line, _ in BAD])
def test_errors_name_the_key_and_what_is_allowed(line: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        read(LEAST + line)
    assert str(error.value).startswith("f.yaml: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 250


FLAT = "camera: {kind: orthographic, width_mm: 6}\n"
BALL = "name: a\nshape: {name: sphere}\n"
WHOLE = [
    ("name: a", "shape: is missing"),
    ("name: ../a\nshape: {name: sphere}\n" + FLAT, "name: must match"),
    ("name: a\nshape: sphere\n" + FLAT, "shape: must hold 'key: value' pairs"),
    ("name: a\nshape: {name: spere}\n" + FLAT, "shape.name: unknown shape 'spere'; there are capsule, cone, cylinder"),
    ("name: a\nshape: {name: sphere, lenght: 3}\n" + FLAT, "shape.lenght: unknown parameter of sphere"),
    ("name: a\nshape: {name: sphere, radius: -3}\n" + FLAT, "shape: radius must be a number from"),
    (BALL + "camera: {width_mm: 60}", "camera: needs a 'kind'"),
    (BALL + "camera: {kind: ortho, width_mm: 60}", "camera: must be one of 'orthographic', 'perspective'"),
    (BALL + "camera: {kind: orthographic, width: 60}", "camera.width: unknown key; did you mean 'width_mm'?"),
    (BALL + "camera: {kind: perspective, distance_mm: 60}", "camera: needs exactly one of focal_px"),
    (BALL + "camera: {kind: perspective, distance_mm: 60, K: [[1, 2, 0], [0, 1, 0], [0, 0, 1]]}", "camera: K must be"),
    ("", "must hold 'key: value' lines"),
    ("- a", "must hold 'key: value' lines"),
]


@pytest.mark.parametrize(("text", "message"), WHOLE, ids=[message for _, message in WHOLE])
def test_errors_of_whole_specs(text: str, message: str) -> None:
    with pytest.raises(InputError, match=r"^f\.yaml: ") as error:
        read(text)
    assert message in str(error.value)


def test_a_bomb_of_aliases_or_merges_is_refused_at_once() -> None:
    aliases = "a0: &a0 [1, 1]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 30))
    merges = "a0: &a0 {k: 1}\n" + "".join(f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 30))
    for text in (aliases, merges):
        with pytest.raises(InputError, match=r"line 1: anchors and aliases"):
            read(text)


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "big.yaml"
    path.write_text("name: a\n" + "# long\n" * 100_000)
    with pytest.raises(InputError, match="too large"):
        read_spec(path)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00n", b"", b"\x00\x01"])
def test_files_that_are_no_text(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"x\.yaml: "):
        read_spec(path)


def test_neither_file_nor_preset() -> None:
    with pytest.raises(InputError, match=r"paper-cilinder: is neither a file nor a preset; the presets are .*paper-cylinder"):
        read_spec("paper-cilinder")
    with pytest.raises(InputError, match="there is no such file"):
        read_spec("nowhere/paper-cylinder.yaml")


@settings(max_examples=300, deadline=None)
@given(st.text(alphabet="ab:-[]{}&*!|>%@`'\"#,? \n\t0.\\<\x00é", max_size=60))
def test_any_text_is_a_mapping_or_an_input_error(text: str) -> None:
    message = "x: "
    try:
        assert isinstance(parse_yaml(text, "x", "a spec"), dict)
    except InputError as error:
        message = str(error)
    assert message.startswith("x: ")


numbers = st.floats(-1e3, 1e3, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers)
colours = st.one_of(st.floats(0, 1), st.tuples(st.floats(0, 1), st.floats(0, 1), st.floats(0, 1)).map(list))
light_lists = st.lists(vectors.filter(lambda v: max(map(abs, v)) > 1e-3).map(list), min_size=1, max_size=5)
rings = st.fixed_dictionaries({"pattern": st.just("ring"), "count": st.integers(1, 9), "tilt_degrees": st.floats(1, 89)})
widths = st.one_of(
    st.builds(lambda a: {"alpha": a}, st.floats(0.001, 1.6)),
    st.builds(lambda r, m: {"roughness": r, "remap": m}, st.floats(0.001, 1), st.booleans()),
)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**62), vectors, colours, widths, st.one_of(light_lists, rings), st.floats(1e-3, 1e3), st.booleans())
def test_a_spec_written_is_the_spec_read(seed, turn, albedo, width, lights, exposure, clip) -> None:  # type: ignore[no-untyped-def]
    spec = spec_from(
        {
            "name": "any.thing-1", "seed": seed, "shape": {"name": "cylinder", "radius": 3, "segments": 16},
            "pose": {"rotation_degrees": list(turn)}, "material": {"albedo": albedo, **width}, "lights": lights,
            "camera": {"kind": "orthographic", "width_mm": 60.0}, "exposure": exposure, "clip": clip,
        },
        "x",
    )  # fmt: skip
    again = read(spec.yaml())
    assert again == spec
    assert again.digest() == spec.digest()


def test_the_schema_refuses_unknown_keys_like_the_spec_does() -> None:
    found = schema()
    assert set(found["properties"]) == set(Spec.model_fields)
    assert sorted(found["required"]) == ["camera", "name", "shape"]
    sections = {name: part for name, part in found["$defs"].items() if part.get("type") == "object"}
    assert {name for name, part in sections.items() if part["additionalProperties"] is not False} == {"Shape"}
    assert found["additionalProperties"] is False
