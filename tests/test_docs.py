"""The pages of docs/ and the README: their code runs, their command lines are real, their links lead somewhere, no name is missing.

A fenced block is checked by its language. `python` runs. `yaml` and `json` are read by the models that they are for. `sh` is parsed by the
real command line, and run where the comment before it says `run`; where it says `shown`, the reason follows. Comments besides: `synopsis`
(options in brackets, only looked up), `script` (for other machines: its shell is asked whether it can read it), `file` and `change` (parts
of the examples in docs/extending.md).
"""

from __future__ import annotations

import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.formats.render_folder import write_render
from gen.images import write_png
from gen.photos.spec import photo_spec
from gen.sets.set_spec import expand, set_from
from gen.spec import spec_from
from gen.strict_yaml import parse_yaml
from recon.benchmark.spec import Benchmark
from tests.conftest import synthetic_capture
from tests.gen.sets.conftest import write_set

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
TEXTS = {page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8") for page in PAGES}
EVERYTHING = "\n".join(TEXTS.values())
OTHER_PROGRAMS = {"apt-get", "blender", "mkdir", "sbatch", "torchrun", "cd", "source", "set", "exec"}
"""What may stand in a block of shell besides degloss, python, make and pip."""

WIDTH = 128
"""Pixels across of the tutorial's photographs in these tests; 480 on the page."""


@dataclass(frozen=True)
class Block:
    """A fenced block. mark: what the comment before it says, "" where there is none. where: page and line."""

    page: str
    line: int
    language: str
    mark: str
    text: str

    @property
    def where(self) -> str:
        return f"{self.page}:{self.line}"


def blocks_of(page: str) -> Iterator[Block]:
    pattern = re.compile(r"^(?:<!-- ([^\n]*?) -->\n)?```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
    for found in pattern.finditer(TEXTS[page]):
        mark, language, text = found.groups()
        yield Block(page, TEXTS[page].count("\n", 0, found.start()) + 1, language, mark or "", text)


BLOCKS = [block for page in TEXTS for block in blocks_of(page)]


def of(language: str, *marks: str) -> list[Block]:
    return [block for block in BLOCKS if block.language == language and (not marks or block.mark.split(":")[0] in marks)]


def commands(text: str) -> Iterator[list[str]]:
    """The command lines of a piece of shell, each as words: comments off, continued lines joined, variables stood in for by 1."""
    joined = re.sub(r"\\\n\s*", " ", text)
    for line in joined.splitlines():
        plain = re.sub(r'"?\$\{?\w+(\[@\])?\}?"?', "1", line)
        words = shlex.split(plain, comments=True)
        if words and "=" not in words[0] and words[0] != "[":
            yield words


def parsed(words: list[str]) -> tuple[Any, Any]:
    """A degloss command line as the real one takes it. Raises cyclopts' errors for an unknown command or option."""
    import degloss

    command, bound, *_ = degloss.app.parse_args(words[1:], exit_on_error=False, print_error=False)
    return command, bound


def test_the_pages_are_there() -> None:
    assert len(PAGES) > 10
    assert len(BLOCKS) > 50


def test_every_block_says_what_it_is() -> None:
    known = {
        "python": {"", "file"},
        "yaml": {""},
        "json": {""},
        "sh": {"run", "shown", "synopsis"},
        "bash": {"script"},
        "diff": {"change"},
        "text": {""},
    }
    for block in BLOCKS:
        assert block.mark.split(":")[0] in known.get(block.language, set()), f"{block.where}: {block.language!r}, {block.mark!r}"
        assert not block.mark.startswith("shown") or len(block.mark) > len("shown: because"), f"{block.where}: says no reason"


def test_every_command_line_is_one() -> None:
    """Each command of every page, run or shown, by the real command line; modules, targets and extras by their names."""
    import tomllib

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    seen = 0
    for block in [*of("sh", "run", "shown"), *of("bash")]:
        for words in commands(block.text):
            where, name = f"{block.where}: {shlex.join(words)}", words[0]
            if name == "degloss":
                parsed(words)
                seen += 1
            elif name == "python" and words[1] == "-m":
                assert find_spec(words[2]), where
            elif name == "python":
                assert (ROOT / words[1]).is_file(), where
            elif name == "make":
                assert set(words[1:]) <= set(targets), where
            elif name == "pip":
                wanted = re.findall(r"\[([\w,]+)\]", words[-1])
                assert set(wanted[0].split(",")) <= set(extras), where
            else:
                assert name in OTHER_PROGRAMS, where
    assert seen > 40


def test_what_is_written_in_passing_exists() -> None:
    """`degloss ...` in running text and in synopses: the command is there, and so are its options."""
    import degloss

    inline = re.findall(r"`(degloss [^`\n]+)`", EVERYTHING)
    lines = []
    for block in of("sh", "synopsis"):
        lines += [line.split("#")[0] for line in block.text.replace("\n      ", " ").splitlines()]
    assert len(inline) > 30
    for line in [*inline, *lines]:
        words = re.sub(r"[\[\]|]", " ", line).split()[1:]
        depth = next((k for k, word in enumerate(words) if not re.fullmatch(r"[a-z][a-z0-9-]*", word)), len(words))
        app, path = degloss.app, []
        for word in words[:depth]:
            if word not in app:
                break
            app, path = app[word], [*path, word]
        assert path or words[0] == "--version", line
        if not path:
            continue
        options = (
            {name for argument in app.assemble_argument_collection() for name in argument.names} if app.default_command else set()
        )
        for option in (word for word in words if re.match(r"--?[a-z]", word)):
            assert option in options | {"--help"}, f"{line}: {option}"


@pytest.fixture(scope="session")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the pages speak of: photographs, a capture, a set, specs; all of it small."""
    place = tmp_path_factory.mktemp("desk")
    scene = synthetic_capture("sphere", 40)
    write_render(scene, place / "captures" / "sphere")
    for name, pictures in {"bolt": scene, "unknown": synthetic_capture("sphere", 40, layer="matte")}.items():
        folder = place / "photos" / name
        folder.mkdir(parents=True)
        for k, picture in enumerate(pictures.images):
            write_png(folder / f"{k + 1:02d}.png", np.round(np.clip(picture, 0, 1) * 65535).astype(np.uint16))
        write_png(folder / "mask.png", scene.mask.astype(np.uint8) * 255)
    np.savetxt(place / "photos" / "bolt" / "lights.txt", scene.lights)
    runpy.run_path(str(ROOT / "docs/examples/photographs.py"))["write"](place / "photos" / "button", WIDTH)
    tutorial = next(block.text for block in blocks_of("docs/tutorial.md") if block.language == "yaml")
    scaled = tutorial.replace("mm_per_pixel: 0.125", f"mm_per_pixel: {60 / WIDTH}")
    (place / "photos" / "button" / "capture.yaml").write_text(scaled)
    (place / "set.yaml").write_text(SMALL_SET)
    (place / "sets").mkdir()
    write_set(place / "set.yaml", place / "sets" / "smoke", synthetic_capture)
    quick = next(block.text for block in blocks_of("docs/benchmarks.md") if "benchmark: quick" in block.text)
    (place / "quick.yaml").write_text(quick)
    return place


SMALL_SET = """\
set: smoke
groups:
  - name: stack
    count: 4
    capture:
      resolution: [24, 24]
      shape: {name: sphere, radius: {uniform: [10, 20]}}
      material: {kind: substrate, albedo: {uniform: [0.2, 0.5]}, specular: 0.05, alpha: {uniform: [0.3, 0.5]}}
      lights: {pattern: random, count: 3, max_tilt_degrees: 40}
      camera: {kind: orthographic, width_mm: 60}
      exposure: 1.0
"""


def runs(block: Block) -> bool:
    return block.mark == "run" or (block.language == "python" and not block.mark)


TUTORIAL = "docs/tutorial.md"
RUNNING = [page for page in TEXTS if any(map(runs, blocks_of(page)))]


@pytest.mark.parametrize("page", sorted(RUNNING, key=lambda page: page != TUTORIAL))
def test_what_should_run_runs(page: str, desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The blocks of a page in their order: shell lines by the command itself, in this process, Python as it stands."""
    monkeypatch.chdir(desk)
    if page == "docs/inspection.md" and not (desk / "out" / "button").is_dir():
        run_blocks(TUTORIAL, capsys)
    run_blocks(page, capsys)


def run_blocks(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    for block in filter(runs, blocks_of(page)):
        if block.language == "python":
            exec(compile(block.text, block.where, "exec"), {"__name__": "__main__"})
            continue
        for words in commands(block.text):
            if words[0] == "degloss":
                command, bound = parsed(words)
                command(*bound.args, **bound.kwargs)
                assert capsys.readouterr().out, f"{block.where}: {shlex.join(words)} printed nothing"
            else:
                assert words[:2] == ["python", "docs/examples/photographs.py"], (
                    f"{block.where}: {words} is done by the fixture or not at all"
                )


def test_the_tutorial_lists_what_is_written(desk: Path) -> None:
    """The table of files in the tutorial, against what its command left."""
    if not (desk / "out" / "button").is_dir():
        pytest.skip("only where the tutorial's commands ran in this process")
    rows = re.findall(r"^\| ((?:`[\w./]+`(?:, )?)+) \|", TEXTS["docs/tutorial.md"], re.MULTILINE)
    listed = {name.strip("`").rstrip("/") for row in rows for name in row.split(", ")}
    assert {path.name for path in (desk / "out" / "button").iterdir() if not path.name.startswith(".")} == listed


def test_the_specs_are_such() -> None:
    """Every YAML block is read by what it is for."""
    kinds = {"name:": 0, "set:": 0, "benchmark:": 0, "images:": 0, "apiVersion:": 0}
    for block in of("yaml"):
        kind = next((kind for kind in kinds if block.text.startswith(kind)), None)
        assert kind, f"{block.where}: what is it?"
        kinds[kind] += 1
        data = parse_yaml(block.text, block.where, "an example")
        if kind == "name:":
            spec_from(data, block.where)
        elif kind == "set:":
            found = set_from(data, block.where)
            assert len(list(expand(found, block.where))) == found.total()
        elif kind == "benchmark:":
            assert Benchmark.model_validate(data).combinations()
        elif kind == "images:":
            photo_spec(data, block.where)
        else:
            (container,) = data["spec"]["template"]["spec"]["containers"]
            (line,) = container["args"]
            command, bound = parsed(next(commands(line)))
            assert command.__name__ == "render_chunk"
            assert bound.arguments["chunks"] == data["spec"]["completions"]
            assert data["spec"]["completionMode"] == "Indexed"
    assert all(kinds.values()), kinds


def test_json_is_json() -> None:
    for block in of("json"):
        assert json.loads(block.text), block.where


def test_scripts_for_clusters_can_be_read_by_their_shell() -> None:
    scripts = of("bash", "script")
    assert len(scripts) == 2
    for block in scripts:
        run = subprocess.run(["bash", "-n"], input=block.text, text=True, capture_output=True)
        assert run.returncode == 0, f"{block.where}: {run.stderr}"
        assert block.text.startswith("#!/bin/bash\n#SBATCH")
        assert "set -euo pipefail" in block.text


@pytest.mark.parametrize("page", TEXTS)
def test_links_lead_somewhere(page: str) -> None:
    """Files, pictures, and the headings that a link names."""
    here = (ROOT / page).parent
    text = re.sub(r"^```.*?^```$", "", TEXTS[page], flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"!?\[[^\]]*\]\(([^)\s]+)\)", text):
        assert not target.startswith("http"), f"{page}: {target} leads away from these pages"
        file, _, heading = target.partition("#")
        path = (here / file).resolve() if file else ROOT / page
        assert path.exists(), f"{page}: {target}"
        if heading:
            assert heading in anchors(path.read_text(encoding="utf-8")), f"{page}: {target}"


def anchors(text: str) -> set[str]:
    """The names by which a page's headings are linked to."""
    titles = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def test_every_picture_is_used_and_described() -> None:
    shown = set(re.findall(r"!\[[^\]]{20,}\]\((?:docs/)?([\w./]+)\)", EVERYTHING))
    made = {path.relative_to(ROOT / "docs").as_posix() for kind in ("png", "svg") for path in (ROOT / "docs").rglob(f"*.{kind}")}
    assert made == shown


def test_every_page_is_reached_from_the_first() -> None:
    index = TEXTS["docs/README.md"]
    for page in TEXTS:
        if page.startswith("docs/") and page != "docs/README.md":
            assert f"]({page.removeprefix('docs/')}" in index, page
    assert "](docs/README.md)" in TEXTS["README.md"]


def registered() -> dict[str, list[str]]:
    """Everything that has a name, by the page that describes it."""
    from blender_scenes.shapes import SHAPES
    from blender_scenes.shapes.detail import DETAILS
    from gen.convert import FORMATS
    from gen.presets import preset_names
    from gen.spec_lights import LIGHT_KINDS, LIGHT_PATTERNS
    from gen.spec_materials import MATERIALS
    from recon.benchmark.spec import preset_names as benchmarks
    from recon.registry import GLOSS, HEIGHT, NORMALS, REPAIR

    return {
        "docs/methods.md": [*GLOSS, *REPAIR, *NORMALS, *HEIGHT],
        "docs/rendering.md": [*SHAPES, *DETAILS, *LIGHT_KINDS, *LIGHT_PATTERNS, *preset_names()],
        "docs/materials.md": list(MATERIALS),
        "docs/benchmarks.md": benchmarks(),
        "docs/data-format.md": list(FORMATS),
    }


@pytest.mark.parametrize(("page", "names"), registered().items(), ids=registered())
def test_every_registered_name_is_described(page: str, names: list[str]) -> None:
    missing = [name for name in names if f"`{name}`" not in TEXTS[page]]
    assert not missing, f"{page}: {missing}"


def test_every_method_and_material_has_a_section_with_its_source() -> None:
    from gen.spec_materials import MATERIALS
    from recon.registry import GLOSS, HEIGHT, NORMALS, REPAIR

    pages = {"gloss": GLOSS, "repair": REPAIR, "normals": NORMALS, "height": HEIGHT}
    for kind, registry in pages.items():
        text = TEXTS[f"docs/methods-{kind}.md"]
        for name in registry:
            found = re.search(rf"^## {re.escape(name)}\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
            assert found, f"{kind}: {name}"
            own = not registry.describe()[name][1]
            assert own or "ource" in found[1], f"{kind}: {name} has no source"
    for name in MATERIALS:
        assert f"\n## {name}\n" in TEXTS["docs/materials.md"], name


def test_numbers_that_the_pages_state_are_those_of_the_code() -> None:
    from recon.conditioning import MAX_CONDITION
    from recon.inspection.verdict import GUARD
    from recon.multiview.stereo import LEAST_DEGREES, MOST_DEGREES
    from recon.photo_check import DIM
    from recon.reconstruct import Settings
    from recon.registry import FEWEST_FOR_GROUP

    for page, sentence in {
        "docs/methods.md": f"from {FEWEST_FOR_GROUP} pictures on where torch is installed",
        "docs/methods-normals.md": f"condition number of at most {MAX_CONDITION:g}",
        "docs/inspection.md": f"`--guard` is g, {GUARD:g} by default",
        "docs/multiview.md": f"{LEAST_DEGREES:g} to {MOST_DEGREES:g} degrees apart",
        "docs/faq.md": f"less than {100 * DIM:g} % of full scale",
    }.items():
        assert sentence in " ".join(TEXTS[page].split()), sentence
    of_settings = {"Normals": Settings.normals, "height": Settings.height, "threshold": Settings.threshold}
    said = [f"**{name}** `{value}`" for name, value in of_settings.items()]
    assert ", ".join([*said, f"**dilate** {Settings.dilate}"]) in " ".join(TEXTS["docs/methods.md"].split())


def test_the_examples_of_new_parts_work(tmp_path: Path) -> None:
    """docs/extending.md, step by step, on a copy of the sources: files written, changes applied, their tests run."""
    for package in ("blender_scenes", "gen", "recon"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc"))
    (tmp_path / "tests").mkdir()
    shutil.copy(ROOT / "tests" / "conftest.py", tmp_path / "tests")
    for block in blocks_of("docs/extending.md"):
        if block.mark.startswith("file: "):
            (tmp_path / block.mark.removeprefix("file: ")).write_text(block.text)
        elif block.mark == "change":
            run = subprocess.run(
                ["git", "apply", "--recount", "-"], input=block.text, text=True, cwd=tmp_path, capture_output=True
            )
            assert run.returncode == 0, f"{block.where}: {run.stderr}"
    tests = sorted(path.name for path in tmp_path.glob("test_*.py"))
    assert len(tests) == 3
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_DISABLE_JIT": "1"}
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "error", *tests],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert f"{len(tests)} passed" in run.stdout
