"""What a release holds, that the same set gives the same bytes, and that nothing that ends a run early shows in them."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import tarfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from gen.errors import InputError
from gen.release import build
from gen.release.samples import without_paths
from gen.sets.set_folder import SetFolder
from gen.srgb import linear_to_srgb
from tests.gen.release.conftest import ABOUT, SHARD_BYTES, contents, release
from tests.gen.sets.conftest import OVEREXPOSED, QUARANTINED

ROOT = Path(__file__).resolve().parents[3]


def shards(folder: Path) -> list[Path]:
    return sorted((folder / "data").glob("*.tar"))


def test_shards_are_plain_archives_of_samples(released: Path, rendered: SetFolder) -> None:
    """Read by Python's tarfile; every file of a picture is the rendered one, byte for byte."""
    seen: dict[str, str] = {}
    for path in shards(released):
        with tarfile.open(path, "r:") as tar:
            members = tar.getmembers()
            assert [m.name for m in members] == sorted(m.name for m in members)
            for member in members:
                assert member.isreg()
                assert (member.mtime, member.uid, member.gid, member.uname, member.gname) == (0, 0, 0, "", "")
                item, field = member.name.split(".", 1)
                seen[item] = re.match(r"train|validation|test", path.name)[0]  # type: ignore[index]
                data = tar.extractfile(member).read()  # type: ignore[union-attr]
                place = rendered.item_folder(item)
                if re.fullmatch(r"\d+\.exr", field):
                    assert data == (place / "frames" / field).read_bytes()
                elif field in ("view.exr", "mask.png"):
                    assert data == (place / field).read_bytes()
                elif field == "capture":
                    assert data == (place / "capture.json").read_bytes()
                elif field == "json":
                    facts = json.loads(data)
                    capture = rendered.capture(item)
                    assert (facts["item"], facts["split"]) == (item, seen[item])
                    assert np.array(facts["directions"]) == pytest.approx(capture.lights, abs=1e-12)
                    assert np.array(facts["intensities"]) == pytest.approx(capture.intensities)
                    assert facts["alpha"] == [pytest.approx(capture.truth.gloss.max())] * 2  # type: ignore[union-attr]
                else:
                    assert field == "preview.png"
            assert path.stat().st_size % tarfile.RECORDSIZE == 0
            assert path.stat().st_size <= SHARD_BYTES + 100_000
    wanted = json.loads((rendered.path / "splits.json").read_text())["splits"]
    assert seen == {item: split for split, items in wanted.items() for item in items}
    assert len(shards(released)) > 4


def test_a_preview_shows_the_picture(released: Path, rendered: SetFolder) -> None:
    capture = rendered.capture("stack-000001")
    with tarfile.open(next(path for path in shards(released) if b"stack-000001.preview" in path.read_bytes())) as tar:
        data = tar.extractfile("stack-000001.preview.png").read()  # type: ignore[union-attr]
    shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    k = int(capture.lights[:, 2].argmax())
    expected = np.round(255 * linear_to_srgb(np.clip(capture.images[k].astype(np.float64), 0, 1)))
    assert shown.shape == expected.shape
    assert np.abs(shown - expected)[expected > 20].max() <= 1


def test_the_tables_name_every_picture(released: Path, rendered: SetFolder) -> None:
    pictures = pq.read_table(released / "data/pictures.parquet").to_pylist()
    rejected = pq.read_table(released / "data/rejected.parquet").to_pylist()
    kept = {(row["item"], row["picture"]) for row in pictures}
    out = {(row["item"], row["picture"]): row["reason"] for row in rejected}
    assert out == {(OVEREXPOSED[0], 1): "overexposed", (OVEREXPOSED[1], 1): "overexposed", (QUARANTINED, 1): "not rendered"}
    assert {row["error"] for row in rejected} == {None, "it broke"}
    planned = {(row["id"], k + 1) for row in rendered.rows() for k in range(row["pictures"] or 1)}
    assert kept | out.keys() == planned
    assert not kept & out.keys()
    assert len(pictures) == len(kept) == 20
    for row in pictures:
        data = (released / "data" / row["shard"]).read_bytes()[row["offset"] :][: row["bytes"]]
        assert data == (rendered.item_folder(row["item"]) / "frames" / row["field"]).read_bytes()
        assert hashlib.sha256(data).hexdigest() == row["sha256"]
        capture = rendered.capture(row["item"])
        assert [row["light_x"], row["light_y"], row["light_z"]] == pytest.approx(capture.lights[row["picture"] - 1])
        assert (row["mm_per_pixel"], row["position_x_mm"]) == (None, None)
    assert {row["pictures"] for row in pictures if row["shard"].split("-")[1] == "5x"} == {5}


