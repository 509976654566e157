"""The errors that a user can act on.

Everything that is the fault of an input (a file, a spec, an option, a missing part) is raised as an `InputError` whose text
is one line: what was wrong, where, what to do. The command line prints that line on stderr and exits with code 2.
"""

from __future__ import annotations


class InputError(ValueError):
    """A bad input. The message is one line that says what was wrong, where, and what to do."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))


class MissingPart(InputError):
    """A part that the job needs is not installed; the message holds the remedy (see `gen.parts`)."""
