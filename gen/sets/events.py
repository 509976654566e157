"""The diary of a set: events.jsonl, one line an event with its time. It is for people; nothing is ever decided by it."""

from __future__ import annotations

import os
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from gen.files import dumps
from gen.sets.set_folder import EVENTS


def record(folder: Path, event: str, **facts: object) -> None:
    """Append an event ("started", "resumed", "rendered", "retried", "quarantined", "finished") with its facts to a set folder's diary.

    Whole lines, even where many processes append at once or one was killed while it wrote. Raises OSError where it cannot be written.
    """
    import fcntl

    now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    line = (dumps({"time": now, "event": event, **facts}) + "\n").encode()
    descriptor = os.open(folder / EVENTS, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
    try:
        with suppress(OSError):  # a file system without locks: appending is all there is
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        size = os.fstat(descriptor).st_size
        if size and os.pread(descriptor, 1, size - 1) != b"\n":
            line = b"\n" + line  # of a line that was cut short
        while line:
            line = line[os.write(descriptor, line) :]
    finally:
        os.close(descriptor)
