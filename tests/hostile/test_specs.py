"""Hostile specs: YAML and TOML that are cut, bombs, code, or ask for what cannot be. No renderer and no network is started."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.hostile.commands import Case, require_refusal
from tests.hostile.files import lay_photographs
from tests.hostile.readers import BENCHMARK, PHOTOS, SET, SPHERE

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
"""A billion x."""

ANY_YAML: dict[str, tuple[str | bytes, str]] = {
    # what it is, for every kind of YAML file: (its content, what the line says)
    "nothing": ("", "is empty"),
    "blanks": (" \n\n", "'key: value'"),
    "a list": ("- a\n- b\n", "'key: value'"),
    "a word": ("hello\n", "'key: value'"),
    "cut in a list": ("a: [1, 2,", "not valid YAML"),
    "a tab": ("a:\n\t- b\n", "not valid YAML"),
    "a billion laughs": (BOMB, "anchors and aliases"),
    "an anchor without an alias": ("a: &b 1\n", "anchors and aliases"),
    "a Python object": ("a: !!python/object/apply:os.system ['touch loaded.txt']\n", "tags"),
    "a time that is none": ("a: !!timestamp x\n", "tags"),
    "a tag of its own": ("!x {a: 1}\n", "tags"),
    "nested 20,000 deep": ("a: " + "[" * 20_000, "nested more than"),
    "a key twice": ("seed: 1\nseed: 2\n", "keep one"),
    "a list as a key": ("? [a, b]\n: 1\n", ""),
    "a table as a key": ("? {a: b}\n: 1\n", "not valid YAML"),
    "a number of 5,000 digits": ("seed: " + "9" * 5000 + "\n", "not valid YAML"),
    "two documents": ("a: 1\n---\nb: 2\n", "not valid YAML"),
    "a version to come": ("%YAML 9.9\n---\na: 1\n", ""),
    "not UTF-8": (b"a: \xe9\n", "not a text file"),
    "UTF-16": ("a: 1\n".encode("utf-16"), "not a text file"),
    "zero bytes": (b"a: \0\0\n", "not valid YAML"),
    "300 kilobytes": ("a: 1\n" + "#" * 300_000, "too large"),
    "a key that is not known": ("colour_of_the_sky: blue\n", "unknown key"),
    "a number as a key": ("1: 2\n", ""),
    "nothing as a key": ("~: 2\n", ""),
    "a date as a key": ("2001-01-01: 2\n", ""),
}
YAML_COMMANDS = {
    "a capture's spec": ("spec.yaml", "gen render HERE/spec.yaml -o HERE/out"),
    "a set's spec": ("set.yaml", "gen plan HERE/set.yaml -o HERE/plan.jsonl"),
    "a benchmark's spec": ("bench.yaml", "recon bench HERE/bench.yaml -o HERE/out"),
    "what is known of photographs": ("photos/capture.yaml", "recon run HERE/photos -o HERE/out"),
}


@pytest.mark.parametrize("kind", YAML_COMMANDS)
@pytest.mark.parametrize("what", ANY_YAML)
def test_hostile_yaml_is_refused(what: str, kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (content, says), (name, command) = ANY_YAML[what], YAML_COMMANDS[kind]

    def lay(folder: Path) -> None:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)

    require_refusal(Case(lay, command, name, says), tmp_path, capfd)
    assert not Path("loaded.txt").exists()


RING = "{pattern: ring, count: 4, tilt_degrees: 35, frontal: true}"
"""The lights of the sound spec of a capture."""

CHANGES: dict[str, dict[str, tuple[str, str, str]]] = {
    # the kind: what is wrong: (a piece of the sound spec, what stands there instead, what the line says)
    "a capture's spec": {
        "a radius that is NaN": ("radius: 10", "radius: .nan", "radius"),
        "a radius without end": ("radius: 10", "radius: .inf", "radius"),
        "a radius below zero": ("radius: 10", "radius: -1", "radius"),
        "a radius of a light year": ("radius: 10", "radius: 1e19", ""),
        "a radius in words": ("radius: 10", "radius: ten", "radius"),
        "a shape that is not known": ("name: sphere", "name: teapot", "unknown shape 'teapot'"),
        "a parameter that is not known": ("radius: 10", "radios: 10", "shape"),
        "a mesh that is not there": ("name: sphere, radius: 10", "name: mesh, file: no.stl", "no.stl"),
        "a mesh that is a Blender file": ("name: sphere, radius: 10", "name: mesh, file: x.blend", ".blend"),
        "a mesh that is a folder": ("name: sphere, radius: 10", "name: mesh, file: dir.stl", "is a folder"),
        "a mesh that is a Blender file by another name": (
            "name: sphere, radius: 10",
            "name: mesh, file: x.glb",
            "not a whole GLB",
        ),
        "200,000 pixels a side": ("[16, 16]", "[200000, 200000]", "resolution"),
        "no pixels": ("[16, 16]", "[0, 16]", "resolution"),
        "half pixels": ("[16, 16]", "[16.5, 16]", "resolution"),
        "more samples than memory": ("[16, 16]", "[8192, 8192]\nsupersampling: 8", "supersampling"),
        "a million lights": ("count: 4", "count: 1000000", "count"),
        "no lights": (RING, "[]", "lights"),
        "a light of no length": (RING, "[[0, 0, 0]]", "length"),
        "a light of no intensity": (RING, "[{direction: [0, 0, 1], intensity: 0}]", "greater than 0"),
        "an albedo above 1": ("[0.8, 0.4, 0.2]", "[8, 4, 2]", "between 0 and 1"),
        "an alpha of nothing": ("alpha: 0.1", "alpha: 0", "alpha"),
        "a material that is not known": ("kind: substrate", "kind: slime", "material"),
        "a camera of no width": ("width_mm: 30", "width_mm: 0", "width_mm"),
        "a camera inside the object": ("width_mm: 30", "width_mm: 30, distance_mm: 5", "distance_mm"),
        "a name that leads up": ("name: ball", "name: ../ball", "name"),
        "a name that is a number": ("name: ball", "name: 3", "name"),
        "a seed below zero": ("name: ball", "name: ball\nseed: -1", "seed"),
    },
    "a set's spec": {
        "a set where a capture is asked for": ("set: small", "name: small", ""),
        "a set of a billion": ("count: 2\n    each", "count: 1000000000\n    each", "count"),
        "a set of too many together": ("[0.1, 0.2]", f"{list(range(1, 60_000))}", ""),
        "a group whose name leads up": ("name: one", "name: ../one", "name"),
        "a draw that is none": ("uniform: [6, 10]", "uniform: [10, 6]", "radius"),
        "a draw of NaN": ("uniform: [6, 10]", "uniform: [.nan, 6]", "radius"),
        "a draw that is not known": ("uniform: [6, 10]", "gaussian: [6, 10]", ""),
        "a path that leads nowhere": ("material.alpha", "material.kind.x", ""),
        "a path that is none": ("material.alpha", "'..'", "dotted path"),
    },
    "a benchmark's spec": {
        "a method that is not known": ("chromaticity", "magic", "unknown gloss remover"),
        "a method twice": ("[none, chromaticity]", "[none, none]", "twice"),
        "draws of two lights": ("lights: 3", "lights: 2", "lights"),
        "captures that are not there": ("path: here", "path: gone", "gone"),
        "captures in three ways": ("path: here", "path: here, set: x", "exactly one"),
        "a seed of 100 digits": ("seed: 1", "seed: " + "9" * 100, "seed"),
    },
    "what is known of photographs": {
        "a pattern over all folders": ("*.png", "**/*.png", "may not hold"),
        "a pattern that leads up": ("*.png", "../*.png", "leads out"),
        "an absolute pattern": ("*.png", "/etc/*", "leads out"),
        "a pattern that finds nothing": ("*.png", "*.gif", "finds no pictures"),
        "a light too few": (", [0, -0.5, 0.9]", "", "4 for 5 pictures"),
        "a direction beyond numbers": ("[0, -0.5, 0.9]", "[0, 1e200, 0.9]", "must lie within"),
        "a direction of NaN": ("[0, -0.5, 0.9]", "[0, .nan, 0.9]", "lights"),
        "a mask that leads up": ("mm_per_pixel: 0.1", "mask: ../mask.png", "leads out"),
        "a scale of nothing": ("mm_per_pixel: 0.1", "mm_per_pixel: 0", "mm_per_pixel"),
        "a dark frame that is not there": ("mm_per_pixel: 0.1", "dark: [no.png]", "no.png"),
        "intensities below zero": ("intensities: equal", "intensities: [-1, 1, 1, 1, 1]", "intensities"),
    },
}
SOUND = {
    "a capture's spec": SPHERE,
    "a set's spec": SET,
    "a benchmark's spec": BENCHMARK,
    "what is known of photographs": PHOTOS,
}


@pytest.mark.parametrize(("kind", "what"), [(kind, what) for kind, changes in CHANGES.items() for what in changes])
def test_a_spec_that_asks_for_what_cannot_be_is_refused(
    kind: str, what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (old, new, says), (name, command) = CHANGES[kind][what], YAML_COMMANDS[kind]
    assert SOUND[kind].count(old) == 1

    def lay(folder: Path) -> None:
        place = (folder / name).parent
        if kind == "what is known of photographs":
            place.mkdir()
            lay_photographs(place)
        (place / "x.blend").write_bytes(b"BLENDER-v405" + b"\0" * 64 + b"import os; os.system('touch loaded.txt')")
        (place / "x.glb").write_bytes((place / "x.blend").read_bytes())
        (place / "dir.stl").mkdir()
        (folder / name).write_text(SOUND[kind].replace(old, new))

    names = says if "mesh" in what or "not there" in what else "" if "photographs" in kind else name
    require_refusal(Case(lay, command, names, says), tmp_path, capfd)


CONFIG = """\
method = "specular"
seed = 1
[model]
width = 4
[data]
pack = "HERE/pack.safetensors"
[train]
batch = 2
steps = 3
"""
CONFIGS: dict[str, tuple[str | bytes, str]] = {
    "nothing": ("", "method"),
    "cut": ('method = "spec', "not valid TOML"),
    "a key twice": (CONFIG.replace("seed = 1", "seed = 1\nseed = 2"), "not valid TOML"),
    "a key that is not known": ("colour = 1\n" + CONFIG, "unknown key 'colour'"),
    "a key of training that is not known": (CONFIG + "speed = 3\n", "unknown key train.speed"),
    "an option of the network that is not known": (CONFIG.replace("width = 4", "depth = 4"), "depth"),
    "a network as wide as memory": (CONFIG.replace("width = 4", "width = 1000000000"), "width"),
    "a batch of 400 digits": (CONFIG.replace("batch = 2", "batch = " + "9" * 400), "must lie from"),
    "a batch of 5,000 digits": (CONFIG.replace("batch = 2", "batch = " + "9" * 5000), "not valid TOML"),
    "a rate of 400 digits": (CONFIG + "rate = " + "9" * 400 + "\n", "must lie from"),
    "a rate that is NaN": (CONFIG + "rate = nan\n", "must lie from"),
    "a rate without end": (CONFIG + "rate = inf\n", "must lie from"),
    "a batch in words": (CONFIG.replace("batch = 2", 'batch = "two"'), "whole number"),
    "a batch that is a date": (CONFIG.replace("batch = 2", "batch = 1979-05-27"), "whole number"),
    "neither steps nor epochs": (CONFIG.replace("steps = 3", ""), "exactly one of epochs and steps"),
    "nested 100,000 deep": ("a = " + "[" * 100_000, "not valid TOML"),
    "not UTF-8": (b'method = "\xe9"', "not UTF-8"),
    "two megabytes": (CONFIG + "#" * 2_000_000, "too large"),
    "a pack that is not there": (CONFIG.replace("pack.safe", "no.safe"), "no.safetensors"),
    "a start that is a pickle": (CONFIG + 'start = "HERE/start.pt"\n', "start.pt"),
    "a method that is not known": (CONFIG.replace("specular", "magic"), "must be one of"),
}


@pytest.mark.skipif(find_spec("torch") is None, reason="torch is not installed")
@pytest.mark.parametrize("what", CONFIGS)
def test_a_hostile_config_is_refused(what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    content, says = CONFIGS[what]

    def lay(folder: Path) -> None:
        from tests.hostile.files import pickled
        from tests.learn.small_runs import write_tiny_pack

        write_tiny_pack(folder / "pack.safetensors")
        (folder / "start.pt").write_bytes(pickled())
        data = content.replace("HERE", str(folder)).encode() if isinstance(content, str) else content
        (folder / "config.toml").write_bytes(data)

    names = "no.safetensors" if "pack" in what else "" if "start" in what or "network" in what else "config.toml"
    require_refusal(Case(lay, "learn train HERE/config.toml -o HERE/run --device cpu", names, says), tmp_path, capfd)
