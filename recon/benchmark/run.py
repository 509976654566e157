"""A benchmark run: units shared out over processes, each unit's rows written when they are done, so that a run can be gone on with.

The folder: benchmark.json (what is run), units/<key>.json and .npz (rows and maps of a unit), captures/ (what was rendered),
results.jsonl, summary.json, table.md, report.html. A unit that is there is never measured again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import numpy as np

from gen.errors import InputError
from gen.files import read_json, write_json, writing
from recon.benchmark.cells import Row, measure_unit
from recon.benchmark.spec import Benchmark, Combination
from recon.benchmark.units import Unit

HEAD, UNITS, RESULTS = "benchmark.json", "units", "results.jsonl"
FORMAT = "degloss benchmark"

Progress = Callable[[int, int], None]


def check_folder(folder: Path, benchmark: Benchmark, resume: bool) -> None:
    """InputError where the folder of a run holds something else, another benchmark, or this one without `resume`."""
    head = folder / HEAD
    if head.is_file():
        said = read_json(head, "the head of a benchmark")
        if not isinstance(said, dict) or said.get("format") != FORMAT:
            raise InputError(f"{head}: is not the head of a benchmark; choose another folder with -o")
        if said.get("digest") != benchmark.digest():
            raise InputError(
                f"{folder}: holds another benchmark (or this one with other settings); choose another folder with -o"
            )
        if not resume:
            raise InputError(f"{folder}: holds a run of this benchmark; go on with --resume, or choose another folder with -o")
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: is there and not a benchmark's; choose another folder with -o")


def begin(folder: Path, benchmark: Benchmark) -> None:
    """Make the folder of a run, or leave it as it is where it was begun before."""
    (folder / UNITS).mkdir(parents=True, exist_ok=True)
    write_json(folder / HEAD, {"format": FORMAT, "digest": benchmark.digest(), "benchmark": benchmark.model_dump(mode="json")})


def run_units(
    folder: Path, units: Sequence[Unit], combinations: Sequence[Combination], workers: int = 1, progress: Progress | None = None
) -> list[Row]:
    """Measure the units that are not there yet, and gather the rows of all, in the units' order.

    workers: processes; with one, everything is done here. Raises InputError where a process is killed or a file is damaged, with what is
    done kept; KeyboardInterrupt likewise.
    """
    left = [unit for unit in units if _read(folder, unit, combinations) is None]
    done = len(units) - len(left)
    if progress is not None:
        progress(done, len(units))
    for unit, rows, maps in _measured(left, combinations, workers):
        _write(folder, unit, rows, maps)
        done += 1
        if progress is not None:
            progress(done, len(units))
    found = [_read(folder, unit, combinations) for unit in units]
    every = [row for rows in found if rows is not None for row in rows]
    with writing(folder / RESULTS) as temporary:
        temporary.write_text("".join(json.dumps(row) + "\n" for row in every), encoding="utf-8")
    return every


def maps_there(folder: Path, units: Sequence[Unit]) -> Iterator[tuple[Unit, dict[str, Any]]]:
    """The maps of the first draw of each capture, as far as they are there."""
    for unit in units:
        path = _place(folder, unit).with_suffix(".npz")
        if unit.draw == 0 and path.is_file():
            with np.load(path, allow_pickle=False) as held:
                yield unit, {name: held[name] for name in held.files}


def _measured(
    units: Sequence[Unit], combinations: Sequence[Combination], workers: int
) -> Iterator[tuple[Unit, list[Row], dict[str, Any]]]:
    """Units with their rows and maps, as they come."""
    if workers == 1 or len(units) < 2:
        for unit in units:
            yield (unit, *measure_unit(unit, combinations))
        return
    pool = ProcessPoolExecutor(min(workers, len(units)), get_context("spawn"), _one_thread)
    try:
        waiting: dict[Future[Any], Unit] = {}
        rest = iter(units)
        while True:
            for unit in rest:
                waiting[pool.submit(measure_unit, unit, combinations)] = unit
                if len(waiting) >= 2 * workers:
                    break
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                unit = waiting.pop(future)
                try:
                    yield (unit, *future.result())
                except BrokenProcessPool:
                    raise InputError(
                        f"{unit.name}: a process was killed while it measured (out of memory?); go on with --resume and fewer --workers"
                    ) from None
    except BaseException:
        for child in active_children():  # whatever they measure is lost anyway; waiting for it would take long
            child.terminate()
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _one_thread() -> None:
    """A worker is one of several: libraries that are not loaded yet begin with one thread each."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    import cv2

    cv2.setNumThreads(1)


def _place(folder: Path, unit: Unit) -> Path:
    return folder / UNITS / f"{unit.key}.json"


def _write(folder: Path, unit: Unit, rows: list[Row], maps: dict[str, Any]) -> None:
    if maps:
        with writing(_place(folder, unit).with_suffix(".npz")) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, **maps)
    write_json(_place(folder, unit), rows)


def _read(folder: Path, unit: Unit, combinations: Sequence[Combination]) -> list[Row] | None:
    """The rows of a unit, None where they are not there. Raises InputError where the file is not what `_write` wrote."""
    path = _place(folder, unit)
    if not path.is_file():
        return None
    rows = read_json(path, "rows of a benchmark")
    try:
        there = [(row["gloss"], row["repair"], row["normals_by"], row["height_by"]) for row in rows]
        right = there == list(combinations) and all(row["draw"] == unit.draw and row["capture"] == unit.name for row in rows)
    except (TypeError, KeyError):
        right = False
    if not right:
        raise InputError(f"{path}: is damaged; delete it, and --resume measures it again")
    return list(rows)
