"""What a page's template needs of each part: pictures as data URIs, numbers as text, values packed."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from recon.page_light import places, words
from recon.page_parts import Bar, Figure, Gallery, Key, Map, NormalMap, Part, Plot, Profile, Row, Table, Window
from recon.page_values import pack_normals, pack_values, reading_step
from recon.pictures import Picture, colour_strip, photo_bytes, png_bytes, sphere_legend
from recon.tables import Column

SMALL = 160
"""Longest side of pictures so small that their pixels should show when enlarged."""


def part_view(part: Part, ids: Iterator[str]) -> dict[str, Any]:
    """What the template needs of a part."""
    view: dict[str, Any] = {"kind": type(part).__name__.lower(), "id": next(ids), "part": part}
    match part:
        case Figure() | Map():
            view |= {"kind": "row", "columns": 1, "title": "", "caption": "", "figures": [_figure(part)]}
        case Row():
            if not part.figures:
                raise InputError(f"the row of figures {part.title!r} is empty")
            columns = part.columns or min(len(part.figures), 5)
            if not 1 <= columns <= 6:
                raise InputError(f"a row of figures has 1 to 6 columns, not {columns}")
            figures = [_figure(f) for f in part.figures]
            view |= {"columns": columns, "title": part.title, "caption": part.caption, "figures": figures}
        case Table():
            view |= _table(part)
        case Gallery():
            view |= _gallery(part)
        case NormalMap():
            view |= _normal_map(part)
        case Profile():
            view |= _profile(part)
        case Plot():
            from recon.page_plot import curves

            view |= {"svg": curves(part)}
    return view


def _figure(figure: Figure | Map) -> dict[str, Any]:
    view: dict[str, Any] = {"title": figure.title, "caption": figure.caption, "bar": None, "colours": None, "key": None}
    if isinstance(figure, Map):
        return view | {"bar": _bar(figure.bar)} | _map(figure)
    view |= {"image": _image(figure.image), "header": None}
    match figure.legend:
        case Bar():
            view["bar"] = _bar(figure.legend)
        case Key():
            view["colours"] = [(name, _image(np.full((1, 1, 3), rgb, np.uint8))) for name, rgb in figure.legend.colours.items()]
        case None:
            pass
        case _:
            view["key"] = _image(figure.legend)
    return view


def _bar(legend: Bar) -> dict[str, Any]:
    values = (legend.lo, (legend.lo + legend.hi) / 2, legend.hi)
    space = "" if legend.unit in ("", "°", "%") else "\u202f"
    ends = [_number(v, legend.format) + (space + legend.unit if i != 1 else "") for i, v in enumerate(values)]
    if legend.above:
        ends[2] = "≥\u202f" + ends[2]
        ends[0] = "≤\u202f" + ends[0] if legend.lo < 0 else ends[0]
    return {"strip": _image(colour_strip(legend.colours, 128)), "ends": ends, "name": legend.colours}


def _map(figure: Map) -> dict[str, Any]:
    """The values of a map, packed, and what the page's script must know of them."""
    bar, values = figure.bar, figure.values
    _fits(figure.title, values, figure.window.shape)
    if not bar.hi > bar.lo:
        raise InputError(f"the scale of the map {figure.title!r} must rise, got {bar.lo} to {bar.hi}")
    packed = pack_values(values, reading_step(bar.lo, bar.hi))
    header = _placed(figure.window) | {
        "lo": packed.lo,
        "step": packed.step,
        "digits": max(0, -round(math.log10(packed.step))),
        "unit": bar.unit,
        "bar": [bar.lo, bar.hi],
        "colours": bar.colours,
    }
    return {"header": header, "data": base64.b64encode(packed.data).decode(), "small": max(values.shape) <= SMALL}


def _fits(title: str, values: NDArray[Any], shape: tuple[int, ...]) -> None:
    if values.shape != shape:
        raise InputError(f"{title!r} holds values of shape {values.shape}, its window shows {shape}")


def _placed(window: Window) -> dict[str, Any]:
    """Where a window lies in the capture, for the page's scripts."""
    height, width = window.shape
    return {
        "width": width,
        "height": height,
        "row": window.rows.start,
        "column": window.columns.start,
        "stride": window.rows.step,
        "millimetres": window.millimetres,
    }


def _normal_map(part: NormalMap) -> dict[str, Any]:
    for values in (part.normal, part.albedo):
        if values is not None:
            _fits(part.title, values, (*part.window.shape, 3))
    return {
        "header": _placed(part.window),
        "data": base64.b64encode(pack_normals(part.normal)).decode(),
        "albedo": None if part.albedo is None else _image(part.albedo, photo=True),
        "key": _image(sphere_legend(132)),
        "small": max(part.window.shape) <= SMALL,
    }


