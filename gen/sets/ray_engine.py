"""A campaign by Ray: actors that each hold a Blender take small parts of the plan, on this machine or on a cluster's.

The machines of a cluster share the file system that holds the set's folder: actors finish and rename items themselves, exactly as the
local engine does, and only say which are done. An actor that is killed is started again and its part tried again.
"""

from __future__ import annotations

import logging
import os
import signal
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gen.errors import InputError
from gen.farm import Farm
from gen.sets.events import record
from gen.sets.item_folder import quarantine, rendered_row
from gen.sets.plan import Item
from gen.sets.ray_reaper import reaped
from gen.sets.work_folder import elsewhere, work_folder

if TYPE_CHECKING:
    from gen.sets.campaign import Ended, Engine

TRIES = 3
"""How often a part is tried on another actor's life before its items go one by one, and a single item into quarantine."""

STORE_BYTES = 80_000_000
"""Ray's shared memory: pictures go through files, so the least that it takes is enough."""


SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}

BACK_WITHIN = 60.0
"""Seconds that an actor that died has to come back."""


class Renderer:
    """An actor: a Blender of its own and a folder for work in progress in the set's, for as long as it lives."""

    def __init__(self, folder: str, blender: str | None, device: str, threads: int) -> None:
        self._folder, self._open = Path(folder), ExitStack()
        self._blender, self._device, self._threads = blender, device, threads
        self._has: tuple[Farm, Path] | None = None

    def render(self, items: Sequence[Item]) -> list[Ended] | Exception:
        """What became of items, those included that were done before; or what makes it pointless to go on."""
        from gen.sets.campaign import Ended, render_items

        ended, todo = [], []
        for item in items:
            found = rendered_row(self._folder, item.id)
            if found is None:
                todo.append(item)
            else:
                ended.append(Ended(item.id, found[0]["pictures"]))
        try:
            if self._has is None:  # not when the actor is made: what fails there has no answer to say it by
                work = self._open.enter_context(work_folder(self._folder))
                farm = Farm(1, self._blender, device=self._device, threads=self._threads, scratch=work)
                self._has = self._open.enter_context(farm), work
            ended += render_items(self._folder, todo, *self._has, finishers=1)
        except (InputError, OSError) as error:
            return error
        return ended

    def answers(self) -> bool:
        """True, for who wants to know whether the actor lives."""
        return True

    def close(self) -> None:
        """Leave no process and no folder behind."""
        self._open.close()


def render_by_ray(folder: Path, items: Sequence[Item], engine: Engine, work: Path) -> Generator[Ended, None, None]:
    """Render items by Ray, each as its part of the work ends. Errors as in `gen.sets.campaign.render_items`."""
    import ray
    from ray.exceptions import RayActorError, RayTaskError

    from gen.sets.campaign import Ended

    actor = ray.remote(max_restarts=-1, max_task_retries=0, num_cpus=1)(Renderer)
    with reaped(), _cluster(engine, work) as processors:
        workers = min(engine.workers, len(items), processors)
        size = max(1, min(8, len(items) // (4 * workers)))
        parts = [(tuple(items[k : k + size]), 1) for k in range(0, len(items), size)][::-1]
        threads = max(1, (os.cpu_count() or 1) // workers) if engine.address is None else 1
        idle = [actor.remote(str(folder), engine.blender, engine.device, threads) for _ in range(workers)]
        every = list(idle)
        busy: dict[Any, tuple[Any, tuple[Item, ...], int]] = {}
        while parts or busy:
            while parts and idle:
                part, tries = parts.pop()
                renderer = idle.pop()
                busy[renderer.render.remote(part)] = (renderer, part, tries)
            ready, _ = ray.wait(list(busy), num_returns=1, timeout=1.0)
            for answer in ready:
                renderer, part, tries = busy.pop(answer)
                idle.append(renderer)
                try:
                    said = ray.get(answer)
                except (RayActorError, RayTaskError) as error:
                    reason = _reason(error)
                    _wait_for(renderer)
                    if tries < TRIES:
                        parts.append((part, tries + 1))
                    elif len(part) > 1:
                        parts += [((item,), 1) for item in part]
                    else:
                        quarantine(folder, part[0], None, reason, work)
                        record(folder, "quarantined", id=part[0].id, kind="failure", error=reason, tries=tries)
                        yield Ended(part[0].id, 0, reason)
                    continue
                if isinstance(said, Exception):
                    raise said
                yield from said
        ray.wait([renderer.close.remote() for renderer in every], num_returns=len(every), timeout=10)


def _wait_for(renderer: Any) -> None:
    """Wait until an actor that died is back, a minute at most: what it is asked before that fails, and would count as a try."""
    import ray
    from ray.exceptions import GetTimeoutError, RayActorError

    deadline = time.monotonic() + BACK_WITHIN
    while time.monotonic() < deadline:
        try:
            ray.get(renderer.answers.remote(), timeout=5)
            return
        except (RayActorError, GetTimeoutError):
            time.sleep(0.2)


@contextmanager
def _cluster(engine: Engine, work: Path) -> Iterator[int]:
    """Ray, started here or joined at the engine's address; quiet, and the signals left to us. Hands out its number of processors."""
    import ray

    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for name, value in SETTINGS.items():
        os.environ.setdefault(name, value)
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    try:
        if engine.address is None:
            place = elsewhere(work)
            ray.init(
                address="local",
                num_cpus=engine.workers,
                include_dashboard=False,
                object_store_memory=STORE_BYTES,
                _temp_dir=str(place),
                **quiet,
            )
        else:
            ray.init(address=engine.address, **quiet)
    except Exception as error:
        where = "here" if engine.address is None else f"at --address {engine.address}"
        ray.shutdown()
        raise InputError(f"--engine ray: Ray cannot be started or reached {where} ({_reason(error)})") from None
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
    try:
        processors = int(ray.cluster_resources().get("CPU", 0))
        if processors < 1:
            raise InputError("--engine ray: the cluster has no processors to render on; start workers on it")
        yield processors
    finally:
        ray.shutdown()


def _reason(error: Exception) -> str:
    """One line of an error of Ray's, whose text runs over many."""
    cause = getattr(error, "cause", None) or error
    lines = [line.strip() for line in str(cause).splitlines() if line.strip()]
    return f"{type(cause).__name__}: {lines[0] if lines else ''}"[:300]
