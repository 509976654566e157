"""What a page is made of: figures, tables, pictures to leaf through, curves, and the page itself. Data alone; `recon.page` renders it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from recon.pictures import Picture
from recon.tables import Column

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class Bar:
    """A colour bar as a legend, drawn as text and so sharp in both themes.

    lo, hi: the values at the two ends, in `unit`. colours: a name of `recon.pictures.COLOURS`. format: of the numbers.
    above: whether values beyond exist in the map and are shown in the last colour: that end is marked ≥ (a negative low end ≤).
    """

    lo: float
    hi: float
    unit: str = ""
    colours: str = "error"
    format: str = ".3g"
    above: bool = False


@dataclass(frozen=True, eq=False)
class Figure:
    """One picture. image: (H, W, 3) uint8. legend: a `Bar`, a picture (such as `sphere_legend`), or None."""

    title: str
    image: Picture
    caption: str = ""
    legend: Bar | Picture | None = None


@dataclass(frozen=True, eq=False)
class Row:
    """Figures side by side, at most `columns` a line (default: all of them up to 5); fewer on a phone."""

    figures: Sequence[Figure]
    columns: int | None = None
    title: str = ""
    caption: str = ""


@dataclass(frozen=True, eq=False)
class Table:
    """A table. Numbers are set right-aligned by their column's format, None and NaN as a dash, text as it is.

    columns: `Column`s, or titles alone. rows: one value a column. highlight: indices of rows to stress.
    reference: indices of rows that are a yardstick (such as the true matte) and are set apart.
    """

    title: str
    columns: Sequence[Column | str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    highlight: Sequence[int] = ()
    reference: Sequence[int] = ()


@dataclass(frozen=True, eq=False)
class Gallery:
    """Pictures of one view: tabs choose the layer, a slider the frame; the keyboard does both.

    layers: name of the layer -> one (H, W, 3) uint8 picture a frame; every layer has as many. frames: names of the frames.
    notes: name of the layer -> a line that says what it is (may lack layers).
    """

    title: str
    layers: Mapping[str, Sequence[Picture]]
    frames: Sequence[str] = ()
    caption: str = ""
    notes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Wipe:
    """Two pictures of one view, (H, W, 3) uint8 each and of one size, with a divider to drag between them."""

    title: str
    left: Picture
    right: Picture
    names: tuple[str, str] = ("before", "after")
    caption: str = ""


@dataclass(frozen=True)
class Series:
    """A curve of a `Plot`. x, y: numbers; NaN in y breaks the line. dashed: for a yardstick such as the truth."""

    name: str
    x: Sequence[float]
    y: Sequence[float]
    dashed: bool = False


@dataclass(frozen=True)
class Plot:
    """Curves over a common axis (a height profile, say), at most six. x_title, y_title: with their units."""

    title: str
    series: Sequence[Series]
    x_title: str = ""
    y_title: str = ""
    caption: str = ""


@dataclass(frozen=True)
class Note:
    """A line that must not be missed, such as "no scale is known: heights are in pixels"."""

    text: str


Part = Figure | Row | Table | Gallery | Wipe | Plot | Note


@dataclass(frozen=True, eq=False)
class Section:
    """A chapter of the page. text: paragraphs, parted by blank lines."""

    title: str
    text: str = ""
    parts: Sequence[Part] = ()


@dataclass(frozen=True, eq=False)
class Page:
    """The whole page. lead: what was measured and what came out, in a paragraph or two. facts: label -> value, shown at the top.

    mesh: in the camera frame (x right, y up, z to the viewer), its lengths in `mesh_unit` ("m" or "px"). mesh_colours: (V, 3)
    uint8 sRGB, the albedo of its vertices; None takes the mesh's own vertex colours where it has them. More than
    `recon.page.MAX_TRIANGLES` are clustered for the page (the file beside it keeps them all), and the page says so.
    """

    title: str
    lead: str = ""
    sections: Sequence[Section] = ()
    mesh: trimesh.Trimesh | None = None
    facts: Mapping[str, str] = field(default_factory=dict)
    mesh_colours: Picture | None = None
    mesh_unit: str = "m"
    mesh_caption: str = ""
    footer: str = ""
