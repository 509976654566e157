"""The kinds of capture folders that are read. To add one: write its two functions and enter them in `READERS`.

`is_x(path) -> bool` looks at names only, as far as it can; `read_x(path, encoding) -> Capture` reads or raises InputError.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

from gen.capture import Capture
from gen.errors import InputError

READERS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "render": ("gen.formats.render_folder:is_render", "gen.formats.render_folder:read_render"),
        "photos": ("gen.photos.read:is_photos", "gen.photos.read:read_photos"),
        "diligent": ("gen.formats.diligent:is_diligent", "gen.formats.diligent:read_diligent"),
        "rti": ("gen.formats.rti:is_rti", "gen.formats.rti:read_rti"),
        "psm": ("gen.formats.psm:is_psm", "gen.formats.psm:read_psm"),
        "plain": ("gen.formats.plain:is_plain", "gen.formats.plain:read_plain"),
    }
)
"""Name of a format -> "module:detect", "module:read", imported when used. The order is the order of detection."""

KNOWN = (
    "our render folders (capture.json), photographs with capture.yaml, DiLiGenT folders (filenames.txt), RTI folders (.lp), "
    "psmImages lists (NAME.txt beside lights.txt), folders of PNG, TIFF, JPEG or EXR pictures with lights.txt"
)


def detect(path: Path) -> str:
    """The name in `READERS` of the format of a capture's folder or list file.

    Raises InputError where there is nothing at `path`, or where it is none of them.
    """
    path = Path(path)
    try:
        if not path.exists():
            raise InputError(f"{path}: there is no such file or folder")
        for name, (is_it, _) in READERS.items():
            if _load(is_it)(path):
                return name
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if path.is_file():
        raise InputError(f"{path}: is a file, but a capture is a folder or its list (.lp, or .txt beside lights.txt)")
    raise InputError(f"{path}: is not a capture that is known; these are: {KNOWN}")


def read(path: Path, encoding: str | None = None, format: str | None = None) -> Capture:
    """Read a capture. encoding: "srgb", "linear" or None for the default of the files' kind. format: a name in `READERS`.

    Raises InputError where the format is unknown or the capture cannot be read.
    """
    from gen.formats.tables import with_distance
    from gen.images import check_encoding

    path = Path(path)
    check_encoding(encoding)
    if format is not None and format not in READERS:
        raise InputError(f"format {format!r} is unknown; there are {', '.join(READERS)}")
    if format is not None and not path.exists():
        raise InputError(f"{path}: there is no such file or folder")
    name = format or detect(path)
    reader = _load(READERS[name][1])
    try:
        capture: Capture = reader(path, encoding)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    return with_distance(capture)


def _load(target: str) -> Callable[..., Any]:
    module, function = target.split(":")
    found: Callable[..., Any] = getattr(import_module(module), function)
    return found
