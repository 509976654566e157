"""Pages in headless Chromium: opened with the network cut, and what must hold of every one of them."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Pixels = NDArray[np.int64]

DESK, PHONE = {"width": 820, "height": 600}, {"width": 390, "height": 800}


@dataclass
class Opened:
    """A tab that shows a page, and what went wrong in it so far: complaints on its console, requests that leave it."""

    tab: Any
    trouble: list[str] = field(default_factory=list)


def open_page(context: Any, path: Path) -> Opened:
    """A page file in a tab of its own, once everything in it is drawn."""
    tab = context.new_page()
    tab.set_viewport_size(DESK)
    opened = Opened(tab)

    def complain(text: str) -> None:
        if "GPU stall" not in text:  # software rendering makes Chromium remark on its own driver; that is not the page's doing
            opened.trouble.append(text)

    tab.on("console", lambda message: complain(message.text) if message.type in ("error", "warning") else None)
    tab.on("pageerror", lambda error: complain(str(error)))
    tab.on("request", lambda asked: None if asked.url.startswith(("data:", "file:", "blob:")) else complain(asked.url))
    tab.goto(path.as_uri())
    drawn(tab)
    return opened


def drawn(tab: Any) -> None:
    """Wait until every canvas and every line of the page is drawn."""
    parts = ".stage, .map .pane, .normals .pane, .profile .pane"
    tab.wait_for_selector(f":is({parts}):not([data-state=drawn])", state="detached", timeout=20_000)


def frame(tab: Any) -> None:
    """Let what was asked for be drawn: two frames."""
    tab.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done())))")


def canvas_of(element: Any) -> Pixels:
    """The pixels of the canvas in an element, (H, W, 4), read back once pending frames are drawn."""
    frame(element.page)
    return _pixels(element.evaluate("""(e) => e.querySelector("canvas").toDataURL()"""))


def stage_of(tab: Any, *keys: str) -> Pixels:
    """The pixels of the mesh's viewer, (H, W, 4), after these keys; read in the frame that draws them, for WebGL keeps none longer."""
    return _pixels(
        tab.evaluate(
            """(keys) => new Promise((done) => {
            const stage = document.querySelector(".stage"), canvas = stage.querySelector("canvas");
            for (const key of keys) stage.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
            requestAnimationFrame(() => done(canvas.toDataURL())); })""",
            list(keys or STILL),
        )
    )


STILL = ("ArrowLeft", "ArrowRight")
"""Keys that leave the mesh as it was, and have it drawn."""


def _pixels(data: str) -> Pixels:
    with Image.open(io.BytesIO(base64.b64decode(data.split(",")[1]))) as picture:
        return np.asarray(picture.convert("RGBA"), dtype=np.int64)


def asks_for_nothing(opened: Opened) -> None:
    """No complaint, no request; every canvas holds a picture, and no part says that it cannot be drawn."""
    tab = opened.tab
    colours, blank = tab.evaluate(
        """() => { const colours = [], blank = [];
        for (const c of document.querySelectorAll(".map canvas, .normals canvas")) {
          const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
          colours.push(new Set(new Uint32Array(d.buffer)).size);
          if (d.some((v, i) => i % 4 === 3 && v !== 255)) blank.push(c.closest("figure").textContent.trim().slice(0, 80));
        }
        return [colours, blank]; }"""
    )
    assert blank == []
    assert max(colours) > 10
    assert tab.locator(".fallback:visible").count() == 0
    if tab.locator(".stage").count():
        picture = stage_of(tab)
        assert 0.05 < (picture[..., 3] > 0).mean() < 0.95
        assert len(np.unique(picture.reshape(-1, 4), axis=0)) > 30  # a shaded surface, not a plain one


def is_light_and_dark(opened: Opened) -> None:
    """Both themes have their ground, and all text stands out of it by the 4.5 to 1 that WCAG 2.2 asks of text (1.4.3)."""
    for scheme in ("light", "dark"):
        opened.tab.emulate_media(color_scheme=scheme)
        ground, poor = opened.tab.evaluate(
            """() => {
            const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
            const linear = (v) => v / 255 <= .04045 ? v / 255 / 12.92 : ((v / 255 + .055) / 1.055) ** 2.4;
            const luminance = ([r, g, b]) => .2126 * linear(r) + .7152 * linear(g) + .0722 * linear(b);
            const behind = (e) => {
              for (; e; e = e.parentElement) {
                const c = rgb(getComputedStyle(e).backgroundColor);
                if (c.length < 4 || c[3] === 1) return c;
              }
            };
            const poor = [];
            const texts = "h1, h2, h3, p, dt, dd, td, th, figcaption, output, a, button, summary, small, select, text, li";
            for (const e of document.querySelectorAll(texts)) {
              if (!e.checkVisibility() || !e.textContent.trim() || e.closest(".pane")) continue;
              const style = getComputedStyle(e);
              const [a, b] = [rgb(e.tagName === "text" ? style.fill : style.color), behind(e)].map(luminance);
              const contrast = (Math.max(a, b) + .05) / (Math.min(a, b) + .05);
              if (contrast < 4.5) poor.push(`${e.tagName}.${e.className}: ${contrast} ${e.textContent.trim().slice(0, 30)}`);
            }
            return [luminance(behind(document.documentElement)), poor]; }"""
        )
        assert ground > 0.9 if scheme == "light" else ground < 0.02
        assert poor == [], scheme
    opened.tab.emulate_media(color_scheme="light")


