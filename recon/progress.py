"""The steps of a measurement as one line on stderr."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


class Steps:
    """Called with the title of each step as it begins. `expect` says how many are still to come, once that is known."""

    def __init__(self, bar: Progress, task: TaskID) -> None:
        self._bar, self._task = bar, task
        self._begun = 0

    def __call__(self, title: str) -> None:
        self._bar.update(self._task, description=title, completed=self._begun)
        self._begun += 1

    def expect(self, more: int) -> None:
        """There are that many steps after the present one."""
        self._bar.update(self._task, total=self._begun + more)


@contextmanager
def steps() -> Iterator[Steps]:
    """A bar on stderr, where that is a terminal, with the step's name, the steps done and the time left."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description:<40}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("steps"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        yield Steps(bar, bar.add_task("starting", total=None))
