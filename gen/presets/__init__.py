"""The specs that ship with the program: one YAML file a preset in this folder, of one capture or of a set of captures."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from gen.errors import InputError

FOLDER = Path(__file__).parent

Kind = Literal["capture", "set"]


def preset_names(kind: Kind | None = None) -> list[str]:
    """Names of the shipped presets, sorted; those of one kind where it is named."""
    names = sorted(path.stem for path in FOLDER.glob("*.yaml"))
    return [name for name in names if kind is None or preset_kind(name) == kind]


def preset_file(name: str) -> Path:
    """The YAML file of a preset."""
    return FOLDER / f"{name}.yaml"


def preset_kind(name: str) -> Kind:
    """Whether a preset is the spec of one capture or of a set: a set's file has a line that starts with 'set:'."""
    return "set" if re.search(r"^set:", preset_file(name).read_text(encoding="utf-8"), re.MULTILINE) else "capture"


def describe_presets() -> dict[str, str]:
    """The first comment line of each preset's file."""
    return {name: preset_file(name).read_text(encoding="utf-8").split("\n")[0].lstrip("# ") for name in preset_names()}


def find_spec(path_or_preset: str | Path) -> Path:
    """The YAML file that a person means: a file's path, or the name of a preset. Raises InputError where it is neither."""
    path, name = Path(path_or_preset), str(path_or_preset)
    if path.exists() or path.name != name or path.suffix in (".yaml", ".yml"):
        return path
    if name not in preset_names():
        raise InputError(f"{name}: is neither a file nor a preset; the presets are {', '.join(preset_names())}")
    return preset_file(name)
