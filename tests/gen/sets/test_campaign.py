"""Campaigns with a real Blender: the same bytes however the work is shared out, quarantine, refusals, a full disk, an interrupt.

What is killed and goes on is in test_campaign_kills.py.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Fault, read_capture
from gen.errors import InputError
from gen.sets.campaign import Engine, Tally, render_set
from gen.sets.item_folder import overexposed_pixels, quarantine
from gen.sets.plan import Item, Plan, identities, plan_of, read_plan, write_plan
from gen.sets.set_folder import COLUMNS, SetFolder
from tests.gen.sets.set_runs import TINY, blenders, contents, descendants, gone, items, run, start, wait_for

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plan of a tiny set, in a file."""
    folder = tmp_path_factory.mktemp("plan")
    (folder / "tiny.yaml").write_text(TINY)
    write_plan(plan_of(folder / "tiny.yaml"), folder / "PLAN.jsonl")
    return folder / "PLAN.jsonl"


@pytest.fixture(scope="module")
def whole(plan_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The set folder that one worker made of it, without any trouble."""
    folder = tmp_path_factory.mktemp("whole") / "set"
    tally = render_set(read_plan(plan_file), folder, Engine())
    assert tally == Tally(rendered=6, quarantined=0, kept=0, pictures=9, indexed=True)
    return folder


def events(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


def test_a_set_folder_says_what_it_is(whole: Path, plan_file: Path) -> None:
    """The head, the plan and every row of the index against the files themselves."""
    folder, plan = SetFolder(whole), read_plan(plan_file)
    about = folder.about()
    assert (about["name"], about["seed"], about["items"], about["plan_sha256"]) == ("tiny", 3, 6, plan.digest())
    assert folder.plan() == plan
    assert (whole / "plan.jsonl").read_bytes() == plan_file.read_bytes()
    assert sorted(path.name for path in whole.iterdir()) == ["events.jsonl", "index.jsonl", "items", "plan.jsonl", "set.json"]
    rows = folder.rows()
    assert [row["id"] for row in rows] == [item.id for item in plan.items]
    overexposed = 0
    for row, item in zip(rows, plan.items, strict=True):
        place, spec = folder.item_folder(row["id"]), item.capture_spec()
        assert list(row) == list(COLUMNS)
        assert (row["group"], row["split"], row["single"]) == (item.group, item.split, item.single)
        assert (row["spec_sha256"], row["seed"], row["size"]) == (spec.digest(), spec.seed, list(spec.resolution))
        assert {key: row[key] for key in ("object", "material_key", "lights_key")} == identities(spec)
        files = {p.relative_to(place).as_posix(): p.read_bytes() for p in place.rglob("*") if p.is_file()}
        assert files.pop("item.json").decode() == json.dumps(row) + "\n"
        assert row["files"] == {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
        assert row["bytes"] == {name: len(data) for name, data in files.items()}
        capture = read_capture(place)
        x = np.clip(capture.images.astype(np.float64), 0, 1)
        encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
        white = (np.round(255 * encoded) == 255).all(axis=3).sum(axis=(1, 2))
        overexposed += int(white.sum())
        assert row["overexposed_pixels"] == white.tolist()
        assert row["clipped_samples"] == int(((capture.faults & Fault.CLIPPED) > 0).sum())
        assert (row["pictures"], row["object_share"]) == (capture.count, float(capture.mask.mean()))
        assert (row["exposure"], row["device"], row["blender"]) == (
            capture.provenance["exposure"],
            "cpu",
            capture.provenance["blender"],
        )
        assert json.loads((place / ".degloss").read_text())["files"] == sorted([*files.keys() - {".degloss"}, "item.json"])
    assert overexposed > 0
    assert [event["event"] for event in events(whole)] == ["started", *["rendered"] * 6, "finished"]


def test_overexposed_pixels_at_the_border_of_white() -> None:
    """Every linear value near the one that rounds to 255, against the formula of the contract."""
    values = np.concatenate([np.linspace(0.97, 1.02, 5001), [0, np.inf]]).astype(np.float32)
    for value in (values, np.nextafter(values, np.float32(0))):
        x = np.clip(value.astype(np.float64), 0, 1)
        white = np.round(255 * (1.055 * x ** (1 / 2.4) - 0.055).astype(np.float32)) == 255
        grey = np.repeat(value[None, :, None], 3, axis=2)
        assert overexposed_pixels(grey) == white.sum()
        assert 0 < white.sum() < len(value)
    red = np.zeros((2, 2, 3), np.float32)
    red[..., 0] = 9
    assert overexposed_pixels(red) == 0


def test_workers_do_not_change_a_byte(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    progress: list[tuple[int, int, int]] = []
    others = set(blenders())  # workers that other tests keep
    render_set(read_plan(plan_file), tmp_path / "set", Engine(2), progress=lambda *three: progress.append(three))
    assert contents(tmp_path / "set") == contents(whole)
    assert [step[:2] for step in progress] == [(n, 6) for n in range(1, 7)]
    assert progress[-1][2] == 9
    assert set(blenders()) <= others


def test_parts_rendered_at_the_same_time_by_processes_of_their_own(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    """One of them is there twice, as when a scheduler starts a task again that it took for dead."""
    parts = [
        start("render-chunk", plan_file, "--index", index, "--chunks", "2", "-o", tmp_path / "set", "--json")
        for index in (1, 0, 1)
    ]
    said = []
    for part in parts:
        out, err = part.communicate(timeout=120)
        assert part.returncode == 0, err
        said.append(json.loads(out))
    assert any(facts["indexed"] for facts in said)
    assert sum(facts["rendered"] for facts in said) >= 6
    assert contents(tmp_path / "set") == contents(whole)


def test_the_spec_of_a_set_and_its_plan_are_the_same(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    """A set spec rendered at once gives what its plan gives; and a part of it is the same items."""
    spec = plan_file.with_name("tiny.yaml")
    code, out, err = run("render", spec, "-o", tmp_path / "few", "--limit", "2")
    assert code == 0, err
    assert "2 items, 3 pictures" in out
    few, all_of_it = contents(tmp_path / "few"), contents(whole)
    assert {path.name for path in (tmp_path / "few" / "items").iterdir()} == {"pair-000000", "one-000002"}
    for name, data in few.items():
        if name.startswith("items/"):
            assert data == all_of_it[name], name
    code, out, err = run("plan", spec, "-o", tmp_path / "PLAN.jsonl", "--json")
    assert (code, json.loads(out)["items"]) == (0, 6)
    assert (tmp_path / "PLAN.jsonl").read_bytes() == plan_file.read_bytes()


def moved_out(plan: Plan) -> Plan:
    """The plan with one item whose object is outside the picture, and one whose spec is not valid."""
    changed = list(plan.items)
    changed[1] = with_spec(plan.items[1], pose={"translation_mm": [1000.0, 0.0, 0.0]})
    changed[4] = with_spec(plan.items[4], supersampling=99)
    return replace(plan, items=tuple(changed))


def with_spec(item: Item, **values: object) -> Item:
    return replace(item, spec={**item.spec, **values})


def test_what_cannot_be_rendered_goes_into_quarantine(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    plan = moved_out(read_plan(plan_file))
    write_plan(plan, tmp_path / "PLAN.jsonl")
    folder = tmp_path / "set"
    code, out, err = run("render", tmp_path / "PLAN.jsonl", "-o", folder, "--workers", "2", "--json")
    facts = json.loads(out)
    assert (code, facts["rendered"], facts["quarantined"], facts["indexed"]) == (2, 4, 2, True)
    assert err.count("\n") == 1
    assert "2 items could not be rendered" in err
    assert "--resume" in err
    rows = SetFolder(folder).rows()
    assert [row["status"] for row in rows] == ["rendered", "quarantined", "rendered", "rendered", "quarantined", "rendered"]
    outside, invalid = rows[1], rows[4]
    assert "the object is not in the picture" in outside["error"]
    assert (outside["files"], outside["pictures"], outside["shape"]) == ({}, 2, "cylinder")
    assert outside["spec_sha256"] == plan.items[1].capture_spec().digest()
    assert "supersampling" in invalid["error"]
    assert invalid["pictures"] is None
    good = SetFolder(whole).rows()
    assert [rows[i] for i in (0, 2, 3, 5)] == [good[i] for i in (0, 2, 3, 5)]
    gone_wrong = {event["id"]: event["kind"] for event in events(folder) if event["event"] == "quarantined"}
    assert gone_wrong == {"pair-000001": "input", "one-000001": "input"}
    before = contents(folder)
    assert render_set(plan, folder, Engine(), resume=True) == Tally(rendered=0, quarantined=2, kept=4, pictures=0, indexed=True)
    assert contents(folder) == before


def test_what_was_in_quarantine_leaves_it_without_a_trace(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    """As after an item whose worker was killed on every try."""
    plan, folder, work = read_plan(plan_file), tmp_path / "set", tmp_path / "work"
    work.mkdir()
    shutil.copytree(whole, folder)
    shutil.rmtree(folder / "items" / "pair-000002")
    quarantine(folder, plan.items[2], plan.items[2].capture_spec(), "the worker was ended by SIGKILL", work)
    render_set(plan, folder, Engine(), resume=True)
    assert contents(folder) == contents(whole)


def test_what_is_damaged_is_rendered_again(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(whole, folder)
    item = folder / "items"
    (item / "pair-000000" / "frames" / "002.exr").unlink()
    with (item / "pair-000001" / "view.exr").open("r+b") as file:
        file.truncate(100)
    (item / "one-000000" / "item.json").write_text('{"id": "one-0')
    (item / "one-000001" / "mask.png").write_bytes(b"")
    tally = render_set(read_plan(plan_file), folder, Engine(2), resume=True)
    assert (tally.rendered, tally.kept) == (4, 2)
    assert contents(folder) == contents(whole)
    (item / "pair-000000" / "frames" / "002.exr").unlink()
    (item / "pair-000000" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"pair-000000: is damaged, and holds a file that is not ours \(notes.txt\)"):
        render_set(read_plan(plan_file), folder, Engine(2), resume=True)
    assert (item / "pair-000000" / "notes.txt").read_text() == "mine"


def test_refusals(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    plan, before = read_plan(plan_file), contents(whole)
    with pytest.raises(InputError, match="--resume"):
        render_set(plan, whole, Engine())
    with pytest.raises(InputError, match="a set of another plan"):
        render_set(replace(plan, items=plan.items[:5]), whole, Engine(), resume=True)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("mine")
    for resume, says in ((False, "is there already"), (True, "no set folder of ours")):
        with pytest.raises(InputError, match=says):
            render_set(plan, tmp_path / "mine", Engine(), resume=resume)
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for place in (tmp_path / "mine" / "thesis.txt", tmp_path / "link"):
        with pytest.raises(InputError, match="in the place of the set's folder"):
            render_set(plan, place, Engine(), resume=True)
    with pytest.raises(InputError, match="holds no items"):
        render_set(replace(plan, items=()), tmp_path / "new", Engine())
    with pytest.raises(InputError, match=r"mine.thesis.txt: cannot be written|thesis.txt.*cannot be written"):
        render_set(plan, tmp_path / "mine" / "thesis.txt" / "set", Engine())
    assert contents(whole) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "mine"]
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["render", "PLAN", "--workers", "0"], "--workers 0"),
        (["render", "PLAN", "--address", "auto"], "--address auto: is for --engine ray"),
        (["render", "PLAN", "--blender", "/no/blender"], "--blender /no/blender"),
        (["render", "PLAN", "--seed", "4"], "--seed 4"),
        (["render", "PLAN", "--limit", "0"], "at least 1"),
        (["render", "PLAN", "--engine", "slurm"], "slurm"),
        (["render", "PLAN", "--device", "tpu"], "tpu"),
        (["render", "small-sphere", "--resume"], "--resume is for sets"),
        (["render", "small-sphere", "--limit", "3"], "--limit is for sets"),
        (["render", "small-sphere", "--engine", "ray"], "--engine is for sets"),
        (["render-chunk", "PLAN", "--index", "3", "--chunks", "3"], "chunk 3 of 3"),
        (["render-chunk", "PLAN", "--index", "0", "--chunks", "0"], "chunk 0 of 0"),
        (["render-chunk", "small-sphere", "--index", "0", "--chunks", "1"], "small-sphere"),
        (["plan", "small-sphere"], "one capture"),
        (["plan", "nothing"], "neither a file nor a preset"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_refusals_of_the_command(options: list[str], says: str, plan_file: Path, tmp_path: Path) -> None:
    from cyclopts import CycloptsError

    from gen.cli import app

    tokens = [str(plan_file) if option == "PLAN" else option for option in options]
    with pytest.raises((InputError, CycloptsError)) as refusal:
        app([*tokens, "-o", str(tmp_path / "out")], exit_on_error=False, print_error=False, result_action="return_value")
    assert says in str(refusal.value)
    assert list(tmp_path.iterdir()) == []


def test_a_blender_that_cannot_start_ends_the_run_at_once(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    blender = tmp_path / "blender"
    blender.write_text(f"#!{sys.executable}\nraise SystemExit('libXi.so.6: cannot open shared object file')\n")
    blender.chmod(0o755)
    began = time.monotonic()
    with pytest.raises(InputError, match=r"does not start: libXi.so.6"):
        render_set(read_plan(plan_file), tmp_path / "set", Engine(2, blender=str(blender)))
    assert time.monotonic() - began < 5
    assert items(tmp_path / "set") == 0
    render_set(read_plan(plan_file), tmp_path / "set", Engine(2), resume=True)
    assert contents(tmp_path / "set") == contents(whole)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of a few hundred kilobytes; skipped where this process may not mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=400k", "tmpfs", place], capture_output=True).returncode:
        pytest.skip("a small file system cannot be mounted here (not root)")
    yield place
    subprocess.run(["umount", place], check=True)


def test_a_full_disk_stops_the_run_and_nothing_is_lost(whole: Path, plan_file: Path, small_disk: Path, tmp_path: Path) -> None:
    ballast = small_disk / "ballast"
    complete, failed = 0, 0
    for size in (400_000, 200_000, 0):  # what is left of the disk is none, a little, and enough
        ballast.unlink(missing_ok=True)
        free = shutil.disk_usage(small_disk).free
        ballast.write_bytes(b"\1" * min(size, free))
        code, _, err = run("render", plan_file, "-o", small_disk / "set", "--resume")
        assert err.count("\n") == (code != 0), err
        folder = small_disk / "set"
        for place in (folder / "items").iterdir() if (folder / "items").is_dir() else ():
            files = {f"items/{place.name}/{p.relative_to(place).as_posix()}": p for p in place.rglob("*")}
            assert {name: p.read_bytes() if p.is_file() else None for name, p in files.items()} == {
                name: data for name, data in contents(whole).items() if name.startswith(f"items/{place.name}/")
            }
        assert not [p for p in folder.rglob("*") if p.name.startswith((".work", ".quarantined"))]
        failed += code != 0
        if code:
            assert "No space left on device" in err
            assert "--resume" in err
            assert not (folder / "index.jsonl").exists()
        assert items(folder) >= complete
        complete = items(folder)
        if code == 0:
            break
    assert failed
    assert contents(small_disk / "set") == contents(whole)


def test_a_limit_on_file_sizes_is_a_full_disk(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    code, _, err = run(
        "render",
        plan_file,
        "-o",
        tmp_path / "set",
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000)),
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},  # Python would leave byte code that is cut short
    )
    assert code == 2, err
    assert err.count("\n") == 1
    assert "File too large" in err
    assert items(tmp_path / "set") == 0
    render_set(read_plan(plan_file), tmp_path / "set", Engine(2), resume=True)
    assert contents(tmp_path / "set") == contents(whole)


@pytest.mark.alone
def test_ctrl_c_ends_soon_and_says_how_to_go_on(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    with start("render", plan_file, "-o", folder, "--workers", "2") as process:
        wait_for(lambda: items(folder) >= 2, process)
        started = descendants(process.pid)
        process.send_signal(signal.SIGINT)
        began = time.monotonic()
        _, err = process.communicate(timeout=20)
    assert time.monotonic() - began < 3
    assert gone(list(started))
    assert process.returncode == 130
    assert err.startswith("degloss: stopped; ")
    assert err.count("\n") == 1
    assert "run the same command with --resume" in err
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]
    render_set(read_plan(plan_file), folder, Engine(2), resume=True)
    assert contents(folder) == contents(whole)
