"""Verifying sets and captures: what is whole passes, and every kind of damage is one line that names it."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.capture import Capture, Fault, Truth
from gen.cli import app
from gen.errors import InputError
from gen.exr import read_exr, write_exr
from gen.formats.render_folder import write_render
from gen.sets.layer_checks import overexposed
from gen.sets.set_folder import SetFolder
from gen.sets.verify import verify

ITEM = "items/stack-000001"


def call(*tokens: str | Path) -> None:
    app([str(token) for token in tokens], exit_on_error=False, result_action="return_value")


def test_a_whole_set_has_no_faults(finished_set: SetFolder) -> None:
    steps: list[tuple[int, int]] = []
    found = verify(finished_set.path, progress=lambda done, total: steps.append((done, total)))
    assert found.faults == ()
    assert (found.items, found.pixels) == (10, 10)
    assert found.files == sum(len(row["files"]) for row in finished_set.rows())
    assert steps == [(n + 1, 10) for n in range(10)]


def test_sampling_reads_pixels_of_some_and_checksums_of_all(set_folder: SetFolder) -> None:
    found = verify(set_folder.path, sample=3, seed=1)
    assert (found.faults, found.pixels, found.items) == ((), 3, 10)
    for place in (set_folder.path / "items").iterdir():
        spoil(place / "mask.png")
    assert len(verify(set_folder.path, sample=0).faults) == 10


def spoil(path: Path) -> None:
    """Change one bit in the middle of a file."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def edit(path: Path, change: Callable[[dict[str, Any]], None], line: int | None = None) -> None:
    """Change the JSON object of a file, or of one of its lines."""
    lines = path.read_text().splitlines() if line is not None else [path.read_text()]
    value = json.loads(lines[line or 0])
    change(value)
    lines[line or 0] = json.dumps(value)
    path.write_text("\n".join(lines) + "\n")


def edit_row(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change an item's row in both of its places, as only a forger would."""
    edit(folder / ITEM / "item.json", change)
    number = [json.loads(line)["id"] for line in (folder / "index.jsonl").read_text().splitlines()].index(Path(ITEM).name)
    edit(folder / "index.jsonl", change, number)


def reorder(path: Path) -> None:
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[1], lines[0], *lines[2:]]) + "\n")


DAMAGE: dict[str, tuple[Callable[[Path], Any], str]] = {
    "a bit": (lambda f: spoil(f / ITEM / "frames/002.exr"), rf"^{ITEM}/frames/002.exr: its SHA-256"),
    "cut short": (lambda f: os.truncate(f / ITEM / "view.exr", 100), rf"^{ITEM}/view.exr: has 100 bytes"),
    "missing": (lambda f: (f / ITEM / "mask.png").unlink(), rf"^{ITEM}/mask.png: is missing"),
    "extra": (lambda f: (f / ITEM / "frames/x.exr").write_text("x"), rf"^{ITEM}/frames/x.exr: is an extra file"),
    "no folder": (lambda f: shutil.rmtree(f / ITEM), rf"^{ITEM}/capture.json: is missing, and so is"),
    "row changed": (lambda f: edit(f / ITEM / "item.json", lambda r: r.update(exposure=2.0)), "item.json: differs from the row"),
    "row damaged": (lambda f: (f / ITEM / "item.json").write_text("{"), "item.json: is missing or damaged"),
    "plan": (lambda f: spoil(f / "plan.jsonl"), r"^plan.jsonl: its SHA-256 is not the one in set.json"),
    "no plan": (lambda f: (f / "plan.jsonl").unlink(), r"^plan.jsonl: is missing"),
    "head": (lambda f: edit(f / "set.json", lambda h: h.update(seed=77)), r"^set.json: seed is 77, the plan says 5"),
    "stranger": (lambda f: (f / "items/other").mkdir(), r"^items/other: does not belong"),
    "order": (lambda f: reorder(f / "index.jsonl"), r"^index.jsonl: is not in the order"),
    "split": (lambda f: edit_row(f, lambda r: r.update(split="train")), "split is 'train', the plan says None"),
    "share": (lambda f: edit_row(f, lambda r: r.update(object_share=0.1)), "object_share is 0.1, the mask has 0."),
    "clipped": (lambda f: edit_row(f, lambda r: r.update(clipped_samples=9)), "clipped_samples is 9, the capture has 0"),
    "white": (lambda f: edit_row(f, lambda r: r.update(overexposed_pixels=[1, 0, 0, 0, 0])), r"overexposed_pixels is \[1, 0"),
    "spec": (lambda f: edit_row(f, lambda r: r.update(spec_sha256="0" * 64)), "spec_sha256 is not that of the plan's spec"),
    "path": (lambda f: edit_row(f, lambda r: (r["files"].update({"../x": "0"}), r["bytes"].update({"../x": 1}))), "leads out"),
}  # fmt: skip


IN_PIXELS = ("share", "clipped", "white", "spec")
"""Damage that only the pixels and the plan's specs bring to light."""


