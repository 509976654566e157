"""What a converted capture says of itself in text: conversion.json in every layout, and which parts of a Capture a layout leaves out."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gen.capture import Capture, Scale
from gen.capture_lights import NEAR, WITHOUT_DIRECTION
from gen.files import write_json
from gen.release.samples import without_paths

ABOUT = "conversion.json"

WORDS = {
    "normals": "true normals",
    "depth": "true depth",
    "albedo": "true albedo",
    "gloss": "gloss",
    "specular_albedo": "specular albedo",
    "diffuse": "diffuse layers",
    "specular": "specular layers",
    "matte": "matte layers",
    "ks0": "layers with Ks = 0",
    "mirror": "mirror layers",
    "shadow": "shadows",
}
"""The parts of a Truth in plain words."""


def write_about(capture: Capture, folder: Path, format: str, files: Sequence[str], white: float = 1.0) -> None:
    """Write conversion.json: of every picture its file, name and light; the scale; and what the capture says of itself.

    It keeps what the layout's own files have no place for, but no path of this machine. white: the radiance that the files' 1 stands
    for, by which the lights' intensities are divided, here as there.
    """
    frames: list[dict[str, Any]] = []
    for k, file in enumerate(files):
        frame = {"file": file, "name": capture.names[k], "direction": capture.lights[k]}
        frame |= {"intensity": capture.intensities[k] / white, "kind": capture.light_kinds[k]}
        if capture.positions is not None and np.isfinite(capture.positions[k]).all():
            frame["position_mm"] = capture.positions[k]
        frames.append(frame)
    height, width = capture.size
    scale = {name: getattr(capture.scale, name) for name in ("mm_per_pixel", "camera", "distance_mm")}
    about = {"format": format, "size": [width, height], "white": white, "frames": frames, "scale": scale}
    write_json(folder / ABOUT, without_paths({**about, "provenance": dict(capture.provenance)}))


def truth_left_out(capture: Capture, held: Collection[str]) -> Iterable[str]:
    """The parts of the capture's truth that are not among `held`, in plain words."""
    return (WORDS[name] for name in capture.truth.names() if name not in held)


def distance_left_out(scale: Scale) -> Iterable[str]:
    """What a layout that says a distance beside a K only does not say of a scale that it writes without one."""
    if scale.distance_mm is not None:
        yield "the camera's distance"


def lights_left_out(capture: Capture, places: bool = False) -> Iterable[str]:
    """What a list of directions does not say of the capture's lights. places: whether the list says where near ones stand."""
    kinds = set(capture.light_kinds)
    if kinds & set(NEAR) and not places:
        yield "that lights are near, and where they stand"
    elif "area" in kinds:
        yield "that near lights are discs"
    if kinds & set(WITHOUT_DIRECTION):
        yield "that light comes from many directions"
