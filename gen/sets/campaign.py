"""The campaign: a plan becomes a set folder, item by item, by workers that render while threads here finish what they rendered.

An item's folder appears by one rename when it is complete, and everything else is made of those folders: so whatever is killed,
whenever, the same command with --resume ends with the same bytes, and it does not matter how many workers there are, in which order they
end, or how the plan was shared out over processes and machines.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import queue
import re
import shutil
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gen.errors import InputError
from gen.farm import DEVICES, Farm, Job, Outcome, check_workers, find_blender
from gen.files import dumps
from gen.formats.render_folder import UNITS
from gen.render import jobs_of
from gen.sets.events import record
from gen.sets.item_folder import clear_damaged, finish_item, quarantine, quarantined_row, rendered_row
from gen.sets.plan import Item, Plan
from gen.sets.set_folder import FORMAT, INDEX, ITEMS, PLAN, QUARANTINE, SET, VERSION
from gen.sets.work_folder import NAME, work_folder
from gen.spec import Spec

ENGINES = ("local", "ray")

Progress = Callable[[int, int, int], None]
"""Called with (items settled, items in all, pictures rendered by this run)."""


@dataclass(frozen=True)
class Engine:
    """What renders. name: "local" or "ray". workers: Blenders at the same time. address: of a Ray cluster. blender, device: see `Farm`.

    Raises InputError or MissingPart where that cannot be.
    """

    workers: int = 1
    name: str = "local"
    address: str | None = None
    blender: str | None = None
    device: str = "auto"

    def __post_init__(self) -> None:
        if self.name not in ENGINES:
            raise InputError(f"--engine {self.name}: must be one of {', '.join(ENGINES)}")
        check_workers(self.workers)
        if self.device not in DEVICES:
            raise InputError(f"--device {self.device}: must be one of {', '.join(DEVICES)}")
        if self.address is not None and self.name != "ray":
            raise InputError(f"--address {self.address}: is for --engine ray")
        if self.address is None:
            find_blender(self.blender)
        if self.name == "ray":
            from gen.parts import require

            require("ray")


@dataclass(frozen=True)
class Ended:
    """An item that is settled. pictures: how many it has. error: one line where it went into quarantine."""

    id: str
    pictures: int
    error: str = ""


@dataclass(frozen=True)
class Tally:
    """What a run did. rendered, quarantined: items. kept: items that were there before. pictures: of those rendered.

    indexed: whether the whole set is settled, and its index written.
    """

    rendered: int
    quarantined: int
    kept: int
    pictures: int
    indexed: bool


def render_set(
    plan: Plan,
    folder: Path,
    engine: Engine,
    resume: bool = False,
    progress: Progress | None = None,
    items: Sequence[Item] | None = None,
) -> Tally:
    """Render a plan into a set folder (see `gen.sets.set_folder`).

    resume: go on with what is there, which without it must be nothing. items: only these of the plan's, for a process that has a
    part of the work. Raises InputError, one line, where the folder holds something else or cannot be written, MissingPart where Blender
    cannot be started; a KeyboardInterrupt comes with a sentence that says how to go on.
    """
    folder = Path(os.path.abspath(folder))
    _may_render_into(folder, plan, resume)
    wanted = plan.items if items is None else items
    kept = rendered = quarantined = pictures = 0
    with _explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with work_folder(folder) as work:
            _write_head(folder, plan, work)
            todo = [item for item in wanted if rendered_row(folder, item.id) is None]
            kept = len(wanted) - len(todo)
            record(folder, "resumed" if kept else "started", items=len(wanted), to_do=len(todo), process=os.getpid())
            for item in todo:
                clear_damaged(folder, item.id, work)
            if todo:
                (folder / INDEX).unlink(missing_ok=True)
            with closing(_by(engine, folder, todo, work)) as every:
                for ended in every:
                    if ended.error:
                        quarantined += 1
                    else:
                        rendered += 1
                        pictures += ended.pictures
                    if progress is not None:
                        progress(kept + rendered + quarantined, len(wanted), pictures)
            indexed = write_index(folder, plan, work)
            record(
                folder, "finished", rendered=rendered, quarantined=quarantined, kept=kept, indexed=indexed, process=os.getpid()
            )
    return Tally(rendered, quarantined, kept, pictures, indexed)


def render_items(folder: Path, items: Sequence[Item], farm: Farm, work: Path, finishers: int = 2) -> Iterator[Ended]:
    """Render items into the set `folder`, each as it ends, those that fail into quarantine.

    work: a folder for work in progress, on the same file system. finishers: threads that turn arrays into files. Raises MissingPart or
    InputError where Blender cannot be started, OSError (or InputError from one) where the disk refuses.
    """
    started: dict[str, _Started] = {}
    refused: queue.SimpleQueue[tuple[Item, Spec | None, str]] = queue.SimpleQueue()

    def jobs() -> Iterator[Job]:
        for item in items:
            spec, place = None, work / item.id
            try:
                spec = _as_written(item).capture_spec()
                place.mkdir()
                made = jobs_of(spec, place)
            except InputError as error:
                refused.put((item, spec, str(error)))
                continue
            started[item.id] = _Started(item, spec, place, made)
            yield from made

    def give_up(item: Item, spec: Spec | None, kind: str, error: str, tries: int = 1) -> Ended:
        text = _line(error, work)
        quarantine(folder, item, spec, text, work)
        record(folder, "quarantined", id=item.id, kind=kind, error=text, tries=tries)
        shutil.rmtree(work / item.id, ignore_errors=True)
        return Ended(item.id, 0, text)

    def settle(finished: _Finished) -> Ended:
        one = finished.started
        if finished.error is not None:
            refusal = disk_error(finished.error)
            if refusal is not None:
                raise refusal
            kind = "input" if isinstance(finished.error, InputError) else "failure"
            name = "" if isinstance(finished.error, InputError) else f"{type(finished.error).__name__}: "
            return give_up(one.item, one.spec, kind, f"{name}{finished.error}")
        seconds = round(sum(outcome.seconds for outcome in one.outcomes), 3)
        record(folder, "rendered", id=one.item.id, seconds=seconds, tries=max(outcome.tries for outcome in one.outcomes))
        return Ended(one.item.id, sum(len(job["lights"]) for job in one.jobs))

    with _Finishers(folder, finishers) as finishing:
        for outcome in farm.run(jobs()):
            while not refused.empty():
                item, spec, error = refused.get()
                yield give_up(item, spec, "input", error)
            one = started.get(Path(outcome.job["out"]).parent.name)
            if one is None:
                continue  # another job of the item has failed before
            if outcome.tries > 1:
                record(folder, "retried", id=one.item.id, tries=outcome.tries)
            if not outcome.ok:
                _raise_if_disk(outcome, folder)
                del started[one.item.id]
                yield give_up(one.item, one.spec, outcome.kind, outcome.error, outcome.tries)
                continue
            one.outcomes.append(outcome)
            if len(one.outcomes) == len(one.jobs):
                del started[one.item.id]
                yield from map(settle, finishing.add(one))
        while not refused.empty():
            item, spec, error = refused.get()
            yield give_up(item, spec, "input", error)
        yield from map(settle, finishing.rest())


def write_index(folder: Path, plan: Plan, work: Path) -> bool:
    """Write the index if every item of the plan is rendered or in quarantine; whether it is so."""
    there = {place.name for place in (folder / ITEMS).iterdir()}
    notes = {place.stem for place in (folder / QUARANTINE).iterdir()} if (folder / QUARANTINE).is_dir() else set()
    if not all(item.id in there or item.id in notes for item in plan.items):
        return False
    with (work / INDEX).open("w", encoding="utf-8") as index:
        for item in plan.items:
            found = rendered_row(folder, item.id)
            if found is not None:
                (folder / QUARANTINE / f"{item.id}.json").unlink(missing_ok=True)
            found = found or quarantined_row(folder, item.id)
            if found is None:
                return False
            index.write(found[1] + "\n")
    os.replace(work / INDEX, folder / INDEX)
    with suppress(OSError):
        (folder / QUARANTINE).rmdir()
    return True


def disk_error(error: BaseException | None) -> OSError | None:
    """The operating system's refusal that an error comes from, or None."""
    while error is not None:
        if isinstance(error, OSError) and error.errno is not None:
            return error
        error = error.__cause__
    return None


