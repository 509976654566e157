"""From rows to tables: means with spread, paired intervals, the gap closed, objects in columns, and what could not be measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon.benchmark.cells import YARDSTICK, Row
from recon.benchmark.published import published
from recon.benchmark.spec import Combination
from recon.normals.reliability import of_tally

RESAMPLES = 2000
"""Of the bootstrap."""

FIGURES = (
    "normals",
    "median",
    "eroded",
    "lit by all",
    "of range",
    "height MSE",
    "normal MSE",
    "non-glossy",
    "picture MSE",
    "measured",
)
"""What is averaged over units, beside the mean and standard deviation of "normals"."""

PUBLISHED_LIGHTS = 20
"""Fewest lights of a measurement that published figures of 96 lights stand beside."""

LEAST_GAP = 0.05
"""Degrees of mean gap between the glossy and the non-glossy pictures under which nothing is said of closing it."""


def summarise(rows: Sequence[Row], combinations: Sequence[Combination], seed: int) -> dict[str, Any]:
    """The summary of a run.

    "ranking": for each combination that measured every unit, by mean error: names, "units", the means of `FIGURES`, "sd" of the error
    over units, "reliability" (see `recon.normals.reliability.Reliability`), "difference" to the glossy pictures by the same solver and
    integrator (degrees, below 0 is better) with "interval", its 95 % paired bootstrap interval over captures and their draws, "gap
    closed" with "gap interval", and "seconds" a unit. "left out": combinations that failed in some unit, with the first reason and how
    often. "objects": of each combination, its names and "errors", group -> mean error.
    "published": rows of `recon.benchmark.published` for the groups that are there, unless few lights were used. seed: of the bootstrap;
    the same rows give the same summary.
    """
    by: dict[Combination, list[Row]] = {c: [] for c in combinations}
    for row in rows:
        by[(row["gloss"], row["repair"], row["normals_by"], row["height_by"])].append(row)
    whole = {c: found for c, found in by.items() if found and all(row.get("normals") is not None for row in found)}
    failed = {c: [row for row in found if row.get("normals") is None] for c, found in by.items() if c not in whole}
    captures = [row["capture"] for row in next(iter(by.values()), [])]
    draws = resamples(captures, seed)
    groups = list(dict.fromkeys(row["group"] for row in rows))
    ranking = sorted((_ranked(c, found, whole, draws) for c, found in whole.items()), key=lambda entry: float(entry["normals"]))
    return {
        "units": len(captures),
        "captures": len(set(captures)),
        "groups": groups,
        "ranking": ranking,
        "left out": [
            {**_names(c), "failed": len(found), "why": str(found[0].get("failed", "nothing was measured"))}
            for c, found in failed.items()
        ],
        "objects": [
            {**_names(c), "errors": {g: float(np.mean([row["normals"] for row in found if row["group"] == g])) for g in groups}}
            for c, found in sorted(whole.items(), key=lambda item: float(np.mean([row["normals"] for row in item[1]])))
        ],
        "published": {} if any(len(row["lights"]) < PUBLISHED_LIGHTS for row in rows) else published(groups),
    }


def resamples(captures: Sequence[str], seed: int) -> NDArray[np.int64]:
    """Indices of units (`RESAMPLES`, n) for a paired bootstrap: captures are drawn, then draws within each; one capture's draws alone.

    captures: the capture of each unit; all have as many units.
    """
    rng = np.random.default_rng(seed)
    names = list(dict.fromkeys(captures))
    members = [np.flatnonzero([c == name for c in captures]) for name in names]
    if len(names) == 1:
        return rng.choice(members[0], (RESAMPLES, len(members[0])))
    result = []
    for _ in range(RESAMPLES):
        chosen = rng.integers(0, len(names), len(names))
        result.append(np.concatenate([rng.choice(members[i], len(members[i])) for i in chosen]))
    return np.array(result)


def _ranked(c: Combination, found: list[Row], whole: Mapping[Combination, list[Row]], draws: NDArray[np.int64]) -> dict[str, Any]:
    errors = _errors(found)
    entry: dict[str, Any] = {**_names(c), "units": len(found), "sd": float(errors.std(ddof=1)) if len(errors) > 1 else None}
    for figure in FIGURES:
        values = [row[figure] for row in found if row.get(figure) is not None and np.isfinite(row[figure])]
        if len(values) == len(found):
            entry[figure] = float(np.mean(values))
    counted = [row["reliability"] for row in found if "reliability" in row]
    if counted and np.sum(counted, axis=0)[:-1, 0].any():
        entry["reliability"] = asdict(of_tally(np.sum(counted, axis=0)))
    entry["seconds"] = float(np.mean([row["seconds"]["gloss"] + row["seconds"]["rest"] for row in found]))
    glossy, matte = (whole.get((name, "none", *c[2:])) for name in ("none", YARDSTICK))
    if glossy is None:
        return entry
    apart = errors - _errors(glossy)
    entry["difference"] = float(apart.mean())
    if len(errors) > 1:
        entry["interval"] = [float(v) for v in np.percentile(apart[draws].mean(1), [2.5, 97.5])]
    if matte is not None:
        gap = _errors(glossy) - _errors(matte)
        if gap.mean() > LEAST_GAP:
            entry["gap closed"] = float(-apart.sum() / gap.sum())
            below = gap[draws].sum(1)
            if len(errors) > 1 and (below > 0).all():
                entry["gap interval"] = [float(v) for v in np.percentile(-apart[draws].sum(1) / below, [2.5, 97.5])]
    return entry


def _errors(rows: Sequence[Row]) -> NDArray[np.float64]:
    return np.array([row["normals"] for row in rows], np.float64)


def _names(c: Combination) -> dict[str, str]:
    return {"gloss": c[0], "repair": c[1], "normals_by": c[2], "height_by": c[3]}


def label(entry: Mapping[str, Any], entries: Sequence[Mapping[str, Any]]) -> str:
    """A combination's name, of the methods that differ among the entries; its remover where none does."""
    parts = [k for k in ("gloss", "repair", "normals_by", "height_by") if len({e[k] for e in entries}) > 1] or ["gloss"]
    return ", ".join(str(entry[part]) for part in parts)


