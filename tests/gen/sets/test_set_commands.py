"""The commands on a set that Blender rendered: cast shadows, averaged pixels, half files, cut pictures, a near light."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gen.cli import app
from gen.errors import InputError
from gen.sets.pack import read_pack
from gen.sets.set_folder import SetFolder
from tests.gen.sets.set_runs import run

RENDERED = """\
# one of everything that verifying has to understand
set: rendered
seed: 2
groups:
  - name: shadows
    each: {shape.name: [gear, stepped_shaft, helical_spring]}
    capture:
      resolution: [48, 48]
      supersampling: 2
      shape: {sample: true}
      pose: {rotation_degrees: {rotation: uniform}}
      lights: {pattern: ring, count: 2, tilt_degrees: 50}
      camera: {kind: orthographic, width_mm: 80}
  - name: cut
    capture:
      resolution: [32, 32]
      shape: {name: sphere, radius: 10}
      material: {kind: substrate, albedo: 0.8, specular: 0.4, alpha: 0.1}
      lights: {pattern: random, count: 2}
      camera: {kind: perspective, distance_mm: 200, fov_degrees: 8}
      exposure: {percentile: 50, level: 0.9}
      clip: true
      half: true
  - name: near
    capture:
      resolution: [32, 32]
      shape: {name: cone, radius: 10}
      lights: {pattern: ring, count: 1, tilt_degrees: 30, distance_mm: 60}
      camera: {kind: orthographic, width_mm: 40}
  - name: single
    count: 2
    single: true
    capture:
      resolution: [32, 32]
      shape: {name: sphere, radius: 10}
      lights: {pattern: random, count: 1}
      camera: {kind: orthographic, width_mm: 30}
      exposure: {choice: [0.5, 0.6]}
"""


def call(*tokens: str | Path) -> None:
    app([str(token) for token in tokens], exit_on_error=False, result_action="return_value")


@pytest.mark.render
def test_from_a_rendered_set_to_a_pack(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "set.yaml").write_text(RENDERED)
    folder = tmp_path / "set"
    call("render", tmp_path / "set.yaml", "-o", folder)
    capsys.readouterr()

    call("verify", folder, "--json")
    facts = json.loads(capsys.readouterr().out)
    assert facts["faults"] == []
    assert facts["items"] == facts["pixels"] == 7

    call("screen", folder, "--json")
    facts = json.loads(capsys.readouterr().out)
    assert (facts["pictures"], facts["kept"]) == (11, 11)
    assert facts["clipped_samples"] > 0

    call("split", folder, "--by", "object", "--fractions", "0.6,0.2,0.2")
    call("preview", folder)
    call("pack", folder, "-o", tmp_path / "train.safetensors", "--size", "16", "--split", "train")
    pack = read_pack(tmp_path / "train.safetensors")
    assert {item["split"] for item in pack.items} == {"train"}
    splits = json.loads((folder / "splits.json").read_text())["splits"]
    assert [item["id"] for item in pack.items] == splits["train"]
    n, mask = pack["normals"], pack["mask"]
    assert np.linalg.norm(n[mask], axis=1) == pytest.approx(1, abs=1e-6)
    whole = pack["valid"]
    total = pack["diffuse"].astype(np.float32) + pack["specular"]
    assert whole.mean() > 0.1
    assert pack["combined"][whole].astype(np.float32) == pytest.approx(total[whole], rel=2e-3, abs=1e-4)

    # What was tried on the way left no trace in the set, and damage ends the command itself with code 2 and one line.
    call("verify", folder, "--sample", "1")
    (folder / "items/near-000000/mask.png").write_bytes(b"x")
    code, out, err = run("verify", folder, "--sample", "0")
    assert code == 2
    assert out.startswith("items/near-000000/mask.png: has 1 bytes, ")
    assert err.splitlines() == [f"degloss: {folder}: 1 fault found; render what is damaged again"]


@pytest.mark.parametrize("name", ["index.jsonl", "set.json", "items/new.png", "items", "mask.png"])
@pytest.mark.parametrize("command", ["preview", "pack"])
def test_nothing_is_written_over_the_set(set_folder: SetFolder, command: str, name: str) -> None:
    before = {path: path.read_bytes() for path in set_folder.path.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match="may be one of the files of"):
        call(command, set_folder.path, "-o", set_folder.path / name)
    assert {path: path.read_bytes() for path in set_folder.path.rglob("*") if path.is_file()} == before