@pytest.mark.parametrize("name", DAMAGE)
def test_every_damage_to_a_set_is_named(set_folder: SetFolder, name: str) -> None:
    damage, expected = DAMAGE[name]
    damage(set_folder.path)
    faults = verify(set_folder.path, sample=None if name in IN_PIXELS else 0).faults
    assert any(re.search(expected, fault) for fault in faults), faults
    assert len(faults) <= 2
    assert all("\n" not in fault for fault in faults)


def test_a_row_for_every_item_of_the_plan(set_folder: SetFolder) -> None:
    path = set_folder.path / "index.jsonl"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[1:]) + "\n")
    assert verify(set_folder.path, sample=0).faults == (
        "index.jsonl: has no row for one-000000",
        "items/one-000000: does not belong to an item that the index calls rendered",
    )
    path.write_text("\n".join([*lines, lines[0].replace("one-000000", "one-000099")]) + "\n")
    assert "index.jsonl: one-000099 is not in the plan" in verify(set_folder.path, sample=0).faults


def test_a_link_is_not_a_file_of_the_set(set_folder: SetFolder) -> None:
    mask = set_folder.path / ITEM / "mask.png"
    mask.rename(set_folder.path / "mask.png")
    mask.symlink_to(set_folder.path / "mask.png")
    assert verify(set_folder.path, sample=0).faults == (f"{ITEM}/mask.png: leads out of the folder",)
    mask.unlink()
    mask.symlink_to("view.exr")
    assert verify(set_folder.path, sample=0).faults == (f"{ITEM}/mask.png: is missing",)


def test_a_file_that_fails_its_checksum_is_never_opened(set_folder: SetFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Path] = []
    monkeypatch.setattr("gen.sets.verify.read_capture", lambda path: opened.append(path) or pytest.fail("opened"))
    for place in (set_folder.path / "items").iterdir():
        spoil(place / "frames/001.exr")
    assert len(verify(set_folder.path).faults) == 10
    assert opened == []


def test_what_is_no_set_and_no_capture_is_refused(tmp_path: Path, set_folder: SetFolder) -> None:
    with pytest.raises(InputError, match="neither a set folder"):
        verify(tmp_path)
    with pytest.raises(InputError, match="--sample -1: must be at least 0"):
        verify(set_folder.path, sample=-1)
    (set_folder.path / "index.jsonl").unlink()
    with pytest.raises(InputError, match=r"index.jsonl: is not there yet"):
        verify(set_folder.path)


def test_a_capture_folder_alone(tmp_path: Path, synthetic: Callable[..., Capture], finished_set: SetFolder) -> None:
    found = verify(finished_set.path / ITEM)
    assert (found.faults, found.items, found.pixels) == ((), 1, 1)
    assert found.files == len(finished_set.rows()[7]["files"])
    write_render(synthetic(size=24), tmp_path / "c")
    assert verify(tmp_path / "c").faults == ()
    assert verify(tmp_path / "c").files == 0
    (tmp_path / "c/note.txt").write_text("x")
    (tmp_path / "c/frames/003.exr").unlink()
    assert verify(tmp_path / "c").faults == ("frames/003.exr: is missing", "note.txt: is an extra file")


def altered(truth: Truth, name: str, where: Any, value: Any) -> Truth:
    layer = getattr(truth, name).copy()
    layer[where] = value(layer[where]) if callable(value) else value
    return replace(truth, **{name: layer})


PIXELS: dict[str, tuple[Callable[[Capture], Capture], str]] = {
    "picture": (lambda c: c.with_images(c.images * np.float32(1.001)), r"001.exr: the picture as read differs"),
    "negative": (lambda c: replace(c, truth=altered(c.truth, "specular", (1, 20, 20), -0.1)), "specular: is negative, down to -0.1"),
    "infinite": (lambda c: replace(c, truth=altered(c.truth, "matte", (0, 3, 3), np.inf)), "matte: 3 values are not finite"),
    "length": (lambda c: replace(c, truth=altered(c.truth, "normals", (20, 20), lambda n: n * 1.1)), "normals: 1 are not unit"),
    "outside": (lambda c: replace(c, truth=altered(c.truth, "normals", (0, 0), (0, 0, 1))), "normals: 1 are not zero outside"),
    "hole": (lambda c: replace(c, truth=altered(c.truth, "depth", (20, 20), np.nan)), "depth: 1 values inside the mask"),
    "behind": (lambda c: replace(c, truth=altered(c.truth, "depth", (20, 20), -1)), "depth: reaches zero or less"),
    "bright matte": (lambda c: replace(c, truth=replace(c.truth, matte=c.truth.matte * 1.1)), "matte: picture 1 is brighter"),
    "dark matte": (lambda c: replace(c, truth=replace(c.truth, matte=c.truth.matte * 0.9)), "matte: picture 1 is darker"),
    "light": (lambda c: replace(c, lights=np.roll(c.lights, 1, axis=0)), "matte: picture 1 is"),
    "intensity": (lambda c: replace(c, intensities=c.intensities * 1.1), "matte: picture 1 is darker"),
    "albedo": (lambda c: replace(c, truth=replace(c.truth, albedo=c.truth.albedo[..., ::-1].copy())), "matte: picture 1 is"),
}  # fmt: skip


