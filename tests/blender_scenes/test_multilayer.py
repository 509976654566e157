"""The small EXR reader against files that the OpenEXR library wrote."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from blender_scenes.multilayer import read_multilayer


def channels(rng: np.random.Generator, height: int = 7, width: int = 5) -> dict[str, np.ndarray]:
    return {
        "View.Combined.R": rng.normal(size=(height, width)).astype(np.float32),
        "View.Depth.Z": rng.uniform(1, 1e10, (height, width)).astype(np.float32),
        "a": rng.normal(size=(height, width)).astype(np.float16),
        "id": rng.integers(0, 1000, (height, width)).astype(np.uint32),
    }


def header(**changes: object) -> dict[str, object]:
    return {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage, **changes}


@pytest.mark.parametrize("order", [OpenEXR.INCREASING_Y, OpenEXR.DECREASING_Y])
def test_single_part(tmp_path: Path, order: object) -> None:
    written = channels(np.random.default_rng(1))
    with OpenEXR.File(header(lineOrder=order), dict(written)) as file:
        file.write(str(tmp_path / "x.exr"))
    read = read_multilayer(tmp_path / "x.exr")
    assert set(read) == set(written)
    for name, array in written.items():
        np.testing.assert_array_equal(read[name], array.astype(np.float32))


def test_parts_are_merged_and_named(tmp_path: Path) -> None:
    one, two = channels(np.random.default_rng(1)), {"Z": np.random.default_rng(2).normal(size=(7, 5)).astype(np.float32)}
    parts = [OpenEXR.Part(header(), dict(one), "first"), OpenEXR.Part(header(), dict(two), "View.Depth")]
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "x.exr"))
    read = read_multilayer(tmp_path / "x.exr")
    np.testing.assert_array_equal(read["View.Depth.Z"], two["Z"])
    np.testing.assert_array_equal(read["View.Combined.R"], one["View.Combined.R"])
    np.testing.assert_array_equal(read["first.id"], one["id"].astype(np.float32))


def test_what_it_cannot_read_it_refuses(tmp_path: Path) -> None:
    path = tmp_path / "x.exr"
    for changes in ({"compression": OpenEXR.ZIP_COMPRESSION}, {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}):
        with OpenEXR.File(header(**changes), channels(np.random.default_rng(1), 64, 64)) as file:
            file.write(str(path))
        with pytest.raises(ValueError, match=r"compressed|scan lines"):
            read_multilayer(path)
    with OpenEXR.File(header(), channels(np.random.default_rng(1))) as file:
        file.write(str(path))
    data = path.read_bytes()
    for length in (0, 3, 7, 20, 100, 300, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:length])
        with pytest.raises(ValueError, match=r"x\.exr"):
            read_multilayer(path)


def test_damage_never_raises_anything_else(tmp_path: Path) -> None:
    with OpenEXR.File(header(), channels(np.random.default_rng(1))) as file:
        file.write(str(tmp_path / "x.exr"))
    data = bytearray((tmp_path / "x.exr").read_bytes())
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(300):
        damaged = bytearray(data)
        for at in rng.integers(0, len(data), 3):
            damaged[at] = rng.integers(256)
        (tmp_path / "y.exr").write_bytes(damaged)
        try:
            read_multilayer(tmp_path / "y.exr")
        except ValueError:
            refused += 1
    assert refused > 30
