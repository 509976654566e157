"""The offline page: one valid file that asks for nothing, trusts no text, and holds the values that it was given."""

from __future__ import annotations

import base64
import hashlib
import html.parser
import io
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from gen.errors import InputError
from recon import page as pages
from recon.page import render_page, write_page
from recon.page_light import places, words
from recon.page_mesh import cluster, pack
from recon.page_parts import (
    Bar,
    Figure,
    Gallery,
    Key,
    Map,
    NormalMap,
    Note,
    Page,
    Plot,
    Profile,
    Row,
    Section,
    Series,
    Table,
    Window,
)
from recon.page_plot import ticks
from recon.page_values import LEVELS, OCTAHEDRON, pack_normals, pack_values, reading_step
from recon.pictures import sphere_legend
from recon.tables import Column

HOSTILE = (
    """<script>document.title='owned'</script><img src=x onerror="document.title='owned'">"'&amp;{{ 7*7 }}</script></style>"""
)


VALUES = np.add.outer(np.arange(30.0), np.arange(40.0)) / 8
SMALL = Window(slice(2, 28, 1), slice(3, 37, 1), 0.5)


def flat(level: int, size: int = 48) -> np.ndarray:
    picture = np.full((size, size, 3), level, np.uint8)
    picture[:4, :4] = 255 - level
    return picture