def markdown(name: str, summary: Mapping[str, Any]) -> str:
    """The summary as Markdown tables."""
    ranking = summary["ranking"]
    lines = [
        f"# {name}",
        "",
        f"{counted(summary['units'], 'measurement')} of {counted(summary['captures'], 'capture')}; mean angular error in degrees",
        "",
    ]
    columns: dict[str, Callable[[Mapping[str, Any]], str]] = {
        "error": lambda e: _text(e["normals"]) + (f" ± {e['sd']:.2f}" if e.get("sd") is not None else ""),
        "median": lambda e: _text(e.get("median")),
        "less than glossy by (95 %)": lambda e: _between(e.get("difference"), e.get("interval"), -1),
        "gap closed (95 %)": lambda e: _between(e.get("gap closed"), e.get("gap interval")),
        "height, % of range": lambda e: _text(e.get("of range")),
        "height MSE": lambda e: _text(e.get("height MSE"), ".1f"),
        "picture MSE": lambda e: _text(e.get("picture MSE"), ".1f"),
        "s": lambda e: _text(e["seconds"]),
    }
    lines += [f"| methods | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]
    lines += [f"| {label(e, ranking)} | {' | '.join(of(e) for of in columns.values())} |" for e in ranking]
    if len(summary["groups"]) > 1 or summary["published"]:
        groups = summary["groups"]
        lines += ["", f"| by object | {' | '.join(groups)} |", "|---|" + "---|" * len(groups)]
        lines += [
            f"| {label(e, summary['objects'])} | {' | '.join(_text(e['errors'][g]) for g in groups)} |"
            for e in summary["objects"]
        ]
        for row, values in summary["published"].items():
            lines.append(f"| {row}, published, 96 lights | {' | '.join(_text(values.get(g)) for g in groups)} |")
    for entry in summary["left out"]:
        lines += [
            "",
            f"Left out: {', '.join(str(entry[k]) for k in ('gloss', 'repair', 'normals_by', 'height_by'))}: {entry['why']}",
        ]
    return "\n".join(lines) + "\n"


def _text(value: float | None, form: str = ".2f") -> str:
    return "-" if value is None else format(value, form)


def _between(value: float | None, interval: Sequence[float] | None, sign: int = 1) -> str:
    if value is None:
        return "-"
    text = f"{sign * value + 0.0:.2f}"
    if interval is None:
        return text
    low, high = sorted(sign * v + 0.0 for v in interval)
    return f"{text} ({low:.2f} to {high:.2f})"


def counted(count: int, noun: str) -> str:
    """A number and its noun: "1 capture", "2 captures"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"
