"""EXR: what was written is what is read, and damaged files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gen.errors import InputError
from gen.exr import HALF_MAX, read_exr, stack, unstack, write_exr

RNG = np.random.default_rng(3)


def planes(*names: str, size: tuple[int, int] = (17, 23)) -> dict[str, np.ndarray]:
    return {name: RNG.normal(0, 5, size).astype(np.float32) for name in names}


def test_channels_come_back_bit_for_bit_under_their_names(tmp_path: Path) -> None:
    channels = planes("R", "G", "B", "A", "diffuse.R", "normal.X", "normal.Y", "normal.Z", "depth.Z")
    channels["depth.Z"][3, 4] = np.nan
    channels["depth.Z"][5, 4] = 1e10
    write_exr(tmp_path / "a.exr", channels, header={"note": "text"})
    found = read_exr(tmp_path / "a.exr")
    assert set(found) == set(channels)
    for name, plane in channels.items():
        assert found[name].dtype == np.float32
        np.testing.assert_array_equal(found[name], plane)


@pytest.mark.parametrize("cut", [np.s_[::2, ::3], np.s_[::-1], np.s_[:, ::-1], np.s_[1:9, 2:11]], ids=str)
def test_arrays_that_are_not_contiguous_are_written_right(tmp_path: Path, cut: object) -> None:
    whole = RNG.normal(size=(24, 30, 3)).astype(np.float32)
    part = whole[cut]
    write_exr(tmp_path / "a.exr", unstack("n", "XYZ", part))
    np.testing.assert_array_equal(stack(read_exr(tmp_path / "a.exr"), "n", "XYZ"), part)
    write_exr(tmp_path / "t.exr", {"Y": whole[..., 0].T})
    np.testing.assert_array_equal(read_exr(tmp_path / "t.exr")["Y"], whole[..., 0].T)


def test_half_channels_round_to_half_and_never_overflow(tmp_path: Path) -> None:
    channels = planes("a", "b")
    write_exr(tmp_path / "a.exr", channels, half=("a",))
    found = read_exr(tmp_path / "a.exr")
    np.testing.assert_array_equal(found["a"], channels["a"].astype(np.float16).astype(np.float32))
    np.testing.assert_array_equal(found["b"], channels["b"])
    for value in (HALF_MAX * 1.01, -1e9):
        channels["a"][0, 0] = value
        with pytest.raises(InputError, match="channel a holds values above 65504"):
            write_exr(tmp_path / "b.exr", channels, half=("a",))
    channels["a"][0, 0] = np.nan
    write_exr(tmp_path / "b.exr", channels, half=("a",))
    assert np.isnan(read_exr(tmp_path / "b.exr")["a"][0, 0])


def test_writing_leaves_the_arguments_and_the_folder_clean(tmp_path: Path) -> None:
    channels, header = planes("R", "G"), {"note": "x"}
    before = {name: plane.copy() for name, plane in channels.items()}
    write_exr(tmp_path / "a.exr", channels, half=("R",), header=header)
    write_exr(tmp_path / "b.exr", channels, half=("R",), header=header)
    assert header == {"note": "x"}
    for name, plane in before.items():
        np.testing.assert_array_equal(channels[name], plane)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    with pytest.raises(InputError, match="share one"):
        write_exr(tmp_path / "c.exr", {"R": np.zeros((3, 4)), "G": np.zeros((4, 3))})
    with pytest.raises(InputError, match="share one"):
        write_exr(tmp_path / "c.exr", {"R": np.zeros((3, 4, 3))})
    with pytest.raises(InputError, match="share one"):
        write_exr(tmp_path / "c.exr", {})
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.exr", "b.exr"]


@pytest.mark.parametrize("compression", ["NO_COMPRESSION", "RLE_COMPRESSION", "ZIPS_COMPRESSION", "PIZ_COMPRESSION"])
def test_files_of_other_writers(tmp_path: Path, compression: str) -> None:
    a = RNG.random((20, 31, 3)).astype(np.float16)
    header = {"compression": getattr(OpenEXR, compression), "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": a}) as file:
        file.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(stack(read_exr(tmp_path / "a.exr"), "", "RGB"), a.astype(np.float32))


def test_parts_are_merged(tmp_path: Path) -> None:
    parts = planes("R", "depth.Z")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File([OpenEXR.Part(dict(header), {name: plane}, f"part {name}") for name, plane in parts.items()]) as file:
        file.write(str(tmp_path / "a.exr"))
    found = read_exr(tmp_path / "a.exr")
    for name, plane in parts.items():
        np.testing.assert_array_equal(found[name], plane)


def test_stack_and_unstack(tmp_path: Path) -> None:
    a = RNG.random((4, 5, 3)).astype(np.float32)
    for name in ("", "normal"):
        np.testing.assert_array_equal(stack(unstack(name, "XYZ", a), name, "XYZ"), a)
        assert stack(unstack(name, "XYZ", a), name, "RGB") is None


def test_truncated_and_foreign_files_are_refused_in_silence(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, planes("R", "G", "B", "normal.X", size=(120, 90)))
    data = path.read_bytes()
    for length in (4, 9, 100, 300, len(data) // 3, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match=r"a\.exr: is damaged or truncated") as error:
            read_exr(path)
        assert "\n" not in str(error.value)
    for other in (b"\x89PNG\r\n\x1a\n" + data, b"text"):
        path.write_bytes(other)
        with pytest.raises(InputError, match="not an OpenEXR file"):
            read_exr(path)
    path.write_bytes(b"")
    with pytest.raises(InputError, match="is empty"):
        read_exr(path)
    assert capfd.readouterr() == ("", "")


def test_bytes_changed_anywhere_never_crash(tmp_path: Path) -> None:
    """Refused, or read with its shape: uncompressed samples carry no checksum."""
    path = tmp_path / "a.exr"
    write_exr(path, planes("R", "G", size=(40, 30)))
    data = path.read_bytes()
    lines: list[str] = []
    for at in [*range(4, 340, 7), *np.linspace(340, len(data) - 1, 30).astype(int)]:
        wrong = bytearray(data)
        wrong[at] ^= 0xFF
        path.write_bytes(bytes(wrong))
        try:
            found = read_exr(path)
        except InputError as error:
            lines.append(str(error))
        else:
            assert all(plane.ndim == 2 for plane in found.values())
    assert len(lines) > 10
    assert not any("\n" in line for line in lines)


def test_a_hostile_size_is_refused_before_memory_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, planes("R", size=(40, 30)))
    data = bytearray(path.read_bytes())
    for value in (29999, 65000, 2**31 - 1):
        at = data.index(b"dataWindow\0box2i\0") + 17 + 4 + 8
        data[at : at + 8] = int(value).to_bytes(4, "little") * 2
        path.write_bytes(bytes(data))
        with pytest.raises(InputError, match=r"a\.exr: is (larger|damaged)"):
            read_exr(path)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_a_cropped_file_gives_the_whole_picture_back(tmp_path_factory: pytest.TempPathFactory, seed: int, half: bool) -> None:
    """Also where all is one value, or all differs; and the library itself sees the windows."""
    import OpenEXR

    rng = np.random.default_rng(seed)
    H, W = rng.integers(1, 9, 2)
    (y0, y1), (x0, x1) = np.sort(rng.integers(0, H + 1, 2)), np.sort(rng.integers(0, W + 1, 2))
    channels = {}
    for name, outside in (("R", 0.0), ("depth.Z", np.nan), ("faults.V", 1.0)):
        channels[name] = np.full((H, W), outside, np.float32)
        channels[name][y0:y1, x0:x1] = rng.normal(size=(y1 - y0, x1 - x0)).astype(np.float16)
    path = tmp_path_factory.mktemp("crop") / "a.exr"
    write_exr(path, channels, half=("R",) if half else (), crop=True)
    back = read_exr(path)
    for name, array in channels.items():
        assert np.array_equal(back[name], array, equal_nan=True), name
    with OpenEXR.File(str(path), separate_channels=True) as file:
        (left, top), (right, bottom) = file.header()["dataWindow"]
        if (y0, x0) != (0, 0):  # the picture's corner shows what lies outside
            assert (right - left + 1) * (bottom - top + 1) == max(1, (y1 - y0) * (x1 - x0))
        assert [int(v) for v in file.header()["displayWindow"][1]] == [W - 1, H - 1]
        assert file.channels()["R"].pixels.shape == (bottom - top + 1, right - left + 1)
