"""How fast a set is released, beside `sha256sum` and `cp` on the same files: `python -m gen.release.bench SET`.

The set is rendered, screened and split (degloss gen render, screen, split). Everything is run in turn, so that a drifting machine harms
none more than another. Seconds are by the clock and, in a second column, of processor time, which other processes do not lengthen
as much. The contact sheet is drawn of a few captures whatever the size of the set: what a large set comes to is the speed without it.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gen.errors import InputError
from gen.files import dumps
from gen.parts import require
from gen.release.about import About
from gen.release.build import release_set
from gen.release.contents import contents_of, released_files
from gen.release.layout import SHARD_BYTES
from gen.sets.preview import contact_sheet
from gen.sets.set_folder import SetFolder

GOAL = 0.7
"""What the release should reach of the speed of sha256sum and cp."""


def timed(run: Callable[[], object]) -> tuple[float, float]:
    """(seconds by the clock, seconds of processor time with all child processes) of a call."""
    started, spent = time.perf_counter(), _spent()
    run()
    return time.perf_counter() - started, _spent() - spent


def files_of(folder: SetFolder) -> list[Path]:
    """The files of a set that stand in its release."""
    kept = {entry.id for shard in contents_of(folder, SHARD_BYTES).shards for entry in shard.entries}
    return [
        folder.item_folder(row["id"]) / file
        for row in folder.each_row()
        if row["id"] in kept
        for file in released_files(row).values()
    ]


def measure(path: Path, rounds: int) -> dict[str, Any]:
    """All figures. Raises InputError where the set cannot be released."""
    require("release")
    import pyarrow.parquet  # noqa: F401 - importing is not what is timed

    folder = SetFolder(path)
    files = files_of(folder)
    names = b"\0".join(str(file.resolve()).encode() for file in files)
    about = About(folder.plan().name, "0.0.0", "bench", "bench", "bench")
    rows: dict[str, list[tuple[float, float]]] = {}
    for _ in range(rounds):
        with tempfile.TemporaryDirectory(prefix="degloss-bench-") as scratch:
            (Path(scratch) / "copy").mkdir()
            rows.setdefault("sha256sum", []).append(timed(lambda: _each(names, "sha256sum")))
            copy = ("cp", "--parents", "-t", f"{scratch}/copy")
            rows.setdefault("cp", []).append(timed(lambda copy=copy: _each(names, *copy)))  # type: ignore[misc]
            output = Path(scratch) / "release"
            rows.setdefault("release", []).append(
                timed(lambda output=output: release_set(folder, output, about))  # type: ignore[misc]
            )
            rows.setdefault("contact sheet, part of it", []).append(timed(lambda: contact_sheet(folder.path)))
    median = {name: tuple(statistics.median(one[k] for one in times) for k in (0, 1)) for name, times in rows.items()}
    plain = [median["sha256sum"][k] + median["cp"][k] for k in (0, 1)]
    whole, sheet = median["release"], median["contact sheet, part of it"]
    return {
        "set": about.name,
        "files": len(files),
        "bytes": sum(file.stat().st_size for file in files),
        "rows": {name: {"seconds": median[name][0], "processor": median[name][1], "all": times} for name, times in rows.items()},
        "ratio": {"seconds": plain[0] / whole[0], "processor": plain[1] / whole[1]},
        "ratio_without_sheet": {"seconds": plain[0] / (whole[0] - sheet[0]), "processor": plain[1] / (whole[1] - sheet[1])},
        "peak_memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
    }


def _each(names: bytes, *command: str) -> None:
    run = subprocess.run(["xargs", "-0", *command], input=names, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    if run.returncode:
        raise InputError(f"{command[0]}: {run.stderr.decode(errors='replace').strip()[:200]}")


def _spent() -> float:
    every = (resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in every)


def main() -> None:
    """Work out all figures and print them."""
    parser = argparse.ArgumentParser(prog="python -m gen.release.bench", description=__doc__)
    parser.add_argument("set", type=Path, help="the folder of a rendered, screened and split set")
    parser.add_argument("--rounds", type=int, default=3, help="how often everything is run in turn (default: 3)")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    arguments = parser.parse_args()
    try:
        figures = measure(arguments.set, arguments.rounds)
    except InputError as error:
        raise SystemExit(f"gen.release.bench: {error}") from None
    if arguments.json:
        print(dumps(figures, indent=2))
        return
    print(f"{figures['set']}: {figures['files']:,} files, {figures['bytes'] / 1e6:,.0f} MB\n")
    print("| | seconds | of processor time |\n|---|---|---|")
    for name, row in figures["rows"].items():
        print(f"| {name} | {row['seconds']:.2f} | {row['processor']:.2f} |")
    print(f"\nsha256sum and cp over the release ({GOAL} is the goal): {_both(figures['ratio'])}")
    print(
        f"without the contact sheet: {_both(figures['ratio_without_sheet'])}; peak memory {figures['peak_memory'] / 1e6:.0f} MB"
    )


def _both(ratio: dict[str, float]) -> str:
    return f"{ratio['seconds']:.2f} of seconds, {ratio['processor']:.2f} of processor time"


if __name__ == "__main__":
    main()
