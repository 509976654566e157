"""A contact sheet: what a set, or one capture, looks like, layer beside layer, for a person's eye."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, read_capture
from gen.errors import InputError
from gen.files import real
from gen.sets.screening import SCREENING, screening_of
from gen.sets.set_folder import RENDERED, SetFolder, is_set_folder
from gen.srgb import linear_to_srgb

Picture = NDArray[np.uint8]
Progress = Callable[[int, int], None]

LAYERS = ("picture", "diffuse", "specular", "matte", "normals")
WIDTH = 2400
"""The widest sheet in pixels."""

GAP, MARGIN, CAPTION, HEAD = 6, 28, 22, 34
PAPER, INK, FAINT, WARN = (250, 250, 248), (38, 40, 44), (128, 130, 136), (176, 58, 38)
OUTSIDE = (226, 226, 222)
"""Where there is no surface, in the pictures of normals."""

MAX_COUNT = 400


@dataclass(frozen=True, eq=False)
class Entry:
    """One line of the sheet. tiles: (H, W, 3) sRGB pictures in the order of `LAYERS`, None where there is none."""

    title: str
    note: str
    tiles: tuple[Picture | None, ...]
    warn: bool = False


def contact_sheet(path: Path, count: int = 24, seed: int = 0, progress: Progress | None = None) -> Picture:
    """(H, W, 3) uint8: a line of tiles an item of a set, or a picture of a capture.

    count: the most lines; where there are more, which ones is drawn by the seed. Raises InputError where nothing is rendered or
    what is rendered cannot be read.
    """
    if not 1 <= count <= MAX_COUNT:
        raise InputError(f"--count {count}: must be from 1 to {MAX_COUNT}")
    if seed < 0:
        raise InputError(f"--seed {seed}: must be at least 0")
    rng = np.random.default_rng(seed)
    entries = _of_set(SetFolder(path), count, rng, progress) if is_set_folder(path) else _of_capture(path, count, rng)
    return _sheet(list(entries))


def _of_set(folder: SetFolder, count: int, rng: np.random.Generator, progress: Progress | None) -> Iterator[Entry]:
    total = sum(row["status"] == RENDERED for row in folder.each_row())
    if not total:
        raise InputError(f"{folder.path}: nothing is rendered yet")
    screened = (folder.path / SCREENING).exists()
    out = {verdict.id: verdict.reason for verdict in screening_of(folder) if not verdict.kept} if screened else {}
    drawn = set(_some(total, count, rng))
    rendered = (row for row in folder.each_row() if row["status"] == RENDERED)
    chosen = [row for i, row in enumerate(rendered) if i in drawn]
    for n, row in enumerate(chosen):
        capture = folder.capture(row["id"])
        k = brightest(capture)
        words = [row["shape"], _gloss(capture), f"picture {k + 1} of {capture.count}" if capture.count > 1 else ""]
        reason = out.get(row["id"])
        words.append(f"left out: {reason}" if reason else "")
        yield Entry(row["id"], ", ".join(word for word in words if word), _tiles(capture, k), bool(reason))
        if progress is not None:
            progress(n + 1, len(chosen))


def _of_capture(path: Path, count: int, rng: np.random.Generator) -> Iterator[Entry]:
    capture = read_capture(path)
    for k in _some(capture.count, count, rng):
        x, y, z = capture.lights[k]
        tilt, azimuth = np.degrees(np.arccos(np.clip(z, -1, 1))), np.degrees(np.arctan2(y, x)) % 360
        where = f"light at {tilt:.0f}°, azimuth {azimuth:.0f}°" if tilt > 0.5 else "frontal light"
        yield Entry(
            f"{real(path).name} {capture.names[k]}", ", ".join(w for w in (where, _gloss(capture)) if w), _tiles(capture, k)
        )


def brightest(capture: Capture) -> int:
    """The picture that shows most: the one with the largest mean inside the mask, what is above white counted as white."""
    return int(np.minimum(capture.images[:, capture.mask], 1).mean(axis=(1, 2)).argmax())


def _some(total: int, count: int, rng: np.random.Generator) -> list[int]:
    return list(range(total)) if total <= count else sorted(rng.choice(total, count, replace=False).tolist())


def _gloss(capture: Capture) -> str:
    if capture.truth.gloss is None:
        return ""
    alpha = capture.truth.gloss[capture.mask]
    low, high = float(alpha.min()), float(alpha.max())
    return f"alpha {low:.3g}" if high - low < 0.01 * max(high, 1e-9) else f"alpha {low:.2g} to {high:.2g}"


def _tiles(capture: Capture, k: int) -> tuple[Picture | None, ...]:
    """The tiles of one picture, cropped to the object with some room around it, all at the capture's own exposure."""
    truth = capture.truth
    rows, columns = np.flatnonzero(capture.mask.any(axis=1)), np.flatnonzero(capture.mask.any(axis=0))
    H, W = capture.size
    side = min(max(H, W), round(1.16 * max(rows[-1] - rows[0] + 1, columns[-1] - columns[0] + 1)) + 4)
    top, left = ((a[0] + a[-1] + 1 - side) // 2 for a in (rows, columns))
    top, left = (min(max(start, 0), max(0, full - side)) for start, full in ((top, H), (left, W)))
    window = (slice(top, top + side), slice(left, left + side))
    layers = [capture.images, truth.diffuse, truth.specular, truth.matte]
    tiles: list[Picture | None] = [None if layer is None else _tone(layer[k][window]) for layer in layers]
    tiles.append(None if truth.normals is None else _normals(truth.normals[window], capture.mask[window]))
    return tuple(tiles)


def _tone(radiance: NDArray[Any]) -> Picture:
    encoded = linear_to_srgb(np.clip(np.nan_to_num(radiance.astype(np.float64)), 0, 1))
    picture: Picture = np.round(255 * encoded).astype(np.uint8)
    return picture


def _normals(normals: NDArray[Any], mask: NDArray[np.bool_]) -> Picture:
    colours = np.round(255 * np.clip((np.nan_to_num(normals) + 1) / 2, 0, 1))
    picture: Picture = np.where(mask[..., None], colours, OUTSIDE).astype(np.uint8)
    return picture


def _sheet(entries: Sequence[Entry]) -> Picture:
    from PIL import Image, ImageDraw, ImageFont

    shown = [c for c in range(len(LAYERS)) if any(entry.tiles[c] is not None for entry in entries)]
    blocks = 1 if len(entries) <= 5 else 2 if len(entries) <= 40 else 3
    between = 2 * MARGIN
    room = (WIDTH - 2 * MARGIN - (blocks - 1) * between) // blocks
    side = min(176 if blocks < 3 else 128, (room - (len(shown) - 1) * GAP) // len(shown))
    block = len(shown) * (side + GAP) - GAP
    lines = -(-len(entries) // blocks)
    step = side + CAPTION + 2 * GAP
    size = (2 * MARGIN + blocks * block + (blocks - 1) * between, MARGIN + HEAD + lines * step + MARGIN - GAP)
    canvas = Image.new("RGB", size, PAPER)
    draw, font, small = ImageDraw.Draw(canvas), ImageFont.load_default(15), ImageFont.load_default(13)
    for b in range(blocks):
        for c, layer in enumerate(shown):
            draw.text((MARGIN + b * (block + between) + c * (side + GAP), MARGIN - 6), LAYERS[layer], INK, font)
    for n, entry in enumerate(entries):
        b, line = divmod(n, lines)
        x, y = MARGIN + b * (block + between), MARGIN + HEAD + line * step - 8
        for c, layer in enumerate(shown):
            tile = entry.tiles[layer]
            if tile is not None:
                canvas.paste(_fitted(tile, side), (x + c * (side + GAP), y))
        room_for_title = _cut(draw, entry.title, small, block)
        draw.text((x, y + side + 3), room_for_title, INK, small)
        at = x + draw.textlength(room_for_title, small) + 10
        draw.text((at, y + side + 3), _cut(draw, entry.note, small, x + block - at), WARN if entry.warn else FAINT, small)
    return np.asarray(canvas)


def _fitted(tile: Picture, side: int) -> Any:
    """The tile at its largest within a square, in its middle."""
    from PIL import Image

    h, w = tile.shape[:2]
    factor = side / max(h, w)
    size = (max(1, round(w * factor)), max(1, round(h * factor)))
    image = Image.fromarray(tile).resize(size, Image.Resampling.LANCZOS if factor < 1 else Image.Resampling.BICUBIC)
    square = Image.new("RGB", (side, side), PAPER)
    square.paste(image, ((side - size[0]) // 2, (side - size[1]) // 2))
    return square


def _cut(draw: Any, text: str, font: Any, room: float) -> str:
    """The text, or as much of its beginning as fits."""
    if draw.textlength(text, font) <= room:
        return text
    while text and draw.textlength(f"{text}...", font) > room:
        text = text[:-1]
    return f"{text}..." if text else ""
