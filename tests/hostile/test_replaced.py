"""Files that change while they are read: the reader gets the old one, the new one or an InputError, never half of each."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from gen.capture import read_capture
from gen.errors import InputError
from gen.exr import read_exr, write_exr
from gen.images import read_image, write_png
from gen.sets.pack import read_pack
from tests.hostile.files import lay_photographs, pack_bytes

READS = 150


@contextmanager
def meanwhile(change: Callable[[int], object]) -> Iterator[None]:
    """Run a change again and again in another thread."""
    ended = threading.Event()

    def again() -> None:
        number = 0
        while not ended.is_set():
            change(number)
            number += 1

    thread = threading.Thread(target=again)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def test_a_picture_that_is_replaced_is_the_old_or_the_new_one(tmp_path: Path) -> None:
    path, spare = tmp_path / "a.png", tmp_path / "b"
    pictures = [np.full((40, 40 + 8 * k, 3), 60 * (k + 1), np.uint8) for k in range(3)]
    write_png(path, pictures[0])

    def change(number: int) -> None:
        write_png(spare, pictures[number % 3])
        os.replace(spare, path)

    with meanwhile(change):
        for _ in range(READS):
            linear = read_image(path, "linear").linear
            expected = pictures[(linear.shape[1] - 40) // 8]
            assert np.allclose(linear, expected / 255)


def test_an_exr_that_is_replaced_is_the_old_or_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"R": np.full((20, 20), 0.0)})
    with meanwhile(lambda number: write_exr(path, {"R": np.full((20 + number % 3, 20), float(number % 3))})):
        for _ in range(READS):
            red = read_exr(path)["R"]
            assert (red == red.shape[0] - 20).all()


@pytest.mark.parametrize("change", ["cut", "empty", "gone", "a folder"])
def test_a_picture_that_goes_bad_is_refused_or_was_read_before(change: str, tmp_path: Path) -> None:
    """In place, as no careful program writes: what is read is then the whole picture or an InputError."""
    path = tmp_path / "a.png"
    write_png(path, np.full((64, 64, 3), 100, np.uint8))
    good = path.read_bytes()

    def harm(number: int) -> None:
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        if number % 2:
            path.write_bytes(good)
        elif change == "a folder":
            path.mkdir()
        elif change != "gone":
            path.write_bytes(good[: len(good) // 2] if change == "cut" else b"")

    refusals = []
    with meanwhile(harm):
        for _ in range(READS):
            try:
                assert np.allclose(read_image(path, "linear").linear, 100 / 255)
            except InputError as error:
                refusals.append(str(error))
    assert all(str(path) in refusal for refusal in refusals)


def test_a_capture_whose_pictures_change_is_whole_or_refused(tmp_path: Path) -> None:
    lay_photographs(tmp_path)
    whole, sound = (tmp_path / "3.png").read_bytes(), read_capture(tmp_path).images

    def harm(number: int) -> None:
        (tmp_path / "3.png").write_bytes(whole[: len(whole) - 9 * (number % 2)])

    refusals = []
    with meanwhile(harm):
        for _ in range(30):
            try:
                np.testing.assert_array_equal(read_capture(tmp_path).images, sound)
            except InputError as error:
                refusals.append(str(error))
    assert all("3.png" in refusal for refusal in refusals)


def test_an_open_pack_outlives_its_replacement(tmp_path: Path) -> None:
    """A pack is mapped; one that is written anew takes the name, and the open one keeps its bytes."""
    path, spare = tmp_path / "a.safetensors", tmp_path / "b"
    path.write_bytes(pack_bytes())
    pack = read_pack(path)
    spare.write_bytes(b"\0" * 10)
    os.replace(spare, path)
    assert (pack["combined"][:] == 1).all()
    with pytest.raises(InputError):
        read_pack(path)
