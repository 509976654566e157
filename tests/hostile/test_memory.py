"""The largest that is read honestly, and what one byte more does: limits hold before memory is taken, in each of the readers."""

from __future__ import annotations

from pathlib import Path

import OpenEXR
import pytest

from gen import exr, files
from gen.errors import InputError
from gen.exr import read_exr
from gen.formats import render_folder
from gen.formats.render_folder import read_render, write_files
from tests.conftest import synthetic_capture
from tests.hostile.files import exr_of_nothing


def test_an_empty_picture_below_the_free_size_is_read(tmp_path: Path) -> None:
    """Nothing but zeros packs as no picture does; as long as it is small, that is no reason to refuse it."""
    (tmp_path / "a.exr").write_bytes(exr_of_nothing(512))
    assert exr.FREE >= 8 * 4 * 512**2
    channels = read_exr(tmp_path / "a.exr")
    assert len(channels) == 8
    assert not any(channel.any() for channel in channels.values())


def test_more_channels_than_memory_holds_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.exr").write_bytes(exr_of_nothing(512))
    monkeypatch.setattr(exr, "memory", lambda: 16_000_000)
    with pytest.raises(InputError, match=r"a.exr: needs 0 GB of memory"):
        read_exr(tmp_path / "a.exr")


def test_a_capture_that_memory_does_not_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_files(synthetic_capture(size=32), tmp_path)
    monkeypatch.setattr(render_folder, "memory", lambda: 100_000)
    with pytest.raises(InputError, match=r"capture.json: its 5 pictures with their layers need"):
        read_render(tmp_path)


def test_the_machines_memory_is_known() -> None:
    text = Path("/proc/meminfo")
    if not text.exists():
        pytest.skip("this system has no /proc")
    said = int(text.read_text().split("MemTotal:")[1].split()[0]) * 1024
    assert files.memory() == pytest.approx(said, rel=0.1)


def test_a_deep_picture_is_refused(tmp_path: Path) -> None:
    """Many samples a pixel, as many as a file says, are nothing that a camera takes."""
    headers = [{"type": OpenEXR.deepscanline, "channels": [], "dataWindow": ((0, 0), (7, 5))}]
    with pytest.raises(InputError, match="deep data"):
        exr._check_headers(headers, 1000, tmp_path / "a.exr")
