"""RTI folders: pictures and one `.lp` file of light positions on the unit dome.

Source: the .lp files of the RTIBuilder and Hewlett-Packard PTM tools: the count, then `file x y z` a line, x right, y up, z out.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from gen.capture import Capture
from gen.errors import InputError
from gen.files import inside
from gen.formats.tables import mask_or_frame, picture_paths, read_named_directions, read_scale
from gen.formats.truth import read_truth
from gen.images import read_frames


def is_rti(path: Path) -> bool:
    """Whether `path` is a `.lp` file or a folder that holds one."""
    return bool(_lists(path))


def read_rti(path: Path, encoding: str | None = None) -> Capture:
    """Read a folder with one `.lp` file, or the `.lp` file that is named. Positions are taken as directions.

    A name in the list may carry the folder's own name before it. Optional beside it: `mask.png` (else the whole frame), true
    normals (see `gen.formats.truth.read_truth`; `normals.png` as SynthRTI writes it), `scale.txt`. Raises InputError where
    there are several lists, or a file is missing, damaged, contradicts another, or a name leads out of the folder.
    """
    lists = _lists(path)
    if len(lists) != 1:
        raise InputError(f"{path}: holds {len(lists)} .lp files; name the one that is meant")
    table, folder = lists[0], lists[0].parent
    names, lights = read_named_directions(table, "lights, file x y z a line")
    paths = picture_paths(folder, [_local(folder, name, table) for name in names], table)
    frames = read_frames(paths, encoding)
    mask, mask_origin = mask_or_frame(folder / "mask.png", frames)
    return Capture(
        images=frames.images,
        lights=lights,
        mask=mask,
        faults=frames.faults,
        names=tuple(p.name for p in paths),
        scale=read_scale(folder, (mask.shape[0], mask.shape[1])),
        truth=read_truth(folder, mask),
        encoding=frames.encoding,
        source=str(path),
        provenance={"format": "rti", "encoding": frames.reading, "bits": frames.bits, "mask": mask_origin, "list": table.name},
    )


def _lists(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(p for p in path.iterdir() if p.suffix.lower() == ".lp" and p.is_file() and not p.name.startswith("."))
    return [path] if path.suffix.lower() == ".lp" and path.is_file() else []


def _local(folder: Path, name: str, table: Path) -> str:
    """`name`, or its last part where only that is in the folder. Names that lead out stay refused, whatever their last part."""
    try:
        if inside(folder, name).is_file():
            return name
    except InputError as error:
        raise InputError(f"{table}: {error}") from error
    last = PurePosixPath(name.replace("\\", "/")).name
    return last if (folder / last).is_file() else name
