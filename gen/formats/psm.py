"""psmImages lists: a text file that names the pictures and the mask, with `lights.txt` beside it.

Source: the photometric-stereo assignment of the University of Washington (CSE 455, S. Seitz): the count, the pictures, the mask.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from gen.capture import Capture
from gen.errors import InputError
from gen.files import inside, is_count, must_exist, read_lines
from gen.formats.tables import mask_or_frame, picture_paths, read_directions, read_scale
from gen.formats.truth import read_truth
from gen.images import SUFFIXES, read_frames


def is_psm(path: Path) -> bool:
    """Whether `path` is a list file, or a folder whose list and `lights.txt` stand beside it."""
    table = _list(path)
    if table is None:
        return False
    try:
        lines = [line for _, line in read_lines(table, "a list of pictures")]
    except InputError:
        return False
    return len(lines) > 1 and is_count(lines[0]) and lines[1].lower().endswith(SUFFIXES)


def read_psm(path: Path, encoding: str | None = None) -> Capture:
    """Read `NAME.txt` (the count, that many pictures, then the mask) or the folder `NAME` beside it; `lights.txt` beside the
    list.

    Names may carry leading folders that are not there (`psmImages/cat/cat.0.png` for `cat/cat.0.png`): these are left off, one by
    one, until the file is found under the list's folder. Where the list names no mask, the whole frame is taken. Raises
    InputError where a file is missing, damaged, contradicts another, or a name leads out of the list's folder.
    """
    table = _list(path)
    if table is None:
        raise InputError(f"{path}: there is no list of pictures ({path.name}.txt) beside this folder")
    folder = table.parent
    lines = [line for _, line in read_lines(table, "a list of pictures")]
    if not is_count(lines[0]):
        raise InputError(f"{table}: must begin with the number of pictures")
    count, names = int(lines[0]), [_found(folder, line, table) for line in lines[1:]]
    if len(names) not in (count, count + 1) or count == 0:
        raise InputError(
            f"{table}: says {count} pictures and then names {len(names)} files; {count} pictures and the mask are needed"
        )
    paths = picture_paths(folder, names, table)
    lights = read_directions(must_exist(folder / "lights.txt", "light directions"), count)
    frames = read_frames(paths[:count], encoding)
    mask, mask_origin = mask_or_frame(paths[count] if len(paths) > count else folder / f"{table.stem}.mask.png", frames)
    beside = paths[0].parent
    return Capture(
        images=frames.images,
        lights=lights,
        mask=mask,
        faults=frames.faults,
        names=tuple(p.name for p in paths[:count]),
        scale=read_scale(beside, (mask.shape[0], mask.shape[1])),
        truth=read_truth(beside, mask),
        encoding=frames.encoding,
        source=str(path),
        provenance={"format": "psm", "encoding": frames.reading, "bits": frames.bits, "mask": mask_origin, "list": table.name},
    )


def _list(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() == ".txt" else None
    path = path.absolute()
    table = path.with_name(f"{path.name}.txt")
    own = (path / "lights.txt").exists()
    return table if path.is_dir() and not own and table.is_file() and table.with_name("lights.txt").is_file() else None


def _found(folder: Path, name: str, table: Path) -> str:
    """`name` without the leading folders that are not there; unchanged where no shorter form is there either."""
    parts = PurePosixPath(name.replace("\\", "/")).parts
    try:
        inside(folder, name)
        for start in range(len(parts)):
            shorter = "/".join(parts[start:])
            if inside(folder, shorter).is_file():
                return shorter
    except InputError as error:
        raise InputError(f"{table}: {error}") from error
    return name
