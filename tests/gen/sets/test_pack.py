"""Packs: the safetensors library reads ours and we read its files; hostile files are one line; pixels are those of the captures."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from gen.capture import Capture, read_capture
from gen.cli import app
from gen.errors import InputError
from gen.formats.render_folder import write_files
from gen.sets.pack import ALWAYS, DTYPES, FORMAT, MAX_HEADER, header_bytes, read_pack
from gen.sets.packing import DEFAULT_LAYERS, layer_names, pack_set
from gen.sets.set_folder import SetFolder
from gen.sets.shrink import shrink
from gen.sets.splits import write_splits

ROOT = Path(__file__).resolve().parents[3]


def call(*tokens: str | Path) -> None:
    app([str(token) for token in tokens], exit_on_error=False, result_action="return_value")


def test_the_library_reads_what_we_write(finished_set: SetFolder, tmp_path: Path) -> None:
    done = pack_set(finished_set, tmp_path / "p.safetensors", kept_only=False)
    ours, theirs = read_pack(tmp_path / "p.safetensors"), load_file(tmp_path / "p.safetensors")
    assert (done.items, done.frames, done.size, done.bytes) == (10, 22, (24, 24), (tmp_path / "p.safetensors").stat().st_size)
    assert set(ours.arrays) == set(theirs) == {*DEFAULT_LAYERS, *ALWAYS}
    for name, array in theirs.items():
        assert ours[name].dtype == array.dtype
        assert np.array_equal(ours[name], array, equal_nan=array.dtype.kind == "f"), name
        assert ours[name].ctypes.data % ours[name].itemsize == 0, f"{name} is not aligned"
    with safe_open(tmp_path / "p.safetensors", "numpy") as file:
        assert json.loads(file.metadata()["facts"])["items"] == list(ours.items)


def test_we_read_what_the_library_writes(finished_set: SetFolder, tmp_path: Path) -> None:
    pack_set(finished_set, tmp_path / "p.safetensors", kept_only=False)
    with safe_open(tmp_path / "p.safetensors", "numpy") as file:
        metadata = file.metadata()
    save_file(load_file(tmp_path / "p.safetensors"), tmp_path / "q.safetensors", metadata)
    first, second = read_pack(tmp_path / "p.safetensors"), read_pack(tmp_path / "q.safetensors")
    assert first.items == second.items
    for name in first.arrays:
        assert np.array_equal(first[name], second[name], equal_nan=first[name].dtype.kind == "f"), name


@pytest.mark.parametrize("dtype", ["half", "float"])
def test_a_pack_holds_the_captures(finished_set: SetFolder, tmp_path: Path, dtype: Any) -> None:
    pack_set(finished_set, tmp_path / "p", dtype=dtype, kept_only=False)
    pack = read_pack(tmp_path / "p")
    small = np.float16 if dtype == "half" else np.float32
    assert [item["id"] for item in pack.items] == [row["id"] for row in finished_set.rows() if row["status"] == "rendered"]
    for i, item in enumerate(pack.items):
        capture, at = read_capture(finished_set.path / "items" / item["id"]), pack.frames(i)
        assert at.stop - at.start == capture.count
        assert (pack["item"][at] == i).all()
        for name in ("combined", "diffuse", "specular", "matte"):
            layer = capture.images if name == "combined" else getattr(capture.truth, name)
            assert np.array_equal(pack[name][at], layer.astype(small))
        for name in ("albedo", "gloss"):
            assert np.array_equal(pack[name][i], getattr(capture.truth, name).astype(small))
        for name in ("normals", "depth"):
            assert np.array_equal(pack[name][i], getattr(capture.truth, name), equal_nan=True)
        assert np.array_equal(pack["mask"][i], capture.mask)
        assert np.array_equal(pack["valid"][at], capture.valid)
        assert np.array_equal(pack["lights"][at], capture.lights.astype(np.float32))
        assert np.array_equal(pack["intensities"][at], capture.intensities.astype(np.float32))
        assert item["alpha"] == pytest.approx(float(capture.truth.gloss.max()))
        assert item["material"] == "substrate"
    assert not pack["matte"].flags.writeable


def test_what_goes_in_is_chosen(set_folder: SetFolder, tmp_path: Path) -> None:
    def ids(**options: Any) -> list[str]:
        pack_set(set_folder, tmp_path / "p", layers=("combined",), **options)
        return [item["id"] for item in read_pack(tmp_path / "p").items]

    kept = [name for name in ids(kept_only=False) if name not in ("one-000001", "one-000004")]
    assert ids() == kept
    assert ids(limit=2) == kept[:2]
    found = write_splits(set_folder, (0.6, 0.2, 0.2), by=("object",))
    for name in ("train", "validation", "test"):
        assert ids(split=name) == list(found.splits[name])
    ids()
    pack = read_pack(tmp_path / "p")
    assert [pack.items[i]["id"] for i in pack.of_split("train")] == list(found.splits["train"])
    assert set(pack.arrays) == {"combined", *ALWAYS}
    with pytest.raises(InputError, match="has no array 'matte', but"):
        pack["matte"]
    for options, expected in (
        ({"split": "exam"}, "--split exam: the set is divided into train, validation, test"),
        ({"limit": 0}, "--limit 0"),
        ({"size": 10}, r"--size 10: one-000000 has 24x24 pixels, which shrink by whole factors only; choose one of 4, 6, 8, 12"),
        ({"size": 48}, r"--size 48: .* choose one of"),
        ({"size": 0}, "--size 0"),
    ):
        with pytest.raises(InputError, match=expected):
            ids(**options)
    for layers, expected in (
        (("gold",), "there is no layer 'gold'; there are combined, diffuse"),
        (("depth",) * 2, "named twice"),
    ):
        with pytest.raises(InputError, match=expected):
            layer_names(layers)
    with pytest.raises(InputError, match=r"one-000000: has no layer 'ks0', but combined, normals"):
        pack_set(set_folder, tmp_path / "new", layers=("ks0",))
    assert not (tmp_path / "new").exists()


def test_shrunk_items_and_layers_of_any_name(set_folder: SetFolder, tmp_path: Path) -> None:
    """A layer of flags and one of radiance that the set's renders do not have are packed by name."""
    for row in set_folder.rows():
        if row["status"] == "rendered":
            place = set_folder.item_folder(row["id"])
            capture = read_capture(place)
            shadow = np.where(capture.truth.matte.max(axis=3) > 0, 0, 2).astype(np.uint8)
            again = replace(capture, truth=replace(capture.truth, ks0=capture.truth.diffuse * 2, shadow=shadow))
            for path in (place / "frames").iterdir():
                path.unlink()
            (place / "frames").rmdir()
            write_files(again, place)
    pack_set(set_folder, tmp_path / "p", size=8, layers=("ks0", "shadow", "normals", "combined"), dtype="float")
    pack = read_pack(tmp_path / "p")
    assert pack.size == (8, 8)
    assert pack["shadow"].dtype == np.uint8
    for i, item in enumerate(pack.items):
        expected = shrink(set_folder.capture(item["id"]), 3)
        assert item["shrunk"] == 3
        assert np.array_equal(pack["ks0"][pack.frames(i)], expected.truth.ks0)
        assert np.array_equal(pack["shadow"][pack.frames(i)], expected.truth.shadow)
        assert np.array_equal(pack["normals"][i], expected.truth.normals)
        assert np.array_equal(pack["combined"][pack.frames(i)], expected.images)


