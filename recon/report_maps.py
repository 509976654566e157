"""What the sections of a report share: which part of a capture its maps show, how large, and on which scale."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture
from recon.page_parts import Bar, Map, Window
from recon.pictures import Picture, crop_to_mask, fit

MAX_SIDE = 512
"""Longest side of a picture in the page, in pixels."""


def window_of(capture: Capture, largest: int) -> Window:
    """The box of the object. Its pixels have one size only where the view is orthographic."""
    return Window.around(capture.mask, largest, capture.scale.mm_per_pixel if capture.scale.camera is None else None)


def thinned(window: Window) -> str:
    """A sentence for maps that leave pixels out; empty where they show them all."""
    return "" if window.rows.step == 1 else f" Of every {window.rows.step} x {window.rows.step} pixels one is shown, as it is."


def error_map(title: str, error: NDArray[Any], window: Window, top: float | None = None) -> Map:
    """Degrees from 0 to `top`, by default to where all but 5 % of this map's pixels lie."""
    known = error[np.isfinite(error)]
    top = error_top(known) if top is None else top
    return Map(title, error, Bar(0, top, "°", "error", ".3g", bool(known.size and known.max() > top)), window)


def error_top(known: NDArray[Any]) -> float:
    """The end of a scale of angles: where all but 5 % of the known ones (N,) lie, in whole degrees from 1 to 90."""
    return float(np.clip(np.ceil(np.percentile(known, 95)), 1, 90)) if known.size else 1.0


def look(picture: Picture, mask: NDArray[np.bool_]) -> Picture:
    """The part of a picture that shows the object, small enough for the page."""
    return fit(crop_to_mask(picture, mask, 8), MAX_SIDE)
