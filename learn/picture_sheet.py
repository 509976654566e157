"""A sheet of small pictures with titles, in the manner of the paper's Fig. 3.3: a line for each scene, a column for each method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from recon.pictures import Picture, fit

TILE = 176
"""Side of a small picture in pixels."""

GAP, HEAD = 6, 22
PAPER, INK = (252, 251, 249), (40, 42, 46)


def picture_sheet(titles: Sequence[str], lines: Sequence[Sequence[Picture | None]]) -> Picture:
    """(H, W, 3) uint8: the titles over the columns, then the lines. lines: pictures (h, w, 3), None where a cell stays empty."""
    from PIL import Image, ImageDraw, ImageFont

    canvas = Image.new("RGB", (GAP + len(titles) * (TILE + GAP), HEAD + GAP + len(lines) * (TILE + GAP)), PAPER)
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(13)
    for c, title in enumerate(titles):
        draw.text((GAP + c * (TILE + GAP), 4), title, INK, font)
        for r, line in enumerate(lines):
            picture = line[c]
            if picture is None:
                continue
            small = Image.fromarray(fit(picture, TILE))
            if max(small.size) < TILE:
                factor = max(1, TILE // max(small.size))
                small = small.resize((small.width * factor, small.height * factor), Image.Resampling.NEAREST)
            x, y = GAP + c * (TILE + GAP), HEAD + GAP + r * (TILE + GAP)
            canvas.paste(small, (x + (TILE - small.width) // 2, y + (TILE - small.height) // 2))
    return np.asarray(canvas)