@dataclass
class _Started:
    """An item whose jobs are with the workers. place: the folder of its arrays."""

    item: Item
    spec: Spec
    place: Path
    jobs: list[dict[str, Any]]
    outcomes: list[Outcome] = field(default_factory=list)


@dataclass(frozen=True)
class _Finished:
    started: _Started
    error: Exception | None


class _Finishers:
    """Threads that turn the arrays of items into folders while others are rendered. At most two items a thread are in hand."""

    def __init__(self, folder: Path, threads: int) -> None:
        self._folder, self._stop, self._open = folder, threading.Event(), 0
        self._todo: queue.Queue[_Started | None] = queue.Queue()
        self._done: queue.SimpleQueue[_Finished] = queue.SimpleQueue()
        self._threads = [threading.Thread(target=self._serve, daemon=True) for _ in range(threads)]

    def __enter__(self) -> _Finishers:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        for _ in self._threads:
            self._todo.put(None)
        for thread in self._threads:
            thread.join(timeout=2)  # who interrupts a huge picture does not wait for it

    def add(self, item: _Started) -> Iterator[_Finished]:
        """Take an item in; hands out what has been finished meanwhile, and waits for something where too much is in hand."""
        self._todo.put(item)
        self._open += 1
        while self._open > 2 * len(self._threads) or (self._open and not self._done.empty()):
            yield self._next()

    def rest(self) -> Iterator[_Finished]:
        while self._open:
            yield self._next()

    def _next(self) -> _Finished:
        finished = self._done.get()
        self._open -= 1
        return finished

    def _serve(self) -> None:
        while (one := self._todo.get()) is not None and not self._stop.is_set():
            made_by: Mapping[str, Any] = {"blender": one.outcomes[0].blender, "device": one.outcomes[0].device}
            try:
                finish_item(self._folder, one.item, one.spec, one.jobs, made_by, one.place)
                shutil.rmtree(one.place, ignore_errors=True)
            except Exception as error:  # whatever one item does, the others are finished
                self._done.put(_Finished(one, error))
            else:
                self._done.put(_Finished(one, None))