@pytest.mark.parametrize("name", PIXELS)
def test_every_broken_promise_of_the_layers_is_named(tmp_path: Path, synthetic: Callable[..., Capture], name: str) -> None:
    change, expected = PIXELS[name]
    write_render(change(synthetic(size=40)), tmp_path / "c")
    faults = verify(tmp_path / "c").faults
    assert any(expected in fault for fault in faults), faults


def test_what_is_stored_in_r_g_b_must_be_the_sum(tmp_path: Path, synthetic: Callable[..., Capture]) -> None:
    write_render(synthetic(size=24), tmp_path / "c")
    path = tmp_path / "c/frames/002.exr"
    channels = read_exr(path)
    channels["G"][5:7, 12] += 0.01
    write_exr(path, channels)
    (fault,) = verify(tmp_path / "c").faults
    assert fault.startswith(
        "002.exr: the picture as stored differs from diffuse + specular in 2 pixels, by 0.01 at column 12, row"
    )


def test_rounding_clipping_and_shadows_are_no_faults(tmp_path: Path, synthetic: Callable[..., Capture]) -> None:
    made = synthetic(size=40)
    write_render(made, tmp_path / "half")
    for path in (tmp_path / "half/frames").iterdir():
        channels = read_exr(path)
        write_exr(path, channels, half=tuple(channels))
    assert verify(tmp_path / "half").faults == ()

    cut = np.where((made.images >= 0.3).any(axis=3), int(Fault.CLIPPED), 0).astype(np.uint8)
    brighter = replace(made.truth, diffuse=made.truth.diffuse / 0.3, specular=made.truth.specular / 0.3, matte=None)
    clipped = np.minimum(brighter.diffuse + brighter.specular, np.float32(1))
    write_render(replace(made, images=clipped, faults=cut, truth=brighter), tmp_path / "clipped")
    assert verify(tmp_path / "clipped").faults == ()
    write_render(replace(made, images=clipped, truth=brighter), tmp_path / "unmarked")
    assert "differs from diffuse + specular" in verify(tmp_path / "unmarked").faults[0]

    # A cast shadow whose edge runs through the pixels of a column.
    matte = made.truth.matte.copy()
    matte[:, :, 10:16] = 0
    matte[:, :, 16] *= 0.4
    write_render(replace(made, truth=replace(made.truth, matte=matte)), tmp_path / "shadow")
    assert verify(tmp_path / "shadow").faults == ()
    shadow = np.zeros(made.images.shape[:3], np.uint8)
    write_render(replace(made, truth=replace(made.truth, matte=matte, shadow=shadow)), tmp_path / "denied")
    assert "matte: picture 1 is darker" in verify(tmp_path / "denied").faults[0]
    shadow[:, :, 10:16] = 2
    write_render(replace(made, truth=replace(made.truth, matte=matte, shadow=shadow)), tmp_path / "admitted")
    assert verify(tmp_path / "admitted").faults == ()


@pytest.mark.parametrize(
    "spec", [{"bounces": 2}, {"lights": {"pattern": "ring", "distance_mm": 300}}, {"lights": [{"kind": "area"}] * 5}]
)
def test_matte_is_not_judged_where_light_is_not_distant(
    tmp_path: Path, synthetic: Callable[..., Capture], spec: dict[str, Any]
) -> None:
    made = synthetic(size=24)
    wrong = replace(made, truth=replace(made.truth, matte=made.truth.matte * 0.8))
    write_render(replace(wrong, provenance={"spec": spec}), tmp_path / "c")
    assert verify(tmp_path / "c").faults == ()
    write_render(replace(wrong, provenance={"spec": {"bounces": 0, "lights": [{"direction": [0, 0, 1]}] * 5}}), tmp_path / "d")
    assert verify(tmp_path / "d").faults


def test_overexposed_is_255_in_all_three_channels() -> None:
    edge = ((254.5 / 255 + 0.055) / 1.055) ** 2.4  # IEC 61966-2-1
    rows = [[edge + 1e-5] * 3, [edge - 1e-5] * 3, [2, 2, edge - 1e-5], [2, 5, 1], [-1, 0, 0], [1, 1, 1]]
    assert overexposed(np.array(rows, np.float32).reshape(2, 1, 3, 3)) == [1, 2]


def test_the_command_prints_faults_and_refuses(set_folder: SetFolder, capsys: pytest.CaptureFixture[str]) -> None:
    call("verify", set_folder.path, "--sample", "1")
    assert "whole; 10 items" in capsys.readouterr().out
    for n in range(30):
        (set_folder.path / ITEM / f"extra{n:02d}").touch()
    with pytest.raises(InputError, match=r"30 faults found"):
        call("verify", set_folder.path)
    lines = capsys.readouterr().out.splitlines()
    assert lines == [f"{ITEM}/extra{n:02d}: is an extra file" for n in range(20)] + ["... and 10 more"]
    with pytest.raises(InputError, match=r"30 faults found"):
        call("verify", set_folder.path, "--json", "--sample", "1")
    assert len(json.loads(capsys.readouterr().out)["faults"]) == 30
