"""Which pictures of a set are fit for training: the paper's screening, which kept 3,744 of 4,000.

A single training picture with overexposed pixels (all of R, G, B at 255 in 8-bit sRGB) is left out. A frame of a stack never is: there
the samples that clip are marked in `valid`, and are only counted here. Everything is judged from the set's index; pixels are read
only where a stack has clipped samples, to say in which of its pictures.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gen.errors import InputError
from gen.files import read_lines, writing
from gen.sets.set_folder import SetFolder

SCREENING = "screening.jsonl"
OVEREXPOSED = "overexposed"
NOT_RENDERED = "not rendered"
MAX_BYTES = 1_000_000_000


@dataclass(frozen=True)
class Verdict:
    """What screening says of one picture. frame: its number in the capture, from 1. reason: None where it is kept."""

    id: str
    frame: int
    kept: bool
    reason: str | None
    overexposed_pixels: int
    clipped_samples: int


def screen(folder: SetFolder) -> list[Verdict]:
    """One verdict a picture, in the order of the index. Raises InputError where the index is missing or damaged."""
    verdicts: list[Verdict] = []
    for row in folder.each_row():
        if row["status"] != "rendered":
            verdicts += [Verdict(row["id"], k + 1, False, NOT_RENDERED, 0, 0) for k in range(row.get("pictures") or 1)]
            continue
        overexposed = row["overexposed_pixels"]
        clipped = _clipped(folder, row)
        for k, pixels in enumerate(overexposed):
            reason = OVEREXPOSED if row["single"] and pixels else None
            verdicts.append(Verdict(row["id"], k + 1, reason is None, reason, pixels, clipped[k]))
    return verdicts


def write_screening(folder: SetFolder) -> list[Verdict]:
    """Screen a set and keep the verdicts in its `screening.jsonl`, by a temporary name. Raises InputError as `screen` does."""
    verdicts = screen(folder)
    with writing(Path(folder.path) / SCREENING) as temporary:
        temporary.write_text("".join(json.dumps(asdict(verdict)) + "\n" for verdict in verdicts), encoding="utf-8")
    return verdicts


def screening_of(folder: SetFolder) -> list[Verdict]:
    """The verdicts of a set: those that were written, or, where there are none yet, those that are written now.

    Raises InputError where the file is damaged, or speaks of other items than the index.
    """
    path = Path(folder.path) / SCREENING
    if not path.exists():
        return write_screening(folder)
    verdicts = []
    for number, line in read_lines(path, "the screening of a set", limit=MAX_BYTES):
        try:
            verdicts.append(_checked(Verdict(**json.loads(line))))
        except (ValueError, TypeError, RecursionError):
            raise InputError(f"{path}: line {number} is not a verdict; run degloss gen screen again") from None
    wanted = [(row["id"], row["status"] == "rendered") for row in folder.each_row()]
    judged = {verdict.id: verdict.reason != NOT_RENDERED for verdict in verdicts}
    if judged != dict(wanted):
        raise InputError(f"{path}: judges other items than the index holds; run degloss gen screen again")
    return verdicts


def kept_items(verdicts: Iterable[Verdict]) -> dict[str, int]:
    """The items with kept pictures, and how many pictures those are."""
    return dict(Counter(verdict.id for verdict in verdicts if verdict.kept))


def reasons(verdicts: Iterable[Verdict]) -> dict[str, int]:
    """How many pictures were left out for which reason, the most frequent first."""
    return dict(Counter(verdict.reason for verdict in verdicts if verdict.reason is not None).most_common())


def _clipped(folder: SetFolder, row: Mapping[str, Any]) -> list[int]:
    """Clipped samples of each picture. The index has their sum."""
    pictures, total = len(row["overexposed_pixels"]), row["clipped_samples"]
    if pictures == 1 or total == 0:
        return [total] * pictures
    from gen.capture import Fault

    faults = folder.capture(row["id"]).faults
    return [int(n) for n in ((faults & Fault.CLIPPED) > 0).sum(axis=(1, 2))]


def _checked(verdict: Verdict) -> Verdict:
    kinds = {"id": str, "frame": int, "kept": bool, "overexposed_pixels": int, "clipped_samples": int}
    wrong = any(type(getattr(verdict, name)) is not kind for name, kind in kinds.items())
    if wrong or verdict.reason not in (None, OVEREXPOSED, NOT_RENDERED) or verdict.kept != (verdict.reason is None):
        raise ValueError("not a verdict")
    return verdict
