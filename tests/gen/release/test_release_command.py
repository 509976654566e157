"""The command from a spec to a release: it renders, screens, divides and releases, and the same again gives the same bytes."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from gen.cli import app
from gen.errors import InputError
from gen.release import bench
from gen.release.command import _described
from gen.release.reading import open_release
from gen.sets.set_folder import SetFolder
from gen.sets.thumbnail import THUMBNAIL, frontal, thumbnail
from gen.sets.verify import verify
from tests.gen.release.conftest import contents

SPEC = """\
# two training captures and a test capture of two pictures
set: tiny-release
seed: 4
groups:
  - name: train
    split: train
    count: 2
    capture:
      resolution: [32, 32]
      half: true
      shape: {name: cylinder, radius: {uniform: [6, 10]}, length: 20, segments: 32}
      material: {kind: substrate, albedo: {uniform: [0.3, 0.8]}, specular: 0.3, alpha: 0.2}
      lights: {pattern: random, count: 2}
      camera: {kind: orthographic, width_mm: 60}
  - name: test
    split: test
    capture:
      resolution: [32, 32]
      half: true
      shape: {name: cylinder, radius: {uniform: [11, 14]}, length: 20, segments: 32}
      material: {kind: substrate, albedo: {uniform: [0.1, 0.2]}, specular: 0.3, alpha: 0.2}
      lights: {pattern: random, count: 2}
      camera: {kind: orthographic, width_mm: 60}
"""


def call(*tokens: str | Path) -> None:
    app([str(token) for token in tokens], exit_on_error=False, result_action="return_value")


@pytest.mark.render
def test_from_a_spec_to_a_release(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "set.yaml").write_text(SPEC)
    options = ("--version", "0.1.0", "--title", "Tiny", "--description", "Three captures.", "--json")
    call("release", tmp_path / "set.yaml", "-o", tmp_path / "all", *options)
    facts = json.loads(capsys.readouterr().out)
    assert (facts["name"], facts["items"], facts["pictures"], facts["rejected"], facts["shards"]) == ("tiny-release", 3, 6, 0, 2)
    assert sorted(os.listdir(tmp_path)) == ["all", "set.yaml"]

    # Rendered step by step, from the plan that the release holds, it comes to the same bytes.
    plan = tmp_path / "all/data/plan.jsonl"
    call("render", plan, "-o", tmp_path / "set")
    call("screen", tmp_path / "set")
    call("split", tmp_path / "set")
    call("release", tmp_path / "set", "-o", tmp_path / "steps", *options)
    assert contents(tmp_path / "steps") == contents(tmp_path / "all")

    found = verify(tmp_path / "all")
    assert (found.faults, found.items, found.pixels) == ((), 3, 3)
    release, folder = open_release(tmp_path / "all"), SetFolder(tmp_path / "set")
    for item in release.items():
        np.testing.assert_array_equal(release.capture(item).images, folder.capture(item).images)
    card = (tmp_path / "all/README.md").read_text()
    assert "config_name: default" in card
    assert "EXRs store the box around the object only" in card
    assert "`diffuse.{R,G,B}` (half)" in card

    # Previews are those that were rendered, and those that would be drawn of a set without them.
    for place in (tmp_path / "set/items").iterdir():
        capture = folder.capture(place.name)
        assert thumbnail(capture.images[frontal(capture.lights)]) == (place / THUMBNAIL).read_bytes()


def test_a_bench_prints_its_figures(rendered: SetFolder) -> None:
    figures = bench.measure(rendered.path, 1)
    assert figures["files"] == 8 * 3 + 20
    assert set(figures["rows"]) == {"sha256sum", "cp", "release", "contact sheet, part of it"}
    assert figures["ratio_without_sheet"]["processor"] > figures["ratio"]["processor"] > 0


def test_the_description_is_the_presets_own() -> None:
    from gen.presets import preset_file
    from gen.sets.set_spec import read_set

    digest = read_set(preset_file("smoke")).digest()
    assert _described("smoke", digest).startswith("A set in seconds")
    assert _described("smoke", "0" * 64).startswith("Rendered pictures")


WRONG = {
    "version": (("--version", "one"), "--version one: must be three numbers"),
    "shards": (("--version", "1.0.0", "--shard-mb", "0"), "--shard-mb 0"),
    "workers": (
        ("--version", "1.0.0", "--workers", "1"),
        "--workers is for sets that are rendered here, and .* is rendered already",
    ),
    "fractions": (("--version", "1.0.0", "--fractions", "1,0,0"), "--fractions is for sets that are rendered here"),
    "by": (("--version", "1.0.0", "--by", "object"), "--by is for sets that are rendered here"),
    "device": (("--version", "1.0.0", "--device", "cpu"), "--device is for sets that are rendered here"),
    "blender": (("--version", "1.0.0", "--blender", "blender"), "--blender is for sets that are rendered here"),
    "title": (("--version", "1.0.0", "--title", "\udcff"), "--title: must be one line of text"),
    "licence": (("--version", "1.0.0", "--license", "GPL"), "--license GPL"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_options_leave_nothing(rendered: SetFolder, tmp_path: Path, name: str) -> None:
    options, message = WRONG[name]
    with pytest.raises(InputError, match=message):
        call("release", rendered.path, "-o", tmp_path / "out", *options)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("options", [("--by", "colour"), ("--by", ""), ("--fractions", "1,1,1"), ("--fractions", "all")])
def test_how_to_divide_is_checked_before_anything_is_rendered(tmp_path: Path, options: tuple[str, str]) -> None:
    with pytest.raises(InputError, match=f"^{options[0]} "):
        call("release", "smoke", "--version", "1.0.0", "-o", tmp_path / "out", *options)
    assert os.listdir(tmp_path) == []


def test_what_is_no_set_is_refused(tmp_path: Path, rendered: SetFolder) -> None:
    for source in (tmp_path, tmp_path / "nothing.yaml", rendered.item_folder("one-000000"), "small-sphere"):
        with pytest.raises(InputError, match="is neither the folder of a rendered set"):
            call("release", source, "--version", "1.0.0", "-o", tmp_path / "out")
    assert os.listdir(tmp_path) == []


def test_a_set_named_like_a_folder_here_is_no_trouble(
    rendered_copy: SetFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rendered preset often lies in a folder of the preset's name."""
    shutil.copytree(rendered_copy.path, tmp_path / "smoke")
    monkeypatch.chdir(tmp_path)
    head = json.loads(Path("smoke/set.json").read_text())
    Path("smoke/set.json").write_text(json.dumps({**head, "name": "smoke"}))
    call("release", "smoke", "--version", "1.0.0", "-o", "out")
    assert json.loads(Path("out/provenance.json").read_text())["name"] == "smoke"