def _profile(part: Profile) -> dict[str, Any]:
    surfaces = {"measured": part.height} | ({} if part.true is None else {"true": part.true})
    for values in surfaces.values():
        _fits(part.title, values, part.window.shape)
    known = np.isfinite(part.height)
    if not known.any():
        raise InputError(f"the surface of {part.title!r} has no height")
    row = int(np.median(np.nonzero(known)[0]))
    span = float(np.ptp(part.height[known]))
    columns = np.flatnonzero(known[row])
    first, last = (int(columns[0]), int(columns[-1])) if columns.size else (0, known.shape[1] - 1)
    packed = {name: pack_values(values) for name, values in surfaces.items()}
    return {
        "relief": _image(part.relief, photo=True),
        "header": _placed(part.window)
        | {
            "unit": part.unit,
            "quantity": part.quantity,
            "ends": [[first, row], [last, row]],
            "digits": max(0, 3 - math.floor(math.log10(span or 1))),
        },
        "bar": _bar(part.bar),
        "colours": None,
        "names": list(surfaces),
        "surfaces": [
            {"header": {"lo": p.lo, "step": p.step}, "data": base64.b64encode(p.data).decode()} for p in packed.values()
        ],
    }


def _table(table: Table) -> dict[str, Any]:
    columns = [Column(c) if isinstance(c, str) else c for c in table.columns]
    rows: list[dict[str, Any]] = []
    for i, row in enumerate(table.rows):
        if len(row) != len(columns):
            raise InputError(f"row {i + 1} of the table {table.title!r} has {len(row)} cells for {len(columns)} columns")
        cells = [_cell(value, column.format) for value, column in zip(row, columns, strict=True)]
        kind = "highlight" if i in table.highlight else "reference" if i in table.reference else ""
        rows.append({"kind": kind, "cells": cells})
    numeric = [any(row["cells"][j]["number"] for row in rows) for j in range(len(columns))]
    return {"columns": list(zip(columns, numeric, strict=True)), "rows": rows}


def _gallery(gallery: Gallery) -> dict[str, Any]:
    counts = {len(pictures) for pictures in gallery.layers.values()}
    if len(counts) != 1 or 0 in counts:
        raise InputError(f"the layers of {gallery.title!r} must hold the same number of pictures, at least one")
    total = counts.pop()
    frames = list(gallery.frames) or [str(i + 1) for i in range(total)]
    if len(frames) != total:
        raise InputError(f"{gallery.title!r} has {len(frames)} names for {total} frames")
    for frame, pictures in zip(frames, zip(*gallery.layers.values(), strict=True), strict=True):
        if len({picture.shape for picture in pictures if picture is not None}) > 1:
            raise InputError(f"the pictures of frame {frame!r} of {gallery.title!r} differ in size")
    layers = [
        {
            "name": name,
            "index": i,
            "note": gallery.notes.get(name, ""),
            "images": [None if p is None else _image(p, photo=True) for p in pictures],
        }
        for i, (name, pictures) in enumerate(gallery.layers.items())
    ]
    if gallery.lights is not None and len(gallery.lights) != total:
        raise InputError(f"{gallery.title!r} has {len(gallery.lights)} lights for {total} frames")
    lights = [] if gallery.lights is None else list(gallery.lights)
    dots = [{"x": x, "y": y, "words": words(light)} for (x, y), light in zip(places(lights), lights, strict=True)]
    return {"layers": layers, "frames": frames, "dots": dots}


def _image(picture: Picture, photo: bool = False) -> dict[str, Any]:
    """Source, size, and whether it is so small that its pixels should show. photo: may be a JPEG where a PNG is large."""
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or 0 in picture.shape:
        raise InputError(f"a picture of a page must be (H, W, 3) uint8, got {picture.shape} {picture.dtype}")
    data, kind = photo_bytes(picture) if photo else (png_bytes(picture), "image/png")
    H, W = picture.shape[:2]
    return {"src": f"data:{kind};base64,{base64.b64encode(data).decode()}", "width": W, "height": H, "small": max(H, W) <= SMALL}


def _cell(value: object, form: str) -> dict[str, Any]:
    """The text of a cell, its plain value for CSV, and whether it is a number."""
    if value is None:
        return {"text": "–", "plain": "", "number": False}
    if isinstance(value, bool | np.bool_):
        return {"text": "yes" if value else "no", "plain": "yes" if value else "no", "number": False}
    if isinstance(value, int | float | np.integer | np.floating):
        number = float(value)
        if math.isnan(number):
            return {"text": "–", "plain": "", "number": True}
        whole = isinstance(value, int | np.integer) and form[-1:] in "feg%"
        return {
            "text": f"{value:,d}".replace(",", "\u202f") if whole else _number(number, form),
            "plain": str(int(value)) if whole else repr(number),
            "number": True,
        }
    return {"text": str(value), "plain": str(value), "number": False}


def _number(value: float, form: str) -> str:
    text = format(value, form)
    if text.startswith("-") and not any(digit in text for digit in "123456789"):
        text = text[1:]  # what rounds to zero has no sign
    return text.replace("-", "\N{MINUS SIGN}")
