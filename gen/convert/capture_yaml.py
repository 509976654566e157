"""capture.yaml beside converted pictures, by which our reader of photographs (`gen.photos`) reads them back."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from gen.capture import Capture, Scale
from gen.capture_lights import NEAR
from gen.convert.about import distance_left_out, lights_left_out
from gen.files import writing
from gen.photos.spec import NAME, PhotoSpec
from gen.strict_yaml import first_complaint


def write_capture_yaml(
    capture: Capture, folder: Path, files: Sequence[str], comments: Sequence[str], white: float = 1.0
) -> tuple[str, ...]:
    """Write mask.png's name, pictures, lights, intensities and scale into capture.yaml; returns what of these it cannot say.

    files: the pictures, one a light. comments: lines to begin with. white: the radiance that the files' 1 stands for, by which the
    intensities are divided. Raises InputError where something is out of the range that is read.
    """
    places = capture.positions is not None and set(capture.light_kinds) <= set(NEAR)
    lights = {"positions_mm": capture.positions} if places else {"directions": capture.lights}
    scale, lost = _scale(capture.scale)
    said: dict[str, Any] = {
        "images": list(files),
        "lights": {key: np.asarray(rows).tolist() for key, rows in lights.items()},
        "intensities": (capture.intensities / white).tolist(),
        "colour": "linear",
        "mask": "mask.png",
        **scale,
    }
    try:
        PhotoSpec.model_validate(said)
    except ValidationError as error:
        raise first_complaint(error, said, f"{capture.source}: cannot be said in {NAME}", {}, {}) from None
    text = "".join(f"# {line}\n" for line in comments) + "".join(f"{key}:{_block(value)}\n" for key, value in said.items())
    with writing(folder / NAME) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return (*lights_left_out(capture, places), *lost)


def _scale(scale: Scale) -> tuple[dict[str, Any], Iterable[str]]:
    """(the keys that say the scale, what they cannot say)."""
    if scale.camera is None:
        return ({} if scale.mm_per_pixel is None else {"mm_per_pixel": scale.mm_per_pixel}), distance_left_out(scale)
    (fx, _, cx), (_, fy, cy), _ = scale.camera.tolist()
    if not np.array_equal(scale.camera, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]):
        return {}, ("the camera's K, which has a skew", *distance_left_out(scale))
    camera: dict[str, Any] = {"K": scale.camera.tolist()}
    if scale.distance_mm is not None:
        camera["distance_mm"] = scale.distance_mm
    return {"camera": camera}, ()


def _block(value: Any, indent: str = "  ") -> str:
    """A value as YAML that people read: lists a line an entry, everything inside these as JSON, which is YAML too."""
    if isinstance(value, dict):
        return "".join(f"\n{indent}{key}:{_block(part, indent + '  ')}" for key, part in value.items())
    if isinstance(value, list):
        return "".join(f"\n{indent}- {json.dumps(part)}" for part in value)
    return f" {json.dumps(value)}"
