"""Curves as SVG for a page: sharp at any size, in the page's own colours, light and dark."""

from __future__ import annotations

import math
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from gen.errors import InputError

if TYPE_CHECKING:
    from recon.page_parts import Plot

WIDTH, HEIGHT = 760.0, 300.0
LEFT, RIGHT, TOP, BOTTOM = 64.0, 14.0, 12.0, 48.0
MAX_SERIES = 6
MAX_POINTS = 2000
"""Longer curves are thinned for the page: it is at most that many pixels wide."""


def curves(plot: Plot) -> str:
    """The plot as an `<svg>` element; all text in it is escaped. Raises InputError for no, too many or uneven series."""
    if not 1 <= len(plot.series) <= MAX_SERIES:
        raise InputError(f"the plot {plot.title!r} needs 1 to {MAX_SERIES} curves, it has {len(plot.series)}")
    data = []
    for series in plot.series:
        x, y = (np.asarray(v, dtype=np.float64) for v in (series.x, series.y))
        if x.ndim != 1 or x.shape != y.shape or not np.isfinite(x).all():
            raise InputError(f"the curve {series.name!r} of {plot.title!r} needs as many finite x as y")
        stride = max(1, math.ceil(len(x) / MAX_POINTS))
        data.append((x[::stride], y[::stride]))
    xs, ys = np.concatenate([x for x, _ in data]), np.concatenate([y for _, y in data])
    ys = ys[np.isfinite(ys)]
    if not xs.size or not ys.size:
        raise InputError(f"the plot {plot.title!r} has no finite point")
    x_ticks, y_ticks = ticks(float(xs.min()), float(xs.max()), 7), ticks(float(ys.min()), float(ys.max()), 5)
    x0, x1 = float(xs.min()), float(xs.max())
    if x1 == x0:
        x0, x1 = x0 - 0.5, x1 + 0.5
    y0, y1 = y_ticks[0], y_ticks[-1]

    def at(x: float, y: float) -> tuple[float, float]:
        return (
            LEFT + (x - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT),
            HEIGHT - BOTTOM - (y - y0) / (y1 - y0) * (HEIGHT - TOP - BOTTOM),
        )

    out = [f'<svg class="plot" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{escape(plot.title)}">']
    for tick in y_ticks:
        h = at(x0, tick)[1]
        out.append(f'<path class="grid" d="M{LEFT:g} {h:.1f}H{WIDTH - RIGHT:g}"/>')
        out.append(f'<text class="tick" x="{LEFT - 8:g}" y="{h + 4:.1f}" text-anchor="end">{_tick(tick, y_ticks)}</text>')
    base = HEIGHT - BOTTOM
    out.append(f'<path class="axis" d="M{LEFT:g} {base:g}H{WIDTH - RIGHT:g}"/>')
    for tick in x_ticks:
        if x0 - 1e-9 * (x1 - x0) <= tick <= x1 + 1e-9 * (x1 - x0):
            w = at(tick, y0)[0]
            out.append(f'<path class="axis" d="M{w:.1f} {base:g}v4"/>')
            out.append(f'<text class="tick" x="{w:.1f}" y="{base + 18:g}" text-anchor="middle">{_tick(tick, x_ticks)}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    out.append(f'<text class="title" x="{middle:g}" y="{HEIGHT - 8:g}" text-anchor="middle">{escape(plot.x_title)}</text>')
    centre = (TOP + base) / 2
    out.append(
        f'<text class="title" transform="translate(14 {centre:g}) rotate(-90)" text-anchor="middle">{escape(plot.y_title)}</text>'
    )
    for i, ((x, y), series) in enumerate(zip(data, plot.series, strict=True)):
        path, pen = [], "M"
        for u, v in zip(x.tolist(), y.tolist(), strict=True):
            if math.isfinite(v):
                w, h = at(u, v)
                path.append(f"{pen}{w:.1f} {h:.1f}")
                pen = "L"
            else:
                pen = "M"
        out.append(f'<path class="curve c{i}{" dashed" if series.dashed else ""}" d="{"".join(path)}"/>')
    out.append("</svg>")
    return "".join(out)


def ticks(lo: float, hi: float, about: int) -> list[float]:
    """Round values (1, 2 or 5 times a power of ten apart) that span lo to hi, roughly `about` of them, at least two."""
    if not hi > lo:
        lo, hi = lo - (abs(lo) or 1) / 2, hi + (abs(hi) or 1) / 2
    raw = (hi - lo) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= raw * (1 - 1e-9))
    first, last = math.floor(lo / step + 1e-9), math.ceil(hi / step - 1e-9)
    return [i * step for i in range(first, last + 1)]


def _tick(value: float, among: list[float]) -> str:
    step = min(b - a for a, b in pairwise(among))
    largest = max(abs(v) for v in among)
    if largest >= 1e5 or largest < 1e-3:
        return f"{value:.3g}".replace("-", "\N{MINUS SIGN}") if abs(value) > step / 2 else "0"
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value if abs(value) > step / 2 else 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}")
