"""The work of a benchmark, of captures or of views: its tasks, and what becomes of their rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from gen.sets.set_spec import evenly
from recon.benchmark.cells import Row, measure_unit
from recon.benchmark.page import benchmark_page
from recon.benchmark.run import Task, maps_there
from recon.benchmark.spec import Benchmark
from recon.benchmark.summary import markdown, summarise
from recon.benchmark.units import places, units
from recon.page_parts import Page

RENDERED = "captures"
"""The folder in that of a run where captures and sets are rendered."""


@dataclass(frozen=True)
class Results:
    """What a run came to. summary: plain values. table: Markdown. page: makes the report of what the run's folder holds."""

    summary: dict[str, Any]
    table: str
    page: Callable[[], Page]


@dataclass(frozen=True)
class Work:
    """tasks: see `recon.benchmark.run.run_tasks`. results: of the rows of all of them."""

    tasks: Sequence[Task]
    results: Callable[[Sequence[Row]], Results]


def work_of(wanted: Benchmark, folder: Path, output: Path, workers: int = 1, limit: int | None = None) -> Work:
    """Find the captures or objects of a benchmark, render those that are sets or presets, and say what is to be measured.

    folder: where relative paths start. output: the folder of the run. workers: that render at the same time. limit: at most so many of
    them, evenly spaced. Raises InputError where one cannot be read or lacks the truth, and as rendering does.
    """
    return (_of_captures if wanted.views is None else _of_views)(wanted, folder, output, workers, limit)


def _of_captures(wanted: Benchmark, folder: Path, output: Path, workers: int, limit: int | None) -> Work:
    """A task for each capture under each draw: all combinations, which are judged on common pixels."""
    combinations = wanted.combinations()
    where = places(wanted.captures, folder, output / RENDERED, workers)
    every = units(wanted, [where[i] for i in evenly(len(where), limit)])

    def results(rows: Sequence[Row]) -> Results:
        summary = summarise(rows, combinations, wanted.seed)
        text = markdown(wanted.benchmark, summary)
        return Results(summary, text, lambda: benchmark_page(wanted.benchmark, summary, maps_there(output, every)))

    tasks = [
        Task(u.name, u.key, {"capture": u.name, "draw": u.draw}, combinations, partial(measure_unit, u, combinations))
        for u in every
    ]
    return Work(tasks, results)


def _of_views(wanted: Benchmark, folder: Path, output: Path, workers: int, limit: int | None) -> Work:
    """A task for each object under each combination: a mesh takes long, and is judged by itself."""
    from recon.benchmark.views import measure_views_unit, objects, views_units
    from recon.benchmark.views_page import views_page
    from recon.benchmark.views_tables import summarise_views, views_markdown

    combinations = wanted.combinations()
    where = objects(wanted.sources, folder, output / RENDERED, workers)
    every = views_units(combinations, [where[i] for i in evenly(len(where), limit)])

    def results(rows: Sequence[Row]) -> Results:
        summary = summarise_views(rows, combinations)
        text = views_markdown(wanted.benchmark, summary)
        return Results(summary, text, lambda: views_page(wanted.benchmark, summary, maps_there(output, every)))

    return Work([Task(u.name, u.key, {"object": u.name}, [u.methods], partial(measure_views_unit, u)) for u in every], results)
