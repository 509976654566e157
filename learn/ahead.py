"""The next batch made during a step, by a thread of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import torch

from learn.method import Source


@contextmanager
def ahead(source: Source, prefetch: bool) -> Iterator[Callable[[int, int | None], Any]]:
    """A function (number, number of the one after it or None) -> batch; with `prefetch` the one after it is begun at once.

    The batches are those of `source.batch`, bit for bit: a batch depends on its number alone. What fails in the thread is raised where
    its batch is asked for.
    """
    if not prefetch:
        yield lambda number, after: source.batch(number)
        return
    waiting: dict[int, Future[Any]] = {}
    threads = torch.get_num_threads()  # OpenMP's count is each thread's own
    with ThreadPoolExecutor(1, "batches", torch.set_num_threads, (threads,)) as pool:

        def batch(number: int, after: int | None) -> Any:
            future = waiting.pop(number, None)
            made = source.batch(number) if future is None else future.result()
            if after is not None and after not in waiting:
                waiting[after] = pool.submit(source.batch, after)
            return made

        try:
            yield batch
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
