"""Where a release comes from: the spec and its hash, the program that rendered and the one that released, and their surroundings."""

from __future__ import annotations

import hashlib
import platform
from functools import lru_cache
from pathlib import Path
from typing import Any

from gen.files import sha256_of
from gen.parts import installed_version
from gen.release.about import About
from gen.release.facts import Facts
from gen.release.layout import FORMAT, PLAN, VERSION
from gen.sets.set_folder import SetFolder

ROOT = Path(__file__).resolve().parents[2]
CONSTRAINTS = "constraints.txt"
PACKAGES = ("numpy", "OpenEXR", "opencv-python-headless", "Pillow", "pyarrow", "pydantic", "ruamel.yaml")
"""What writes bytes of a release, or decides them."""


def provenance_of(folder: SetFolder, about: About, facts: Facts, sources: dict[str, str]) -> dict[str, Any]:
    """The content of provenance.json. sources: SHA-256 of the files of the rendered set that it is made of, by their names there."""
    said = folder.about()
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "name": about.name,
        "version": about.version,
        "set": {
            "name": said["name"],
            "seed": said["seed"],
            "spec_sha256": said["set_sha256"],
            "plan": PLAN,
            "plan_sha256": said["plan_sha256"],
            "items": said["items"],
            "named_files": facts.named_files,
            "files_sha256": sources,
        },
        "rendered": [
            {"blender": blender, "cycles": blender, "device": device, "degloss": program, "items": count}
            for (blender, device, program), count in facts.renderers.items()
        ],
        "released": {
            "degloss": installed_version("degloss"),
            "code_sha256": code_sha256(),
            "constraints_sha256": constraints_sha256(),
            "python": platform.python_version(),
            "packages": {name: installed_version(name) for name in PACKAGES},
        },
        "again": f"degloss gen render {PLAN} -o SET",
    }


@lru_cache(maxsize=1)
def code_sha256() -> str:
    """SHA-256 over the names and contents of the Python files of blender_scenes and gen: which code it is, also between versions."""
    digest = hashlib.sha256()
    for package in ("blender_scenes", "gen"):
        for path in sorted((ROOT / package).rglob("*.py")):
            data = path.read_bytes()
            digest.update(f"{path.relative_to(ROOT).as_posix()}\0{len(data)}\0".encode() + data)
    return digest.hexdigest()


def constraints_sha256() -> str | None:
    """SHA-256 of the file that pins the packages' versions; None where the program was installed without it."""
    path = ROOT / CONSTRAINTS
    return sha256_of(path) if path.is_file() else None
