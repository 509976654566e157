"""Damage to bytes: what the fuzz tests do to sound files, as plain steps that a failure is reported and shrunk by."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gen.errors import InputError
from tests.hostile.readers import Reader

NUMBERS = (
    b"\0\0\0\0",
    b"\xff\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\x7f\xff\xff\xff",
    b"\0\0\0\x80",
    b"\x80\0\0\0",
    b"\0\0\x40\0",
)
"""Four bytes that are the largest, the least or a large number in one order or the other."""

STEPS = ("byte", "bit", "cut", "take out", "put in", "number", "copy", "piece", "piece over")
Step = tuple[str, int, int]
"""What is done, where (modulo the length), and with what."""


def damaged(data: bytes, steps: Sequence[Step], grammar: Sequence[bytes]) -> bytes:
    """`data` after the steps. grammar: the pieces of `Reader`."""
    made = bytearray(data)
    for kind, where, value in steps:
        at = where % (len(made) + 1)
        match kind:
            case "byte" if at < len(made):
                made[at] = value % 256
            case "bit" if at < len(made):
                made[at] ^= 1 << value % 8
            case "cut":
                del made[at:]
            case "take out":
                del made[at : at + 1 + value % 16]
            case "put in":
                made[at:at] = value.to_bytes(8, "little")[: 1 + value % 8]
            case "number":
                made[at : at + 4] = NUMBERS[value % len(NUMBERS)]
            case "copy":
                made[at:at] = made[value % (len(made) + 1) :][:64]
            case "piece" | "piece over" if grammar:
                piece = grammar[value % len(grammar)]
                made[at : at + (len(piece) if kind == "piece over" else 0)] = piece
    return bytes(made)


def read_or_refused(reader: Reader, folder: Path, data: bytes) -> bool:
    """Whether the reader takes `data` in the place of its file. Whatever it raises but a one-line InputError, this raises."""
    (folder / reader.file).write_bytes(data)
    refusal = ""
    try:
        reader.read(folder)
    except InputError as error:
        refusal = str(error)
    assert "\n" not in refusal
    assert len(refusal) < 2000
    return not refusal
