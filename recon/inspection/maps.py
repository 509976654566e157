"""The maps of an inspection as pictures, each with its legend."""

from __future__ import annotations

import numpy as np

from recon.inspection.inspection import Inspection
from recon.inspection.verdict import FAIL, PASS, UNDECIDED
from recon.inspection.view import Doubles
from recon.page_parts import Bar
from recon.pictures import OUTSIDE, Picture, colour_strip, crop_to_mask, error_picture, fit, signed_picture

COLOURS = {"pass": (58, 130, 170), "cannot be decided": (238, 205, 95), "fail": (190, 45, 35), "not judged": (104, 108, 114)}
"""Told apart without colour vision by their lightness too."""

PAPER, INK = (252, 251, 249), (40, 42, 46)
LARGEST = 1024
"""Longest side in pixels of a map's picture: the EXR beside it holds every pixel."""


def deviation_map(inspection: Inspection, name: str) -> tuple[Picture, Bar]:
    """Picture and legend of "raw", "form" or "features". Features are shown to twice the tolerance; the others to all but 2 % of theirs."""
    found, factor = inspection.deviation, inspection.factor
    values = getattr(found, name) * factor
    chosen = np.abs(values[found.judged])
    reach = float(np.percentile(chosen, 98)) if chosen.size else 0.0
    top = 2 * inspection.verdict.tolerance * factor if name == "features" else max(reach, 1e-9)
    beyond = bool(chosen.size and chosen.max() > top)
    return signed_picture(values, top=top), Bar(-top, top, inspection.unit, "signed", ".2g", beyond)


def uncertainty_map(inspection: Inspection, name: str) -> tuple[Picture, Bar] | None:
    """Picture and legend of "raw_uncertainty" or "uncertainty" (of the features); None where it is not known."""
    values: Doubles = getattr(inspection.deviation, name) * inspection.factor
    known = values[inspection.deviation.judged & np.isfinite(values)]
    if not known.size:
        return None
    top = max(float(np.percentile(known, 98)), 1e-9)
    return error_picture(values, top=top), Bar(0, top, inspection.unit, "error", ".2g", bool(known.max() > top))


def verdict_map(inspection: Inspection) -> Picture:
    """The verdict of every pixel in `COLOURS`."""
    codes = inspection.verdict.codes
    picture = np.empty((*codes.shape, 3), np.uint8)
    picture[:] = OUTSIDE
    picture[inspection.measured.known] = COLOURS["not judged"]
    for name, code in (("pass", PASS), ("cannot be decided", UNDECIDED), ("fail", FAIL)):
        picture[codes == code] = COLOURS[name]
    return picture


def look(inspection: Inspection, picture: Picture, largest: int = LARGEST) -> Picture:
    """The part of a picture that shows the object; small ones are enlarged by whole pixels, so that their text has room."""
    cut = crop_to_mask(picture, inspection.measured.known | inspection.alignment.nominal.inside, 6)
    by = max(1, 360 // max(cut.shape[:2]))
    return fit(cut.repeat(by, axis=0).repeat(by, axis=1), largest)


def with_bar(picture: Picture, title: str, bar: Bar) -> Picture:
    """The picture over its title and colour bar, for a file that stands alone."""
    low, high = (f"{value:{bar.format}} {bar.unit}" for value in (bar.lo, bar.hi))
    if bar.above:
        low, high = low + (" or less" if bar.lo < 0 else ""), high + " or more"
    width = max(picture.shape[1], 280)
    return _framed(picture, title, colour_strip(bar.colours, width - 20, 12), [(10, low, "la"), (width - 10, high, "ra")])


def with_key(picture: Picture, title: str) -> Picture:
    """The picture over its title and the key to `COLOURS`."""
    return _framed(picture, title, key(max(picture.shape[1], 280) - 20), [])


def key(width: int = 420) -> Picture:
    """The key to `COLOURS`, one line or, where narrow, two."""
    from PIL import Image, ImageDraw, ImageFont

    columns = 4 if width >= 420 else 2
    canvas = Image.new("RGB", (width, 20 * (4 // columns)), PAPER)
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(13)
    for i, (name, colour) in enumerate(COLOURS.items()):
        x, y = (i % columns) * width // columns, 20 * (i // columns)
        draw.rectangle((x, y + 4, x + 12, y + 16), fill=colour)
        draw.text((x + 18, y + 2), name, INK, font)
    return np.asarray(canvas)


def _framed(picture: Picture, title: str, strip: Picture, texts: list[tuple[int, str, str]]) -> Picture:
    from PIL import Image, ImageDraw, ImageFont

    H, W = picture.shape[:2]
    width = max(W, strip.shape[1] + 20)
    canvas = Image.new("RGB", (width, 28 + H + 10 + strip.shape[0] + (22 if texts else 6)), PAPER)
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(14)
    draw.text((10, 5), title, INK, font)
    canvas.paste(Image.fromarray(picture), ((width - W) // 2, 28))
    canvas.paste(Image.fromarray(strip), (10, 28 + H + 8))
    for x, text, anchor in texts:
        draw.text((x, 28 + H + 10 + strip.shape[0] + 2), text, INK, font, anchor=anchor)
    return np.asarray(canvas)
