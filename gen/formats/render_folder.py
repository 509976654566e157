"""Our own capture folder: everything that a Capture holds, in files that other programs read too, and bit for bit back.

    capture.json      what the files are: frames with light and intensity, scale, encoding, provenance
    frames/001.exr    R G B A, diffuse.RGB, specular.RGB, matte.RGB, ks0.RGB, mirror.RGB, shadow.V, faults.V; float32, what there is
    view.exr          normal.XYZ, depth.Z (metres), albedo.RGB, gloss.A, specular_albedo.RGB; what there is of them
    mask.png          white on the object

A frame says the kind of its light where that is not a sun, and position_mm of a near one (see `gen.capture.Capture`).
Where the pictures are the sum of their diffuse and specular parts, they are formed from the two on reading. The same
capture gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Floats, Scale, Truth
from gen.errors import InputError
from gen.exr import read_exr, stack, unstack, write_exr
from gen.files import dumps, inside, memory, read_json, writing_folder
from gen.images import read_mask, write_png

INDEX = "capture.json"
FORMAT = "degloss capture"
VERSION = 1
MAX_FRAMES = 10_000
UNITS = {
    "radiance": "linear, Rec.709 primaries",
    "frame": "camera: x right, y up, z to the viewer",
    "depth": "metres along -z from the camera",
    "direction": "unit vector to the light",
    "intensity": "radiance of a white Lambertian surface facing the light",
}
COLOUR_LAYERS = ("diffuse", "specular", "matte", "ks0", "mirror")
VIEW_LAYERS = {
    "normals": ("normal", "XYZ"),
    "depth": ("depth", "Z"),
    "albedo": ("albedo", "RGB"),
    "gloss": ("gloss", "A"),
    "specular_albedo": ("specular_albedo", "RGB"),
}


def is_render(folder: Path) -> bool:
    """Whether `folder` is a capture folder of ours."""
    return (folder / INDEX).is_file()


def write_render(capture: Capture, folder: Path, coverage: Floats | None = None, half: bool = False) -> None:
    """Write any capture as a folder of ours, which takes its place whole or not at all. See `write_files`."""
    with writing_folder(folder, "capture") as temporary:
        write_files(capture, temporary, coverage, half)


def write_files(capture: Capture, folder: Path, coverage: Floats | None = None, half: bool = False, crop: bool = False) -> None:
    """Write a capture's files into an existing folder.

    coverage: (H, W) share of each pixel that the object fills, for the pictures' alpha channel; the mask where not given.
    half: radiance is stored in half precision (at most 65504, three digits), all else as float32. crop: the files' data windows are the
    box that holds the object; see `gen.exr.write_exr`.
    Raises InputError where a layer has the wrong shape or the folder cannot be written.
    """
    truth, (H, W), K = capture.truth, capture.size, capture.count
    _check_shapes(capture)
    summed = (
        truth.diffuse is not None
        and truth.specular is not None
        and np.array_equal(capture.images, _sum(truth.diffuse, truth.specular))
    )
    alpha = np.asarray(capture.mask if coverage is None else coverage, np.float32)
    faulty = bool(capture.faults.any())
    (folder / "frames").mkdir()
    frames = []
    for k in range(K):
        channels: dict[str, NDArray[Any]] = {**unstack("", "RGB", capture.images[k]), "A": alpha}
        for name in COLOUR_LAYERS:
            layer = getattr(truth, name)
            if layer is not None:
                channels |= unstack(name, "RGB", layer[k])
        if truth.shadow is not None:
            channels["shadow.V"] = truth.shadow[k]
        if faulty:
            channels["faults.V"] = capture.faults[k]
        file = f"frames/{k + 1:03d}.exr"
        write_exr(folder / file, channels, half=tuple(channels) if half else (), crop=crop)
        frames.append({"name": capture.names[k], "file": file, **_light(capture, k)})
    view: dict[str, NDArray[Any]] = {}
    for name, (prefix, letters) in VIEW_LAYERS.items():
        layer = getattr(truth, name)
        if layer is not None:
            view |= unstack(prefix, letters, layer if layer.ndim == 3 else layer[..., None])
    if view:
        write_exr(folder / "view.exr", view, crop=crop)
    write_png(folder / "mask.png", np.where(capture.mask, 255, 0).astype(np.uint8))
    scale = capture.scale
    index = {
        "format": FORMAT,
        "version": VERSION,
        "units": UNITS,
        "size": [W, H],
        "frames": frames,
        "pictures": "diffuse + specular" if summed else "RGB",
        "faults": faulty,
        "mask": "mask.png",
        "view": "view.exr" if view else None,
        "scale": {"mm_per_pixel": scale.mm_per_pixel, "camera": scale.camera, "distance_mm": scale.distance_mm},
        "encoding": capture.encoding,
        "source": capture.source,
        "provenance": dict(capture.provenance),
    }
    (folder / INDEX).write_text(dumps(index, indent=1) + "\n", encoding="utf-8")


def read_render(folder: Path, encoding: str | None = None) -> Capture:
    """Read a capture folder of ours. Its `source` is the folder.

    encoding: may be left out or say "linear", which is all that such a folder holds.
    Raises InputError, one line, where a file is missing, damaged, of another size, or named outside the folder.
    """
    where = folder / INDEX
    if encoding == "srgb":
        raise InputError(f"{folder}: is a capture folder of ours, which is linear; leave the encoding out")
    index = read_json(where, "the index of a capture")
    if not isinstance(index, dict) or index.get("format") != FORMAT:
        raise InputError(f"{where}: is not the index of a capture folder of ours (format '{FORMAT}')")
    if index.get("version") != VERSION:
        raise InputError(
            f"{where}: has version {index.get('version')!r}, this program reads {VERSION}; use the one that wrote it"
        )
    listed = _get(index, "frames", list, where)
    if not 1 <= len(listed) <= MAX_FRAMES:
        raise InputError(f"{where}: frames must list 1 to {MAX_FRAMES} pictures, it lists {len(listed)}")
    faulty, summed = _get(index, "faults", bool, where), _get(index, "pictures", str, where) == "diffuse + specular"
    lights, intensities, kinds, positions, names, images, faults = [], [], [], [], [], [], []
    layers: dict[str, list[NDArray[Any]]] = {}
    size: tuple[int, ...] | None = None
    seen: set[Path] = set()
    for k, frame in enumerate(listed):
        at = f"{where}: frames[{k}]"
        if not isinstance(frame, dict):
            raise InputError(f"{at}: must be an object")
        lights.append(_numbers(frame, "direction", at))
        intensities.append(_numbers(frame, "intensity", at))
        kinds.append(_get(frame, "kind", str, at) if "kind" in frame else "sun")
        positions.append(_numbers(frame, "position_mm", at) if "position_mm" in frame else [np.nan] * 3)
        names.append(_get(frame, "name", str, at))
        path = inside(folder, _get(frame, "file", str, at))
        if path in seen:
            raise InputError(f"{at}: names {path.name} a second time; each picture is a file of its own")
        seen.add(path)
        channels = read_exr(path)
        if k == 0:
            _require_memory(len(listed), channels, where)
        found = next(iter(channels.values())).shape
        if size is None:
            size = found
        elif found != size:
            raise InputError(f"{path}: is {found[1]}x{found[0]} pixels, the first picture is {size[1]}x{size[0]}")
        parts: dict[str, NDArray[Any]] = {}
        for name in COLOUR_LAYERS:
            layer = stack(channels, name, "RGB")
            if layer is not None:
                parts[name] = layer
        if "shadow.V" in channels:
            parts["shadow"] = _flags(channels["shadow.V"], path)
        if layers and parts.keys() != layers.keys():
            raise InputError(f"{path}: has the layers {sorted(parts)}, the first picture has {sorted(layers)}")
        for name, part in parts.items():
            layers.setdefault(name, []).append(part)
        picture = _sum(parts["diffuse"], parts["specular"]) if summed and "specular" in parts and "diffuse" in parts else None
        picture = stack(channels, "", "RGB") if picture is None else picture
        if picture is None or (faulty and "faults.V" not in channels):
            raise InputError(f"{path}: lacks the channels {'R, G, B' if picture is None else 'faults.V'}")
        images.append(picture)
        faults.append(_flags(channels["faults.V"], path) if faulty else np.zeros(found, np.uint8))
    assert size is not None
    mask = read_mask(inside(folder, _get(index, "mask", str, where)), (size[0], size[1]))
    per_light = {name: np.stack(stacked) for name, stacked in layers.items()}
    return Capture(
        images=np.stack(images),
        lights=np.array(lights),
        intensities=np.array(intensities),
        mask=mask,
        faults=np.stack(faults),
        names=tuple(names),
        scale=_scale(_get(index, "scale", dict, where), where),
        truth=Truth(**per_light, **_view(folder, index, size)),
        encoding=_get(index, "encoding", str, where),
        source=str(folder),
        provenance=_get(index, "provenance", dict, where),
        light_kinds=tuple(kinds),
        positions=np.array(positions),
    )


def _light(capture: Capture, k: int) -> dict[str, Any]:
    """What the index says of a picture's light. A sun needs no more than direction and intensity."""
    light: dict[str, Any] = {"direction": capture.lights[k], "intensity": capture.intensities[k]}
    if capture.light_kinds[k] != "sun":
        light["kind"] = capture.light_kinds[k]
    if capture.positions is not None and np.isfinite(capture.positions[k]).all():
        light["position_mm"] = capture.positions[k]
    return light


