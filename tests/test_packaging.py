"""What is installed: the wheel, the source archive, another project's packages of the same names, and (`make soak`) empty environments."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("blender_scenes", "gen", "recon", "learn")
BESIDE = {".py", ".yaml", ".toml", ".json", ".safetensors", ".md", ".html", ".js", ".css", ".typed"}
"""Endings of what a package holds beside its modules, and needs."""


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """(wheel, source archive), both built of a copy of the project: nothing of a build stays in it."""
    folder = tmp_path_factory.mktemp("packaging")
    copy = folder / "project"
    left_out = shutil.ignore_patterns(
        ".git", ".venv", "out", "__pycache__", "*.egg-info", "build", ".*_cache", ".hypothesis", "node_modules"
    )
    shutil.copytree(ROOT, copy, ignore=left_out)
    for what in ("wheel", "sdist"):  # each by a process of its own: setuptools keeps state
        code = f"import sys, setuptools.build_meta as build; build.build_{what}(sys.argv[1])"
        subprocess.run([sys.executable, "-c", code, str(folder)], cwd=copy, capture_output=True, check=True)
    (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, source


@pytest.fixture(scope="module")
def unpacked(archives: tuple[Path, Path]) -> Path:
    """The wheel's files, as an installer lays them down."""
    place = archives[0].parent / "unpacked"
    with zipfile.ZipFile(archives[0]) as wheel:
        wheel.extractall(place)
    return place


def files_of(package: str) -> set[str]:
    """Paths of a package's files in the project, those that Python or a run made excepted."""
    found = (p for p in (ROOT / package).rglob("*") if p.is_file() and "__pycache__" not in p.parts)
    return {p.relative_to(ROOT).as_posix() for p in found if p.suffix in BESIDE}


def test_the_wheel_holds_the_packages_and_nothing_else(archives: tuple[Path, Path]) -> None:
    names = set(zipfile.ZipFile(archives[0]).namelist())
    ours = {name for name in names if ".dist-info/" not in name}
    assert ours == {"degloss.py"}.union(*map(files_of, PACKAGES))
    assert any(name.endswith("/LICENSE") for name in names)


def test_the_source_archive_holds_what_builds_and_tests_it(archives: tuple[Path, Path]) -> None:
    with tarfile.open(archives[1]) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    wanted = {
        "pyproject.toml",
        "constraints.txt",
        "Makefile",
        "README.md",
        "LICENSE",
        "degloss.py",
        ".ci/run",
        "tests/conftest.py",
    }
    assert wanted.union(*map(files_of, PACKAGES)) <= names
    assert not {name for name in names if name.split("/")[0] in {"shared", "out", ".venv", ".git"}}


