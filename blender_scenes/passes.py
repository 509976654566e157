"""Rendering, and the raw passes as arrays. Two routes to the same bits: straight from memory, or through a file.

Blender gives a script no public way to a headless render's passes but a file. The fast route wraps the engine's own render method and
copies the passes while the result is at hand; should a version of Blender lack that, the slow route writes an uncompressed
32-bit multilayer EXR and reads it back.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blender_scenes.multilayer import read_multilayer
from blender_scenes.studio import blender

Floats = NDArray[np.float32]

CHANNELS = {
    "Combined": "RGBA",
    "Depth": "Z",
    "Normal": "XYZ",
    "DiffDir": "RGB",
    "DiffCol": "RGB",
    "GlossDir": "RGB",
    "GlossCol": "RGB",
}
"""The passes that are always fetched, by Blender's short names, and their channels in order."""

INDIRECT = {"DiffInd": "RGB", "GlossInd": "RGB"}
"""Those that are fetched beside them where light passes from surface to surface."""

LONG = {
    "Diffuse Direct": "DiffDir",
    "Diffuse Indirect": "DiffInd",
    "Diffuse Color": "DiffCol",
    "Glossy Direct": "GlossDir",
    "Glossy Indirect": "GlossInd",
    "Glossy Color": "GlossCol",
    "Z": "Depth",
}
"""The names that Blender 5 gives to some passes."""

ROUTES = ("auto", "memory", "exr")


def switch_on(scene: Any, outputs: Mapping[str, str], indirect: bool = False) -> dict[str, str]:
    """Switch on the passes of the next render and return them with their channels.

    outputs: those that the material writes itself, name and channels. indirect: whether light passes from surface to surface.
    """
    layer = scene.view_layers[0]
    for name in ("z", "normal", "diffuse_direct", "diffuse_color", "glossy_direct", "glossy_color"):
        setattr(layer, f"use_pass_{name}", True)
    layer.use_pass_diffuse_indirect = layer.use_pass_glossy_indirect = indirect
    for there in [aov for aov in layer.aovs if aov.name not in outputs]:
        layer.aovs.remove(there)
    for name, letters in outputs.items():
        aov = layer.aovs[name] if name in layer.aovs else layer.aovs.add()
        # The same name may stand for a number in one material and a colour in the next.
        aov.name, aov.type = name, "COLOR" if len(letters) > 1 else "VALUE"
    return CHANNELS | (INDIRECT if indirect else {}) | dict(outputs)


def render(scene: Any, route: str = "auto", channels: Mapping[str, str] = CHANNELS) -> tuple[dict[str, Floats], str]:
    """Render the scene. Returns its passes (H, W, channels), rows top to bottom, and the route taken ("memory" or "exr").

    route: "memory" or "exr" to insist on one, "auto" for memory with the file as fallback. channels: the passes wanted, of
    `switch_on`. Raises RuntimeError where Blender gave no passes by the route asked for.
    """
    if route in ("auto", "memory"):
        passes = _from_memory(channels)
        if passes is not None:
            return passes, "memory"
        if route == "memory":
            raise RuntimeError("this Blender hands out no passes from memory; use the route exr")
    return _from_file(scene, channels), "exr"


def _from_memory(channels: Mapping[str, str]) -> dict[str, Floats] | None:
    """Render and copy the passes out of the engine's result, or None where that is not possible."""
    bpy = blender()
    try:
        from cycles import CyclesRender
    except ImportError:
        return None
    kept: list[dict[str, Floats]] = []
    original = CyclesRender.render

    # Blender counts the parameters of the function and passes as many: no *arguments here.
    def tapped(self: Any, depsgraph: Any) -> None:
        original(self, depsgraph)
        try:
            result = self.get_result()
            kept.append(_copy(result))
        except (AttributeError, RuntimeError, TypeError, ValueError):
            kept.clear()

    CyclesRender.render = tapped
    try:
        bpy.ops.render.render()
    finally:
        CyclesRender.render = original
    return _complete(kept[-1], channels) if kept else None


def _copy(result: Any) -> dict[str, Floats]:
    width, height = result.resolution_x, result.resolution_y
    passes: dict[str, Floats] = {}
    for item in result.layers[0].passes:
        buffer = np.empty(width * height * item.channels, np.float32)
        item.rect.foreach_get(buffer)
        # Blender's rows run from bottom to top.
        passes[item.name] = buffer.reshape(height, width, item.channels)[::-1]
    return passes


def _complete(passes: dict[str, Floats], channels: Mapping[str, str]) -> dict[str, Floats] | None:
    renamed = {LONG.get(name, name): array for name, array in passes.items()}
    if any(name not in renamed for name in channels):
        return None
    # A colour output of a shader comes with a fourth channel.
    return {name: renamed[name][..., : len(letters)] for name, letters in channels.items()}


def _from_file(scene: Any, channels: Mapping[str, str]) -> dict[str, Floats]:
    bpy = blender()
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_mode = "RGBA"
    settings.color_depth = "32"
    settings.exr_codec = "NONE"
    if hasattr(settings, "use_exr_interleave"):
        # Blender 5 would write a part for each pass, which fails where pixels are not square: only the first part gets their aspect.
        settings.use_exr_interleave = True
    with tempfile.TemporaryDirectory(prefix="blender_scenes.") as folder:
        path = Path(folder) / "passes.exr"
        scene.render.filepath = str(path)
        scene.render.use_file_extension = False
        bpy.ops.render.render(write_still=True)
        if not path.is_file():
            raise RuntimeError("Blender rendered but wrote no file")
        found = read_multilayer(path)
    by_pass: dict[str, dict[str, Floats]] = {}
    for name, array in found.items():
        parts = name.split(".")
        if len(parts) >= 2:
            by_pass.setdefault(parts[-2], {})[parts[-1]] = array
    stacked = {}
    for name, letters in by_pass.items():
        order = channels.get(LONG.get(name, name), "")
        if order and all(letter in letters for letter in order):
            stacked[name] = np.stack([letters[letter] for letter in order], axis=-1)
    passes = _complete(stacked, channels)
    if passes is None:
        raise RuntimeError(f"Blender's file lacks some of the passes {', '.join(channels)}; it has {', '.join(by_pass)}")
    return passes
