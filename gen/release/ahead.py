"""Reading ahead: a thread that keeps some of what comes next in memory, bounded by its size."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator
from typing import TypeVar

T = TypeVar("T")


def ahead(source: Iterator[T], size: Callable[[T], int], limit: int) -> Generator[T, None, None]:
    """What `source` yields, in its order, drawn from it by another thread while the caller works on what came before.

    At most `limit` of size waits, or one thing that is larger. An error of the source is raised where it would have come. Closing the
    generator stops the thread.
    """
    waiting: deque[T] = deque()
    changed = threading.Condition()
    held, ended, stopped = 0, False, False
    failure: list[BaseException] = []

    def draw() -> None:
        nonlocal held, ended
        try:
            for thing in source:
                with changed:
                    while not stopped and waiting and held + size(thing) > limit:
                        changed.wait()
                    if stopped:
                        return
                    waiting.append(thing)
                    held += size(thing)
                    changed.notify_all()
        except BaseException as error:  # raised again where the caller waits
            failure.append(error)
        finally:
            with changed:
                ended = True
                changed.notify_all()

    thread = threading.Thread(target=draw, daemon=True)
    thread.start()
    try:
        while True:
            with changed:
                while not waiting and not ended:
                    changed.wait()
                if not waiting:
                    break
                thing = waiting.popleft()
                held -= size(thing)
                changed.notify_all()
            yield thing
            del thing
        if failure:
            raise failure[0]
    finally:
        with changed:
            stopped = True
            changed.notify_all()
        thread.join()
