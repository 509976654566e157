"""BagIt (RFC 8493): the payload in data/, its manifest, and a manifest of all other files; `sha256sum -c` checks both."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from gen.errors import InputError
from gen.files import inside, must_exist, sha256_of
from gen.release.about import About
from gen.release.layout import BAG_INFO, BAGIT, DATA, MANIFEST, TAG_MANIFEST

MAX_MANIFEST = 100_000_000
"""The largest manifest in bytes."""

_LINE = re.compile(r"([0-9a-f]{64})  ([A-Za-z0-9][A-Za-z0-9._/-]{0,200})")
DECLARATION = "BagIt-Version: 1.0\nTag-File-Character-Encoding: UTF-8\n"


def write_bag(built: Path, about: About, known: Mapping[str, str]) -> int:
    """Write bagit.txt, bag-info.txt and both manifests; the bytes of all files. known: SHA-256 of files that were hashed before."""
    payload = sorted(path.relative_to(built).as_posix() for path in (built / DATA).iterdir())
    sizes = {name: (built / name).stat().st_size for name in payload}
    info = {
        "External-Identifier": about.identifier,
        "External-Description": about.title,
        "Payload-Oxum": f"{sum(sizes.values())}.{len(payload)}",
        "Bag-Software-Agent": f"degloss {version('degloss')}",
        **({"Bagging-Date": about.date} if about.date else {}),
    }
    (built / BAGIT).write_text(DECLARATION, encoding="utf-8")
    (built / BAG_INFO).write_text("".join(f"{key}: {value}\n" for key, value in info.items()), encoding="utf-8")
    _manifest(built / MANIFEST, {name: known.get(name) or sha256_of(built / name) for name in payload})
    tags = sorted(path.name for path in built.iterdir() if path.is_file())
    _manifest(built / TAG_MANIFEST, {name: sha256_of(built / name) for name in tags})
    return sum(sizes.values()) + sum(path.stat().st_size for path in built.iterdir() if path.is_file())


def read_manifest(folder: Path, name: str) -> dict[str, str]:
    """The SHA-256 of each file that a manifest lists, by its name from the bag's folder.

    Raises InputError where it is missing or too large, or a line is none of a manifest's, leads out of the folder or comes twice.
    """
    path = must_exist(folder / name, "a manifest")
    if path.is_symlink() or path.stat().st_size > MAX_MANIFEST:
        raise InputError(f"{name}: is a link, or too large")
    listed: dict[str, str] = {}
    for number, line in enumerate(path.read_text("utf-8", "replace").splitlines(), 1):
        match = _LINE.fullmatch(line)
        if match is None or match[2] in listed:
            raise InputError(f"{name}: line {number} is no line of a manifest, or names a file twice")
        try:
            inside(folder, match[2])
        except InputError:
            raise InputError(f"{name}: line {number} names a file outside the folder") from None
        listed[match[2]] = match[1]
    return listed


def _manifest(path: Path, digests: Mapping[str, str]) -> None:
    path.write_text("".join(f"{digest}  {name}\n" for name, digest in digests.items()), encoding="utf-8")
