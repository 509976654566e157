"""The conversion of captures and sets as a whole, by the command: whole or not at all, and nothing outside the output."""

from __future__ import annotations

import json
import re
import resource
import shutil
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pyarrow.parquet as pq
import pytest
import webdataset

from gen.capture import Capture, read_capture
from gen.cli import app
from gen.convert import FORMATS
from gen.convert.command import Format
from gen.convert.conversion import convert
from gen.convert.diligent import write_diligent
from gen.convert.webdataset import Shards
from gen.errors import InputError
from gen.exr import write_exr
from gen.files import sha256_of
from gen.formats.render_folder import write_render
from gen.images import write_png
from gen.release.about import About
from gen.release.build import release_set
from gen.release.layout import MANIFEST, MEMBERS, PICTURES, file_of
from gen.release.samples import without_paths
from gen.release.tables import MEMBERS as MEMBER_COLUMNS
from gen.release.tables import table_writer
from gen.sets.set_folder import SetFolder
from gen.sets.splits import write_splits
from tests.gen.convert.conftest import contents
from tests.gen.sets.conftest import store_half_and_cropped
from tests.gen.test_render_folder import same

LEFT_OPEN = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
"""webdataset leaves the archives that it reads to the garbage collector."""


def call(*tokens: object) -> None:
    app(["convert", *map(str, tokens)], exit_on_error=False, result_action="return_value")


@pytest.fixture
def render(tmp_path: Path, glossy: Capture) -> Path:
    write_render(glossy, tmp_path / "render")
    return tmp_path / "render"


def test_the_command_offers_every_format() -> None:
    assert set(get_args(Format)) == set(FORMATS)


@pytest.mark.parametrize("format", FORMATS)
def test_a_capture_by_the_command(render: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], format: str) -> None:
    call(render, tmp_path / "out", "--format", format, "--json")
    printed = capsys.readouterr()
    facts = json.loads(printed.out)
    assert (facts["captures"], facts["pictures"], facts["format"]) == (1, 7, format)
    assert printed.err.count("\n") == bool(facts["not_held"])
    assert bool(facts["not_held"]) == (format in ("diligent", "png16"))
    before = contents(tmp_path / "out")
    call(render, tmp_path / "out", "--format", format)  # an earlier conversion is replaced
    printed = capsys.readouterr()
    assert re.fullmatch(rf".*out: 7 pictures as {format} in [\d.]+ s\n", printed.out)
    assert facts["not_held"] == {} or printed.err.startswith(f"note: {format} does not hold: ")
    assert contents(tmp_path / "out") == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "render"]


@pytest.mark.parametrize("format", FORMATS)
def test_a_set_becomes_a_folder_a_capture_or_shards(small_set: SetFolder, tmp_path: Path, format: str) -> None:
    steps: list[tuple[int, int]] = []
    done = convert(small_set.path, tmp_path / "out", format, progress=lambda n, total: steps.append((n, total)))
    assert (done.captures, done.pictures) == (10, 22)
    assert steps == [(n, 10) for n in range(1, 11)]
    ids = [row["id"] for row in small_set.rows() if row["status"] == "rendered"]
    if format == "webdataset":
        assert sorted(path.name for path in (tmp_path / "out").glob("*.tar")) == ["captures-00000.tar", "test-00000.tar"]
        return
    listed = json.loads((tmp_path / "out" / "captures.json").read_text())["captures"]
    assert [row["folder"] for row in listed] == ids
    assert [row["split"] for row in listed] == [None] * 8 + ["test"] * 2
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*ids, "captures.json", ".degloss"}
    for name in (ids[0], ids[-1]):
        found, capture = read_capture(tmp_path / "out" / name), small_set.capture(name)
        assert found.count == capture.count
        np.testing.assert_allclose(found.reflectance(), capture.reflectance(), atol=1e-4)
    rare = {what: n for what, n in done.lost.items() if n < 10}
    for what, n in rare.items():
        assert f"{what} (of {n} captures)" in done.note(format)


