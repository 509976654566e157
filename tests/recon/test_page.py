"""The offline page: one valid file that asks for nothing, trusts no text, and works in a browser."""

from __future__ import annotations

import base64
import hashlib
import html.parser
import io
import json
import re
import shutil
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from gen.errors import InputError
from recon import page as pages
from recon.page import render_page, write_page
from recon.page_mesh import cluster, pack
from recon.page_parts import Bar, Figure, Gallery, Note, Page, Plot, Row, Section, Series, Table, Wipe
from recon.page_plot import ticks
from recon.pictures import sphere_legend
from recon.tables import Column

HOSTILE = (
    """<script>document.title='owned'</script><img src=x onerror="document.title='owned'">"'&amp;{{ 7*7 }}</script></style>"""
)


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
        ),
        Gallery(name, {name: [flat(30), flat(120)], "matte": [flat(70), flat(170)]}, [name, "two"], name, {name: name}),
        Wipe(name, flat(40), flat(220), (name, name), name),
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


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (Table("t", ["a", "b"], [[1]]), "row 1 of the table 't' has 1 cells for 2 columns"),
        (Gallery("g", {"a": [flat(1)], "b": []}), "same number of pictures"),
        (Gallery("g", {}), "same number of pictures"),
        (Gallery("g", {"a": [flat(1)]}, ["x", "y"]), "2 names for 1 frames"),
        (Wipe("w", flat(1), flat(1, 20)), "differ in size"),
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


# ---- in a browser ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium: Debian's or Google's own, as Playwright's download is not needed for one engine."""
    sync = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no Chromium here; install the package chromium")
    arguments = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=arguments)
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Any]:
    """A function that opens a page with the network cut; at the end no complaint and no request may have been seen."""
    contexts, trouble = [], []

    def load(page: Page, wait: bool = True, **options: Any) -> Any:
        path = tmp_path / "report.html"
        write_page(path, page)
        context = browser.new_context(offline=True, viewport={"width": 1000, "height": 900}, **options)
        contexts.append(context)
        tab = context.new_page()
        tab.on("console", lambda message: trouble.append(message.text) if message.type in ("error", "warning") else None)
        tab.on("pageerror", lambda error: trouble.append(str(error)))
        tab.on(
            "request",
            lambda request: trouble.append(request.url) if not request.url.startswith(("data:", "file:", "blob:")) else None,
        )
        tab.goto(path.as_uri())
        if wait:
            tab.wait_for_selector(".stage[data-state=drawn]", timeout=20_000)
        return tab

    yield load
    for context in contexts:
        context.close()
    # Software rendering makes Chromium remark on its own driver; that is not the page's doing.
    assert not [line for line in trouble if "GPU stall" not in line]


def shot(target: Any) -> np.ndarray:
    """What a tab or an element of it looks like, (H, W, 3), once pending frames are drawn."""
    getattr(target, "page", target).wait_for_timeout(150)
    with Image.open(io.BytesIO(target.screenshot())) as picture:
        return np.asarray(picture.convert("RGB"), dtype=int)


