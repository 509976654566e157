"""The specs that ship with the program: one YAML file a preset in this folder."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent


def preset_names() -> list[str]:
    """Names of the shipped presets, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def preset_file(name: str) -> Path:
    """The YAML file of a preset."""
    return FOLDER / f"{name}.yaml"


def describe_presets() -> dict[str, str]:
    """The first comment line of each preset's file."""
    return {name: preset_file(name).read_text(encoding="utf-8").split("\n")[0].lstrip("# ") for name in preset_names()}