def _by(engine: Engine, folder: Path, items: Sequence[Item], work: Path) -> Generator[Ended, None, None]:
    if not items:
        return
    if engine.name == "ray":
        from gen.sets.ray_engine import render_by_ray

        yield from render_by_ray(folder, items, engine, work)
        return
    with Farm(engine.workers, engine.blender, device=engine.device, scratch=work) as farm:
        yield from render_items(folder, items, farm, work, finishers=min(16, 1 + engine.workers // 2))


def _may_render_into(folder: Path, plan: Plan, resume: bool) -> None:
    """InputError where the folder holds something that is not this set, or anything without `resume`."""
    if not plan.items:
        raise InputError(f"{plan.name}: the plan holds no items")
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise InputError(f"{folder}: is in the place of the set's folder; choose another place with -o")
    if not folder.is_dir():
        return
    there = [place.name for place in folder.iterdir()]
    if there and not resume:
        raise InputError(f"{folder}: is there already; go on with it by --resume, or choose another place with -o")
    if (folder / PLAN).is_file():
        if hashlib.sha256((folder / PLAN).read_bytes()).hexdigest() != plan.digest():
            raise InputError(f"{folder}: is a set of another plan; choose another place with -o")
    elif foreign := [name for name in there if not NAME.fullmatch(name.removesuffix(".lock"))]:
        raise InputError(f"{folder}: is no set folder of ours (it holds {foreign[0]}); choose another place with -o")


def _write_head(folder: Path, plan: Plan, work: Path) -> None:
    head = {
        "format": FORMAT,
        "version": VERSION,
        "name": plan.name,
        "seed": plan.seed,
        "set_sha256": plan.set_sha256,
        "plan_sha256": plan.digest(),
        "items": len(plan.items),
        "units": UNITS,
    }
    for name, text in ((PLAN, plan.text()), (SET, dumps(head, indent=1) + "\n")):
        if not (folder / name).is_file():
            (work / name).write_text(text, encoding="utf-8", newline="\n")
            os.replace(work / name, folder / name)
    (folder / ITEMS).mkdir(exist_ok=True)


@contextmanager
def _explained(folder: Path) -> Iterator[None]:
    """Say, whatever ends the work early, what is kept and how to go on."""

    def there() -> int:
        return len(list((folder / ITEMS).iterdir())) if (folder / ITEMS).is_dir() else 0

    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; {there()} items are complete, run the same command with --resume to go on with {folder}"
        ) from None
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror or error}); {there()} items are complete and kept: make room, "
            "then run the same command with --resume"
        ) from error


def _raise_if_disk(outcome: Outcome, folder: Path) -> None:
    """OSError where a job failed for want of room, which is no fault of the item's."""
    refusal = re.search(r" cannot be written \((.*)\)$", outcome.error)
    if refusal is not None:
        codes = [code for code in errno.errorcode if os.strerror(code) == refusal[1]]
        raise OSError(codes[0] if codes else errno.EIO, refusal[1])
    if shutil.disk_usage(folder).free < 1 << 20:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _as_written(item: Item) -> Item:
    """An item as it is read from a plan's file, whose keys are sorted: so that spec.yaml does not tell where the plan came from."""
    return replace(item, spec=json.loads(item.line())["spec"])


def _line(error: str, work: Path) -> str:
    """An error as one line that is the same on every run: without the names of folders for work in progress."""
    return " ".join(error.replace(f"{work}{os.sep}", "").split())[:500]
