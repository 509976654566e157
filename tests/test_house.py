"""The order of the house: which package may import which, and that importing and asking for help stay cheap."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ALLOWED = {
    "blender_scenes": {"blender_scenes"},
    "gen": {"gen", "blender_scenes.shapes"},
    "recon": {"recon", "gen"},
    "learn": {"learn", "recon", "gen"},
}
OURS = {*ALLOWED, "degloss", "tests"}
HEAVY = {
    "bpy",
    "torch",
    "matplotlib",
    "cv2",
    "OpenEXR",
    "trimesh",
    "scipy",
    "skimage",
    "pyamg",
    "jinja2",
    "pydantic",
    "ray",
    "pyarrow",
    "safetensors",
    "lightning_fabric",
    "tensorboard",
    "onnx",
    "onnxruntime",
}
INNER_WALL = ["gen/capture.py", "gen/exr.py", "gen/substrate.py", "gen/images.py", "gen/files.py", "gen/errors.py"]


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imported(path: Path) -> Iterator[str]:
    """Full names of what a module imports anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            module = str(node.module)
            yield from (f"{module}.{alias.name}" for alias in node.names) if module == "blender_scenes" else (module,)


@pytest.mark.parametrize("package", ALLOWED)
def test_imports_run_one_way(package: str) -> None:
    assert modules(package)
    for path in modules(package):
        for name in imported(path):
            if name.split(".")[0] in OURS:
                assert any(name == a or name.startswith(a + ".") for a in ALLOWED[package]), f"{path} imports {name}"


def test_only_the_studio_imports_blender() -> None:
    for package in set(ALLOWED) - {"blender_scenes"}:
        for path in modules(package):
            assert not {"bpy", "mathutils"} & {name.split(".")[0] for name in imported(path)}, path


def test_studio_needs_numpy_and_the_standard_library_alone() -> None:
    allowed = {"bpy", "mathutils", "cycles", "_cycles", "numpy", "blender_scenes", *sys.stdlib_module_names}
    for path in modules("blender_scenes"):
        extra = {name.split(".")[0] for name in imported(path)} - allowed
        if "shapes" in path.parts:
            extra |= {name.split(".")[0] for name in imported(path)} & {"bpy", "mathutils"}
        assert not extra, f"{path} imports {extra}"


def test_inner_wall_of_gen() -> None:
    for path in [*(ROOT / name for name in INNER_WALL), *modules("gen/formats")]:
        banned = {"gen.spec", "gen.farm", "gen.sets", "gen.render", "gen.release", "gen.cli"} & set(imported(path))
        assert not banned, f"{path} imports {banned}"


@pytest.mark.parametrize(
    "package",
    [
        *ALLOWED,
        "degloss",
        "gen.cli",
        "recon.cli",
        "learn.cli",
        "recon.pipeline",
        "recon.registry",
        "gen.capture",
        "learn.removers",
    ],
)
def test_importing_is_cheap(package: str) -> None:
    """A package imports nothing heavy: asked of a fresh interpreter."""
    code = f"import sys, {package}; print(*sorted(m for m in sys.modules if m in {HEAVY!r}))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert run.stdout.split() == []


def test_system_libraries_are_named_alike_everywhere() -> None:
    """The apt line of the doctor, of the studio's own error and of the README."""
    from gen.parts import SYSTEM_LIBRARIES

    for name in ("blender_scenes/studio.py", "README.md"):
        text = " ".join((ROOT / name).read_text(encoding="utf-8").replace('"', " ").split())
        assert SYSTEM_LIBRARIES in text, name


def test_no_module_outgrows_its_room() -> None:
    for package in ALLOWED:
        for path in modules(package):
            assert len(path.read_text(encoding="utf-8").splitlines()) <= 400, path
