"""What a page is made of: figures, maps to read, tables, pictures to leaf through, curves. Data alone; `recon.page` renders it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from recon.pictures import Bools, Picture, crop_box
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


@dataclass(frozen=True)
class Key:
    """A legend of named colours, for maps of kinds. colours: name -> sRGB bytes."""

    colours: Mapping[str, tuple[int, int, int]]


@dataclass(frozen=True)
class Window:
    """Which pixels of a capture its maps show, each as it is: so that a reading names the capture's own pixel, and a ruler its size.

    rows, columns: slices with start, stop and step. millimetres: between neighbouring pixels of the capture, None where no scale is
    known or it differs over the view.
    """

    rows: slice
    columns: slice
    millimetres: float | None = None

    @classmethod
    def around(cls, mask: Bools, largest: int, millimetres: float | None = None, margin: int = 8) -> Window:
        """The box of a mask (H, W) and `margin` pixels around it, every nth pixel so that neither side exceeds `largest`."""
        rows, columns = crop_box(mask, margin)
        step = max(1, -(-max(rows.stop - rows.start, columns.stop - columns.start) // largest))
        return cls(slice(rows.start, rows.stop, step), slice(columns.start, columns.stop, step), millimetres)

    @classmethod
    def whole(cls, values: NDArray[Any], millimetres: float | None = None) -> Window:
        """All of an array (H, W, ...)."""
        return cls(slice(0, values.shape[0], 1), slice(0, values.shape[1], 1), millimetres)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of what is shown."""
        rows, columns = (len(range(s.start, s.stop, s.step)) for s in (self.rows, self.columns))
        return rows, columns

    def cut(self, values: NDArray[Any]) -> NDArray[Any]:
        """What the window shows of an array (H, W, ...)."""
        return values[self.rows, self.columns]


@dataclass(frozen=True, eq=False)
class Figure:
    """One picture. image: (H, W, 3) uint8. legend: a `Bar`, a `Key`, a picture (such as `sphere_legend`), or None."""

    title: str
    image: Picture
    caption: str = ""
    legend: Bar | Key | Picture | None = None


@dataclass(frozen=True, eq=False)
class Map:
    """A map whose value is read under the pointer or by the arrow keys.

    values: (h, w) in the unit of `bar`, NaN where there is none, as `window` cuts them. Maps of one window in one `Row` are read together,
    at the same pixel.
    """

    title: str
    values: NDArray[Any]
    bar: Bar
    window: Window
    caption: str = ""


@dataclass(frozen=True, eq=False)
class Row:
    """Figures and maps side by side, at most `columns` a line (default: all of them up to 5); fewer on a phone."""

    figures: Sequence[Figure | Map]
    columns: int | None = None
    title: str = ""
    caption: str = ""


@dataclass(frozen=True, eq=False)
class NormalMap:
    """Normals to read, and to light anew with the pointer or the arrow keys.

    normal: (h, w, 3) unit, zero where unknown, as `window` cuts it. albedo: (h, w, 3) uint8 sRGB, or None: then it is lit in white only.
    """

    title: str
    normal: NDArray[Any]
    window: Window
    albedo: Picture | None = None
    caption: str = ""


@dataclass(frozen=True, eq=False)
class Profile:
    """A surface, and its height along a line that the reader draws.

    height: (h, w) in `unit`, NaN where unknown, as `window` cuts it; true: the same of the true surface, on the same level. quantity: what
    it is, where it is not the height. relief: (h, w, 3) uint8, the picture to draw on; bar: its colours. Distances along the line are in mm
    where the window knows them, else in pixels.
    """

    title: str
    height: NDArray[Any]
    relief: Picture
    window: Window
    unit: str
    bar: Bar
    true: NDArray[Any] | None = None
    caption: str = ""
    quantity: str = "height"


@dataclass(frozen=True, eq=False)
class Table:
    """A table. Numbers are set right-aligned by their column's format, None and NaN as a dash, text as it is.

    columns: `Column`s, or titles alone. rows: one value a column. highlight: indices of rows to stress.
    reference: indices of rows that are a yardstick (such as the true matte) and are set apart. folded: whether it opens on a click,
    for long ones.
    """

    title: str
    columns: Sequence[Column | str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    highlight: Sequence[int] = ()
    reference: Sequence[int] = ()
    folded: bool = False


@dataclass(frozen=True, eq=False)
class Gallery:
    """Pictures of one view: tabs choose the layer, a slider the frame, a divider wipes between two layers; the keyboard does all three.

    layers: name of the layer -> one (H, W, 3) uint8 picture a frame, None where it has none; every layer has as many, and the pictures
    of a frame have one size. frames: names of the frames. notes: name of the layer -> a line that says what it is (may lack layers).
    lights: (frames, 3), the unit vector to the light of each frame, drawn beside the slider; None where the frames are not lights.
    against: the layer on the divider's other side at first, "" for none. slider: what the slider chooses.
    """

    title: str
    layers: Mapping[str, Sequence[Picture | None]]
    frames: Sequence[str] = ()
    caption: str = ""
    notes: Mapping[str, str] = field(default_factory=dict)
    lights: NDArray[Any] | None = None
    against: str = ""
    slider: str = "Picture"


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


Part = Figure | Map | Row | NormalMap | Profile | Table | Gallery | Plot | Note


@dataclass(frozen=True, eq=False)
class Section:
    """A chapter of the page. text: paragraphs, parted by blank lines."""

    title: str
    text: str = ""
    parts: Sequence[Part] = ()


@dataclass(frozen=True, eq=False)
class Page:
    """The whole page. lead: what was measured and what came out, in a paragraph or two. facts: label -> value, shown at the top.

    mesh: x right, y up, z to the viewer, its lengths in `mesh_unit` ("m", "mm" or "px"). mesh_colours: (V, 3)
    uint8 sRGB, the colours of its vertices, called `mesh_painted`; None takes the mesh's own vertex colours where it has them. More than
    `recon.page.MAX_TRIANGLES` are clustered for the page (the file beside it keeps them all), and the page says so.
    """

    title: str
    lead: str = ""
    sections: Sequence[Section] = ()
    mesh: trimesh.Trimesh | None = None
    facts: Mapping[str, str] = field(default_factory=dict)
    mesh_colours: Picture | None = None
    mesh_painted: str = "Albedo"
    mesh_unit: str = "m"
    mesh_caption: str = ""
    footer: str = ""
