"""The commands that work on a rendered set: verify, screen, split, preview, pack. Nothing heavy is imported before a command runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

Json = Annotated[bool, Parameter(negative=(), show_default=False)]
MAX_LINES = 20
"""Faults that are printed one by one."""


def verify(folder: Path, /, *, sample: int | None = None, seed: int = 0, json: Json = False) -> None:
    """Check that a set, a release or a capture is whole: checksums, index, plan, and what its layers promise in every pixel.

    Faults are printed one a line, and the command ends with exit code 2. Checksums are checked before anything is opened.

    Parameters
    ----------
    folder
        A set folder, a release, or one capture folder of ours.
    sample
        Read the pixels of so many items only, drawn at random; checksums are of all.
    seed
        Of that draw.
    json
        Print one JSON object on stdout.
    """
    from gen.errors import InputError
    from gen.files import dumps
    from gen.sets.verify import verify as check

    with progress_bar("checking", "") as progress:
        found = check(folder, sample, seed, progress)
    if json:
        facts = {"folder": str(folder), "items": found.items, "files": found.files, "pixels": found.pixels}
        print(dumps({**facts, "faults": list(found.faults)}))
    else:
        for fault in found.faults[:MAX_LINES]:
            print(" ".join(fault.split()))
        if len(found.faults) > MAX_LINES:
            print(f"... and {len(found.faults) - MAX_LINES} more")
    if found.faults:
        remedy = "get it again" if found.kind == "release" else "render what is damaged again"
        raise InputError(f"{folder}: {_count(len(found.faults), 'fault')} found; {remedy}")
    if not json:
        print(
            f"{folder}: whole; {_count(found.items, 'item')}, {_count(found.files, 'checksum')}, pixels of {found.pixels} checked"
        )


def screen(folder: Path, /, *, json: Json = False) -> None:
    """Screen a set: single training pictures with overexposed pixels are left out, as in the paper.

    A frame of a stack is never left out; its clipped samples are marked and counted. Writes screening.jsonl, one row a picture.

    Parameters
    ----------
    folder
        A set folder.
    json
        Print one JSON object on stdout.
    """
    from gen.files import dumps
    from gen.sets.screening import SCREENING, reasons, write_screening
    from gen.sets.set_folder import SetFolder

    verdicts = write_screening(SetFolder(folder))
    kept, out = sum(verdict.kept for verdict in verdicts), reasons(verdicts)
    clipped = sum(verdict.clipped_samples for verdict in verdicts if verdict.kept)
    if json:
        print(
            dumps(
                {
                    "file": str(folder / SCREENING),
                    "pictures": len(verdicts),
                    "kept": kept,
                    "left_out": out,
                    "clipped_samples": clipped,
                }
            )
        )
        return
    why = "".join(f"; {n} left out: {reason}" for reason, n in out.items())
    print(
        f"{folder}: {kept} of {_count(len(verdicts), 'picture')} kept{why}; {_count(clipped, 'clipped sample')} in what is kept"
    )


def split(
    folder: Path, /, *, fractions: str = "0.8,0.1,0.1", seed: int = 0, by: str = "object,material,lights", json: Json = False
) -> None:
    """Divide a set into train, validation and test so that no two share an object, a material or a light set.

    What the set's plan says of an item stands. The others go in groups that hang together by what they share. Only kept pictures
    count; a set that is not screened yet is screened first. Writes splits.json.

    Parameters
    ----------
    folder
        A set folder.
    fractions
        The shares of the pictures for train, validation and test.
    seed
        Of the order in which groups of equal size are dealt out.
    by
        What the splits must not share: object, material, lights.
    json
        Print one JSON object on stdout.
    """
    from gen.files import dumps
    from gen.sets.set_folder import SetFolder
    from gen.sets.splits import SPLITS, write_splits

    found = write_splits(SetFolder(folder), fractions_of(fractions), seed, words(by))
    if json:
        print(dumps({"file": str(folder / SPLITS), **found.plain()}))
        return
    parts = ", ".join(
        f"{name} {_count(len(ids), 'item')} ({_count(found.pictures[name], 'picture')})" for name, ids in found.splits.items()
    )
    print(f"{folder}: {parts}; {_count(found.groups, 'group')} by {', '.join(found.by)}")
    for note in found.notes:
        print(f"note: {note}")


def preview(
    folder: Path,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    count: int = 24,
    seed: int = 0,
) -> None:
    """Draw a contact sheet of a set or a capture: picture, diffuse, specular, matte and normals side by side.

    Of a stack the brightest picture is shown; of a single capture folder every picture is.

    Parameters
    ----------
    folder
        A set folder, or any capture folder.
    output
        The PNG to write. Default: preview.png in a set folder; of a capture, NAME-preview.png in the current folder.
    count
        The most items (or pictures) to show, drawn at random where there are more.
    seed
        Of that draw.
    """
    from gen.files import real
    from gen.images import write_png
    from gen.sets.preview import contact_sheet
    from gen.sets.set_folder import is_set_folder

    with progress_bar("drawing", "items") as progress:
        sheet = contact_sheet(folder, count, seed, progress)
    if output is None:
        output = folder / "preview.png" if is_set_folder(folder) else Path(f"{real(folder).name}-preview.png")
    _not_its_own(folder, output)
    write_png(output, sheet)
    print(f"{output}: {sheet.shape[1]}x{sheet.shape[0]} pixels")


def pack(
    folder: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    size: int | None = None,
    layers: str | None = None,
    dtype: Literal["half", "float"] = "half",
    split: str | None = None,
    kept_only: Annotated[bool, Parameter(name="--kept-only", negative="--all")] = True,
    limit: int | None = None,
    json: Json = False,
) -> None:
    """Pack a set into one safetensors file, from which training reads with numpy and torch alone.

    Masks, valid samples, lights and intensities are always packed. The memory needed is that of one capture.

    Parameters
    ----------
    folder
        A set folder.
    output
        The file to write, such as train.safetensors.
    size
        Pixels of a picture's longer side; a whole fraction of the rendered size. Default: as rendered.
    layers
        Comma-separated; default combined,diffuse,specular,matte,normals,depth,albedo,gloss.
    dtype
        Of radiance, albedo and gloss; normals, depth and lights are always float.
    split
        Pack one split only, such as train (see degloss gen split).
    kept_only
        Leave out what screening leaves out, or pack all that is rendered.
    limit
        Pack the first so many items only.
    json
        Print one JSON object on stdout.
    """
    from gen.files import dumps
    from gen.sets.packing import DEFAULT_LAYERS, pack_set
    from gen.sets.set_folder import SetFolder

    names = DEFAULT_LAYERS if layers is None else words(layers)
    with progress_bar("packing", "items") as progress:
        _not_its_own(folder, output)
        done = pack_set(SetFolder(folder), output, size, names, dtype, split, kept_only, limit, progress)
    h, w = done.size
    if json:
        print(dumps({"file": str(output), "items": done.items, "frames": done.frames, "size": [w, h], "bytes": done.bytes}))
        return
    print(f"{output}: {_count(done.items, 'item')}, {_count(done.frames, 'picture')} of {w}x{h}, {done.bytes / 1e6:.1f} MB")


def _not_its_own(folder: Path, output: Path) -> None:
    """InputError where an output would take the place of a file that belongs to the set or capture itself."""
    from gen.errors import InputError
    from gen.files import real

    place, root = real(output), real(folder)
    own = place.suffix in (".json", ".jsonl", ".yaml", ".exr", "") or place.name == "mask.png"
    if place.is_relative_to(root) and (own or len(place.relative_to(root).parts) > 1):
        raise InputError(f"{output}: may be one of the files of {folder} itself; choose another place with -o")


def fractions_of(text: str) -> list[float]:
    """The numbers of --fractions. Raises InputError where they are none."""
    from gen.errors import InputError

    try:
        return [float(word) for word in words(text)]
    except ValueError:
        raise InputError(f"--fractions {text}: must be three numbers such as 0.8,0.1,0.1") from None


def words(text: str) -> tuple[str, ...]:
    """The words of an option that takes several, with commas between them."""
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _count(n: int, noun: str) -> str:
    return f"{n:,} {noun}{'' if n == 1 else 's'}"


@contextmanager
def progress_bar(title: str, unit: str) -> Iterator[Callable[[int, int], None] | None]:
    """A progress bar on stderr, where that is a terminal; otherwise nothing."""
    import sys

    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn(unit), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
