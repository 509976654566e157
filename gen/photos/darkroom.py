"""From the files that capture.yaml names to linear pictures: dark, ambient and flat frames prepared once, then light by light."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen import large
from gen.capture import Bools, Floats, Scale, grey
from gen.errors import InputError
from gen.files import memory
from gen.formats.tables import mask_or_frame
from gen.images import Frames as Stack
from gen.images import Picture, read_mask, require_alike
from gen.photos.brackets import exposure_slope, merge, shift_between
from gen.photos.develop import Colour, Development, Frames, flat_field
from gen.photos.listing import Taken, existing, named_files, photographs_of
from gen.photos.spec import GammaColour, PhotoSpec, Shot
from gen.photos.view import View


@dataclass(frozen=True, eq=False)
class Photographs:
    """The developed pictures of a folder, before anything is said of their lights.

    images: (K, H, W, 3) float32 linear; 1 is the sensor's full scale at the shortest exposure. faults: (K, H, W). mask: (H, W) bool.
    names: (K,). record: for the capture's provenance. development, colour, reference: what other pictures of the same camera need.
    """

    images: Floats
    faults: NDArray[np.uint8]
    mask: Bools
    names: tuple[str, ...]
    scale: Scale
    encoding: str
    record: dict[str, Any]
    development: Development
    colour: Colour
    reference: float | None

    @property
    def view(self) -> View:
        """The camera."""
        height, width = self.mask.shape
        return View((height, width), self.scale)


def develop_folder(folder: Path, spec: PhotoSpec, encoding: str | None = None) -> Photographs:
    """Read and develop the photographs that a spec names. encoding: "srgb" or "linear" in place of the spec's colour.

    Raises InputError where a file is missing, damaged, too large or contradicts another, or the pictures would not fit into memory.
    """
    groups = photographs_of(folder, spec.images, named_files(folder, spec))
    exposures = [one.exposure for group in groups for one in group if one.exposure is not None]
    reference = min(exposures) if exposures else None
    if encoding is not None or not isinstance(spec.colour, GammaColour):
        said = encoding if encoding is not None else spec.colour
        colour = Colour(said if isinstance(said, str) else None)
    else:
        colour = Colour(gamma=spec.colour.gamma)
    development = _development(folder, spec, colour, reference)
    stack, record = develop_stack(groups, development, colour, reference)
    size = (stack.faults.shape[1], stack.faults.shape[2])
    if spec.mask is not None:
        path = existing(folder, spec.mask, "mask")
        mask, origin = read_mask(path, size), path.name
    else:
        mask, origin = mask_or_frame(folder / "mask.png", stack)
    mask = development.mask(mask)
    if not mask.any():
        raise InputError(f"{folder}: nothing is left of the mask after undistorting; check camera.distortion")
    record["mask"] = origin
    done = {"dark": spec.dark, "ambient": spec.ambient, "flat": spec.flat}
    record["frames"] = {name: [shot.file for shot in shots] for name, shots in done.items() if shots}
    camera = None if spec.camera is None else spec.camera.matrix()
    if development.distortion is not None:
        record["undistorted"] = development.distortion.tolist()
    scale = Scale(spec.mm_per_pixel, camera, None if spec.camera is None else spec.camera.distance_mm)
    names = tuple(group[0].path.relative_to(folder).as_posix() for group in groups)
    return Photographs(stack.images, stack.faults, mask, names, scale, stack.encoding, record, development, colour, reference)


def develop_stack(
    groups: list[list[Taken]], development: Development, colour: Colour, reference: float | None
) -> tuple[Stack, dict[str, Any]]:
    """(the developed pictures, one a group; what was seen on the way).

    The record holds the encoding, and of brackets the slope of log value over log exposure (`exposure_slope`) and the largest shift in
    pixels between the exposures of one picture. Raises InputError as reading does.
    """
    images: Floats = np.empty(0, np.float32)
    faults = np.empty(0, np.uint8)
    slopes: list[float] = []
    shifts: list[float] = []
    first: Picture | None = None
    for k, group in enumerate(groups):
        values, flags, times = [], [], []
        for taken in group:
            picture = colour.read(taken.path)
            if first is None:
                first = picture
                height, width = picture.clipped.shape
                _require_memory(groups, height, width)
                images = large.empty((len(groups), height, width, 3), np.float32)
                faults = large.empty((len(groups), height, width), np.uint8)
            require_alike(picture, first, taken.path, groups[0][0].path)
            value, flag = development.without_dark(picture, taken.exposure, taken.path)
            values.append(value)
            flags.append(flag)
            times.append(1.0 if taken.exposure is None or reference is None else taken.exposure / reference)
        if len(group) == 1:
            radiance, flag = values[0] / np.float32(times[0]), flags[0]
        else:
            bracket, marks, t = np.stack(values), np.stack(flags), np.array(times)
            assert first is not None
            radiance, flag = merge(bracket, marks, t, first.bits, first.encoding)
            slope = exposure_slope(bracket, marks, t)
            slopes += [] if slope is None else [slope]
            shifts.append(_largest_shift(bracket, t))
        images[k], faults[k] = development.finish(radiance, flag, group[0].path)
        large.release(images)
    assert first is not None
    stack = Stack(images, faults, first.encoding, first.said or colour.gamma != 1, first.bits)
    record: dict[str, Any] = {"encoding": stack.reading, "bits": stack.bits}
    if any(len(group) > 1 for group in groups):
        record["brackets"] = {
            "exposures_s": sorted({one.exposure for group in groups for one in group if one.exposure is not None}),
            "slope": float(np.median(slopes)) if slopes else None,
            "largest_shift_px": max(shifts),
        }
    return stack, record


def _development(folder: Path, spec: PhotoSpec, colour: Colour, reference: float | None) -> Development:
    dark: dict[float | None, Frames] = {}
    if spec.dark:
        grouped: dict[float | None, list[Shot]] = defaultdict(list)
        for shot in spec.dark:
            grouped[shot.exposure_s].append(shot)
        for time, shots in grouped.items():
            paths = [existing(folder, shot.file, "dark") for shot in shots]
            dark[time] = Frames.of([colour.read(path) for path in paths], paths)
    bare = Development(dark)
    ambient = flat = None
    if spec.ambient:
        if reference is not None and any(shot.exposure_s is None for shot in spec.ambient):
            raise InputError(
                f"{folder}: ambient: the photographs have exposures, so the ambient frames need their exposure_s too"
            )
        ambient = _mean(folder, spec.ambient, "ambient", colour, bare, reference)
    if spec.flat:
        frame = _mean(folder, spec.flat, "flat", colour, bare, None)
        flat = flat_field(frame, existing(folder, spec.flat[0].file, "flat"))
    camera = spec.camera
    bent = camera is not None and camera.distortion is not None and any(camera.distortion)
    return Development(
        dark,
        ambient,
        flat,
        camera.matrix() if camera is not None else None,
        np.array(camera.distortion) if camera is not None and bent else None,
    )


def _mean(folder: Path, shots: tuple[Shot, ...], key: str, colour: Colour, bare: Development, reference: float | None) -> Floats:
    """The mean of some frames over the dark, per unit of the reference exposure where there is one."""
    total: Floats | None = None
    for shot in shots:
        path = existing(folder, shot.file, key)
        value, _ = bare.without_dark(colour.read(path), shot.exposure_s, path)
        if reference is not None and shot.exposure_s is not None:
            value = value * np.float32(reference / shot.exposure_s)
        if total is not None and total.shape != value.shape:
            raise InputError(f"{path}: is another size than {shots[0].file}; the frames of one kind must have one size")
        total = value if total is None else total + value
    assert total is not None
    mean: Floats = total / np.float32(len(shots))
    return mean


def _largest_shift(bracket: Floats, times: NDArray[np.float64]) -> float:
    """Pixels between neighbouring exposures, both brought to one brightness and cut where either is clipped."""
    order = np.argsort(times)
    found = 0.0
    for a, b in pairwise(order):
        ratio = np.float32(times[b] / times[a])
        one, two = (np.minimum(grey(part), 1.0) for part in (bracket[a] * ratio, bracket[b]))
        found = max(found, float(np.hypot(*shift_between(one, two))))
    return found


def _require_memory(groups: list[list[Taken]], height: int, width: int) -> None:
    # the result, and one bracket with the copies that merging it takes
    need = height * width * (13 * len(groups) + 40 * max(len(group) for group in groups))
    if need > memory():
        raise InputError(
            f"{groups[0][0].path.parent}: {len(groups)} pictures of {width}x{height} need {need / 1e9:.0f} GB of memory; crop them"
        )
