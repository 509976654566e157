"""Single pictures with their truth from a pack, for the methods that see one picture at a time: cropped, flipped, recoloured, in batches.

A batch is a pure function of the seed and its number. The pictures of a split stand in a new order every epoch, and batches are cut from
the endless row of epochs: all are full, and every epoch holds each picture once.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gen.errors import InputError
from gen.sets.pack import Pack, read_pack
from learn.method import check_options
from learn.models.blocks import as_recorded

OPTIONS: Mapping[str, Any] = {
    "pack": "",
    "train_split": "train",
    "validation_split": "validation",
    "validation_share": 0.05,
    "crop": 0,
    "flip": True,
    "zoom": 1.0,
    "recolour": False,
    "gain": 1.0,
    "device_cache_gb": 4.0,
}
"""The `data` table and its defaults; see `Pictures`."""

LIME_LAYERS = ("albedo", "specular_albedo", "gloss", "mirror")
"""What LIME's factors are made from, beside the layers that every pack of pictures has (`gen.lime`)."""

UNIFORM = 0.01
"""By how much reflectance or alpha may differ over an object that counts as one material; half precision alone is .001."""

ORDER, PLACE, COLOUR, GAIN = 0, 1, 2, 3
"""What a random stream is for: the order of an epoch, the crops and turns of a batch, its colours, its exposure."""


@dataclass(frozen=True)
class Window:
    """What is shown of a picture: rows, columns, resampled to size (h, w), then turned by quarters and mirrored."""

    rows: slice
    columns: slice
    size: tuple[int, int]
    turns: int
    mirrored: bool


@dataclass(frozen=True, eq=False)
class PictureBatch:
    """Pictures with their truth, linear radiance.

    image, diffuse, specular: (B, 3, H, W) float32. mask: (B, 1, H, W) bool.
    LIME's factors, None where they were not asked for: D, S, mirror (B, 3, H, W), 0 where undefined; m_d, m_s (B, 3); exponent (B,), 0
    where there is none.
    """

    image: Tensor
    diffuse: Tensor
    specular: Tensor
    mask: Tensor
    D: Tensor | None = None
    S: Tensor | None = None
    mirror: Tensor | None = None
    m_d: Tensor | None = None
    m_s: Tensor | None = None
    exponent: Tensor | None = None


