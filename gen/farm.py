"""The render farm: worker processes that each hold a Blender, fed jobs as JSON lines on descriptors of their own.

A worker that crashes or hangs takes its own job down and nothing else: it is replaced and the job tried again. bpy is never
imported here. The job's keys are those of `blender_scenes.job`.
"""

from __future__ import annotations

import os
import queue
import shutil
import threading
from collections.abc import Iterable, Iterator, Mapping, Sized
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from gen.errors import InputError
from gen.parts import require
from gen.worker import Worker, WorkerLost

Job = Mapping[str, Any]

DEVICES = ("auto", "cpu", "gpu")
MAX_WORKERS = 1024
"""Each has a thread here; more are a slip of the keyboard."""

STARTS = 4
"""How often a worker that is killed while it starts is started again before Blender counts as one that cannot be started."""


@dataclass(frozen=True)
class Outcome:
    """What became of a job. ok: its file is written. kind: "input" or "failure" and error: one line, where it is not.

    seconds: the worker's own time. route: how the pixels left Blender. tries: how often it was tried.
    blender, device: the worker's.
    """

    job: Job
    ok: bool
    error: str = ""
    kind: str = ""
    seconds: float = 0.0
    route: str = ""
    tries: int = 1
    blender: str = ""
    device: str = ""


def check_workers(workers: int) -> None:
    """InputError unless so many Blenders may render at the same time: from 1 to `MAX_WORKERS`."""
    if not 1 <= workers <= MAX_WORKERS:
        raise InputError(f"--workers {workers}: must be from 1 to {MAX_WORKERS}")


def find_blender(blender: str | None) -> str | None:
    """The path of an installed Blender, or None for the bpy module. Raises InputError or MissingPart where it is not there."""
    if blender is None:
        require("bpy")
        return None
    found = shutil.which(blender)
    if found is None:
        raise InputError(f"--blender {blender}: there is no such program; give the path of Blender's executable")
    return found


