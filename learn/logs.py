"""What a training says while it runs: a CSV file, TensorBoard where it is installed, sample pictures, a line of progress."""

from __future__ import annotations

import csv
import io
import struct
import sys
import time
import zlib
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gen.errors import InputError
from gen.files import writing

QUIET_SECONDS = 30.0
"""Between two lines of progress where the output is not a terminal."""


class Meters:
    """Means since the last row of the log. Sums stay on the device, so that adding never waits for it."""

    def __init__(self) -> None:
        self.count = 0
        self.sums: dict[str, Tensor] = {}
        self.counts: dict[str, int] = {}

    def add(self, figures: Mapping[str, Tensor]) -> None:
        """Take in one step's figures, each a tensor of one number. A figure may be missing in some steps."""
        self.count += 1
        for name, value in figures.items():
            value = value.detach().float().reshape(())
            self.sums[name] = self.sums[name] + value if name in self.sums else value
            self.counts[name] = self.counts.get(name, 0) + 1

    def means(self) -> dict[str, float]:
        """The mean of each figure over the steps that had it."""
        return {name: float(total) / self.counts[name] for name, total in self.sums.items()}

    def state(self) -> dict[str, Any]:
        """The sums as plain numbers, exactly, for a checkpoint."""
        return {"count": self.count, "sums": {name: [float(total), self.counts[name]] for name, total in self.sums.items()}}

    @classmethod
    def of(cls, state: Mapping[str, Any], device: torch.device) -> Meters:
        """The meters of a checkpoint."""
        meters = cls()
        meters.count = int(state["count"])
        for name, (total, count) in state["sums"].items():
            meters.sums[name], meters.counts[name] = torch.tensor(float(total), device=device), int(count)
        return meters


class CsvLog:
    """Rows of figures in a CSV file with one header, on the disk after each row.

    On resuming, the rows after `step` and any torn one are dropped. A figure that appears for the first time widens the header: the
    file is then written anew, by a temporary name.
    """

    def __init__(self, path: Path, step: int) -> None:
        self.path = path
        self.columns: list[str] = ["step"]
        self._rows: list[dict[str, str]] = []
        if path.is_file():
            with path.open(newline="", encoding="utf-8", errors="replace") as stream:
                rows = list(csv.reader(stream))
            self.columns = rows[0] if rows and rows[0][:1] == ["step"] else ["step"]
            whole = [row for row in rows[1:] if len(row) == len(self.columns) and row[0].isdecimal() and int(row[0]) <= step]
            self._rows = [dict(zip(self.columns, row, strict=True)) for row in whole]
            self._rewrite()

    def write(self, row: Mapping[str, float]) -> None:
        """Append a row; `row` has a "step"."""
        texts = {name: str(int(value)) if name == "step" else f"{value:.7g}" for name, value in row.items()}
        self._rows.append(texts)
        new = [name for name in texts if name not in self.columns]
        if new or not self.path.is_file():
            self.columns += new
            self._rewrite()
        else:
            with self.path.open("a", newline="", encoding="utf-8") as stream:
                stream.write(self._text([texts]))

    def _rewrite(self) -> None:
        with writing(self.path) as temporary:
            temporary.write_text(",".join(self.columns) + "\n" + self._text(self._rows), encoding="utf-8")

    def _text(self, rows: list[dict[str, str]]) -> str:
        text = io.StringIO()
        csv.DictWriter(text, self.columns, restval="", lineterminator="\n").writerows(rows)
        return text.getvalue()


class Board:
    """TensorBoard's event files in a folder, or nothing where the package is missing. note: the line that says so, or ''."""

    def __init__(self, folder: Path, step: int) -> None:
        self.note = ""
        self._writer: Any = None
        if find_spec("tensorboard") is None:
            self.note = "no package tensorboard: the log is log.csv alone (pip install tensorboard)"
            return
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder), purge_step=step + 1)

    def write(self, row: Mapping[str, float]) -> None:
        """One row's figures."""
        if self._writer is not None:
            for name, value in row.items():
                if name != "step":
                    self._writer.add_scalar(name, value, int(row["step"]))
            self._writer.flush()

    def picture(self, sheet: NDArray[np.uint8], step: int) -> None:
        """A contact sheet (h, w, 3)."""
        if self._writer is not None:
            self._writer.add_image("samples", sheet, step, dataformats="HWC")

    def close(self) -> None:
        """Write what is left."""
        if self._writer is not None:
            self._writer.close()


class Progress:
    """One line that says how far a training is, how fast, and how long it still takes: rewritten on a terminal, else every 30 s.

    stream: None for silence.
    """

    def __init__(self, stream: TextIO | None = sys.stderr) -> None:
        self._stream = stream
        self._terminal = stream is not None and stream.isatty()
        self._last = 0.0 if self._terminal else time.monotonic()
        self._open = False

    def show(self, step: int, total: int, speed: float, left: float, loss: float | None) -> None:
        """Say it, if it is time. speed: pictures a second. left: seconds."""
        now = time.monotonic()
        if self._stream is None or now - self._last < (0.2 if self._terminal else QUIET_SECONDS):
            return
        self._last = now
        share = step / total
        text = f"step {step} of {total} ({share:.0%}), {speed:.3g} pictures/s, {_clock(left)} left"
        text += f", loss {loss:.4g}" if loss is not None else ""
        if self._terminal:
            bar = "#" * round(20 * share)
            print(f"\r[{bar:<20}] {text}\033[K", end="", file=self._stream, flush=True)
            self._open = True
        else:
            print(text, file=self._stream, flush=True)

    def say(self, text: str) -> None:
        """A line of its own."""
        if self._stream is not None:
            self.close()
            print(text, file=self._stream, flush=True)

    def close(self) -> None:
        """End the line that is being rewritten."""
        if self._open and self._stream is not None:
            print(file=self._stream, flush=True)
        self._open = False


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """An 8-bit RGB picture (h, w, 3) as PNG, with the standard library alone. Raises InputError for another kind of array."""
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or 0 in picture.shape:
        raise InputError(f"{path}: samples are {picture.shape} {picture.dtype}, they must be (h, w, 3) uint8")
    height, width = picture.shape[:2]
    lines = np.zeros((height, 1 + 3 * width), np.uint8)  # each line is led by its filter, 0 for none
    lines[:, 1:] = picture.reshape(height, -1)
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(lines.tobytes())),
        (b"IEND", b""),
    )
    with writing(path) as temporary, temporary.open("wb") as stream:
        stream.write(b"\x89PNG\r\n\x1a\n")
        for kind, body in parts:
            stream.write(struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)))


def _clock(seconds: float) -> str:
    whole = int(min(max(seconds, 0.0), 359_999.0))
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"
