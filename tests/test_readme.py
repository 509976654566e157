"""What the README shows works as it stands there."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from gen.capture import Capture
from gen.formats.render_folder import write_render
from gen.photos.spec import photo_spec
from gen.sets.set_spec import expand, set_from
from gen.spec import spec_from
from gen.strict_yaml import parse_yaml
from recon.benchmark.spec import Benchmark

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
Synthetic = Callable[..., Capture]


def blocks(language: str) -> list[str]:
    return [text for kind, text in re.findall(r"^```(\w*)\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL) if kind == language]


def test_the_specs_are_such() -> None:
    capture_spec, set_spec, benchmark = (
        next(b for b in blocks("yaml") if b.startswith(key)) for key in ("name:", "set:", "benchmark:")
    )
    photos = next(b for b in blocks("yaml") if b.startswith("images:"))
    assert len(blocks("yaml")) == 4
    assert photo_spec(parse_yaml(photos, "README.md", "photographs"), "README.md").mm_per_pixel == 0.05
    assert spec_from(parse_yaml(capture_spec, "README.md", "a spec"), "README.md").name == "my-cylinder"
    found = set_from(parse_yaml(set_spec, "README.md", "a set spec"), "README.md")
    assert len(list(expand(found, "README.md"))) == found.total() == 40
    assert len(Benchmark.model_validate(parse_yaml(benchmark, "README.md", "a benchmark")).combinations()) == 7


def test_every_material_and_preset_is_named() -> None:
    from gen.presets import preset_names
    from gen.spec_materials import MATERIALS

    for name in [*MATERIALS, *preset_names("set")]:
        assert f"`{name}`" in TEXT, name


def test_every_shape_is_named() -> None:
    from blender_scenes.shapes import SHAPES

    (sentence,) = re.findall(r"^Shapes: (.*?), each with", TEXT, re.MULTILINE | re.DOTALL)
    assert {word.split("(")[0].strip() for word in sentence.replace("\n", " ").split(",")} == set(SHAPES)


def test_the_python_runs(tmp_path: Path, synthetic: Synthetic) -> None:
    (code,) = blocks("python")
    write_render(synthetic("sphere", 32), tmp_path / "photos" / "bolt")
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "out" / "bolt" / "mesh.ply").is_file()


def test_every_command_and_option_exists() -> None:
    """Each `degloss ...` line of the README against the help of that command."""
    lines = [line.split("#")[0].strip() for block in blocks("") for line in block.replace("\n      ", " ").splitlines()]
    commands = [line for line in lines if line.startswith("degloss ")]
    assert len(commands) >= 4
    for line in commands:
        words = shlex.split(line.replace("[", " ").replace("]", " ").replace("|", " "))[1:]
        depth = 2 if words[0] in ("recon", "gen", "learn") else 1
        run = subprocess.run(
            [sys.executable, "-m", "degloss", *words[:depth], "--help"], capture_output=True, text=True, cwd=ROOT
        )
        assert run.returncode == 0, line
        for option in (word for word in words if word.startswith("-")):
            assert re.search(rf"(^|\s){re.escape(option)}\b", run.stdout), f"{line}: {option}"


@pytest.mark.parametrize("target", re.findall(r"!?\[[^\]]*\]\(([^)]+)\)", TEXT))
def test_links_and_pictures_are_there(target: str) -> None:
    assert target.startswith("http") or (ROOT / target).exists(), target
