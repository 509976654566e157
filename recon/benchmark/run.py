"""A benchmark run: tasks shared out over processes, each task's rows written when they are done, so that a run can be gone on with.

The folder: benchmark.json (what is run), units/<key>.json and .npz (rows and maps of a task), captures/ (what was rendered),
results.jsonl, summary.json, table.md, report.html. A task that is there is never measured again, unless something that it needed was
not installed.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import active_children, connection, get_context, parent_process
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from gen.files import read_json, write_json, writing
from recon.benchmark.cells import PART_MISSING, Row
from recon.benchmark.spec import Benchmark, Combination

HEAD, UNITS, RESULTS = "benchmark.json", "units", "results.jsonl"
FORMAT = "degloss benchmark"

Progress = Callable[[int, int], None]
Maps = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Task:
    """Something to measure by itself, whose rows are kept as soon as they are there.

    name: what messages call it. key: a file name of its own. identity: what every row of it says. combinations: of its rows, in order.
    measure: makes the rows and the maps; it can be sent to another process.
    """

    name: str
    key: str
    identity: Mapping[str, Any]
    combinations: Sequence[Combination]
    measure: Callable[[], tuple[list[Row], Maps]]


class _Keyed(Protocol):
    @property
    def key(self) -> str: ...


Keyed = TypeVar("Keyed", bound=_Keyed)


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
    write_json(folder / HEAD, {"format": FORMAT, "digest": benchmark.digest(), "benchmark": benchmark.plain()})


def run_tasks(folder: Path, tasks: Sequence[Task], workers: int = 1, progress: Progress | None = None) -> list[Row]:
    """Measure what is not there yet, and gather the rows of all, in the tasks' order.

    workers: processes; with one, everything is done here. Raises InputError where a process is killed or a file is damaged, with what is
    done kept; KeyboardInterrupt likewise.
    """
    left = [task for task in tasks if not _settled(_read(folder, task))]
    done = len(tasks) - len(left)
    if progress is not None:
        progress(done, len(tasks))
    for task, rows, maps in _measured(left, workers):
        _write(folder, task, rows, maps)
        done += 1
        if progress is not None:
            progress(done, len(tasks))
    found = [_read(folder, task) for task in tasks]
    every = [row for rows in found if rows is not None for row in rows]
    with writing(folder / RESULTS) as temporary:
        temporary.write_text("".join(json.dumps(row) + "\n" for row in every), encoding="utf-8")
    return every


def maps_there(folder: Path, units: Iterable[Keyed]) -> Iterator[tuple[Keyed, Maps]]:
    """The maps of the units that have any, as far as they are there."""
    for unit in units:
        path = folder / UNITS / f"{unit.key}.npz"
        if path.is_file():
            with np.load(path, allow_pickle=False) as held:
                yield unit, {name: held[name] for name in held.files}


def _measured(tasks: Sequence[Task], workers: int) -> Iterator[tuple[Task, list[Row], Maps]]:
    """Tasks with their rows and maps, as they come."""
    if workers == 1 or len(tasks) < 2:
        for task in tasks:
            yield (task, *task.measure())
        return
    pool = ProcessPoolExecutor(min(workers, len(tasks)), get_context("spawn"), _begin_worker)
    try:
        waiting: dict[Future[Any], Task] = {}
        rest = iter(tasks)
        while True:
            for task in rest:
                waiting[pool.submit(task.measure)] = task
                if len(waiting) >= 2 * workers:
                    break
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                task = waiting.pop(future)
                try:
                    yield (task, *future.result())
                except BrokenProcessPool:
                    raise InputError(
                        f"{task.name}: a process was killed while it measured (out of memory?); go on with --resume and fewer --workers"
                    ) from None
    except BaseException:
        for child in active_children():  # whatever they measure is lost anyway; waiting for it would take long
            child.terminate()
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _begin_worker() -> None:
    """A worker is one of several: libraries that are not loaded yet begin with one thread each. It ends with the process that began it,
    which may be killed and then says nothing."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    import cv2

    cv2.setNumThreads(1)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _write(folder: Path, task: Task, rows: list[Row], maps: Maps) -> None:
    place = folder / UNITS / f"{task.key}.json"
    if maps:
        with writing(place.with_suffix(".npz")) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, **maps)
    write_json(place, rows)


def _read(folder: Path, task: Task) -> list[Row] | None:
    """The rows of a task, None where they are not there. Raises InputError where the file is not what `_write` wrote."""
    path = folder / UNITS / f"{task.key}.json"
    if not path.is_file():
        return None
    rows = read_json(path, "rows of a benchmark")
    try:
        there = [(row["gloss"], row["repair"], row["normals_by"], row["height_by"]) for row in rows]
        right = there == list(task.combinations) and all(row[key] == said for row in rows for key, said in task.identity.items())
    except (TypeError, KeyError):
        right = False
    if not right:
        raise InputError(f"{path}: is damaged; delete it, and --resume measures it again")
    return list(rows)


def _settled(rows: Sequence[Row] | None) -> bool:
    """Whether rows are there, and none for want of something that may be installed by now."""
    return rows is not None and not any(PART_MISSING in row for row in rows)
