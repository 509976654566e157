"""One picture that sums a measurement up: a line of small pictures for each kind of input, from picture to shape."""

from __future__ import annotations

import numpy as np

from gen import large
from recon.compare import Comparison
from recon.metrics import angular_error
from recon.pictures import (
    Picture,
    crop_box,
    crop_to_mask,
    error_picture,
    height_range,
    normal_picture,
    relief_picture,
    tone,
    white_of,
)

TILE = 224
"""Side of a small picture in pixels."""

GAP, HEAD = 10, 26
PAPER, INK = (252, 251, 249), (40, 42, 46)
TOP = 30.0
"""Degrees of error that are shown in the lightest colour."""


def overview(comparison: Comparison) -> Picture:
    """(H, W, 3) uint8: the first picture, the normals, the relief and (where the truth is known) the angle to the true normals.

    One line for the glossy pictures, one for the best removal that was made, and one for the non-glossy pictures where they are known.
    """
    from PIL import Image, ImageDraw, ImageFont

    rows, capture = comparison.rows, comparison.capture
    best = next((name for name in ("repaired", "removed") if name in rows), None)
    names = [name for name in ("glossy", best, "true matte") if name is not None and name in rows]
    white = white_of(capture.images, capture.mask)
    large.release(capture.images)
    low, high = comparison.height_range() if comparison.reference else height_range(rows[names[0]].height.height)
    # Of a picture many times larger than it will be shown every nth pixel is as good.
    nth = max(max(span.stop - span.start for span in crop_box(capture.mask, 8)) // (8 * TILE), 1)
    thin = np.s_[::nth, ::nth]
    mask = capture.mask[thin]
    lines: list[tuple[str, list[tuple[str, Picture]]]] = []
    for name in names:
        shape = rows[name]
        step = nth * ((capture.scale.metres_per_pixel or 1.0) if shape.height.unit == "m" else 1.0)
        tiles = [
            (comparison.label(name), tone(shape.images[0][thin], white)),
            ("normals", normal_picture(shape.normals.normal[thin], shape.normals.measurable[thin])),
            ("relief", relief_picture(shape.height.height[thin], low, high, step)),
        ]
        if capture.truth.normals is not None:
            error = angular_error(shape.normals.normal, capture.truth.normals)
            mean = float(np.nanmean(error[capture.mask]))
            tiles.append((f"error: {mean:.1f} deg on average", error_picture(error[thin], mask, TOP)))
        lines.append((name, tiles))
    columns = max(len(tiles) for _, tiles in lines)
    canvas = Image.new("RGB", (GAP + columns * (TILE + GAP), GAP + len(lines) * (TILE + HEAD + GAP)), PAPER)
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(14)
    for r, (_, tiles) in enumerate(lines):
        for c, (title, picture) in enumerate(tiles):
            x, y = GAP + c * (TILE + GAP), GAP + r * (TILE + HEAD + GAP)
            draw.text((x, y + 2), title, INK, font)
            small = Image.fromarray(crop_to_mask(picture, mask, 8))
            small.thumbnail((TILE, TILE), Image.Resampling.LANCZOS)
            if max(small.size) < TILE:
                factor = TILE / max(small.size)
                small = small.resize((round(small.width * factor), round(small.height * factor)), Image.Resampling.LANCZOS)
            canvas.paste(small, (x, y + HEAD))
    return np.asarray(canvas)
