"""Being told to stop (Ctrl-C, a closed terminal, a batch system) in the middle of a step, without losing the step before."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import torch
from torch import Tensor, nn

from learn.checkpoint import random_state

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
"""An alarm counts where its own handler takes it for an interrupt: `degloss` puts those off that meet an import."""


class Interrupts:
    """Catches the signals while it is entered. A signal raises KeyboardInterrupt inside `allowed` blocks and is only noted elsewhere.

    asked: whether one came. Outside the main thread nothing is caught, as Python allows no handlers there.
    """

    def __init__(self) -> None:
        self.asked = False
        self._allowed = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                handler = signal.getsignal(number)
                if callable(handler) if number == signal.SIGALRM else handler != signal.SIG_IGN:  # nohup's wish stands
                    self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def allowed(self) -> Iterator[None]:
        """Where a signal may break in."""
        if self.asked:
            raise KeyboardInterrupt
        self._allowed = True
        try:
            yield
        finally:
            self._allowed = False

    def _note(self, number: int, frame: FrameType | None) -> None:
        before, told = self._before[signal.Signals(number)], number != signal.SIGALRM
        if callable(before):
            try:
                before(number, frame)  # the command's own handler must know too, but the moment is ours
            except KeyboardInterrupt:
                told = True
            if told:
                signal.setitimer(signal.ITIMER_REAL, 0)  # nor may it come back in a moment, wherever we are then
        if not told:
            return
        self.asked = True
        if self._allowed:
            self._allowed = False
            raise KeyboardInterrupt


class Mark:
    """The state before a step that the step changes before its end: buffers (BatchNorm's statistics) and torch's generators."""

    def __init__(self, network: nn.Module, place: torch.device) -> None:
        self._network, self._place = network, place
        self._before: tuple[list[Tensor], dict[str, Tensor]] | None = None

    def set(self) -> None:
        """A step begins."""
        self._before = [buffer.detach().clone() for buffer in self._network.buffers()], random_state(self._place)

    def clear(self) -> None:
        """The step is done."""
        self._before = None

    def undo(self) -> dict[str, Tensor]:
        """Take back what a step did that was broken off. Returns the states of the generators between two steps."""
        if self._before is None:
            return random_state(self._place)
        for buffer, before in zip(self._network.buffers(), self._before[0], strict=True):
            buffer.detach().copy_(before)
        return self._before[1]


def open_to_signals(network: nn.Module) -> None:
    """Let signals break into the backward pass on a CPU.

    Python looks at signals between its own steps only, and backward is one call that may last longer than a user waits. A hook that
    does nothing on the output of every layer gives it an occasion after each.
    """

    def hook(module: nn.Module, inputs: object, output: object) -> None:
        if isinstance(output, torch.Tensor) and output.requires_grad:
            output.register_hook(_nothing)

    for module in network.modules():
        if not any(module.children()):
            module.register_forward_hook(hook)


def _nothing(gradient: torch.Tensor) -> None:
    return None
