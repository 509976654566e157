"""Materials by kind. To add one: a module with a frozen dataclass of `base.Material` and `parse(entries)`, and a line in `MATERIALS`."""

from __future__ import annotations

from importlib import import_module

from blender_scenes.entries import Entries
from blender_scenes.errors import JobError
from blender_scenes.materials.base import Material, Placed, Stand

MATERIALS = {
    "approximate-substrate": "blender_scenes.materials.approximate_substrate",
    "blinn-phong": "blender_scenes.materials.blinn_phong",
    "blinn-phong-lobe": "blender_scenes.materials.blinn_phong",
    "lambertian": "blender_scenes.materials.lambertian",
    "metal": "blender_scenes.materials.metal",
    "mirror": "blender_scenes.materials.mirror",
    "oren-nayar": "blender_scenes.materials.oren_nayar",
    "principled": "blender_scenes.materials.principled",
    "substrate": "blender_scenes.materials.substrate",
    "two-lobe": "blender_scenes.materials.two_lobe",
}
"""Kind of each material and the module that holds its class and `parse`."""

__all__ = ["MATERIALS", "Material", "Placed", "Stand", "parse"]


def parse(entries: Entries) -> Material:
    """The material of a job's entry. Raises JobError, one line, where its kind is unknown or a value is out of range."""
    kind = entries.text("kind")
    if kind not in MATERIALS:
        raise JobError(f"job: material.kind {kind!r} is unknown; there are {', '.join(MATERIALS)}")
    material: Material = import_module(MATERIALS[kind]).parse(entries)
    entries.close()
    return material
