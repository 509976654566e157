"""Reading a release back into captures, and the care with which a lone shard is unpacked."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from gen.capture import read_capture
from gen.errors import InputError
from gen.release.layout import field_of, file_of, key_of
from gen.release.reading import open_release, unpack_shard
from gen.release.tar import header
from gen.sets.set_folder import SetFolder
from tests.gen.release.test_documents import same_captures


def test_every_capture_comes_back_to_the_bit(released: Path, rendered: SetFolder) -> None:
    release = open_release(released)
    ids = []
    for capture in release.captures():
        same_captures(capture, rendered)
        ids.append(capture.provenance["spec"]["name"])
    splits = json.loads((rendered.path / "splits.json").read_text())["splits"]
    assert ids == release.items()
    assert {split: sorted(release.items(split)) for split in splits} == {split: sorted(items) for split, items in splits.items()}


def test_a_capture_unpacks_to_a_folder(released: Path, rendered: SetFolder, tmp_path: Path) -> None:
    open_release(released).unpack("stack-000002", tmp_path / "c")
    same_captures(read_capture(tmp_path / "c"), rendered)
    with pytest.raises(InputError, match="holds no capture 'nobody'"):
        open_release(released).unpack("nobody", tmp_path / "d")
    assert not (tmp_path / "d").exists()


def test_a_lone_shard_unpacks_to_folders(released: Path, rendered: SetFolder, tmp_path: Path) -> None:
    found = []
    for shard in sorted((released / "data").glob("*.tar")):
        found += unpack_shard(shard, tmp_path / shard.stem)
    assert len(found) == 8
    for folder in found:
        same_captures(read_capture(folder), rendered)


def archive(path: Path, *members: tuple[str, bytes | str | int]) -> Path:
    """A tar archive of files (bytes), links (a text) and devices (a type)."""
    with tarfile.open(path, "w") as tar:
        for name, content in members:
            info = tarfile.TarInfo(name)
            if isinstance(content, bytes):
                info.size = len(content)
                tar.addfile(info, io.BytesIO(content))
            else:
                info.type = tarfile.SYMTYPE if isinstance(content, str) else tarfile.CHRTYPE
                info.linkname = content if isinstance(content, str) else ""
                tar.addfile(info)
    return path


HOSTILE: dict[str, Callable[[Path], Path]] = {
    "up": lambda p: archive(p, ("../evil.001.exr", b"x")),
    "whole path": lambda p: archive(p, ("/tmp/evil.001.exr", b"x")),
    "below": lambda p: archive(p, ("a/b.001.exr", b"x")),
    "in the field": lambda p: archive(p, ("a.b/../../x.exr", b"x")),
    "link": lambda p: archive(p, ("a.mask.png", "/etc/passwd")),
    "device": lambda p: archive(p, ("a.mask.png", 1)),
    "hidden": lambda p: archive(p, (".a.mask.png", b"x")),
    "no field": lambda p: archive(p, ("a", b"x")),
    "huge": lambda p: p.write_bytes(header("a.001.exr", 2_000_000_001) + bytes(1024)) and p,  # type: ignore[func-returns-value]
    "truncated": lambda p: p.write_bytes(header("a.001.exr", 5000) + bytes(100)) and p,  # type: ignore[func-returns-value]
    "packed": lambda p: p.write_bytes(b"\x1f\x8b" + bytes(600)) and p,  # type: ignore[func-returns-value]
    "twice": lambda p: archive(p, ("a.mask.png", b"x"), ("a.mask.png", "b")),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_shard_is_refused_whole(tmp_path: Path, name: str) -> None:
    (tmp_path / "in").mkdir()
    shard = HOSTILE[name](tmp_path / "in/x.tar")
    with pytest.raises(InputError) as caught:
        unpack_shard(shard, tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["in", "x.tar"]
    assert not Path("/tmp/evil.001.exr").exists()


def test_unpacking_writes_over_nothing(released: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(InputError, match="is there already"):
        unpack_shard(next((released / "data").glob("*.tar")), tmp_path)


def test_fields_and_files_are_each_others_reverse() -> None:
    files = ["capture.json", "view.exr", "mask.png", "frames/001.exr", "frames/00012.exr"]
    assert [file_of(str(field_of(file))) for file in files] == files
    assert field_of("spec.yaml") is None
    assert file_of("json") is None
    for file in ("frames/../x.exr", "notes.txt", "frames/1.png"):
        with pytest.raises(InputError, match="has no place in a release"):
            field_of(file)
    with pytest.raises(InputError, match="cannot be the key of a sample"):
        key_of("v1.2-000001")


@pytest.mark.parametrize("text", ["{}", "[]", "x", '{"format": "degloss release", "format_version": 99}'])
def test_what_is_no_release_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="provenance"):
        open_release(tmp_path)
    (tmp_path / "provenance.json").write_text(text)
    with pytest.raises(InputError, match=r"provenance.json"):
        open_release(tmp_path)