def test_sha256sum_checks_the_bag(released: Path) -> None:
    run = subprocess.run(
        ["sha256sum", "-c", "--strict", "--quiet", "manifest-sha256.txt", "tagmanifest-sha256.txt"],
        cwd=released,
        capture_output=True,
        text=True,
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")
    listed = {
        line.split("  ")[1]
        for name in ("manifest", "tagmanifest")
        for line in (released / f"{name}-sha256.txt").read_text().splitlines()
    }
    assert listed == contents(released).keys() - {"tagmanifest-sha256.txt"}


def test_the_same_set_gives_the_same_bytes(
    released: Path, rendered_copy: SetFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On another day, from another place, under another name, with other permissions."""
    monkeypatch.setattr("time.time", lambda: 4e9)
    for path in rendered_copy.path.rglob("*"):
        os.utime(path, (1e9, 1e9))
    before = os.umask(0o077)
    try:
        release(rendered_copy, tmp_path / "elsewhere" / "another name")
    finally:
        os.umask(before)
    again = contents(tmp_path / "elsewhere" / "another name")
    assert again == contents(released)
    assert os.listdir(tmp_path / "elsewhere") == ["another name"]
    everything = b"".join(again.values())
    for foreign in (str(tmp_path), str(rendered_copy.path), str(Path.home()) + "/", "another name", str(ROOT)):
        assert foreign.encode() not in everything, foreign


def test_paths_of_the_maker_stay_behind() -> None:
    spec = {
        "shape": {"name": "mesh", "file": "/home/me/part.stl"},
        "lights": [{"environment": "C:\\maps\\room.exr"}],
        "name": "a/b",
    }
    bare = {"shape": {"name": "mesh", "file": "part.stl"}, "lights": [{"environment": "room.exr"}], "name": "a/b"}
    assert without_paths(spec) == bare


def test_a_spec_that_names_a_file_is_released_without_its_folder(rendered_copy: SetFolder, tmp_path: Path) -> None:
    place = rendered_copy.item_folder("one-000000")
    index = json.loads((place / "capture.json").read_text())
    index["provenance"]["spec"]["shape"] = {"name": "mesh", "file": "/secret/part.stl"}
    text = json.dumps(index)
    (place / "capture.json").write_text(text)
    plan = (rendered_copy.path / "plan.jsonl").read_text().splitlines()
    item = json.loads(plan[1])
    item["spec"]["shape"]["file"] = "/secret/part.stl"
    plan[1] = json.dumps(item, sort_keys=True)
    (rendered_copy.path / "plan.jsonl").write_text("\n".join(plan) + "\n")
    edit(rendered_copy.path / "set.json", r'"plan_sha256": "\w+"', f'"plan_sha256": "{rendered_copy.plan().digest()}"')
    rows = (rendered_copy.path / "index.jsonl").read_text().splitlines()
    row = json.loads(rows[0])
    row["files"]["capture.json"], row["bytes"]["capture.json"] = hashlib.sha256(text.encode()).hexdigest(), len(text)
    rows[0] = json.dumps(row)
    (place / "item.json").write_text(rows[0] + "\n")
    (rendered_copy.path / "index.jsonl").write_text("\n".join(rows) + "\n")
    release(rendered_copy, tmp_path / "out")
    everything = contents(tmp_path / "out")
    assert not any(b"/secret" in data for data in everything.values())
    assert b"the terms of their authors may ask for more" in everything["LICENSE"]
    assert json.loads(everything["provenance.json"])["set"]["named_files"] is True


KILLED = """\
import os, signal, sys
from pathlib import Path
from gen.release import build
from gen.sets.set_folder import SetFolder
from tests.gen.release.conftest import release

def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)

if sys.argv[3] == "bag":
    build.write_bag = die
release(SetFolder(Path(sys.argv[1])), Path(sys.argv[2]), resume=True, progress=lambda done, total: done == 5 and die())
"""


def test_what_was_killed_goes_on_to_the_same_bytes(released: Path, rendered: SetFolder, tmp_path: Path) -> None:
    output, partial = tmp_path / "out", tmp_path / ".out.partial"
    command = [sys.executable, "-c", KILLED, str(rendered.path), str(output)]
    assert subprocess.run([*command, "capture"], cwd=ROOT).returncode == -9
    there = shards(partial / "release")
    assert 0 < len(there) < len(shards(released))
    assert not output.exists()
    with pytest.raises(InputError, match=r"unfinished release is in \.out\.partial; go on with it by --resume"):
        release(rendered, output)
    with pytest.raises(InputError, match="was begun from another set, with other options"):
        release(rendered, output, replace(ABOUT, version="1.2.1"), resume=True)

    # A shard that is damaged since is not kept.
    data = bytearray(there[0].read_bytes())
    data[700] ^= 1
    there[0].write_bytes(data)
    stamps = {path.name: path.stat().st_mtime_ns for path in there}
    done = release(rendered, output, resume=True)
    assert done.kept == len(there) - 1
    assert contents(output) == contents(released)
    assert not partial.exists()
    kept = [name for name, stamp in stamps.items() if (output / "data" / name).stat().st_mtime_ns == stamp]
    assert len(kept) == done.kept


def test_killed_at_its_very_end(released: Path, rendered: SetFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    output = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(build, "write_bag", stop)
        with pytest.raises(KeyboardInterrupt, match="run the same command with --resume"):
            release(rendered, output)
    with monkeypatch.context() as patch:  # after the last rename, before the hidden folder was removed
        patch.setattr(build.shutil, "rmtree", stop)
        with pytest.raises(KeyboardInterrupt):
            release(rendered, output, resume=True)
    assert (tmp_path / ".out.partial").exists()
    done = release(rendered, output, resume=True)
    assert (done.items, done.pictures, done.rejected) == (8, 20, 3)
    assert contents(output) == contents(released)
    assert not (tmp_path / ".out.partial").exists()


def test_a_full_disk_says_how_to_go_on(
    rendered: SetFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, released: Path
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(build, "concatenate", full)
        with pytest.raises(InputError, match=r"No space left on device.*with --resume"):
            release(rendered, tmp_path / "out")
    release(rendered, tmp_path / "out", resume=True)
    assert contents(tmp_path / "out") == contents(released)


def test_one_process_at_a_time(rendered: SetFolder, tmp_path: Path) -> None:
    with build.workplace(tmp_path / "out", False) as place:
        with pytest.raises(InputError, match="another process is making it"):
            release(rendered, tmp_path / "out", resume=True)
        assert place.exists()


def test_a_set_holds_no_release_of_itself(rendered_copy: SetFolder) -> None:
    before = contents(rendered_copy.path)
    with pytest.raises(InputError, match=r"one: lies in .*set itself; choose another place"):
        release(rendered_copy, rendered_copy.path / "releases/one")
    assert contents(rendered_copy.path) == before


def test_a_name_that_is_too_long_is_one_line(rendered: SetFolder, tmp_path: Path) -> None:
    for length in (250, 300):  # the hidden folder's name is longer
        with pytest.raises(InputError, match=r"a: cannot be written \(File name too long\); choose another place with -o"):
            release(rendered, tmp_path / ("a" * length))
    assert os.listdir(tmp_path) == []


def test_nothing_is_written_over(rendered: SetFolder, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine.txt").write_text("x")
    with pytest.raises(InputError, match="is there already, and a release is never written over"):
        release(rendered, tmp_path / "out")
    assert contents(tmp_path) == {"out/mine.txt": b"x"}


REFUSED = {
    "not divided": (lambda f: (f / "splits.json").unlink(), "not divided yet; run degloss gen split"),
    "a file changed": (lambda f: (f / "items/one-000000/view.exr").write_bytes(b"x"), "view.exr: has 1 bytes"),
    "a bit flipped": (lambda f: flip(f / "items/stack-000000/frames/003.exr"), "003.exr: its SHA-256 is not the one in the index"),
    "the previewed bit": (lambda f: flip(f / "items/one-000000/frames/001.exr"), "001.exr: its SHA-256 is not the one"),
    "a link": (lambda f: link(f / "items/one-000000/mask.png"), "mask.png: cannot be read"),
    "a row changed": (lambda f: append(f / "items/one-000000/item.json"), "item.json: is not the row of the index"),
    "splits": (lambda f: edit(f / "splits.json", "stack-000000", "stack-000099"), "in no split"),
    "too many splits": (lambda f: edit(f / "splits.json", '"test"', '"exam"'), "'exam' is no split"),
    "another plan": (lambda f: edit(f / "plan.jsonl", '"radius": 1', '"radius": 2'), "plan.jsonl: its SHA-256 is not the one in set"),
    "no plan": (lambda f: (f / "plan.jsonl").unlink(), "set/plan.jsonl: there is no such file"),
    "a pipe": (lambda f: ((f / "plan.jsonl").unlink(), os.mkfifo(f / "plan.jsonl")), "set/plan.jsonl: is a pipe or a device"),
    "a head": (lambda f: edit(f / "set.json", '"seed": 5', '"seed": null'), "set.json: seed is missing or not as a set has it"),
    "divided by letters": (lambda f: divided(f, by="object"), "splits.json: does not say by what the set is divided"),
    "divided by nothing": (lambda f: divided(f, by=[]), "splits.json: does not say by what the set is divided"),
    "notes": (lambda f: divided(f, notes=None), "splits.json: does not say by what the set is divided"),
    "divided by what is none": (lambda f: divided(f, by=["colour"]), "splits.json: is divided by 'colour'; there are object"),
    "shared": (lambda f: share(f), "splits.json: train and test share 1 object, and it does not say so; run degloss gen split again"),
    "screening": (lambda f: edit(f / "screening.jsonl", "overexposed\\b.*", "x"), "is not a verdict"),
}  # fmt: skip


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def divided(folder: Path, **said: object) -> None:
    path = folder / "splits.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | said))


def share(folder: Path) -> None:
    """Give a test capture the object of a training one."""
    donor = json.loads((folder / "splits.json").read_text())["splits"]["train"][0]
    rows = {row["id"]: row for row in map(json.loads, (folder / "index.jsonl").read_text().splitlines())}
    rows["test-000000"]["object"] = rows[donor]["object"]
    (folder / "index.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows.values()))


def link(path: Path) -> None:
    path.rename(path.with_name("real.png"))
    path.symlink_to("real.png")


def append(path: Path) -> None:
    path.write_text(path.read_text().replace('"single": true', '"single": false'))


def edit(path: Path, before: str, after: str) -> None:
    text, count = re.subn(before, after, path.read_text())
    assert count
    path.write_text(text)


@pytest.mark.parametrize("name", REFUSED)
def test_a_set_that_is_not_whole_is_refused(rendered_copy: SetFolder, tmp_path: Path, name: str) -> None:
    damage, message = REFUSED[name]
    damage(rendered_copy.path)
    with pytest.raises(InputError, match=message) as caught:
        release(rendered_copy, tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_memory_does_not_grow_with_a_capture(rendered: SetFolder) -> None:
    """What is read ahead is bounded, and the source is not drawn further than that."""
    from gen.release.ahead import ahead

    drawn: list[int] = []

    def source() -> object:
        for n in range(50):
            drawn.append(n)
            yield SimpleNamespace(size=10)

    held = ahead(source(), lambda thing: thing.size, 35)  # type: ignore[arg-type, attr-defined, var-annotated]
    next(held)
    import time

    deadline = time.monotonic() + 5
    while len(drawn) < 5 and time.monotonic() < deadline:
        time.sleep(0.001)
    time.sleep(0.01)
    assert len(drawn) == 5  # one taken, three waiting, one in hand
    assert len(list(held)) == 49

    def broken() -> object:
        yield SimpleNamespace(size=1)
        raise InputError("broken")

    failing = ahead(broken(), lambda thing: thing.size, 10)  # type: ignore[arg-type, attr-defined, var-annotated]
    next(failing)
    with pytest.raises(InputError, match="broken"):
        next(failing)


def test_an_empty_folder_may_be_there(rendered: SetFolder, tmp_path: Path, released: Path) -> None:
    (tmp_path / "out").mkdir()
    release(rendered, tmp_path / "out")
    assert contents(tmp_path / "out") == contents(released)