class Farm:
    """Up to `workers` workers, kept between runs; a context manager that leaves no process behind.

    timeout: seconds a job may take. tries: how often a job is tried before it is reported as failed. jobs_per_worker: after so
    many jobs a worker is replaced, since Blender's memory creeps. device: "auto", "cpu" or "gpu". threads: of each worker, by default
    the cores shared out. scratch: a folder for what Blender leaves behind.
    """

    def __init__(
        self,
        workers: int = 1,
        blender: str | None = None,
        timeout: float = 600.0,
        tries: int = 3,
        jobs_per_worker: int = 150,
        device: str = "cpu",
        threads: int | None = None,
        scratch: Path | None = None,
    ) -> None:
        check_workers(workers)
        if device not in DEVICES:
            raise InputError(f"--device {device}: must be one of {', '.join(DEVICES)}")
        self.workers = workers
        self._blender, self._timeout, self._tries, self._jobs_per_worker = find_blender(blender), timeout, tries, jobs_per_worker
        self._device, self._scratch = device, scratch
        # Workers that each take every core get into each other's way.
        self._threads_each = threads if threads is not None else 0 if workers == 1 else max(1, (os.cpu_count() or 1) // workers)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._alive: set[Worker] = set()
        self._idle: list[Worker] = []
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> Farm:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with self._lock:
            self._stop.set()
            busy = [worker for worker in self._alive if worker not in self._idle]
        for worker in busy:
            worker.end_process()
        for thread in self._threads:
            thread.join()
        for worker in list(self._alive):
            self._drop(worker, gently=kind is None)

    def run(self, jobs: Iterable[Job]) -> Iterator[Outcome]:
        """The outcome of each job, in the order in which they end. Ids of jobs that may run at once must differ.

        jobs: taken one by one, by any thread, as workers come free; and no more work is begun while outcomes wait to be taken, so any
        number of them fits. Raises MissingPart (or InputError with --blender) where Blender cannot be started at all, and whatever
        `jobs` raises.
        """
        todo, turn, over = iter(jobs), threading.Lock(), threading.Event()
        done: queue.Queue[Outcome | Exception | None] = queue.Queue(self.workers)
        count = min(self.workers, len(jobs)) if isinstance(jobs, Sized) else self.workers
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        for _ in range(count):
            thread = threading.Thread(target=self._serve, args=(todo, turn, done, over), daemon=True)
            self._threads.append(thread)
            thread.start()
        try:
            while count:
                outcome = done.get()
                if isinstance(outcome, Exception):
                    raise outcome
                if outcome is None:
                    count -= 1
                else:
                    yield outcome
        finally:
            over.set()

    def _serve(
        self,
        todo: Iterator[Job],
        turn: threading.Lock,
        done: queue.Queue[Outcome | Exception | None],
        over: threading.Event,
    ) -> None:
        """A thread's life: take jobs until there are none or nobody wants the outcomes (`over`), with one worker at a time."""

        def give(outcome: Outcome | Exception | None) -> None:
            while not (self._stop.is_set() or over.is_set()):
                with suppress(queue.Full):
                    done.put(outcome, timeout=0.1)
                    break

        worker: Worker | None = None
        try:
            while not (self._stop.is_set() or over.is_set()):
                with turn:
                    job = next(todo, None)
                if job is None:
                    break
                outcome, worker = self._try(job, worker)
                give(outcome)
        except Exception as error:
            give(error)
        finally:
            with self._lock:
                alive = worker is not None and worker in self._alive
            if worker is not None and alive and worker.jobs_done >= self._jobs_per_worker:
                self._drop(worker, gently=True)
            elif worker is not None and alive:
                with self._lock:
                    self._idle.append(worker)
            give(None)

    def _try(self, job: Job, worker: Worker | None) -> tuple[Outcome, Worker | None]:
        error = ""
        for attempt in range(1, self._tries + 1):
            if worker is not None and worker.jobs_done >= self._jobs_per_worker:
                self._drop(worker, gently=True)
                worker = None
            try:
                worker = worker or self._start_again()
                reply = worker.ask(job, self._timeout)
            except WorkerLost as lost:
                error = f"the worker {lost}"
                if worker is not None:
                    self._drop(worker, gently=False)
                    worker = None
                if self._stop.is_set():
                    break
                continue
            error = str(reply.get("error", ""))
            if reply["ok"] or reply.get("kind") == "input":
                return self._outcome(job, worker, reply, attempt), worker
        return Outcome(job, ok=False, error=error, kind="failure", tries=self._tries), worker

    def _start_again(self) -> Worker:
        """A worker that is ready, at the first start or a later one: a start that is lost is none of the job's tries.

        Raises InputError where every start is lost, WorkerLost where the farm ends.
        """
        reason = ""
        for _ in range(STARTS):
            try:
                return self._start()
            except WorkerLost as lost:
                if self._stop.is_set():
                    raise
                reason = str(lost)
        raise InputError(
            f"Blender does not start: the worker {reason}, {STARTS} times in a row; if memory is short, give fewer --workers"
        )

    def _outcome(self, job: Job, worker: Worker, reply: Mapping[str, Any], attempt: int) -> Outcome:
        return Outcome(
            job,
            ok=reply["ok"],
            error=str(reply.get("error", "")),
            kind=str(reply.get("kind", "")),
            seconds=float(reply.get("seconds", 0.0)),
            route=str(reply.get("route", "")),
            tries=attempt,
            blender=str(worker.info.get("blender", "")),
            device=str(worker.info.get("device", "")),
        )

    def _start(self) -> Worker:
        """A worker that is ready. Raises WorkerLost where it was killed or slow, InputError where Blender does not start."""
        with self._lock:
            if self._stop.is_set():
                raise WorkerLost("was stopped")
            if self._idle:
                return self._idle.pop()
            worker = Worker(self._blender, self._threads_each, device=self._device, scratch=self._scratch)
            self._alive.add(worker)
        try:
            worker.wait_until_ready()
        except WorkerLost as lost:
            self._drop(worker, gently=False)
            if lost.ended is not None and lost.ended >= 0:
                reason = str(lost).split(": ", 1)[-1]
                if self._blender is not None:
                    raise InputError(f"--blender {self._blender}: does not start: {reason}") from None
                require("system libraries" if "shared object" in reason else "bpy", reason)
            raise
        return worker

    def _drop(self, worker: Worker, gently: bool) -> None:
        with self._lock:
            known = worker in self._alive
            self._alive.discard(worker)
            if worker in self._idle:
                self._idle.remove(worker)
        if known:
            worker.close() if gently else worker.kill()