def _view(folder: Path, index: Mapping[str, Any], size: tuple[int, ...]) -> dict[str, Any]:
    name = index.get("view")
    if name is None:
        return {}
    path = inside(folder, _get(index, "view", str, folder / INDEX))
    channels = read_exr(path)
    found = next(iter(channels.values())).shape
    if found != size:
        raise InputError(f"{path}: is {found[1]}x{found[0]} pixels, the pictures are {size[1]}x{size[0]}")
    layers = {key: stack(channels, *where) for key, where in VIEW_LAYERS.items()}
    return {key: layer[..., 0] if layer.shape[2] == 1 else layer for key, layer in layers.items() if layer is not None}


def _scale(given: Mapping[str, Any], where: Path) -> Scale:
    def number(key: str) -> float | None:
        value = given.get(key)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > 1e300):
            raise InputError(f"{where}: scale.{key} must be a number or null")
        return value

    camera = given.get("camera")
    try:
        K = None if camera is None else np.array(camera, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: scale.camera must be a 3x3 matrix or null") from None
    try:
        return Scale(mm_per_pixel=number("mm_per_pixel"), camera=K, distance_mm=number("distance_mm"))
    except InputError as error:
        raise InputError(f"{where}: {str(error).removeprefix(f'{where}: ')}") from None


def _require_memory(count: int, channels: Mapping[str, NDArray[Any]], where: Path) -> None:
    need = count * sum(channel.nbytes for channel in channels.values())
    if need > memory():
        raise InputError(f"{where}: its {count} pictures with their layers need {need / 1e9:.0f} GB of memory; render it smaller")


def _check_shapes(capture: Capture) -> None:
    """That every layer of the truth has the shape that its channels need (the Capture itself checks only what leads)."""
    truth, (H, W), K = capture.truth, capture.size, capture.count
    wanted: dict[str, tuple[int, ...]] = {
        name: (H, W, 3) if len(letters) == 3 else (H, W) for name, (_, letters) in VIEW_LAYERS.items()
    }
    wanted |= {"shadow": (K, H, W)}
    wanted |= dict.fromkeys(COLOUR_LAYERS, (K, H, W, 3))
    for name, shape in wanted.items():
        layer = getattr(truth, name)
        if layer is not None and layer.shape != shape:
            raise InputError(f"{capture.source}: truth '{name}' has the shape {layer.shape}, a capture folder stores {shape}")


def _sum(diffuse: NDArray[Any], specular: NDArray[Any]) -> Floats:
    total: Floats = np.asarray(diffuse, np.float32) + np.asarray(specular, np.float32)
    return total


def _flags(channel: NDArray[Any], path: Path) -> NDArray[np.uint8]:
    if not ((channel >= 0) & (channel <= 255) & (channel == np.floor(channel))).all():
        raise InputError(f"{path}: a channel of flags holds values that are not whole numbers from 0 to 255")
    return channel.astype(np.uint8)


def _get(table: Mapping[str, Any], key: str, kind: type, where: object) -> Any:
    value = table.get(key)
    if not isinstance(value, kind):
        plain = {"list": "a list", "dict": "an object", "str": "a text", "bool": "true or false"}[kind.__name__]
        raise InputError(f"{where}: {key} is missing or not {plain}")
    return value


def _numbers(table: Mapping[str, Any], key: str, where: str) -> list[float]:
    value = _get(table, key, list, where)
    if len(value) != 3 or any(isinstance(v, bool) or not isinstance(v, int | float) or abs(v) > 1e300 for v in value):
        raise InputError(f"{where}: {key} must be three numbers")
    return [float(v) for v in value]