@LEFT_OPEN
def test_a_divided_set_keeps_its_splits(small_set: SetFolder, tmp_path: Path) -> None:
    shutil.copytree(small_set.path, tmp_path / "set")
    write_splits(SetFolder(tmp_path / "set"), (0.5, 0.25, 0.25), by=("object",))
    convert(tmp_path / "set", tmp_path / "out", "webdataset")
    split_of = {}
    for path in sorted((tmp_path / "out").glob("*.tar")):
        for sample in webdataset.WebDataset(str(path), shardshuffle=False, empty_check=False).decode():
            split_of[sample["__key__"]] = sample["json"]["split"]
            assert path.name.startswith(f"{sample['json']['split'] or 'captures'}-")
    divided = json.loads((tmp_path / "set" / "splits.json").read_text())["splits"]
    assert {key: split for key, split in split_of.items() if split} == {i: name for name, ids in divided.items() for i in ids}
    assert len(split_of) == 10


def test_a_release_becomes_what_its_set_would(small_set: SetFolder, released: Path, tmp_path: Path) -> None:
    done = convert(released, tmp_path / "out", "diligent")
    listed = json.loads((tmp_path / "out" / "captures.json").read_text())["captures"]
    assert done.captures == len(listed)
    assert {row["split"] for row in listed} == {"train", "validation", "test"}
    for row in (listed[0], listed[-1]):
        wanted = tmp_path / "wanted" / row["folder"]
        wanted.mkdir(parents=True)
        write_diligent(small_set.capture(row["folder"]), wanted)
        assert contents(tmp_path / "out" / row["folder"]) == contents(wanted)
    with pytest.raises(InputError, match=r"lies in .* itself"):
        convert(released, released / "data" / "new", "exr")


def samples(folder: Path) -> dict[str, bytes]:
    """The files in all shards of a folder by their names."""
    found = {}
    for path in sorted(folder.glob("*.tar")):
        with tarfile.open(path) as archive:
            for member in archive:
                found[member.name] = archive.extractfile(member).read()  # type: ignore[union-attr]
    return found


