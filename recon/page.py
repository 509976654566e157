"""An offline page of measurements: figures, tables, pictures to leaf through, and the mesh to turn.

The result is one self-contained HTML file. It asks the network for nothing, and its Content-Security-Policy holds the hashes of
its own style and scripts, so that text from a capture (file names above all) can never run. Light and dark, desk and phone.

The mesh is shown by a small WebGL viewer of our own (`templates/viewer.js`), not by trimesh's HTML scene: that one carries
744 kB of three.js in an iframe, needs 'unsafe-inline' scripts, knows neither the page's dark mode nor the capture's camera, and
has no scale bar. Ours is orthographic, as a measuring view should be, starts with the camera's view, and weighs 11 kB.
"""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Iterator
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gen.errors import InputError
from gen.files import writing
from gen.parts import require
from recon.page_parts import Bar, Figure, Gallery, Page, Part, Plot, Row, Table, Wipe
from recon.pictures import Picture, colour_strip, photo_bytes, png_bytes
from recon.tables import Column

if TYPE_CHECKING:
    pass


MAX_TRIANGLES = 150_000
"""The most triangles that the page's viewer is given."""


def write_page(path: str | Path, page: Page) -> None:
    """The page as one HTML file, by a temporary name. Raises InputError where it cannot be written."""
    text = render_page(page)
    with writing(Path(path)) as temporary:
        temporary.write_text(text, encoding="utf-8")


def render_page(page: Page) -> str:
    """The page as one self-contained HTML text. Raises InputError where parts do not fit together, MissingPart without jinja2."""
    require("report")
    import jinja2

    loader = jinja2.PackageLoader("recon", "templates")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    style = _template("page.css")
    script = "\n".join([_template("page.js"), *([_template("viewer.js")] if page.mesh is not None else [])])
    policy = (
        f"default-src 'none'; img-src data:; style-src {_hash(style)}; script-src {_hash(script)}; "
        "base-uri 'none'; form-action 'none'"
    )
    ids = (f"p{i}" for i in count(1))
    return environment.get_template("page.html").render(
        page=page,
        lead=_paragraphs(page.lead),
        policy=policy,
        style=style,
        script=script,
        facts=list(page.facts.items()),
        mesh=None if page.mesh is None else _mesh_view(page),
        sections=[
            {"id": f"s{i}", "title": s.title, "paragraphs": _paragraphs(s.text), "parts": [_part(part, ids) for part in s.parts]}
            for i, s in enumerate(page.sections, 1)
        ],
    )


def _part(part: Part, ids: Iterator[str]) -> dict[str, Any]:
    """What the template needs of a part."""
    view: dict[str, Any] = {"kind": type(part).__name__.lower(), "id": next(ids), "part": part}
    match part:
        case Figure():
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
        case Wipe():
            if part.left.shape != part.right.shape:
                raise InputError(f"the two pictures of {part.title!r} differ in size: {part.left.shape} and {part.right.shape}")
            view |= {"left": _image(part.left, photo=True), "right": _image(part.right, photo=True)}
        case Plot():
            from recon.page_plot import curves

            view |= {"svg": curves(part)}
    return view


def _figure(figure: Figure) -> dict[str, Any]:
    legend = figure.legend
    view: dict[str, Any] = {
        "title": figure.title,
        "caption": figure.caption,
        "image": _image(figure.image),
        "bar": None,
        "key": None,
    }
    if isinstance(legend, Bar):
        values = (legend.lo, (legend.lo + legend.hi) / 2, legend.hi)
        space = "" if legend.unit in ("", "°", "%") else "\u202f"
        ends = [_number(v, legend.format) + space + legend.unit for v in values]
        if legend.above:
            ends[2] = "≥\u202f" + ends[2]
            ends[0] = "≤\u202f" + ends[0] if legend.lo < 0 else ends[0]
        view["bar"] = {"strip": _image(colour_strip(legend.colours, 128)), "ends": ends}
    elif legend is not None:
        view["key"] = _image(legend)
    return view


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
    layers = [
        {"name": name, "note": gallery.notes.get(name, ""), "images": [_image(p, photo=True) for p in pictures]}
        for name, pictures in gallery.layers.items()
    ]
    return {"layers": layers, "frames": frames}


def _image(picture: Picture, photo: bool = False) -> dict[str, Any]:
    """Source, size, and whether it is so small that its pixels should show. photo: may be a JPEG where a PNG is large."""
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or 0 in picture.shape:
        raise InputError(f"a picture of a page must be (H, W, 3) uint8, got {picture.shape} {picture.dtype}")
    data, kind = photo_bytes(picture) if photo else (png_bytes(picture), "image/png")
    H, W = picture.shape[:2]
    return {"src": f"data:{kind};base64,{base64.b64encode(data).decode()}", "width": W, "height": H, "small": max(H, W) <= 160}


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
    return format(value, form).replace("-", "\N{MINUS SIGN}")


def _paragraphs(text: str) -> list[str]:
    return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]


def _mesh_view(page: Page) -> dict[str, Any]:
    from recon.page_mesh import pack

    packed = pack(page.mesh, page.mesh_colours, MAX_TRIANGLES)
    return {
        "header": packed.header | {"unit": page.mesh_unit},
        "data": base64.b64encode(packed.data).decode(),
        "shown": packed.header["triangles"],
        "total": packed.total,
        "colours": packed.header["colours"],
    }


def _template(name: str) -> str:
    return files("recon").joinpath("templates", name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
