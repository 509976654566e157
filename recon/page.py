"""An offline page of measurements: figures, maps to read, tables, pictures to leaf through, and the mesh to turn.

The result is one self-contained HTML file. It asks the network for nothing, and its Content-Security-Policy holds the hashes of
its own style and scripts, so that text from a capture (file names above all) can never run. Light and dark, desk and phone.

The mesh is shown by a small WebGL viewer of our own (`templates/viewer.js`), not by trimesh's HTML scene: that one carries
744 kB of three.js in an iframe, needs 'unsafe-inline' scripts, knows neither the page's dark mode nor the capture's camera, and
has no scale bar. Ours is orthographic, as a measuring view should be, starts with the camera's view, and weighs 11 kB. Maps are drawn
from the values that they are read from, so that what is seen and what is said cannot differ.
"""

from __future__ import annotations

import base64
import hashlib
import sys
from collections.abc import Callable, Sequence
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import Any

from gen.files import writing
from gen.parts import PARTS, require
from recon.page_parts import Bar, Figure, Map, NormalMap, Page, Part, Profile, Row
from recon.page_views import part_view
from recon.pictures import colour_strip

SCALES = {
    "error": "error (dark violet to pale yellow) and height rise evenly in lightness",
    "height": "error (dark violet to pale yellow) and height rise evenly in lightness",
    "signed": "signed darkens evenly to both sides of zero",
    "grey": "grey is 8-bit sRGB",
}
"""What the foot of a page says of the colour scales that it uses (see `recon.pictures.COLOURS`)."""

MAX_TRIANGLES = 150_000
"""The most triangles that the page's viewer is given."""


def write_report(folder: Path, compose: Callable[[], Page]) -> str | None:
    """The page of `compose` as report.html in a folder. Returns its name; None, with a line on stderr, where its package is missing."""
    if PARTS["report"].look().state != "ok":
        print(f"degloss: {PARTS['report'].line}", file=sys.stderr)
        return None
    write_page(folder / "report.html", compose())
    return "report.html"


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
    kinds = {type(figure) for section in page.sections for part in section.parts for figure in _figures(part)}
    scripts = {
        "normals.js": NormalMap in kinds,
        "maps.js": Map in kinds,
        "profile.js": Profile in kinds,
        "viewer.js": page.mesh is not None,
    }
    wanted = ["packed.js", "page.js", *(name for name, used in scripts.items() if used)]
    script = "\n".join(_template(name) for name in wanted)
    policy = (
        f"default-src 'none'; img-src data:; style-src {_hash(style)}; script-src {_hash(script)}; "
        "base-uri 'none'; form-action 'none'"
    )
    ids = (f"p{i}" for i in count(1))
    sections = [
        {"id": f"s{i}", "title": s.title, "paragraphs": _paragraphs(s.text), "parts": [part_view(part, ids) for part in s.parts]}
        for i, s in enumerate(page.sections, 1)
    ]
    bars = [bar for section in page.sections for part in section.parts for figure in _figures(part) if (bar := _bar_of(figure))]
    named = list(dict.fromkeys(bar.colours for bar in bars))
    return environment.get_template("page.html").render(
        page=page,
        lead=_paragraphs(page.lead),
        policy=policy,
        style=style,
        script=script,
        facts=list(page.facts.items()),
        mesh=None if page.mesh is None else _mesh_view(page),
        sections=sections,
        scales="Colour scales: " + "; ".join(dict.fromkeys(SCALES[name] for name in named)) + "." if named else "",
        tables={name: base64.b64encode(colour_strip(name).tobytes()).decode() for name in named} if Map in kinds else {},
    )


def _figures(part: Part) -> Sequence[Part]:
    """What stands in a part: the figures of a row, else the part itself."""
    return part.figures if isinstance(part, Row) else [part]


def _bar_of(part: Part) -> Bar | None:
    """The colour bar of a figure, map or profile, None where it has none."""
    if isinstance(part, Map | Profile):
        return part.bar
    return part.legend if isinstance(part, Figure) and isinstance(part.legend, Bar) else None


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
