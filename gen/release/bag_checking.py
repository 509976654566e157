"""Whether a folder is the BagIt bag that its manifests say: no links, sizes as bag-info.txt says, every byte by its checksum."""

from __future__ import annotations

from pathlib import Path

from gen.errors import InputError
from gen.files import sha256_of
from gen.release.bag import read_manifest
from gen.release.layout import BAG_INFO, BAGIT, DATA, MANIFEST, TAG_MANIFEST

MAX_INFO = 100_000
"""The largest bag-info.txt in bytes."""

MAX_FILES = 1_000_000


def bag_faults(path: Path) -> tuple[list[str], int]:
    """The faults of the folder as a BagIt bag, each line starting with a file's name; how many checksums were compared.

    None were where a file of the bag itself is missing or damaged: then nothing else in the folder can be relied on.
    """
    there, faults = _tree(path)
    for name in (BAGIT, BAG_INFO, MANIFEST, TAG_MANIFEST):
        if name not in there:
            return [*faults, f"{name}: is missing"], 0
    try:
        tags = read_manifest(path, TAG_MANIFEST)
        if sha256_of(path / MANIFEST) != tags.get(MANIFEST):
            raise InputError(f"{MANIFEST}: its SHA-256 is not the one in {TAG_MANIFEST}")
        payload = read_manifest(path, MANIFEST)
    except InputError as error:  # of what a damaged manifest says of other files nothing is true
        return [*faults, str(error)], 0
    listed = {**tags, **payload}
    faults += [f"{name}: is an extra file" for name in sorted(there - listed.keys() - {TAG_MANIFEST})]
    faults += [f"{name}: is in the manifest of the other files" for name in tags if name.startswith(f"{DATA}/")]
    faults += [f"{name}: does not lie in {DATA}" for name in payload if not name.startswith(f"{DATA}/")]
    oxum = f"{sum((path / name).stat().st_size for name in payload if name in there)}.{len(payload)}"
    if (path / BAG_INFO).stat().st_size > MAX_INFO:
        return [*faults, f"{BAG_INFO}: is too large"], 0
    if f"Payload-Oxum: {oxum}" not in (path / BAG_INFO).read_text("utf-8", "replace").splitlines():
        faults.append(f"{BAG_INFO}: Payload-Oxum is not {oxum}, the bytes and files that are there")
    for name, digest in listed.items():
        if name not in there:
            faults.append(f"{name}: is missing")
        elif sha256_of(path / name) != digest:
            faults.append(f"{name}: its SHA-256 is not the one in the manifest")
    return faults, len(listed)


def _tree(path: Path) -> tuple[set[str], list[str]]:
    """The names of all plain files, and a fault for every link and special file. Hidden names at the top are the downloader's."""
    names: set[str] = set()
    faults: list[str] = []
    waiting = [path]
    while waiting:
        for place in sorted(waiting.pop().iterdir()):
            name = place.relative_to(path).as_posix()
            if name.startswith("."):
                continue
            if place.is_symlink() or not (place.is_dir() or place.is_file()):
                faults.append(f"{name[:200]}: is a link or a special file, a release holds neither")
            elif place.is_dir():
                waiting.append(place)
            else:
                names.add(name)
            if len(names) > MAX_FILES:
                raise InputError(f"{path}: holds more than {MAX_FILES:,} files")
    return names, faults
