"""The parts that are not always there (Blender, torch, report packages, a browser, reference data): how to tell, and the remedy.

One table serves `degloss doctor` and every place that needs a part, so both say the same line.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from gen.errors import MissingPart

SYSTEM_LIBRARIES = "libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libice6 libxext6 libgl1"
"""Debian packages that the bpy module loads and a bare container lacks."""

BLENDERS_PLACES = ("TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME")
"""Environment variables of the folders in which Blender leaves files of its own when it starts."""

APT_LINE = f"apt-get install -y {SYSTEM_LIBRARIES}"


@dataclass(frozen=True)
class Finding:
    """What a check found. state: "ok", "missing", or "none" (does not apply here). detail: version, path or reason."""

    state: str
    detail: str


@dataclass(frozen=True)
class PartOf:
    """A part. purpose: what does not work without it. remedy: the command that brings it. look: how to tell whether it is there.

    needed: whether its absence is a fault (else it only narrows what can be done).
    """

    name: str
    purpose: str
    remedy: str
    look: Callable[[], Finding]
    needed: bool = True

    @property
    def line(self) -> str:
        """The one line that says what is missing and what to do."""
        return f"{self.name} is missing ({self.purpose}): {self.remedy}"


def require(name: str, reason: str = "") -> None:
    """Raise MissingPart with the part's remedy unless it can be found (without importing it). reason: what failed, if known."""
    part = PARTS[name]
    modules = MODULES.get(name, ())
    absent = [module for module in modules if find_spec(module) is None]
    if absent or reason:
        raise MissingPart(part.line + (f" [{reason}]" if reason else ""))


def import_whole(module: str) -> None:
    """Import a large module with signals held back until it is done.

    A KeyboardInterrupt in the middle of torch's import may be swallowed, printed as a traceback, or leave half a module behind. The signal
    is not lost: it is delivered when the import ends, within a second or two.
    """
    held = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, held)
    try:
        import_module(module)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def installed_version(package: str) -> str | None:
    """The version of an installed package; None where it is not installed, or not by a package."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _modules(*names: str) -> Callable[[], Finding]:
    def look() -> Finding:
        found = []
        for name in names:
            if find_spec(name) is None:
                return Finding("missing", f"no package {name}")
            found.append(f"{name} {installed_version(name) or ''}".rstrip())
        return Finding("ok", ", ".join(found))

    return look


def _bpy() -> Finding:
    if find_spec("bpy") is None:
        return Finding("missing", "no package bpy")
    code = "import bpy; print('bpy', bpy.app.version_string)"
    with tempfile.TemporaryDirectory(prefix="degloss-", ignore_cleanup_errors=True) as scratch:
        environment = os.environ | dict.fromkeys(BLENDERS_PLACES, scratch)
        run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, env=environment)
    if run.returncode == 0:
        return Finding("ok", (run.stdout.strip().splitlines() or ["bpy"])[-1])
    return Finding("missing", (run.stderr.strip().splitlines() or ["import bpy fails"])[-1])


def _libraries() -> Finding:
    """Whether the dynamic loader finds every library that the bpy module names."""
    spec = find_spec("bpy")
    if spec is None or spec.origin is None:
        return Finding("none", "asked for by bpy, which is not installed")
    module = Path(spec.origin).parent / "__init__.so"
    tool = shutil.which("ldd")
    if not module.is_file() or tool is None:
        return Finding("none", "cannot be told on this system")
    text = subprocess.run([tool, str(module)], capture_output=True, text=True, timeout=60).stdout
    absent = sorted({line.split()[0] for line in text.splitlines() if "not found" in line})
    return Finding("missing", ", ".join(absent)) if absent else Finding("ok", "all found by the loader")


def _blender() -> Finding:
    path = shutil.which("blender")
    return Finding("ok", path) if path else Finding("none", "no blender on the path; the bpy module serves instead")


def _gpu() -> Finding:
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return Finding("none", "no NVIDIA driver; everything runs on the CPU")
    try:
        run = subprocess.run([tool, "--query-gpu=name", "--format=csv,noheader"], capture_output=True, text=True, timeout=20)
    except (OSError, subprocess.TimeoutExpired):
        return Finding("none", "the driver does not answer; everything runs on the CPU")
    names = run.stdout.strip().splitlines() if run.returncode == 0 else []
    return Finding("ok", ", ".join(names)) if names else Finding("none", "no GPU answers; everything runs on the CPU")


def chromium() -> str | None:
    """The path of a Chromium or Chrome, or None."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


def _chromium() -> Finding:
    path = chromium()
    return Finding("ok", path) if path else Finding("missing", "no chromium on the path")


def data_folder() -> Path:
    """Where the tests look for reference photographs: DEGLOSS_DATA, by default ../shared/data beside the repository."""
    return Path(os.environ.get("DEGLOSS_DATA", Path(__file__).resolve().parent.parent.parent / "shared" / "data"))


def _data() -> Finding:
    folder = data_folder()
    sets = sorted(p.name for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []
    return Finding("ok", f"{folder}: {', '.join(sets)}") if sets else Finding("missing", f"nothing at {folder}")


MODULES: dict[str, tuple[str, ...]] = {
    "bpy": ("bpy",),
    "torch": ("torch", "safetensors"),
    "training": ("torch", "safetensors", "lightning_fabric"),
    "export": ("onnx", "onnxruntime"),
    "report": ("jinja2",),
    "playwright": ("playwright",),
    "ray": ("ray",),
    "release": ("pyarrow",),
}
PARTS: dict[str, PartOf] = {
    part.name: part
    for part in (
        PartOf("bpy", "rendering: degloss gen render, degloss demo", "pip install bpy==4.5.15 (Python 3.11)", _bpy),
        PartOf("system libraries", "Blender does not load without them", APT_LINE, _libraries),
        PartOf(
            "blender",
            "an installed Blender in place of the bpy module: --blender PATH",
            "optional: install Blender 4.5 LTS, 5.0 or 5.2 LTS",
            _blender,
            False,
        ),
        PartOf("GPU", "faster rendering and training", "optional: an NVIDIA GPU with its driver", _gpu, False),
        PartOf(
            "torch",
            "the learned gloss removers, degloss learn",
            "pip install torch==2.13.0 safetensors",
            _modules("torch", "safetensors"),
            False,
        ),
        PartOf(
            "training",
            "degloss learn train",
            "pip install torch==2.13.0 safetensors lightning-fabric",
            _modules("torch", "safetensors", "lightning_fabric"),
            False,
        ),
        PartOf(
            "export", "degloss learn export --format onnx", "pip install onnx onnxruntime", _modules("onnx", "onnxruntime"), False
        ),
        PartOf(
            "report",
            "report.html",
            "pip install jinja2",
            _modules(
                "jinja2",
            ),
        ),
        PartOf("release", "degloss gen release, and checking one", "pip install 'pyarrow<26'", _modules("pyarrow"), False),
        PartOf("ray", "rendering a set on a cluster: --engine ray", "pip install 'ray>=2.40'", _modules("ray"), False),
        PartOf("chromium", "the report's tests in a browser", "apt-get install -y chromium", _chromium, False),
        PartOf("playwright", "the report's tests in a browser", "pip install playwright", _modules("playwright"), False),
        PartOf(
            "reference data",
            "the tests on real photographs",
            "set DEGLOSS_DATA to the folder that holds diligent/, uw_psm/, ...",
            _data,
            False,
        ),
    )
}