@pytest.mark.browser
def test_the_mesh_is_drawn_and_turns(opened: Any) -> None:
    tab = opened(full_page(mesh=dome()))
    stage = tab.locator(".stage")
    front = shot(stage)
    height, width, _ = front.shape
    middle = front[height // 2 - 40 : height // 2 + 40, width // 2 - 40 : width // 2 + 40]
    assert middle.std() > 2  # shaded, not one colour
    assert abs(middle.mean() - front[20:60, 20:60].mean()) > 20  # and not the background
    assert not tab.locator(".fallback").is_visible()

    box = stage.bounding_box()
    tab.mouse.move(box["x"] + width / 2, box["y"] + height / 2)
    tab.mouse.down()
    tab.mouse.move(box["x"] + width / 2 + 90, box["y"] + height / 2 + 30, steps=4)
    tab.mouse.up()
    assert abs(shot(stage) - front).mean() > 1

    stage.press("Home")
    assert abs(shot(stage) - front)[8:-8, 8:-8].max() <= 2  # all but the focus ring
    stage.press("ArrowRight")
    assert abs(shot(stage) - front).mean() > 0.3


@pytest.mark.browser
def test_the_mesh_starts_with_the_cameras_view_and_its_colours(opened: Any) -> None:
    tab = opened(full_page(mesh=dome()))
    tab.get_by_role("button", name="Albedo").click()
    picture = shot(tab.locator(".stage"))
    y, x = picture.shape[0] // 2, picture.shape[1] // 2
    left, right = picture[y, x - 60], picture[y, x + 60]
    assert right[0] > right[2] + 60  # red is to the right, as in the mesh
    assert left[2] > left[0] + 60
    tab.get_by_role("button", name="Normals").click()
    picture = shot(tab.locator(".stage"))
    np.testing.assert_allclose(picture[y, x], [128, 128, 255], atol=8)
    assert picture[y - 100, x][1] > 150  # up is green
    assert picture[y, x + 100][0] > 150  # right is red


@pytest.mark.browser
def test_the_ruler_measures_the_mesh(opened: Any) -> None:
    tab = opened(full_page(mesh=dome()))
    tab.get_by_role("button", name="Normals").click()
    picture = shot(tab.locator(".stage"))
    row = picture[picture.shape[0] // 2]
    width = np.ptp(np.flatnonzero(row.max(axis=1) - row.min(axis=1) > 30)) + 1  # the dome is 10 mm wide
    length = tab.locator(".ruler i").bounding_box()["width"]
    number, unit = tab.locator(".ruler span").inner_text().split()
    assert unit == "mm"
    assert length / float(number) == pytest.approx(width / 10, rel=0.04)


@pytest.mark.browser
def test_tabs_and_slider_work_by_keyboard(opened: Any) -> None:
    tab = opened(full_page(), wait=False)
    picture = tab.locator(".gallery .frames img:visible")

    def level() -> int:
        return int(shot(picture)[300, 300, 0])

    assert level() == 30
    first = tab.get_by_role("tab").first
    first.focus()
    tab.keyboard.press("ArrowRight")
    assert tab.get_by_role("tab", selected=True).inner_text() == "matte"
    assert level() == 70
    tab.get_by_role("slider", name="Picture").focus()
    tab.keyboard.press("ArrowRight")
    assert level() == 170
    assert tab.locator(".gallery output").inner_text() == "2 of 2: two"
    tab.get_by_role("tab", name="matte").focus()
    tab.keyboard.press("Home")
    assert level() == 120


@pytest.mark.browser
def test_the_divider_shows_more_of_one_picture(opened: Any) -> None:
    tab = opened(full_page(), wait=False)
    pair = tab.locator(".pair")

    def share_of_left() -> float:
        return float((shot(pair)[100, :, 0] < 100).mean())

    assert share_of_left() == pytest.approx(0.5, abs=0.02)
    box = pair.bounding_box()
    tab.mouse.move(box["x"] + box["width"] * 0.5, box["y"] + 100)
    tab.mouse.down()
    tab.mouse.move(box["x"] + box["width"] * 0.8, box["y"] + 100, steps=3)
    tab.mouse.up()
    assert share_of_left() == pytest.approx(0.8, abs=0.02)
    tab.locator(".pair input").press("Home")
    assert share_of_left() < 0.03


@pytest.mark.browser
def test_a_figure_enlarges_and_closes(opened: Any) -> None:
    tab = opened(full_page(), wait=False)
    tab.locator(".enlarge").first.click()
    assert tab.locator("dialog img").bounding_box()["width"] > 500
    tab.keyboard.press("Escape")
    assert not tab.locator("dialog").is_visible()


@pytest.mark.browser
def test_a_table_is_copied_as_csv(opened: Any) -> None:
    table = Table("t", ["name", Column("error", ".1f", "°")], [['a, "b"', 1.25], ["c", None]])
    tab = opened(Page("p", sections=[Section("s", parts=[table])]), wait=False, permissions=["clipboard-read", "clipboard-write"])
    tab.locator(".csv").click()
    tab.locator(".csv", has_text="Copied").wait_for()
    assert tab.evaluate("navigator.clipboard.readText()") == 'name,error (°)\r\n"a, ""b""",1.25\r\nc,\r\n'


@pytest.mark.browser
@pytest.mark.parametrize("width", [360, 768, 1280])
def test_nothing_spills_sideways_and_hostile_names_do_not_run(opened: Any, width: int) -> None:
    page = full_page(HOSTILE + "x" * 200, dome(12))
    tab = opened(page)
    tab.set_viewport_size({"width": width, "height": 800})
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert tab.title() != "owned"


@pytest.mark.browser
def test_dark_mode_is_dark(opened: Any) -> None:
    light, dark = (shot(opened(Page("p", "text"), wait=False, color_scheme=scheme)).mean() for scheme in ("light", "dark"))
    assert light > 230
    assert dark < 50


@pytest.mark.browser
def test_without_scripts_there_is_a_word_about_the_mesh(opened: Any) -> None:
    tab = opened(full_page(mesh=dome()), wait=False, java_script_enabled=False)
    assert "WebGL" in tab.locator(".fallback").inner_text()
    assert tab.locator(".gallery img:visible").count() == 1
    assert not tab.locator(".controls").is_visible()


def test_mesh_header_is_json() -> None:
    text = render_page(Page("p", mesh=dome(), mesh_unit="px"))
    found = re.search(r'class="mesh-header">(.*?)</script>', text)
    assert found is not None
    assert json.loads(found[1])["unit"] == "px"