@pytest.mark.parametrize("name", PACKAGES)
def test_another_projects_package_of_our_name_is_named(name: str, unpacked: Path, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{unpacked}"}
    run = subprocess.run(
        [sys.executable, "-m", "degloss", "gen", "presets"], env=environment, cwd=tmp_path.parent, capture_output=True, text=True
    )
    assert (run.returncode, run.stdout) == (2, "")
    assert len(run.stderr.splitlines()) == 1
    assert f"{tmp_path / name}: a package of another project" in run.stderr


@pytest.mark.parametrize(("foreign", "module"), [("gen", "recon.pipeline"), ("recon", "learn.removers")])
def test_importing_beside_another_projects_package(foreign: str, module: str, unpacked: Path, tmp_path: Path) -> None:
    (tmp_path / foreign).mkdir()
    (tmp_path / foreign / "__init__.py").write_text("")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{unpacked}"}
    run = subprocess.run(
        [sys.executable, "-c", f"import {module}"], env=environment, cwd=tmp_path.parent, capture_output=True, text=True
    )
    assert run.returncode == 1
    assert f"{foreign}/__init__.py is another project's package" in run.stderr.splitlines()[-1]


LOWEST = {"opencv-python-headless": "4.10.0.84", "OpenEXR": "3.5.0"}
"""The lowest versions whose first release is not called as `>=` says."""


def lowest() -> list[str]:
    """Requirements of the core, each at the lowest version that pyproject.toml allows."""
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    parts = [line.split(">=") for line in project["dependencies"]]
    return [f"{name}=={LOWEST.get(name, version + '.*')}" for name, version in parts]


PINNED = ["-c", "constraints.txt"]
ENVIRONMENTS: dict[str, tuple[str, str, list[str]]] = {
    # what is installed: (the Python, the extras, how versions are held down); without constraints the newest there are
    "core": ("3.11", "", PINNED),
    "lowest": ("3.11", "", []),
    "render": ("3.11", "[render,report]", PINNED),
    "learn": ("3.11", "[learn,report]", PINNED),
    "python 3.12": ("3.12", "[report]", []),
    "python 3.13": ("3.13", "[report]", []),
}

MEASURE = ["recon", "run", "{photos}", "--gloss", "explain", "-o", "{out}"]
RENDER = ["gen", "render", "small-sphere", "-o", "{out}"]
PREDICT = ["recon", "run", "{photos}", "--gloss", "group", "-o", "{out}"]
CAN = {"render": [MEASURE, RENDER], "learn": [MEASURE, PREDICT]}
"""What each does; [MEASURE] where nothing is said."""
LACKS = {"core": [(RENDER, "bpy"), (PREDICT, "torch")], "render": [(PREDICT, "torch")], "learn": [(RENDER, "bpy")]}


def interpreter(version: str) -> str:
    """A Python of that version: this one, one on the path, or one of pyenv's. Skips the test where there is none."""
    if version == f"{sys.version_info.major}.{sys.version_info.minor}":
        return sys.executable
    kept = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    for place in (shutil.which(f"python{version}"), *map(str, kept)):
        if place is not None and subprocess.run([place, "--version"], capture_output=True).returncode == 0:
            return place
    pytest.skip(f"there is no Python {version}")


def photographs(folder: Path) -> Path:
    """A folder of five PNG pictures and their lights, as a user has them."""
    from gen.convert.png16 import write_png16
    from tests.conftest import synthetic_capture

    (folder / "photos").mkdir()
    write_png16(synthetic_capture("sphere", 48), folder / "photos")
    return folder / "photos"


@pytest.mark.soak
@pytest.mark.parametrize("which", ENVIRONMENTS)
@pytest.mark.parametrize("form", [0, 1], ids=["wheel", "source"])
def test_empty_environments(which: str, form: int, archives: tuple[Path, Path], tmp_path: Path) -> None:
    """Installed into nothing, it does what its parts allow, says in one line what is missing, and writes nothing beside its output."""
    if form == 1 and which != "core":
        pytest.skip("the source archive is installed once: it becomes the same wheel")
    version, extras, constraints = ENVIRONMENTS[which]
    python = tmp_path / "env" / "bin" / "python"
    subprocess.run([interpreter(version), "-m", "venv", str(tmp_path / "env")], check=True)
    wanted = [*constraints, f"{archives[form]}{extras}", *(lowest() if which == "lowest" else [])]
    subprocess.run([str(python), "-m", "pip", "install", "-q", *wanted], cwd=ROOT, check=True)
    photos, home = photographs(tmp_path), tmp_path / "home"
    home.mkdir()
    environment = {
        "PATH": os.environ["PATH"],
        "HOME": str(home),
        "http_proxy": "http://127.0.0.1:9",
        "https_proxy": "http://127.0.0.1:9",
    }

    def run(command: list[str], out: Path) -> subprocess.CompletedProcess[str]:
        words = [word.format(photos=photos, out=out) for word in command]
        return subprocess.run(
            [str(python), "-m", "degloss", *words], env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300
        )

    assert run(["--version"], tmp_path).stdout == "0.1.0\n"
    for n, command in enumerate(CAN.get(which, [MEASURE])):
        done = run(command, tmp_path / f"made-{n}")
        assert done.returncode == 0, done.stderr
        assert (tmp_path / f"made-{n}").is_dir()
    for command, part in LACKS.get(which, []):
        refused = run(command, tmp_path / "refused")
        assert (refused.returncode, refused.stdout) == (2, "")
        assert len(refused.stderr.splitlines()) == 1
        assert f"{part} is missing" in refused.stderr
        assert not (tmp_path / "refused").exists()
    assert not list(home.rglob("*")), "something was written into the user's home"


def test_compiled_solvers_run_where_nothing_can_be_written(unpacked: Path) -> None:
    """numba keeps compiled code on disk; where a file stands in the place of every folder that it would take, solvers still run."""
    (unpacked / "recon" / "normals" / "__pycache__").touch()
    assert (unpacked / "recon" / "normals" / "__pycache__").is_file()
    nowhere = dict.fromkeys(("NUMBA_CACHE_DIR", "HOME", "XDG_CACHE_HOME"), "/dev/null")
    environment = {**os.environ, **nowhere, "PYTHONPATH": str(unpacked), "PYTHONDONTWRITEBYTECODE": "1"}
    code = "from recon.normals.compiled import compiled\nprint(compiled(lambda x: x + 1)(1))"
    run = subprocess.run([sys.executable, "-c", code], env=environment, cwd=unpacked, capture_output=True, text=True)
    assert run.stdout.split() == ["2"], run.stderr


@pytest.mark.render
@pytest.mark.parametrize("command", [["doctor"], ["gen", "render", "small-sphere", "-o", "made"]], ids=["doctor", "render"])
def test_blender_leaves_nothing_in_the_home(command: list[str], tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    kept = {key: value for key, value in os.environ.items() if not key.startswith("XDG_")}
    environment = {**kept, "HOME": str(tmp_path / "home"), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", "degloss", *command], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "4.5" in done.stdout or (tmp_path / "made").is_dir()
    assert not list((tmp_path / "home").iterdir())