def dome(size: int = 40, colours: bool = True) -> trimesh.Trimesh:
    """A hemisphere over a pixel grid, 1 cm across, in metres, facing +z, red to the right."""
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j]
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, None))
    index = np.arange(size * size).reshape(size, size)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    faces = np.vstack([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    mesh = trimesh.Trimesh(np.stack([x, y, z], -1).reshape(-1, 3) * 0.005, faces, process=False)
    if colours:
        red = np.where(x.ravel() > 0, 255, 0)
        mesh.visual.vertex_colors = np.stack([red, 0 * red, 255 - red, 0 * red + 255], 1).astype(np.uint8)
    return mesh


def full_page(name: str = "bolt.png", mesh: trimesh.Trimesh | None = None) -> Page:
    """A page with every kind of part, `name` wherever text can come from outside."""
    parts = [
        Figure(name, flat(90), name, legend=Bar(-1, 2.5, name, above=True)),
        Row([Figure(name, flat(v), name, legend=sphere_legend(32)) for v in (20, 60, 100)], title=name, caption=name),
        Table(
            name,
            [name, Column(name, ".2f", name)],
            [[name, 1.0], [name, -2.345], ["none", None]],
            name,
            highlight=[1],
            reference=[2],
            folded=True,
        ),
        Row(
            [
                Map(name, SMALL.cut(VALUES), Bar(0, 9, name), SMALL, name),
                Figure(name, flat(50), name, Key({name: (200, 30, 20)})),
            ],
            title=name,
        ),
        NormalMap(name, np.broadcast_to([0.0, 0.6, 0.8], (26, 34, 3)), SMALL, flat(90, 34)[:26], name),
        Profile(
            name, SMALL.cut(VALUES), flat(60, 34)[:26], SMALL, name, Bar(0, 9, name, "height"), SMALL.cut(VALUES) + 1, name, name
        ),
        Gallery(
            name,
            {name: [flat(30), flat(120)], "matte": [flat(70), flat(170)]},
            [name, "two"],
            name,
            {name: name},
            np.array([[0, 0, 1], [1, 0, 1]]),
            "matte",
        ),
        Plot(
            name,
            [Series(name, [0, 1, 2], [1.0, float("nan"), 3.0]), Series("truth", [0, 2], [1.0, 3.0], dashed=True)],
            name,
            name,
            name,
        ),
        Note(name),
    ]
    sections = [Section(name, f"{name}\n\n{name}", parts), Section("two"), Section("three")]
    return Page(name, name, sections, mesh, {name: name}, mesh_caption=name, footer=name)


class Reader(html.parser.HTMLParser):
    """Tags with their attributes, the text between them, and whether every tag is closed in order."""

    VOID = frozenset({"meta", "link", "img", "input", "br"})

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.bodies: dict[str, list[str]] = {}
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len({key for key, _ in attrs}) == len(attrs), f"<{tag}> names an attribute twice"
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open:
            self.bodies.setdefault(self.open[-1], []).append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.mark.parametrize("mesh", [None, dome()], ids=["no mesh", "mesh"])
def test_page_is_one_well_formed_file_that_asks_for_nothing(mesh: trimesh.Trimesh | None) -> None:
    text = render_page(full_page(mesh=mesh))
    assert text.startswith("<!doctype html>")
    reader = Reader(text)
    assert not reader.open
    ids = [a["id"] for _, a in reader.tags if "id" in a]
    assert len(set(ids)) == len(ids)
    for tag, attributes in reader.tags:
        for key in ("src", "href", "srcset", "action", "data", "poster"):
            value = attributes.get(key)
            assert value is None or value.startswith(("data:", "#")), f"<{tag} {key}={value!r}>"
            if value and value.startswith("#"):
                assert value[1:] in ids
        assert not [key for key in attributes if key.startswith("on") or key == "style"]
    assert not re.search(r"https?://|url\(|@import|\beval\b|new Function", re.sub(r"data:[^\"]+", "", text))
    assert all("alt" in a for a in reader.all("img"))


def test_policy_allows_only_this_pages_own_script_and_style() -> None:
    reader = Reader(render_page(full_page(mesh=dome())))
    policy = next(a["content"] for a in reader.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    for tag in ("style", "script"):
        body = next(text for text in reversed(reader.bodies[tag]) if "{" in text)
        digest = base64.b64encode(hashlib.sha256(body.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy


def test_hostile_names_stay_text() -> None:
    plain, hostile = (Reader(render_page(full_page(name, dome()))) for name in ("bolt.png", HOSTILE))
    assert [tag for tag, _ in hostile.tags] == [tag for tag, _ in plain.tags]
    assert hostile.bodies["h1"] == hostile.bodies["title"] == [HOSTILE]
    assert HOSTILE in hostile.bodies["h2"]


def test_numbers_are_formatted_and_kept_whole_for_csv() -> None:
    table = Table("t", ["name", Column("error", ".2f", "°"), "count"], [["a", -3.14159, 51321], ["b", float("nan"), None]])
    reader = Reader(render_page(Page("p", sections=[Section("s", parts=[table])])))
    cells = reader.all("td")
    assert [a["data-plain"] for a in cells] == ["-3.14159", "51321", "", ""]
    assert [a.get("class") for a in cells] == ["n", "n", "n", "n"]
    assert reader.bodies["td"] == ["−3.14", "51\u202f321", "–", "–"]
    tiny = Table("t", ["name", Column("gain", "+.2f"), Column("gap", ".2f")], [["a", -0.001, -0.001]])
    assert Reader(render_page(Page("p", sections=[Section("s", parts=[tiny])]))).bodies["td"] == ["0.00", "0.00"]


def test_a_gallery_may_lack_any_picture() -> None:
    gallery = Gallery("g", {"a": [None, flat(2)], "b": [flat(3), None]}, ["x", "y"])
    text = render_page(Page("t", "t", sections=[Section("s", "", [gallery])]))
    assert text.count("has no picture here") == 2


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (Table("t", ["a", "b"], [[1]]), "row 1 of the table 't' has 1 cells for 2 columns"),
        (Gallery("g", {"a": [flat(1)], "b": []}), "same number of pictures"),
        (Gallery("g", {}), "same number of pictures"),
        (Gallery("g", {"a": [flat(1)]}, ["x", "y"]), "2 names for 1 frames"),
        (Gallery("g", {"a": [flat(1)], "b": [flat(1, 20)]}), "differ in size"),
        (Gallery("g", {"a": [flat(1)]}, lights=np.eye(3)), "3 lights for 1 frames"),
        (Map("m", VALUES, Bar(0, 1), SMALL), r"shape \(30, 40\), its window shows \(26, 34\)"),
        (Map("m", SMALL.cut(VALUES), Bar(1, 1), SMALL), "must rise"),
        (Map("m", SMALL.cut(VALUES), Bar(0, 0), SMALL), "must rise"),
        (NormalMap("n", SMALL.cut(VALUES), SMALL), r"its window shows \(26, 34, 3\)"),
        (Profile("p", SMALL.cut(VALUES) * np.nan, flat(9), SMALL, "mm", Bar(0, 1)), "has no height"),
        (Row([]), "is empty"),
        (Row([Figure("f", flat(1))], columns=9), "1 to 6 columns"),
        (Figure("f", np.zeros((4, 4))), r"must be \(H, W, 3\) uint8"),
        (Plot("p", []), "1 to 6 curves"),
        (Plot("p", [Series("s", [1, 2], [1])]), "as many finite x as y"),
        (Plot("p", [Series("s", [1], [float("nan")])]), "no finite point"),
    ],
)
def test_parts_that_do_not_fit_are_refused_in_one_line(part: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        render_page(Page("p", sections=[Section("s", parts=[part])]))


def test_write_page_leaves_nothing_behind_when_it_fails(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "report.html"
    write_page(path, Page("first"))
    with pytest.raises(InputError):
        write_page(path, Page("second", sections=[Section("s", parts=[Row([])])]))
    assert "first" in path.read_text("utf-8")
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]


def test_pictures_in_the_page_are_the_pictures_given() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    reader = Reader(render_page(Page("p", sections=[Section("s", parts=[Figure("f", picture)])])))
    source = next(a["src"] for a in reader.all("img") if (a.get("src") or "").startswith("data:image/png"))
    assert source is not None
    with Image.open(io.BytesIO(base64.b64decode(source.split(",")[1]))) as opened:
        np.testing.assert_array_equal(np.asarray(opened), picture)


def undo(data: bytes, rows: int, columns: int) -> np.ndarray:
    """Codes of packed values, from the format's description."""
    low, high = np.frombuffer(zlib.decompress(data), np.uint8).astype(np.uint16).reshape(2, rows, columns)
    steps = low + 256 * high
    steps[:, 0] = np.cumsum(steps[:, 0], dtype=np.uint16)
    return np.cumsum(steps, axis=1, dtype=np.uint16)


@pytest.mark.parametrize("step", [None, 0.01])
def test_values_come_back_to_within_half_a_step(step: float | None) -> None:
    rng = np.random.default_rng(2)
    values = rng.normal(0, 20, (23, 31))
    values[rng.random(values.shape) < 0.2] = np.nan
    packed = pack_values(values, step)
    codes = undo(packed.data, *values.shape)
    back = np.where(codes > 0, packed.lo + (codes.astype(float) - 1) * packed.step, np.nan)
    np.testing.assert_allclose(back, values, atol=0.50001 * packed.step)
    assert packed.step == step or (step is None and packed.step == pytest.approx(np.ptp(values[codes > 0]) / (LEVELS - 1)))


def test_a_step_too_fine_for_16_bits_grows_by_tens() -> None:
    assert pack_values(np.array([[0.0, 9000.0]]), 0.01).step == pytest.approx(1.0)
    assert pack_values(np.full((2, 2), np.nan)).step > 0
    assert pack_values(np.full((2, 2), 3.0)).lo == 3


def test_readings_have_four_digits() -> None:
    assert [reading_step(0, hi) for hi in (30, 5, 0.4)] == pytest.approx([0.01, 0.001, 0.0001])
    assert reading_step(-12.0, 3.0) == pytest.approx(0.01)


def test_normals_come_back_within_the_stated_angle() -> None:
    rng = np.random.default_rng(3)
    normal = rng.normal(size=(50, 60, 3))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    normal[0, :4] = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 0, 0]]
    codes = undo(pack_normals(normal), 100, 60).astype(float)
    x, y = 2 * (codes.reshape(2, 50, 60) - 1) / OCTAHEDRON - 1
    z = 1 - abs(x) - abs(y)
    x, y = np.where(z < 0, (1 - abs(y)) * np.where(x < 0, -1, 1), x), np.where(z < 0, (1 - abs(x)) * np.where(y < 0, -1, 1), y)
    back = np.stack([x, y, z], -1) / np.linalg.norm(np.stack([x, y, z], -1), axis=2, keepdims=True)
    known = codes.reshape(2, 50, 60)[0] > 0
    assert not known[0, 3]
    assert known.sum() == 50 * 60 - 1
    angle = np.degrees(2 * np.arcsin(np.linalg.norm((back - normal)[known], axis=1) / 2))
    assert angle.max() < 0.06


def test_a_window_shows_pixels_as_they_are() -> None:
    mask = np.zeros((300, 500), bool)
    mask[50:250, 40:460] = True
    window = Window.around(mask, 128, 0.1)
    values = np.arange(300 * 500).reshape(300, 500)
    cut = window.cut(values)
    assert max(cut.shape) <= 128
    assert cut[5, 7] == values[window.rows.start + 5 * window.rows.step, window.columns.start + 7 * window.columns.step]
    assert window.rows.start <= 50
    assert window.columns.stop >= 460
    assert cut.shape == window.shape
    assert Window.whole(values).shape == values.shape


@pytest.mark.parametrize(
    ("light", "said", "place"),
    [
        ((0, 0, 2), "along the view", (0, 0)),
        ((1, 0, 1), "45° off the view, from the right", (0.7071, 0)),
        ((-1, 1, 0), "90° off the view, from the upper left", (-0.7071, -0.7071)),
        ((0.1, -1, 0.2), "79° off the view, from the bottom", (0.0976, 0.9759)),
        ((1, 0, -1), "135° off the view, from the right", (1, 0)),
    ],
)
def test_lights_are_placed_as_the_camera_sees_them(light: tuple[float, ...], said: str, place: tuple[float, float]) -> None:
    assert words(light).startswith(said)
    assert places([np.array(light)])[0] == pytest.approx(place, abs=1e-3)


def unpack(packed: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """What the viewer makes of the packed mesh, written from the format's description."""
    data, at, h = zlib.decompress(packed.data), 0, packed.header

    def plane(kind: str, length: int) -> np.ndarray:
        nonlocal at
        steps = np.frombuffer(data, kind, length, at)
        at += steps.nbytes
        return np.cumsum(steps, dtype=steps.dtype)

    index = plane("<u4", 3 * h["triangles"]).reshape(-1, 3)
    n = h["vertices"]
    position = np.stack([plane("<u2", n) / 65535 * h["span"][i] + h["lo"][i] for i in range(3)], 1)
    normal = np.stack([plane("<u2", n).view("<i2") / 2047 for _ in range(3)], 1)
    colour = np.stack([plane("<u1", n) for _ in range(3)], 1) if h["colours"] else None
    assert at == len(data)
    return index, position, normal, colour


@pytest.mark.parametrize("colours", [True, False])
def test_a_small_mesh_survives_packing(colours: bool) -> None:
    mesh = dome(colours=colours)
    index, position, normal, colour = unpack(pack(mesh, None, 10_000))
    np.testing.assert_array_equal(index, mesh.faces)
    np.testing.assert_allclose(position, mesh.vertices, atol=0.01 / 65535)
    np.testing.assert_allclose(normal, mesh.vertex_normals, atol=0.001)
    if colours:
        np.testing.assert_array_equal(colour, mesh.visual.vertex_colors[:, :3])
    else:
        assert colour is None


def test_given_colours_come_before_the_meshs_own() -> None:
    mesh = dome()
    given = np.full((len(mesh.vertices), 3), 77, np.uint8)
    colour = unpack(pack(mesh, given, 10_000))[3]
    assert colour is not None
    assert (colour == 77).all()
    with pytest.raises(InputError, match="one colour a vertex"):
        pack(mesh, given[:-1], 10_000)


def test_a_mesh_of_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="needs triangles"):
        pack(trimesh.Trimesh(np.zeros((3, 3)), np.zeros((0, 3), int), process=False), None, 100)


@pytest.mark.parametrize("limit", [20_000, 3_000, 500])
def test_clustering_keeps_the_surface(limit: int) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=3.0)  # 20 480 triangles
    vertices, triangles, _ = cluster(np.asarray(mesh.vertices), np.asarray(mesh.faces), np.zeros((len(mesh.vertices), 0)), limit)
    assert limit / 4 < len(triangles) <= limit
    cell = 3.0 * np.sqrt(4 * np.pi / len(triangles)) * 2
    assert abs(np.linalg.norm(vertices, axis=1) - 3).max() < cell**2 / 3
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    outward = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) > 0
    assert outward.mean() > 0.97
    assert np.unique(triangles).tolist() == list(range(len(vertices)))


