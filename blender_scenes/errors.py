"""What a caller can act on. This package stands alone, so these are its own."""

from __future__ import annotations


class JobError(ValueError):
    """A job that cannot be rendered as it stands. The message is one line: which job, which entry, what is wrong."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))


class MissingBlender(JobError):
    """bpy, or a system library that it needs, is not installed; the message holds the remedy."""
