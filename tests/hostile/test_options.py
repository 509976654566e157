"""Options that ask for what cannot be: below zero, beyond all numbers, not numbers at all. Refused before anything is begun."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

from gen.formats.render_folder import write_files
from tests.conftest import synthetic_capture
from tests.hostile.commands import Case, require_refusal
from tests.hostile.files import large_picture, stl
from tests.hostile.readers import BENCHMARK, READERS, SET, SPHERE

BIG = "9" * 30
OPTIONS: dict[str, list[tuple[str, str]]] = {
    # the command: (options, what the line names)
    "recon run HERE/capture -o HERE/out": [
        ("--threshold nan", "nan"),
        ("--threshold inf", "inf"),
        ("--dilate -1", "-1"),
        (f"--dilate {BIG}", "--dilate"),
        (f"--lights {BIG}", "--lights"),
        ("--lights 1,2,3,", "--lights"),
        ("--lights ,", "--lights"),
        ("--lights -1,2,3", "--lights"),
        ("--lights ١,٢,٣", "--lights"),
        ("--saturated maybe", "saturated"),
        ("--gloss ../../x", "--gloss"),
        ("--height x", "--height"),
        ("--normals os:system", "--normals"),
        ("--output", "output"),
        ("--json=3", "json"),
    ],
    "recon inspect HERE/measured HERE/part.stl -o HERE/out": [
        ("", "tolerance"),
        ("--tolerance nan", "tolerance"),
        ("--tolerance inf", "tolerance"),
        ("--tolerance -1", "tolerance"),
        ("--tolerance 0", "tolerance"),
        ("--tolerance 0.1 --guard nan", "guard"),
        ("--tolerance 0.1 --guard -1", "guard"),
        ("--tolerance 0.1 --uncertainty nan", "uncertainty"),
        ("--tolerance 0.1 --uncertainty 400", "uncertainty"),
        ("--tolerance 0.1 --initial-pose 1,2", "pose"),
        ("--tolerance 0.1 --initial-pose nan,0,0", "pose"),
        ("--tolerance 0.1 --unit parsec", "unit"),
    ],
    "recon bench HERE/bench.yaml -o HERE/out": [
        ("--workers 0", "--workers"),
        ("--workers 100000", "--workers"),
        ("--limit 0", "--limit"),
        (f"--limit -{BIG}", "--limit"),
        ("--workers many", "workers"),
        ("--resume HERE/gone", "gone"),
    ],
    "gen plan HERE/set.yaml -o HERE/planned.jsonl": [
        ("--limit 0", "limit"),
        ("--limit -3", "limit"),
        ("--seed -1", "seed"),
        (f"--seed {BIG}", "seed"),
    ],
    "gen render HERE/spec.yaml -o HERE/out": [
        ("--workers 0", "workers"),
        ("--workers -1", "workers"),
        ("--seed -1", "seed"),
        (f"--seed {BIG}", "seed"),
        ("--device tpu", "device"),
        ("--blender HERE/part.stl", "part.stl"),
        ("--blender HERE/no-blender", "no-blender"),
        ("--resume", "--resume"),
        ("--limit 3", "--limit"),
        ("--engine ray", "--engine"),
    ],
    "gen render-chunk HERE/plan.jsonl -o HERE/out": [
        ("--index 1 --chunks 1", "chunk"),
        ("--index -1 --chunks 1", "chunk"),
        ("--index 0 --chunks 0", "chunk"),
        (f"--index {BIG} --chunks 2", "chunk"),
    ],
    "learn predict specular HERE/a.png -o HERE/out": [
        ("--device tpu", "tpu"),
        ("--device cuda:99", "cuda:99"),
        ("--device cuda:-1", "cuda:-1"),
        (f"--device cuda:{BIG}", "cuda"),
        ("--lights HERE/part.stl", "--lights"),
        ("--encoding log", "encoding"),
        ("--mask HERE/part.stl", "part.stl"),
    ],
    "learn eval specular HERE/data.safetensors": [
        ("--limit 0", "limit"),
        ("--limit -1", "limit"),
        ("--split half", "split"),
        ("--split test", "test"),
        ("--repair glue", "glue"),
    ],
    "learn export group -o HERE/g.pt --format torch": [
        ("--pictures 0", "pictures"),
        ("--pictures -1", "pictures"),
        (f"--pictures {BIG}", "pictures"),
        ("--shrink 0", "shrink"),
        (f"--shrink {BIG}", "shrink"),
        ("--format gif", "format"),
    ],
    "learn train smoke-specular -o HERE/run": [
        ("--minutes nan", "minutes"),
        ("--minutes -1", "minutes"),
        ("--minutes inf", "minutes"),
        ("--data pack", "--data"),
        ("--data ../x=1", "--data"),
        ("--data pack=HERE/data.safetensors crop=4", "crop"),
        ("--data pack=HERE/data.safetensors validation_share=2", "validation_share"),
        ("--device tpu", "tpu"),
        ("--resume", "run"),
    ],
}


def lay(folder: Path) -> None:
    from tests.learn.small_runs import write_tiny_pack

    (folder / "capture").mkdir()
    write_files(synthetic_capture(size=8), folder / "capture")
    (folder / "measured").mkdir()
    READERS["measurement"].lay(folder / "measured")
    READERS["plan"].lay(folder)
    (folder / "part.stl").write_bytes(stl())
    (folder / "spec.yaml").write_text(SPHERE)
    (folder / "set.yaml").write_text(SET)
    (folder / "bench.yaml").write_text(BENCHMARK)
    (folder / "a.png").write_bytes(large_picture())
    write_tiny_pack(folder / "data.safetensors")


@pytest.mark.parametrize(("command", "options", "names"), [(c, *row) for c, rows in OPTIONS.items() for row in rows])
def test_an_option_that_cannot_be_is_refused(
    command: str, options: str, names: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    if command.startswith("learn") and find_spec("torch") is None:
        pytest.skip("torch is not installed")
    require_refusal(Case(lay, f"{command} {options}", names, ""), tmp_path, capfd)