def test_the_page_says_when_the_mesh_was_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "Shown with" not in render_page(Page("p", mesh=dome()))
    monkeypatch.setattr(pages, "MAX_TRIANGLES", 500)
    assert re.search(r"Shown with \d+ of its 3,042 triangles", render_page(Page("p", mesh=dome())))


@pytest.mark.parametrize(("lo", "hi"), [(0.0, 1.0), (-0.003, 0.011), (12345.0, 12399.0), (0.0, 0.0), (-7.0, -7.0), (1e-9, 3e-9)])
def test_ticks_are_round_and_span_the_range(lo: float, hi: float) -> None:
    values = np.array(ticks(lo, hi, 5))
    steps = np.diff(values)
    assert values[0] <= lo + 1e-12 * abs(lo)
    assert values[-1] >= hi - 1e-12 * abs(hi)
    assert 2 <= len(values) <= 9
    mantissa = steps[0] / 10 ** np.floor(np.log10(steps[0]) + 1e-9)
    assert min(abs(mantissa - m) for m in (1, 2, 5, 10)) < 1e-6
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)


def test_mesh_header_is_json() -> None:
    text = render_page(Page("p", mesh=dome(), mesh_unit="px"))
    found = re.search(r'class="mesh-header">(.*?)</script>', text)
    assert found is not None
    assert json.loads(found[1])["unit"] == "px"
