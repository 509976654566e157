"""The controls of a page in headless Chromium: each does what it says, against the arrays that the page was made of."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from gen.srgb import linear_to_srgb
from recon.page import write_page
from recon.page_parts import Bar, Gallery, Map, NormalMap, Page, Profile, Row, Section, Table, Window
from recon.pictures import OUTSIDE, colour_strip
from recon.tables import Column
from tests.pages import CHECKS, Opened, canvas_of, open_page, stage_of
from tests.recon.test_page import HOSTILE, dome, flat, full_page

pytestmark = pytest.mark.browser

WINDOW = Window(slice(4, 84, 2), slice(10, 122, 2), 0.25)
"""40 x 56 of the pixels of the arrays, half a millimetre apart."""

RNG = np.random.default_rng(7)
ERRORS = RNG.uniform(0, 40, (90, 130))
ERRORS[:30, 60:] = np.nan
OFFSETS = RNG.normal(0, 2, (90, 130))
ROW, COLUMN = np.mgrid[:90, :130].astype(float)
HEIGHT = 3 * np.sin(ROW / 9) * np.cos(COLUMN / 14)
HEIGHT[:14] = np.nan
TRUE = HEIGHT + 0.01 * COLUMN
NORMAL = np.stack([np.cos(COLUMN / 20) * 0.5, np.sin(ROW / 15) * 0.6, np.ones_like(ROW)], -1)
NORMAL /= np.linalg.norm(NORMAL, axis=2, keepdims=True)
NORMAL[:, :14] = 0
ALBEDO = RNG.integers(60, 256, (90, 130, 3), dtype=np.uint8)
LIGHTS = np.array([[0, 0, 1], [0.6, 0, 0.8], [-0.6, 0.6, 0.53]])
NAMES = ["left.png", "middle.png", "right.png"]
LEVELS = {"input": (30, 120, 210), "gloss removed": (60, 150, 240), "matte": (90, 180, 20)}
TABLE = Table(
    "Figures", ["name", Column("error", ".1f", "°"), Column("n", ".0f")], [['a, "b"', 1.25, 12000], ["c", None, float("nan")]]
)


@pytest.fixture(scope="module")
def parts(chromium: Any, tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """A page of every part that answers, from the arrays above."""
    layers = {name: [flat(level) for level in levels] for name, levels in LEVELS.items()}
    bar = Bar(0, 30, "°", above=True)
    shown = [
        Gallery("Pictures", layers, NAMES, lights=LIGHTS, against="gloss removed", slider="Light"),
        Row(
            [
                Map("Error", WINDOW.cut(ERRORS), bar, WINDOW),
                Map("Offset", WINDOW.cut(OFFSETS), Bar(-5, 5, "mm", "signed"), WINDOW),
            ]
        ),
        NormalMap("Normals", WINDOW.cut(NORMAL), WINDOW, WINDOW.cut(ALBEDO)),
        Profile("Height", WINDOW.cut(HEIGHT), flat(120, 56)[:40], WINDOW, "mm", Bar(-3, 3, "mm", "height"), WINDOW.cut(TRUE)),
        TABLE,
    ]
    path = tmp_path_factory.mktemp("parts") / "report.html"
    write_page(path, Page("parts", "text", [Section("s", parts=shown)]))
    return open_page(chromium, path)


@pytest.fixture(scope="module")
def mesh(chromium: Any, tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """A page of a mesh alone: a dome 10 mm wide, red to the right and blue to the left."""
    path = tmp_path_factory.mktemp("mesh") / "report.html"
    write_page(path, Page("dome", mesh=dome(20)))
    return open_page(chromium, path)


@pytest.fixture
def tab(parts: Opened) -> Any:
    """The page as earlier tests left it; at the end nothing may have gone wrong."""
    parts.trouble.clear()
    yield parts.tab
    assert parts.trouble == []


def at(pane: Any, column: float, row: float) -> tuple[float, float]:
    """Where the middle of a pixel of `WINDOW` stands on the screen."""
    pane.scroll_into_view_if_needed()
    box = pane.bounding_box()
    return box["x"] + box["width"] * (column + 0.5) / 56, box["y"] + box["height"] * (row + 0.5) / 40


def level_of(picture: Any) -> int:
    """The grey value in the middle of the file that an <img> shows."""
    return int(
        picture.evaluate(
            """async (e) => { await e.decode(); const c = new OffscreenCanvas(e.naturalWidth, e.naturalHeight), t = c.getContext("2d");
            t.drawImage(e, 0, 0); return t.getImageData(e.naturalWidth / 2, e.naturalHeight / 2, 1, 1).data[0]; }"""
        )
    )


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_a_page_of_every_part(parts: Opened, check: Any) -> None:
    parts.trouble.clear()
    check(parts)
    assert parts.trouble == []


def test_tabs_slider_and_disc_choose_the_picture(tab: Any) -> None:
    gallery = tab.locator(".gallery")
    picture = gallery.locator(".frames img:visible")
    gallery.locator("select").select_option("")
    gallery.get_by_role("tab", selected=True).press("Home")
    gallery.get_by_role("slider", name="Light").press("Home")

    def shown() -> int:
        return level_of(picture)

    assert shown() == 30
    gallery.get_by_role("tab").first.press("ArrowRight")
    assert gallery.get_by_role("tab", selected=True).inner_text() == "gloss removed"
    assert shown() == 60
    gallery.get_by_role("slider", name="Light").press("ArrowRight")
    assert shown() == 150
    assert gallery.locator("output").inner_text() == "2 of 3: middle.png"
    now = gallery.locator(".dial .now")
    assert [float(now.get_attribute(key)) for key in ("cx", "cy")] == pytest.approx([0.6, 0], abs=1e-3)
    assert gallery.locator(".towards").inner_text() == "37° off the view, from the right (0.60, 0.00, 0.80)"
    gallery.locator(".dial").click(position={"x": 40, "y": 40})
    assert shown() == 240
    assert gallery.locator("output").inner_text() == "3 of 3: right.png"
    gallery.get_by_role("tab", selected=True).press("Home")
    assert shown() == 210


def test_the_divider_wipes_between_two_layers(tab: Any) -> None:
    gallery = tab.locator(".gallery")
    pane = gallery.locator(".pane")
    gallery.get_by_role("tab", selected=True).press("Home")
    gallery.get_by_role("slider", name="Light").press("Home")
    gallery.locator("select").select_option("gloss removed")
    assert gallery.locator(".name").all_inner_texts() == ["input", "gloss removed"]

    def sides() -> tuple[int, int, float]:
        """The levels of the picture below and of the one over it, and the share of the width at which that one begins."""
        over = gallery.locator(".over")
        at = float(over.evaluate("(e) => getComputedStyle(e).clipPath").split()[-1].rstrip("%)")) / 100
        return level_of(gallery.locator(".frames img:visible")), level_of(over), at

    assert sides()[:2] == (30, 60)
    pane.scroll_into_view_if_needed()
    box = pane.bounding_box()
    tab.mouse.move(box["x"] + box["width"] * 0.5, box["y"] + 100)
    tab.mouse.down()
    tab.mouse.move(box["x"] + box["width"] * 0.8, box["y"] + 100, steps=3)
    tab.mouse.up()
    assert sides() == (30, 60, 0.8)
    gallery.locator("select").select_option("matte")
    gallery.get_by_role("slider", name="Light").press("End")
    assert sides() == (210, 20, 0.8)
    gallery.locator(".wipe").press("Home")
    assert sides() == (210, 20, 0)
    assert gallery.locator(".divider").bounding_box()["x"] == pytest.approx(box["x"] - 1, abs=1)
    gallery.locator("select").select_option("")
    assert not gallery.locator(".over, .divider, .wipe").locator("visible=true").count()


def test_maps_show_and_say_their_values(tab: Any) -> None:
    figures = tab.locator(".map")
    cut = WINDOW.cut(ERRORS)
    table = colour_strip("error", 256)[0]
    wanted = np.where(np.isnan(cut)[..., None], OUTSIDE, table[np.rint(np.clip(np.nan_to_num(cut) / 30, 0, 1) * 255).astype(int)])
    # A value is rounded to what is read, so it may fall on the next colour
    assert (abs(canvas_of(figures.first)[..., :3] - wanted).max(axis=2) <= 4).all()

    for column, row in ((3, 30), (40, 35), (30, 2)):
        tab.mouse.move(*at(figures.first.locator(".pane"), column, row))
        value, offset = cut[row, column], WINDOW.cut(OFFSETS)[row, column]
        said = "no value" if np.isnan(value) else f"{value:.2f}°"
        place = f"at row {4 + 2 * row + 1}, column {10 + 2 * column + 1}"
        assert figures.first.locator(".reading").inner_text() == f"{said} {place}"
        assert figures.last.locator(".reading").inner_text() == f"{offset:.3f}\u202fmm {place}".replace("-", "\u2212")
    figures.last.locator(".pane").press("ArrowDown")
    assert f"row {4 + 2 * 3 + 1}, column {10 + 2 * 30 + 1}" in figures.first.locator(".reading").inner_text()
    figures.last.locator(".pane").press("Shift+ArrowLeft")
    assert f"{WINDOW.cut(OFFSETS)[3, 20]:.3f}".replace("-", "\u2212") in figures.last.locator(".reading").inner_text()
    ruler, pane = (figures.first.locator(name).bounding_box()["width"] for name in (".ruler", ".pane"))
    number, unit = figures.first.locator(".ruler").inner_text().split()
    assert unit == "mm"
    assert ruler / pane == pytest.approx(float(number) / (56 * 0.5), rel=0.02)


def test_a_map_enlarges_and_closes(tab: Any) -> None:
    tab.locator(".enlarge").first.click()
    assert tab.locator("dialog img").bounding_box()["width"] > 500
    assert tab.locator("dialog img").evaluate("(i) => i.decode().then(() => i.naturalWidth)") == 56
    tab.keyboard.press("Escape")
    assert not tab.locator("dialog").is_visible()


def test_normals_are_read_on_the_map_and_on_the_sphere(tab: Any) -> None:
    figure = tab.locator(".normals")
    figure.locator("[data-mode=normals]").click()
    normal = WINDOW.cut(NORMAL)
    picture = canvas_of(figure)
    np.testing.assert_allclose(picture[:, 2:, :3], (normal[:, 2:] + 1) / 2 * 255, atol=1)
    assert (picture[:, :2, :3] == OUTSIDE).all()
    tab.mouse.move(*at(figure.locator(".pane"), 30, 12))
    x, y, z = normal[12, 30]
    reading = figure.locator(".reading").inner_text().replace("\u2212", "-")
    numbers = [float(part.strip("(),°")) for part in reading.split(" off")[0].split()]
    assert numbers == pytest.approx([x, y, z, np.degrees(np.arccos(z))], abs=0.06)
    sphere, spot = (figure.locator(name).bounding_box() for name in (".sphere img", ".spot"))
    place = [spot[k] + spot[s] / 2 - sphere[k] - sphere[s] / 2 for k, s in (("x", "width"), ("y", "height"))]
    assert place == pytest.approx([0.48 * sphere["width"] * x, -0.48 * sphere["height"] * y], abs=1.5)


@pytest.mark.parametrize("mode", ["white", "albedo"])
def test_the_surface_is_lit_by_lamberts_law(tab: Any, mode: str) -> None:
    figure = tab.locator(".normals")
    figure.locator(f"[data-mode={mode}]").click()
    pane = figure.locator(".pane")
    albedo = (WINDOW.cut(ALBEDO) / 255.0) if mode == "albedo" else np.ones((40, 56, 3))
    linear = np.where(albedo <= 0.04045, albedo / 12.92, ((albedo + 0.055) / 1.055) ** 2.4)

    def expected(x: float, y: float) -> np.ndarray:
        light = np.array([x, y, np.sqrt(1 - x * x - y * y)])
        shade = np.maximum(WINDOW.cut(NORMAL) @ light, 0)[..., None]
        lit = np.rint(255 * linear_to_srgb(np.clip(linear * shade, 0, 1)))
        return np.where((WINDOW.cut(NORMAL) == 0).all(axis=2)[..., None], OUTSIDE, lit)

    box = pane.bounding_box()
    reach = min(box["width"], box["height"]) / 2
    for x, y in ((0.5, 0.3), (-0.7, -0.2)):
        pane.scroll_into_view_if_needed()
        box = pane.bounding_box()
        tab.mouse.move(box["x"] + box["width"] / 2 + x * reach, box["y"] + box["height"] / 2 - y * reach)
        difference = abs(canvas_of(figure)[..., :3] - expected(x, y))
        assert np.percentile(difference, 99) <= 2
        assert difference.max() <= 8  # near the terminator sRGB is steep
    figure.locator(".pane").press("Home")
    assert np.percentile(abs(canvas_of(figure)[..., :3] - expected(0, 0)), 99) <= 2
    figure.locator(".pane").press("ArrowRight")
    assert np.percentile(abs(canvas_of(figure)[..., :3] - expected(0.05, 0)), 99) <= 2
    assert figure.locator(".reading").inner_text() == "light (0.05, 0.00, 1.00), 3° off the view"


@pytest.mark.parametrize("ends", [((5, 20), (50, 20)), ((8, 36), (44, 9)), ((30, 1), (30, 39))], ids=["row", "slant", "column"])
def test_the_profile_is_the_height_along_the_line_drawn(tab: Any, ends: tuple[tuple[int, int], tuple[int, int]]) -> None:
    figure = tab.locator(".profile")
    start, end = (at(figure.locator(".pane"), *place) for place in ends)
    tab.mouse.move(*start)
    tab.mouse.down()
    tab.mouse.move(*end, steps=3)
    tab.mouse.up()
    figure.locator(".csv").click()
    figure.locator(".csv", has_text="Copied").wait_for()
    title, *rows = csv.reader(io.StringIO(tab.evaluate("navigator.clipboard.readText()")))
    assert title == ["along the line (mm)", "measured (mm)", "true (mm)"]
    along, measured, true = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows]).T

    length = np.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1])
    assert along[-1] == pytest.approx(0.5 * length, rel=1e-6)
    share = along / along[-1]
    places = [ends[0][1] + share * (ends[1][1] - ends[0][1]), ends[0][0] + share * (ends[1][0] - ends[0][0])]
    for found, surface in ((measured, HEIGHT), (true, TRUE)):
        wanted = map_coordinates(WINDOW.cut(surface), places, order=1, mode="nearest")
        known = np.isfinite(wanted) & np.isfinite(found)
        assert known.sum() >= 0.6 * len(found)
        np.testing.assert_allclose(found[known], wanted[known], atol=1e-3)
    # The curve that is drawn is those numbers: its y is linear in them
    drawn = figure.locator(".plot .curve.c0").get_attribute("d").replace("M", "L").split("L")[1:]
    x, y = np.array([[float(number) for number in point.split()] for point in drawn]).T
    known = np.isfinite(measured)
    for pixels, values in ((x, along[known]), (y, measured[known])):
        line = np.polyfit(values, pixels, 1)
        assert abs(np.polyval(line, values) - pixels).max() < 0.02
    assert np.polyfit(measured[known], y, 1)[0] < 0  # up is higher
    assert f"{0.5 * length:.2f}\u202fmm long" in figure.locator(".reading").inner_text()


def test_the_ends_of_the_line_move_by_keys_and_buttons(tab: Any) -> None:
    figure = tab.locator(".profile")
    handle = figure.locator(".handle.end")
    figure.get_by_role("button", name="Along the row").click()
    assert figure.locator(".line").last.get_attribute("d").startswith("M0.5 ")
    handle.press("ArrowLeft")
    handle.press("Shift+ArrowUp")
    before = handle.get_attribute("aria-label")
    assert before.endswith(f"column {10 + 2 * 54 + 1}")
    start, box = figure.locator(".handle").first.bounding_box(), handle.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    tab.mouse.move(x, y)
    tab.mouse.down()
    tab.mouse.move(x - 60, y)
    tab.mouse.up()
    assert handle.get_attribute("aria-label") != before
    assert figure.locator(".handle").first.bounding_box() == start  # the other end stays


def test_a_table_is_copied_as_csv(tab: Any) -> None:
    tab.locator(".table .csv").click()
    tab.locator(".table .csv", has_text="Copied").wait_for()
    copied = list(csv.reader(io.StringIO(tab.evaluate("navigator.clipboard.readText()"))))
    assert copied == [["name", "error (°)", "n"], ['a, "b"', "1.25", "12000"], ["c", "", ""]]


def test_the_mesh_turns_by_pointer_and_keys(mesh: Opened) -> None:
    tab = mesh.tab
    front = stage_of(tab, "Home")
    box = tab.locator(".stage").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    tab.mouse.move(x, y)
    tab.mouse.down()
    tab.mouse.move(x + 90, y + 30, steps=2)
    tab.mouse.up()
    assert abs(stage_of(tab) - front).mean() > 1
    assert abs(stage_of(tab, "Home") - front).max() <= 2
    assert abs(stage_of(tab, "ArrowRight") - front).mean() > 0.3
    for name in ("Front", "Oblique"):
        tab.get_by_role("button", name=name).click()
        assert (abs(stage_of(tab) - front).max() <= 2) == (name == "Front")
    assert mesh.trouble == []


def test_the_mesh_starts_from_the_front_and_its_ruler_measures_it(mesh: Opened) -> None:
    tab = mesh.tab
    tab.get_by_role("button", name="Albedo").click()
    picture = stage_of(tab, "Home")
    y, x = picture.shape[0] // 2, picture.shape[1] // 2
    left, right = picture[y, x - 60], picture[y, x + 60]
    assert right[0] > right[2] + 60  # red is to the right, as in the mesh
    assert left[2] > left[0] + 60
    tab.get_by_role("button", name="Normals").click()
    picture = stage_of(tab)
    np.testing.assert_allclose(picture[y, x, :3], [128, 128, 255], atol=8)
    assert picture[y - 100, x, 1] > 150  # up is green
    assert picture[y, x + 100, 0] > 150  # right is red
    width = (picture[y, :, 3] > 128).sum()  # the dome is 10 mm wide
    length = tab.locator(".ruler i").bounding_box()["width"]
    number, unit = tab.locator(".ruler span").inner_text().split()
    assert unit == "mm"
    assert length / float(number) == pytest.approx(width / 10, rel=0.04)
    assert mesh.trouble == []


def test_hostile_names_do_not_run_and_nothing_spills(chromium: Any, tmp_path: Path) -> None:
    write_page(tmp_path / "report.html", full_page(HOSTILE + "x" * 200, dome(12)))
    opened = open_page(chromium, tmp_path / "report.html")
    for width in (360, 768, 1280):
        opened.tab.set_viewport_size({"width": width, "height": 800})
        assert opened.tab.evaluate("document.documentElement.scrollWidth") <= width
    assert opened.tab.title() != "owned"
    assert opened.trouble == []
    opened.tab.close()


def test_the_policy_forbids_what_the_page_does_not_need(chromium: Any, tmp_path: Path) -> None:
    """Neither eval nor a handler in the markup, a foreign script, a style attribute or a request gets past the page's own policy."""
    write_page(tmp_path / "report.html", Page("p"))
    opened = open_page(chromium, tmp_path / "report.html")
    opened.tab.evaluate(
        """() => { window.refused = [];
        document.addEventListener("securitypolicyviolation", (e) => window.refused.push(e.effectiveDirective));
        setTimeout(() => { try { eval("1"); window.ran = "eval"; } catch { } });
        document.body.insertAdjacentHTML("beforeend", '<img src="data:," onerror="window.ran = 1"><p style="color: red">');
        const script = document.createElement("script"); script.textContent = "window.ran = 2"; document.body.append(script);
        fetch("https://degloss.invalid/").catch(() => {}); }"""
    )
    wanted = {"script-src", "script-src-attr", "script-src-elem", "style-src-attr", "connect-src"}
    for _ in range(50):
        if wanted <= set(opened.tab.evaluate("window.refused")):
            break
        opened.tab.wait_for_timeout(20)
    assert wanted <= set(opened.tab.evaluate("window.refused"))
    assert opened.tab.evaluate("window.ran") is None
    opened.tab.close()


def test_without_scripts_pictures_and_words_remain(chromium: Any, tmp_path: Path) -> None:
    write_page(tmp_path / "report.html", full_page(mesh=dome(12)))
    context = chromium.browser.new_context(offline=True, java_script_enabled=False)
    tab = context.new_page()
    tab.goto((tmp_path / "report.html").as_uri())
    assert "WebGL" in tab.locator(".stage .fallback").inner_text()
    assert tab.locator(".gallery img:visible").count() == 1
    assert not tab.locator(".controls:visible").count()
    assert all("scripts are allowed" in text for text in tab.locator("figure:not(.viewer) .fallback").all_inner_texts())
    context.close()