def fits_a_phone(opened: Opened) -> None:
    """At 390 pixels nothing makes the page scroll sideways, and no text leaves it, tables in their own scroller apart."""
    tab = opened.tab
    tab.set_viewport_size(PHONE)
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    spilt = tab.evaluate(
        """[...document.querySelectorAll("main *, header *, footer *")].filter((e) => e.checkVisibility() && !e.closest(".scroll")
        && !(e instanceof SVGElement) && e.getBoundingClientRect().right > 391).map((e) => e.outerHTML.slice(0, 100))"""
    )
    assert spilt == []
    tab.set_viewport_size(DESK)


def is_reached_by_keyboard(opened: Opened) -> None:
    """Tab reaches every control that is to be seen, in the page's order (of a row of tabs the chosen one; the arrow keys do the rest)."""
    tab = opened.tab
    wanted = tab.evaluate(
        """() => {
        window.controls = [...document.querySelectorAll("a[href], button, select, input, summary, [tabindex='0']")]
        .filter((e) => e.checkVisibility() && e.tabIndex >= 0 && !e.closest("dialog"));
        window.reached = [];
        document.addEventListener("focusin", (e) => window.reached.push(window.controls.indexOf(e.target)));
        window.controls[0].focus();
        return window.controls.length; }"""
    )
    for _ in range(wanted - 1):
        tab.keyboard.press("Tab")
    assert tab.evaluate("window.reached") == list(range(wanted))


def does_what_its_controls_say(opened: Opened) -> None:
    """Every gallery, divider, map, normal map, profile, table and the mesh answers; the page is asked in one go, so by made events."""
    tab = opened.tab
    silent = tab.evaluate(
        """async () => {
        const silent = [];
        const answers = async (what, part, look, act) => {
          const before = look();
          await act();
          await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
          if (look() === before) silent.push(`${what}: ${part.textContent.trim().slice(0, 60)}`);
        };
        const key = (e, key) => e.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
        const slide = (e, value) => { e.value = value; e.dispatchEvent(new Event("input", { bubbles: true })); };
        const picture = (e) => {
          const c = e.querySelector("canvas");
          return c.getContext("2d").getImageData(0, 0, c.width, c.height).data.join();
        };
        for (const part of document.querySelectorAll(".gallery")) {
          const shown = () => [...part.querySelectorAll(".frames > *")].filter((e) => e.checkVisibility()).map((e) => e.outerHTML).join();
          const slider = part.querySelector(".slider input"), tab = part.querySelector("[aria-selected=true]");
          if (slider) await answers("slider", part, shown, () => slide(slider, slider.value === "1" ? 0 : 1));
          if (part.querySelectorAll("[role=tab]").length > 1) await answers("tabs", part, shown, () => key(tab, "ArrowRight"));
          const wipe = part.querySelector(".wipe"), edge = () => getComputedStyle(part.querySelector(".over")).clipPath;
          if (wipe && !wipe.hidden) await answers("divider", part, edge, () => slide(wipe, wipe.value === "10" ? 20 : 10));
        }
        for (const part of document.querySelectorAll(".map, .normals")) {
          const pane = part.querySelector(".pane"), reading = part.querySelector(".reading");
          await answers("reading", part, () => reading.textContent, () => key(pane, "ArrowRight"));
          if (!/at row \\d+, column \\d+$/.test(reading.textContent)) silent.push(reading.textContent);
          part.querySelector("[data-mode=normals]")?.click();
          for (const button of part.querySelectorAll("[data-mode]:not([data-mode=normals])")) {
            await answers("lit", part, () => picture(part), () => button.click());
            await answers("light", part, () => picture(part), () => key(pane, "ArrowRight"));
          }
        }
        for (const part of document.querySelectorAll(".profile")) {
          const curve = () => part.querySelector(".plot .c0").getAttribute("d");
          await answers("line", part, curve, () => part.querySelector("[data-line=column]").click());
          await answers("end", part, curve, () => key(part.querySelector(".handle"), "ArrowDown"));
        }
        for (const part of document.querySelectorAll("figure.table")) {
          part.querySelector(".csv").click();
          while (part.querySelector(".csv").textContent !== "Copied") await new Promise((done) => setTimeout(done));
          const lines = (await navigator.clipboard.readText()).trim().split("\\r\\n").length;
          if (lines !== part.querySelectorAll("tr").length) silent.push(`table: ${lines} lines`);
        }
        return silent; }"""
    )
    assert silent == []
    if tab.locator(".stage").count():
        assert abs(stage_of(tab, "Home") - stage_of(tab, "ArrowRight", "ArrowRight")).mean() > 0.2


CHECKS: tuple[Callable[[Opened], None], ...] = (
    asks_for_nothing,
    is_light_and_dark,
    fits_a_phone,
    is_reached_by_keyboard,
    does_what_its_controls_say,
)
"""What holds of every kind of page."""
