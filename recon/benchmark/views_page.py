"""The page of a benchmark of views: the ranking, the objects, and each object's meshes as two of its views see them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon.benchmark.page import MAX_MAPS, MAX_OBJECTS
from recon.benchmark.summary import counted
from recon.benchmark.views import ViewsUnit
from recon.benchmark.views_tables import EXPLAINED, FIGURES, pixels, views_label
from recon.multiview.measure import LABELS
from recon.page_parts import Bar, Figure, Gallery, Map, Note, Page, Part, Row, Section, Table, Window
from recon.pictures import OUTSIDE, Picture, height_range, relief_picture
from recon.tables import Column

Maps = Mapping[str, NDArray[Any]]

ERRORS_SHOWN = 12
"""Meshes whose errors stand side by side, the best first."""

TRUE_SURFACE = "true surface"


def views_page(name: str, summary: Mapping[str, Any], maps: Iterable[tuple[ViewsUnit, Maps]]) -> Page:
    """The page of a summary (see `recon.benchmark.views_tables.summarise_views`) and the maps of its units, object by object."""
    ranking, objects = summary["ranking"], summary["objects"]
    seen = f"{counted(summary['views'], 'view')} of {counted(len(objects), 'object')}"
    lead = "Nothing could be measured by every combination."
    asked = [e for e in ranking if not e["gloss"].startswith("true-")]
    if asked:
        beside = [
            e for e in ranking if e["gloss"] in LABELS and e["repair"] == "none" and e["normals_by"] == asked[0]["normals_by"]
        ]
        others = ", ".join(f"{LABELS[e['gloss']]} {e['chamfer']:.3f} mm" for e in beside if e is not asked[0])
        lead = (
            f"{seen}. Of the methods that need no truth, {views_label(asked[0], ranking)} comes nearest: mesh and true surface are "
            f"{asked[0]['chamfer']:.3f} mm apart (chamfer distance{f'; {others}' if others else ''})."
        )
    left_out: list[Part] = [Note(f"Left out: {views_label(e, [e, *ranking])}. {e['why']}") for e in summary["left out"]]
    sections = [Section("Ranking", "", [_ranking(summary), *left_out])]
    if len(objects) > 1:
        sections.append(Section("Objects", "", [_objects(summary)]))
    order = {_methods(e): i for i, e in enumerate(ranking)}
    for shown, (_, units) in enumerate(groupby(maps, key=lambda pair: pair[0].path)):
        if shown == MAX_OBJECTS:
            break
        held = [(order[unit.methods], unit, found) for unit, found in units if unit.methods in order]
        if held:
            sections.append(_object(sorted(held, key=lambda each: each[0])[:MAX_MAPS], ranking))
    facts = {"objects": str(len(objects)), "views": str(summary["views"]), "meshes": str(len(objects) * len(ranking))}
    return Page(f"Benchmark {name}", lead, sections, facts=facts)


def _methods(entry: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(entry[k] for k in ("gloss", "repair", "normals_by", "height_by"))


def _ranking(summary: Mapping[str, Any]) -> Table:
    ranking = summary["ranking"]
    columns = [Column("methods", "s"), *(column for _, column in FIGURES.values())]
    rows = [[views_label(e, ranking), *(e.get(name) for name in FIGURES)] for e in ranking]
    caption = EXPLAINED + (f" The pixel: {pixels(summary)}." if summary["tolerance"] else "")
    if len(summary["objects"]) > 1:
        caption += " All are means over the objects."
    true = [i for i, e in enumerate(ranking) if e["gloss"].startswith("true-")]
    best = [i for i in range(len(ranking)) if i not in true][:1]
    return Table("The meshes against the true surface, the nearest first", columns, rows, caption, best, true)


def _objects(summary: Mapping[str, Any]) -> Table:
    objects, entries = summary["objects"], summary["chamfer"]
    rows = [[views_label(e, entries), *(e["objects"][o] for o in objects)] for e in entries]
    return Table("Chamfer distance by object", [Column("methods", "s"), *(Column(o, ".3f", "mm") for o in objects)], rows)


def _object(held: Sequence[tuple[int, ViewsUnit, Maps]], ranking: Sequence[Mapping[str, Any]]) -> Section:
    """The meshes of one object, best first: their form from its first view, and their errors from each view that is kept."""
    unit, first = held[0][1:]
    frames = [views_label(ranking[i], ranking) for i, _, _ in held]
    parts: list[Part] = []
    for v, view in enumerate(str(name) for name in first["views"]):
        if v == 0:
            parts.append(_form(view, frames, [found for _, _, found in held]))
        true = first[f"true{v}"]
        errors = {frame: found[f"depth{v}"] - true for frame, (_, _, found) in zip(frames, held, strict=True)}
        rows, columns = (slice(*side) for side in first[f"window{v}"].tolist())
        parts += _errors(view, errors, Window(rows, columns), first[f"picture{v}"])
    return Section(unit.name, f"{counted(unit.views, 'view')}.", parts)


def _form(view: str, frames: Sequence[str], found: Sequence[Maps]) -> Gallery:
    """The true surface and every mesh as the first view sees them."""
    true, true_normal = found[0]["true0"], found[0].get("true normal0")
    scale, step = height_range(-true), float(found[0]["step0"])
    depths = [true, *(maps["depth0"] for maps in found)]
    reliefs: list[Picture | None] = [relief_picture(-depth, *scale, step) for depth in depths]
    maps_of_normals = [true_normal, *(maps["normal0"] for maps in found)]
    normals = [None if n is None else _outside(n, np.isfinite(depth)) for n, depth in zip(maps_of_normals, depths, strict=True)]
    notes = {
        "relief": "lit from the upper left; lighter is nearer, by one scale for all",
        "normals": "red to the right, green up, blue to the viewer",
    }
    caption = f"As {view} sees them; the slider goes through the true surface and the methods, the nearest first."
    return Gallery(
        "The meshes", {"relief": reliefs, "normals": normals}, [TRUE_SURFACE, *frames], caption, notes, slider="Method"
    )


def _errors(view: str, errors: Mapping[str, NDArray[Any]], window: Window, picture: Picture) -> list[Part]:
    """Depth of the meshes less the true depth in a view, (h, w) mm each, on one scale; nothing where no mesh is seen."""
    known = np.abs(np.concatenate([e[np.isfinite(e)] for e in errors.values()]))
    if not known.size:
        return []
    top = float(np.percentile(known, 98)) or 1.0
    figures: list[Figure | Map] = [Figure("brightest picture", picture)]
    for frame, error in list(errors.items())[:ERRORS_SHOWN]:
        size = np.abs(error[np.isfinite(error)])
        said = f"{frame}: {size.mean():.3f} mm" if size.size else frame
        figures.append(Map(said, error, Bar(-top, top, "mm", "signed", ".3g", bool((size > top).any())), window))
    caption = (
        "Depth of the mesh less the true depth, along the optical axis, and the mean of its size. Orange is too far, blue too near; empty "
        "where the mesh is open, or its outline lies within the true one."
    )
    return [Row(figures, columns=4, title=f"Errors seen from {view}", caption=caption)]


def _outside(picture: NDArray[Any], inside: NDArray[np.bool_]) -> Picture:
    return np.where(inside[..., None], picture, np.array(OUTSIDE, np.uint8)).astype(np.uint8)