def test_what_half_precision_cannot_hold_is_refused(set_folder: SetFolder, tmp_path: Path) -> None:
    place = set_folder.path / "items/stack-000001"
    capture = read_capture(place)
    for path in (place / "frames").iterdir():
        path.unlink()
    (place / "frames").rmdir()
    write_files(replace(capture, truth=replace(capture.truth, matte=capture.truth.matte * 4e5)), place)
    (tmp_path / "p").write_text("an earlier file")
    with pytest.raises(InputError, match=r"stack-000001: matte reaches .* half precision ends at 65504; pack with --dtype float"):
        pack_set(set_folder, tmp_path / "p")
    assert (tmp_path / "p").read_text() == "an earlier file"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p", "set"]
    pack_set(set_folder, tmp_path / "p", dtype="float")
    assert float(read_pack(tmp_path / "p")["matte"].max()) > 65504


def test_the_same_set_gives_the_same_bytes_in_the_memory_of_one_capture(finished_set: SetFolder, tmp_path: Path) -> None:
    def peak(limit: int) -> int:
        tracemalloc.start()
        try:
            pack_set(finished_set, tmp_path / f"{limit}", kept_only=False, limit=limit, dtype="float")
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(6)  # whatever is loaded and cached the first time
    six, eight = peak(6), peak(8)  # one stack or three
    grown = (tmp_path / "8").stat().st_size - (tmp_path / "6").stat().st_size
    assert grown > 300_000
    assert eight - six < grown / 4, (six, eight)
    before = (tmp_path / "8").read_bytes()
    peak(8)
    assert (tmp_path / "8").read_bytes() == before