class Pictures:
    """Batches of a pack's pictures: a `learn.method.Source`.

    data: see `OPTIONS`. pack: the file. train_split, validation_split: which items; where the pack has none of validation_split,
    validation_share of the training items is held out, chosen by their ids alone. crop: side of the square that is cut out so that it
    shows the object, all of it where it fits; 0 takes whole pictures. flip: random mirrorings and quarter turns (half turns where
    pictures are not square). zoom: whole pictures are enlarged by up to that factor, drawn evenly in its logarithm, about a place on the
    object. recolour: the channels are put in a random order, the same for all layers: hues that no picture has, of the same physics.
    gain: all layers of a picture are multiplied by a factor from 1 / gain to gain, drawn evenly in its logarithm: bright is then not
    glossy. Validation pictures are cropped about the object's middle, and left as they are. device_cache_gb: a pack whose
    layers are no larger is copied to a device other than the CPU once; otherwise its pixels come from the mapped file.

    split: "train" or "validation". factors: whether LIME's are wanted.
    The image is the pack's `combined`, and diffuse + specular where it has none. Raises InputError where an option or a layer is missing
    or wrong, a split is empty, or factors are wanted of an object with more than one material.
    """

    def __init__(
        self, data: Mapping[str, Any], batch: int, seed: int, device: torch.device, split: str, factors: bool = False
    ) -> None:
        options = check_options(data, OPTIONS, "data")
        pack = _open(options)
        self.pictures = batch
        self.device, self.seed, self.training = device, seed, split == "train"
        self.crop: int = options["crop"]
        self.flip: bool = options["flip"] and self.training
        self.zoom: float = options["zoom"] if self.training else 1.0
        self.gain: float = options["gain"] if self.training else 1.0
        self.recolour: bool = options["recolour"] and self.training
        self.items = _items(pack, options, self.training)
        self.frames = np.array([frame for item in self.items for frame in range(*pack.items[item]["frames"])])
        self.steps_per_epoch = math.ceil(len(self.frames) / batch)
        self.item_of, self.mask = pack["item"], pack["mask"]
        self.materials = _materials(pack, self.items) if factors else None
        names = ["diffuse", "specular", *(["combined"] if "combined" in pack.arrays else []), *(["mirror"] if factors else [])]
        self.layers = _on_device({name: pack[name] for name in names}, device, options["device_cache_gb"])

    def batch(self, step: int) -> PictureBatch:
        """Batch number `step`: (B, 3, H, W) on the source's device."""
        frames = self.frames[self._numbers(step)]
        rng = np.random.default_rng([self.seed, PLACE, step])
        windows = [self._window(self.mask[self.item_of[frame]], rng) for frame in frames]
        layers = {name: self._cut(array, frames, windows) for name, array in self.layers.items()}
        colours = self._colours(step)
        if colours is not None:
            wide = colours[:, :, None, None]
            layers = {name: layer.gather(1, wide.expand(-1, -1, *layer.shape[2:])) for name, layer in layers.items()}
        if self.gain > 1:
            drawn = np.random.default_rng([self.seed, GAIN, step]).uniform(-1, 1, (self.pictures, 1, 1, 1))
            factor = torch.from_numpy((self.gain**drawn).astype(np.float32)).to(self.device)
            layers = {name: layer * factor for name, layer in layers.items()}
        mask = self._cut(self.mask, self.item_of[frames], windows)[:, None].bool()
        image = layers["combined"] if "combined" in layers else layers["diffuse"] + layers["specular"]
        plain = PictureBatch(image, layers["diffuse"], layers["specular"], mask)
        return plain if self.materials is None else self._with_factors(plain, frames, layers["mirror"], colours)

    def _numbers(self, step: int) -> NDArray[np.int64]:
        """Which of the split's pictures batch `step` holds."""
        count = len(self.frames)
        places = step * self.pictures + np.arange(self.pictures)
        orders = {epoch: np.random.default_rng([self.seed, ORDER, epoch]).permutation(count) for epoch in set(places // count)}
        return np.array([orders[place // count][place % count] for place in places])

    def _window(self, mask: NDArray[np.bool_], rng: np.random.Generator) -> Window:
        """What is shown of one picture. mask: (h, w)."""
        rows, columns = (slice(0, side) for side in mask.shape)
        if self.crop:
            rows, columns = _around(mask, (self.crop, self.crop), rng if self.training else None)
        size = rows.stop - rows.start, columns.stop - columns.start
        if self.zoom > 1:
            factor = self.zoom ** rng.random()
            rows, columns = _around(mask, (round(size[0] / factor), round(size[1] / factor)), rng)
        if not self.flip:
            return Window(rows, columns, size, 0, False)
        turns = int(rng.integers(4))
        return Window(rows, columns, size, turns if size[0] == size[1] else turns // 2 * 2, bool(rng.integers(2)))

    def _colours(self, step: int) -> Tensor | None:
        """The order of each picture's channels (B, 3), or None where they stay."""
        if not self.recolour:
            return None
        rng = np.random.default_rng([self.seed, COLOUR, step])
        return torch.from_numpy(np.stack([rng.permutation(3) for _ in range(self.pictures)])).to(self.device)

    def _cut(self, array: Any, entries: NDArray[Any], windows: Sequence[Window]) -> Tensor:
        """Entries of an array (E, h, w[, 3]), each through its window, float32 (B[, 3], H, W) on the device."""
        library = torch if isinstance(array, Tensor) else np
        parts = []
        for entry, window in zip(entries, windows, strict=True):
            part = array[int(entry), window.rows, window.columns]
            if tuple(part.shape[:2]) != window.size:
                part = _resampled(part, window.size)
            part = library.rot90(part, window.turns, (0, 1)) if window.turns else part
            parts.append(library.flip(part, (1,)) if window.mirrored else part)
        stacked = library.stack(parts)
        tensor = stacked if isinstance(stacked, Tensor) else torch.from_numpy(stacked).to(self.device)
        tensor = tensor.float()
        return tensor.permute(0, 3, 1, 2).contiguous() if tensor.ndim == 4 else tensor

    def _with_factors(self, plain: PictureBatch, frames: NDArray[Any], mirror: Tensor, colours: Tensor | None) -> PictureBatch:
        assert self.materials is not None
        m = torch.from_numpy(self.materials[self.item_of[frames]]).to(self.device)
        m_d, m_s, exponent = m[:, :3], m[:, 3:6], m[:, 6]
        if colours is not None:
            m_d, m_s = m_d.gather(1, colours), m_s.gather(1, colours)
        return PictureBatch(
            plain.image,
            plain.diffuse,
            plain.specular,
            plain.mask,
            D=_over(plain.diffuse, m_d) * plain.mask,
            S=_over(plain.specular, m_s) * plain.mask,
            mirror=mirror,
            m_d=m_d,
            m_s=m_s,
            exponent=exponent,
        )


def sheet(columns: Sequence[Tensor], rows: int = 4) -> NDArray[np.uint8]:
    """A contact sheet (rows * H, columns * W, 3), sRGB: a picture of the batch a row, what belongs to it from left to right.

    columns: (B, 3, H, W) linear each, or (B, 1, H, W) for masks. rows: at most so many pictures.
    """
    line = torch.cat([column[:rows].detach().float().expand(-1, 3, -1, -1) for column in columns], dim=3)
    pixels = (as_recorded(torch.nan_to_num(line)) * 255).round().to(torch.uint8)
    B, _, H, W = pixels.shape
    return pixels.permute(0, 2, 3, 1).reshape(B * H, W, 3).cpu().numpy()


def _open(options: Mapping[str, Any]) -> Pack:
    if not options["pack"]:
        raise InputError("data: pack is missing; name the file that degloss gen pack wrote")
    if not 0 <= options["validation_share"] < 1:
        raise InputError(f"data: validation_share = {options['validation_share']} must be from 0 to less than 1")
    if not 1 <= options["zoom"] <= 4 or (options["crop"] and options["zoom"] > 1):
        raise InputError(f"data: zoom = {options['zoom']} must be from 1 to 4, and 1 where pictures are cropped")
    if not 1 <= options["gain"] <= 16:
        raise InputError(f"data: gain = {options['gain']} must be from 1 to 16")
    if options["device_cache_gb"] < 0:
        raise InputError(f"data: device_cache_gb = {options['device_cache_gb']} must not be negative")
    pack = read_pack(Path(options["pack"]))
    crop, side = options["crop"], min(pack.size)
    if crop != 0 and not 8 <= crop <= side:
        raise InputError(f"data: crop = {crop} must be 0 (whole pictures) or from 8 to the pack's {side} pixels")
    return pack


def _items(pack: Pack, options: Mapping[str, Any], training: bool) -> list[int]:
    """The items of the split that is asked for."""
    train, named = (pack.of_split(options[key]) for key in ("train_split", "validation_split"))
    if not named:
        held = round(options["validation_share"] * len(train))
        by_id = sorted(train, key=lambda item: hashlib.sha256(str(pack.items[item].get("id", item)).encode()).digest())
        train, named = sorted(by_id[held:]), sorted(by_id[:held])
    elif options["validation_split"] == options["train_split"]:
        raise InputError(f"data: train_split and validation_split are both {options['train_split']!r}")
    chosen, key = (train, "train_split") if training else (named, "validation_split")
    if not chosen:
        splits = ", ".join(sorted({str(item.get("split")) for item in pack.items}))
        raise InputError(f"{pack.path}: no item of {key} = {options[key]!r}; the pack's splits are {splits}")
    return chosen


def _on_device(arrays: Mapping[str, NDArray[Any]], device: torch.device, limit_gb: float) -> Mapping[str, Any]:
    """The arrays as tensors of the device where they fit; on the CPU the mapped file serves as well."""
    if device.type == "cpu" or sum(array.nbytes for array in arrays.values()) > limit_gb * 1e9:
        return arrays
    return {name: torch.from_numpy(np.array(array)).to(device) for name, array in arrays.items()}


def _materials(pack: Pack, items: Sequence[int]) -> NDArray[np.float32]:
    """m_d, m_s and the exponent of each of the pack's items (N, 7), 0 for those not asked for."""
    missing = [name for name in LIME_LAYERS if name not in pack.arrays]
    if missing:
        raise InputError(
            f"{pack.path}: lacks {', '.join(missing)}, from which LIME's factors are made; render with lime: true and pack with "
            f"--layers combined,diffuse,specular,{','.join(LIME_LAYERS)}"
        )
    found = np.zeros((len(pack.items), 7), np.float32)
    for item in items:
        inside = pack["mask"][item]
        layers = [np.asarray(pack[name][item][inside], np.float32) for name in ("albedo", "specular_albedo", "gloss")]
        values = np.concatenate([layer.reshape(len(layer), -1) for layer in layers], axis=1)
        if len(values) == 0 or np.ptp(values, axis=0).max() > UNIFORM:
            raise InputError(
                f"{pack.path}: item {pack.items[item].get('id', item)} has more than one material; LIME needs one a picture"
            )
        found[item] = values.mean(axis=0)
    alpha = found[:, 6].astype(np.float64)  # 2 / alpha^2 - 2 as in `gen.lime.exponent_of`
    defined = (alpha > 0) & (alpha < 1)
    found[:, 6] = np.where(defined, 2 / np.where(defined, alpha, 1) ** 2 - 2, 0)
    return found


def _over(layer: Tensor, divisor: Tensor) -> Tensor:
    """layer (B, 3, H, W) / divisor (B, 3), 0 in the channels where that is 0."""
    wide = divisor[:, :, None, None]
    return torch.where(wide > 0, layer / torch.where(wide > 0, wide, torch.ones_like(wide)), torch.zeros_like(layer))


def _resampled(part: Any, size: tuple[int, int]) -> Any:
    """Part of a layer (h, w[, 3]), resampled to a size: linearly, a mask by its nearest pixel."""
    given = part if isinstance(part, Tensor) else torch.from_numpy(np.array(part))
    wide = given.float()[None, None] if given.ndim == 2 else given.float().permute(2, 0, 1)[None]
    mode = {"mode": "nearest-exact"} if given.dtype == torch.bool else {"mode": "bilinear", "align_corners": False}
    enlarged = torch.nn.functional.interpolate(wide, size=size, **mode)
    found = (enlarged[0, 0] if given.ndim == 2 else enlarged[0].permute(1, 2, 0)).to(given.dtype)
    return found if isinstance(part, Tensor) else found.numpy()


def _around(mask: NDArray[np.bool_], size: tuple[int, int], rng: np.random.Generator | None) -> tuple[slice, slice]:
    """A window of `size` pixels that shows the object of a mask (h, w), drawn by rng or, without one, about its middle.

    Along each axis it holds the whole object where that fits, and otherwise lies within its extent; a pixel of the object is always in it.
    """
    places = np.argwhere(mask)
    if len(places) == 0:
        places = np.argwhere(np.ones_like(mask))
    low, high = places.min(axis=0), places.max(axis=0)
    middle = places[np.abs(places - (low + high) / 2).sum(axis=1).argmin()]
    shown = middle if rng is None else places[rng.integers(len(places))]
    windows = []
    for first, last, pixel, length, side in zip(low, high, shown, mask.shape, size, strict=True):
        inner, outer = sorted((first, last + 1 - side))
        least = max(0, inner, pixel + 1 - side)
        most = min(length - side, outer, pixel)
        start = int((least + most) // 2 if rng is None else rng.integers(least, most + 1))
        windows.append(slice(start, start + side))
    return windows[0], windows[1]