def test_a_set_and_its_release_become_the_same_samples(
    small_set: SetFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half precision, soft edges and cropping stay; the release's tables are read once, however many captures there are."""
    folder = SetFolder(Path(shutil.copytree(small_set.path, tmp_path / "set")))
    store_half_and_cropped(folder, "stack-000001")
    write_splits(folder, (0.5, 0.25, 0.25), by=("object",))
    release_set(folder, tmp_path / "release", About("closed-form", "1.0.0", "Closed form", "Closed form.", "degloss"))
    monkeypatch.setattr("gen.release.reading.read_rows", lambda *_: pytest.fail("a table was searched"))
    convert(folder.path, tmp_path / "of-set", "webdataset")
    convert(tmp_path / "release", tmp_path / "of-release", "webdataset")
    of_set, of_release = samples(tmp_path / "of-set"), samples(tmp_path / "of-release")
    assert len({name.split(".")[0] for name in of_release}) == 8
    assert {name: of_set[name] for name in of_release} == of_release
    picture = folder.item_folder("stack-000001") / "frames/002.exr"
    assert of_release["stack-000001.002.exr"] == picture.read_bytes()


def test_a_release_whose_tables_differ_is_refused(released: Path, tmp_path: Path) -> None:
    table = pq.read_table(released / MEMBERS)
    rows = table.to_pylist()
    first = rows[0]["item"]
    for some in ([row for row in rows if row["item"] != first], [row for row in rows if row["item"] == first], rows[::-1]):
        other = Path(shutil.copytree(released, tmp_path / f"release-{len(some)}-{some[0]['item']}"))
        with table_writer(other / MEMBERS, MEMBER_COLUMNS) as append:
            append(some)
        listed = (other / MANIFEST).read_text().replace(sha256_of(released / MEMBERS), sha256_of(other / MEMBERS))
        (other / MANIFEST).write_text(listed)
        with pytest.raises(InputError, match=r"holds other captures than data/pictures\.parquet, or in another order"):
            convert(other, tmp_path / "out", "exr")
    assert not (tmp_path / "out").exists()


def test_a_circle_of_links_is_no_output(render: Path, small_set: SetFolder, tmp_path: Path) -> None:
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    for source in (render, small_set.path):
        for output in (loop, loop / "out"):
            with pytest.raises(InputError, match="loop"):
                convert(source, output, "webdataset")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["loop", "render"]


@LEFT_OPEN
@pytest.mark.parametrize("kind", ["render", "diligent"])
def test_a_sample_of_a_shard_is_the_capture(render: Path, tmp_path: Path, glossy: Capture, kind: str) -> None:
    source = tmp_path / "Some Thing v1.2"
    convert(render, source, "diligent") if kind == "diligent" else shutil.copytree(render, source)
    convert(source, tmp_path / "out", "webdataset")
    (path,) = (tmp_path / "out").glob("*.tar")
    (tmp_path / "unpacked" / "frames").mkdir(parents=True)
    with tarfile.open(path) as archive:
        for member in archive:
            key, field = member.name.split(".", 1)
            assert key == "Some-Thing-v1-2"
            assert (member.mtime, member.uid, member.isfile()) == (0, 0, True)
            file = file_of(field)
            if file is not None:
                (tmp_path / "unpacked" / file).write_bytes(archive.extractfile(member).read())  # type: ignore[union-attr]
    capture = read_capture(source)
    same(replace(capture, provenance=without_paths(capture.provenance)), read_capture(tmp_path / "unpacked"))
    (sample,) = webdataset.WebDataset(str(path), shardshuffle=False).decode("rgb8")
    facts = sample["json"]
    np.testing.assert_array_equal(facts["directions"], glossy.lights)
    assert facts["fields"] == [f"{k:03d}.exr" for k in range(1, 8)]
    assert (sample["mask.png"][..., 0] > 0).tolist() == glossy.mask.tolist()
    assert b"/home/someone" not in path.read_bytes()


def test_a_full_shard_is_followed_by_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gen.convert.webdataset.SHARD_BYTES", 3000)
    shards = Shards(tmp_path, "train")
    for k in range(5):
        shards.add(f"s{k}", [("a", bytes(700)), ("b", b"x")])
    shards.close()
    names = {}
    for path in sorted(tmp_path.iterdir()):
        with tarfile.open(path) as archive:
            names[path.name] = archive.getnames()
    assert names == {
        "train-00000.tar": ["s0.a", "s0.b", "s1.a", "s1.b"],
        "train-00001.tar": ["s2.a", "s2.b", "s3.a", "s3.b"],
        "train-00002.tar": ["s4.a", "s4.b"],
    }


def test_bad_requests_are_one_line_and_write_nothing(render: Path, small_set: SetFolder, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    before = contents(tmp_path), contents(small_set.path)
    for message, *tokens in (
        ("there is no such file or folder", tmp_path / "absent", tmp_path / "out", "--format", "diligent"),
        ("holds other files too; choose another place", render, tmp_path / "mine", "--format", "png16"),
        ("is or holds the capture", render, tmp_path, "--format", "exr"),
        ("is or holds the capture", render, render, "--format", "webdataset"),
        ("lies in .* itself", small_set.path, small_set.path / "items" / "new", "--format", "diligent"),
        ("--white -1.0: must be a positive number", render, tmp_path / "out", "--format", "diligent", "--white=-1"),
        ("--white 2.0: is for 16-bit formats", render, tmp_path / "out", "--format", "exr", "--white", "2"),
        ("--white 2.0: is for 16-bit formats", render, tmp_path / "out", "--format", "webdataset", "--white", "2"),
        ("--encoding srgb: .* is a set of ours", small_set.path, tmp_path / "out", "--format", "exr", "--encoding", "srgb"),
        ("which is linear", render, tmp_path / "out", "--format", "exr", "--encoding", "srgb"),
        ("cannot be written", render, render / "mask.png" / "out", "--format", "exr"),
    ):
        with pytest.raises(InputError, match=message) as error:
            call(*tokens)
        assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="format 'gif' is unknown; there are diligent"):
        convert(render, tmp_path / "out", "gif")
    assert (contents(tmp_path), contents(small_set.path)) == before


def edited(path: Path, edit: Any) -> None:
    said = json.loads(path.read_text())
    edit(said)
    path.write_text(json.dumps(said))


def test_hostile_sources_are_refused(render: Path, small_set: SetFolder, released: Path, tmp_path: Path) -> None:
    """Names that lead out of a folder, links, ids and files that have no place: one line each, nothing written, nothing read outside."""
    secret = tmp_path / "secret.exr"
    write_exr(secret, {name: np.ones((32, 32), np.float32) for name in "RGB"})
    write_png(tmp_path / "secret.png", np.full((32, 32, 3), 9, np.uint16))

    def attack(message: str, source: Path, *formats: str) -> None:
        for format in formats or FORMATS:
            with pytest.raises(InputError, match=message):
                convert(source, tmp_path / "out", format)

    def copy(source: Path, name: str) -> Path:
        return Path(shutil.copytree(source, tmp_path / name, symlinks=True))

    bad = copy(render, "climbs")
    edited(bad / "capture.json", lambda said: said["frames"][2].update(file="../secret.exr"))
    attack("leads out of the folder", bad)
    bad = copy(render, "links")
    (bad / "frames" / "003.exr").unlink()
    (bad / "frames" / "003.exr").symlink_to(secret)
    attack("leads out of the folder", bad)
    bad = copy(render, "mask-climbs")
    edited(bad / "capture.json", lambda said: said.update(mask="../secret.png"))
    attack("leads out of the folder", bad)
    bad = copy(render, "other-names")
    (bad / "frames" / "003.exr").rename(bad / "frames" / "json")
    edited(bad / "capture.json", lambda said: said["frames"][2].update(file="frames/json"))
    attack("'frames/json' has no place in a (shard|release)", bad, "webdataset")
    bad = copy(render, "twice")
    edited(bad / "capture.json", lambda said: said.update(mask="frames/001.exr"))
    attack("'frames/001.exr' has no place in a shard", bad, "webdataset")
    convert(render, tmp_path / "published", "diligent")
    for line in ("../secret.png", "/etc/passwd", "C:\\secret.png"):
        (tmp_path / "published" / "filenames.txt").write_text(f"001.png\n{line}\n" + "003.png\n" * 5)
        attack("leads out of the folder", tmp_path / "published", "png16", "webdataset")
    bad = copy(small_set.path, "set")
    rows = (bad / "index.jsonl").read_text()
    (bad / "index.jsonl").write_text(rows.replace('"one-000000"', '"../../out"', 1))
    attack("is no id of an item", bad)
    (bad / "index.jsonl").write_text(rows.replace('"split": "test"', '"split": "../../out"', 1))
    attack(r"test-000000: '\.\./\.\./out' is no split", bad)
    (bad / "index.jsonl").write_text(rows.replace('"one-000000"', '"one.000000"', 1))
    (bad / "items" / "one-000000").rename(bad / "items" / "one.000000")
    attack("cannot be the key of a sample", bad, "webdataset")
    table = pq.read_table(released / PICTURES)
    for message, column, value in (
        ("cannot be the key of a sample", "item", "../../out"),
        ("'../../out' is no split", "split", "../../out"),
        ("lists .* twice", "item", table["item"].to_pylist()[-1]),
    ):
        other = Path(shutil.copytree(released, tmp_path / f"release-{len(list(tmp_path.iterdir()))}"))
        values = [value, *table[column].to_pylist()[1:]]
        pq.write_table(table.set_column(table.schema.get_field_index(column), column, [values]), other / PICTURES)
        listed = (other / MANIFEST).read_text().replace(sha256_of(released / PICTURES), sha256_of(other / PICTURES))
        (other / MANIFEST).write_text(listed)  # whoever makes such a table can count its checksum too
        attack(message, other)
    shutil.rmtree(bad / "items" / "one.000000")
    (bad / "index.jsonl").write_text(rows)
    attack("there is no such item", bad)
    assert not (tmp_path / "out").exists()
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_an_earlier_conversion_stays_where_a_new_one_fails(render: Path, tmp_path: Path) -> None:
    convert(render, tmp_path / "out", "diligent")
    before = contents(tmp_path / "out")
    (render / "frames" / "005.exr").write_bytes(b"")
    with pytest.raises(InputError, match=r"005\.exr: is empty"):
        convert(render, tmp_path / "out", "png16")
    assert contents(tmp_path / "out") == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "render"]


@pytest.mark.parametrize("format", FORMATS)
def test_a_full_disk_is_one_line_and_leaves_nothing(render: Path, tmp_path: Path, format: str) -> None:
    """A limit on the size of files acts as a full disk does: the system refuses in the middle of a file."""
    source = tmp_path / "photos"
    convert(render, source, "exr")
    before = contents(tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(InputError, match=r"(out|\.tmp)\b.*File too large") as error:
            convert(source, tmp_path / "out", format)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "\n" not in str(error.value)
    assert contents(tmp_path) == before