def test_reading_needs_numpy_and_the_standard_library_alone(set_folder: SetFolder, tmp_path: Path) -> None:
    pack_set(set_folder, tmp_path / "p", limit=2)  # which screens the set first
    code = (
        "import sys, numpy; before = {*sys.modules}; from gen.sets.pack import read_pack;"
        "pack = read_pack(sys.argv[1]); pack['matte'].sum();"
        "print(*sorted({m.split('.')[0] for m in {*sys.modules} - before if not m.startswith('numpy.')} - {*sys.stdlib_module_names}))"
    )
    run = subprocess.run([sys.executable, "-c", code, tmp_path / "p"], capture_output=True, text=True, cwd=ROOT, check=True)
    assert run.stdout.split() == ["gen"]


@pytest.fixture(scope="module")
def packed(finished_set: SetFolder, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The bytes of a small pack."""
    path = tmp_path_factory.mktemp("pack") / "p"
    pack_set(finished_set, path, size=4, layers=("matte", "depth"), limit=5, kept_only=False)
    return path.read_bytes()


def taken_apart(data: bytes) -> tuple[dict[str, Any], bytes]:
    length = int.from_bytes(data[:8], "little")
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def put_together(header: Any, body: bytes) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + body


def change(name: str, **entry: Any) -> Callable[[dict[str, Any]], None]:
    return lambda header: header[name].update(entry)


def metadata(**entries: Any) -> Callable[[dict[str, Any]], None]:
    return lambda header: header["__metadata__"].update(entries)


def facts(edit: Callable[[Any], None]) -> Callable[[dict[str, Any]], None]:
    def apply(header: dict[str, Any]) -> None:
        value = json.loads(header["__metadata__"]["facts"])
        edit(value)
        header["__metadata__"]["facts"] = json.dumps(value)

    return apply


HEADERS: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "no metadata": (lambda h: h.pop("__metadata__"), "not a pack; write one with degloss gen pack"),
    "version": (metadata(version="9"), "version 9, this program reads 1"),
    "no facts": (metadata(facts="[]"), "lacks the facts"),
    "deep facts": (metadata(facts="[" * 100_000), "lacks the facts"),
    "entry": (lambda h: h.update(matte=3), "array 'matte' is of a kind that is not read"),
    "dtype": (change("matte", dtype="F64"), "array 'matte' is of a kind that is not read; a pack holds BOOL, U8"),
    "shape": (change("matte", shape=[-1, 4, 4, 3]), "must be short lists of whole numbers"),
    "float shape": (change("matte", shape=[5.0, 4, 4, 3]), "must be short lists of whole numbers"),
    "true shape": (change("matte", shape=[True, 4, 4, 3]), "must be short lists of whole numbers"),
    "long shape": (change("matte", shape=[1] * 9), "must be short lists"),
    "offsets": (change("matte", data_offsets=[0]), "must be short lists"),
    "huge": (change("matte", data_offsets=[0, 2**61]), "the file is truncated or damaged"),
    "huge shape": (change("matte", shape=[2**61, 2**61]), "its shape asks for"),
    "backwards": (change("matte", data_offsets=[480, 0]), "the file is truncated or damaged"),
    "overlap": (change("valid", data_offsets=[0, 80]), "overlaps the array before it|leaves a gap"),
    "no mask": (lambda h: h.pop("mask"), "leaves a gap|bytes follow the last array"),
    "size": (change("matte", shape=[5, 2, 8, 3]), r"array 'matte' is \(5, 2, 8, 3\), the others ask for \(5, 4, 4, 3\)"),
    "item kind": (change("item", dtype="F32"), "are not"),
    "frames": (facts(lambda f: f["items"][2].update(frames=[2, 4])), "not those of item 2|no range of frames"),
    "frames kind": (facts(lambda f: f["items"][2].update(frames="all")), "item 2 name no range of frames"),
    "items": (facts(lambda f: f["items"].pop()), r"array 'depth' is \(5, 4, 4\), the others ask for \(4, 4, 4\)"),
}  # fmt: skip


@pytest.mark.parametrize("name", HEADERS)
def test_a_header_that_lies_is_one_line(packed: bytes, tmp_path: Path, name: str) -> None:
    header, body = taken_apart(packed)
    HEADERS[name][0](header)
    (tmp_path / "p").write_bytes(put_together(header, body))
    with pytest.raises(InputError, match=HEADERS[name][1]):
        read_pack(tmp_path / "p")


FILES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "empty": (lambda d: b"", "is empty"),
    "short": (lambda d: d[:5], "truncated or not a safetensors file"),
    "header cut": (lambda d: d[:40], "truncated or not a safetensors file"),
    "body cut": (lambda d: d[:-1], "truncated or damaged"),
    "more": (lambda d: d + b"x", "1 bytes follow the last array"),
    "huge header": (lambda d: (2**63).to_bytes(8, "little") + d[8:], f"its header would be {2**63} bytes"),
    "a picture": (lambda d: b"\x89PNG\r\n\x1a\n" * 20, "not a safetensors file"),
    "not JSON": (lambda d: put_together(b"{nothing}", b""), "not valid JSON"),
    "not text": (lambda d: put_together(b"\xff\xfe{}", b""), "not valid JSON"),
    "deep": (lambda d: put_together(b"[" * 200_000, b""), "not valid JSON"),
    "a list": (lambda d: put_together(b"[1, 2]", b""), "not a table of arrays"),
    "twice": (lambda d: put_together(b'{"a": 1, "a": 2}', b""), "is there twice"),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_no_pack_is_one_line(packed: bytes, tmp_path: Path, name: str) -> None:
    (tmp_path / "p").write_bytes(FILES[name][0](packed))
    with pytest.raises(InputError, match=FILES[name][1]) as caught:
        read_pack(tmp_path / "p")
    assert len(str(caught.value)) < 400
    with pytest.raises(InputError, match="no such file"):
        read_pack(tmp_path / "nothing")


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_any_changed_byte_of_the_header_is_read_or_refused(packed: bytes, tmp_path_factory: Any, data: st.DataObject) -> None:
    length = 8 + int.from_bytes(packed[:8], "little")
    damaged = bytearray(packed)
    for _ in range(data.draw(st.integers(1, 3))):
        damaged[data.draw(st.integers(0, length - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "damaged"
    path.write_bytes(damaged)
    try:
        pack = read_pack(path)
    except InputError:
        return
    for array in pack.arrays.values():
        assert array.tobytes() is not None  # whatever is mapped lies inside the file


@settings(max_examples=50, deadline=None)
@given(
    st.dictionaries(
        st.text(min_size=1, max_size=8).filter(lambda name: name != "__metadata__" and name.isprintable()),
        st.tuples(st.sampled_from(sorted(DTYPES)), st.lists(st.integers(0, 5), max_size=4).map(tuple)),
        max_size=6,
    )
)
def test_any_header_of_ours_is_read_by_the_library(tmp_path_factory: Any, tensors: dict[str, Any]) -> None:
    opening, places = header_bytes(tensors, {"format": FORMAT})
    total = sum(math.prod(shape) * DTYPES[kind].itemsize for kind, shape in tensors.values())
    path = tmp_path_factory.getbasetemp() / "header"
    body = np.arange(total, dtype=np.uint64).astype(np.uint8) % 2
    path.write_bytes(opening + body.tobytes())
    found = load_file(path)
    assert set(found) == set(tensors)
    for name, (kind, shape) in tensors.items():
        start = places[name] - len(opening)
        expected = body[start : start + math.prod(shape) * DTYPES[kind].itemsize].view(DTYPES[kind]).reshape(shape)
        assert found[name].tobytes() == expected.tobytes()
        assert found[name].shape == shape


def test_too_many_facts_are_refused() -> None:
    with pytest.raises(InputError, match="do not fit into one header"):
        header_bytes({}, {"facts": "x" * MAX_HEADER})


def test_the_command_packs(set_folder: SetFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str], synthetic: Any) -> None:
    call("pack", set_folder.path, "-o", tmp_path / "p", "--size", "12", "--layers", "combined, matte,mask", "--json")
    facts = json.loads(capsys.readouterr().out)
    assert facts == {"file": str(tmp_path / "p"), "items": 8, "frames": 20, "size": [12, 12], "bytes": facts["bytes"]}
    call("pack", set_folder.path, "-o", tmp_path / "p", "--all", "--limit", "9", "--dtype", "float")
    assert "9 items, 21 pictures of 24x24" in capsys.readouterr().out
    assert isinstance(read_capture(set_folder.path / "items/one-000000"), Capture)
