"""The benchmark: its spec, its units, the figures beside those of `compare`, gone on with after a stop, its tables and its page."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gen.errors import InputError
from gen.formats.render_folder import write_render
from recon.benchmark.cells import measure_unit
from recon.benchmark.published import OBJECTS, ROWS, published
from recon.benchmark.run import RESULTS, UNITS, begin, check_folder, run_tasks
from recon.benchmark.spec import Benchmark, preset_names, read_benchmark
from recon.benchmark.summary import markdown, resamples, summarise
from recon.benchmark.units import Unit, places, units
from recon.benchmark.work import work_of
from recon.compare import compare
from recon.pipeline import measure
from recon.registry import GLOSS
from tests.conftest import Synthetic

ROWS_OF = {"gloss": ("none", "chromaticity"), "repair": ("none", "telea"), "normals": ("least-squares", "three-light")}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two captures: a glossy sphere under five lights and a cylinder under eight."""
    from tests.conftest import synthetic_capture

    place = tmp_path_factory.mktemp("captures")
    turns = np.radians(45) * np.arange(8)
    ring = np.stack([0.6 * np.cos(turns), 0.6 * np.sin(turns), 0.8 * np.ones(8)], -1)
    write_render(synthetic_capture("sphere", 40), place / "ball")
    write_render(synthetic_capture("cylinder", 40, lights=ring, specular=0.1), place / "tube")
    return place


def benchmark(folder: Path, **more: object) -> Benchmark:
    return Benchmark.model_validate({"benchmark": "b", "captures": [{"path": str(folder)}], **more})


def measured(folder: Path, spec: Benchmark, output: Path, workers: int = 1) -> list[dict[str, object]]:
    check_folder(output, spec, resume=True)
    begin(output, spec)
    return run_tasks(output, work_of(spec, Path(), output).tasks, workers)


@pytest.mark.parametrize("name", preset_names())
def test_shipped_benchmarks_are_such(name: str) -> None:
    found, _ = read_benchmark(name)
    assert found.benchmark == name
    combinations = found.combinations()
    integrator = "adaptive" if found.views is None else "quadratic"
    assert ("none", "none", "least-squares", integrator) in combinations
    assert ("true-matte", "none", "least-squares", integrator) in combinations
    assert len(set(combinations)) == len(combinations)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("benchmark: b\ngloss: [nonesuch]\n", "unknown gloss remover"),
        ("benchmark: b\nnormals: [least-squares, least-squares]\n", "twice"),
        ("benchmark: b\ncaptures: [{path: a, set: zoo}]\n", "exactly one"),
        ("benchmark: b\ninpaint: [none]\n", "did you mean 'repair'"),
        ("benchmark: b\ndraws: {count: 0, lights: 5}\n", "draws.count"),
        ("gloss: [none]\n", "benchmark"),
        ("benchmark: ../b\n", "benchmark"),
    ],
)
def test_bad_specs_are_refused(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "b.yaml").write_text(text)
    with pytest.raises(InputError, match=says):
        read_benchmark(tmp_path / "b.yaml")


def test_an_unknown_benchmark_names_the_known_ones() -> None:
    with pytest.raises(InputError, match="diligent-few"):
        read_benchmark("nonesuch")


def test_a_row_says_what_compare_says(folder: Path) -> None:
    """The errors of the glossy, the removed, the repaired and the non-glossy pictures are those of `recon.compare`."""
    spec = benchmark(folder, gloss=["none", "chromaticity"], repair=["none", "telea"])
    unit = units(spec, places(spec.captures, Path(), folder))[0]
    rows, maps = measure_unit(unit, spec.combinations())
    by = {(row["gloss"], row["repair"]): row for row in rows}
    expected = compare(measure(unit.capture(), "chromaticity", "telea")).figures()
    pairs = {"glossy": ("none", "none"), "removed": ("chromaticity", "none"), "repaired": ("chromaticity", "telea")}
    for name, of in {**pairs, "true matte": ("true-matte", "none")}.items():
        assert by[of]["normals"] == pytest.approx(expected[name]["normals"]["mask"]["mean"])
        assert by[of]["of range"] == pytest.approx(expected[name]["height"]["percent"])
        assert by[of]["height MSE"] == pytest.approx(expected[name]["non-glossy"]["height MSE"])
    assert by["true-matte", "none"]["height MSE"] == 0
    error = maps["e0"][maps["mask"]].astype(np.float64)
    assert str(maps["names"][0]).split("\x1f")[0] == "none"
    assert np.nanmean(error) == pytest.approx(by["none", "none"]["normals"], rel=0.01)


def test_a_method_that_cannot_is_left_out_and_the_others_stand(folder: Path, tmp_path: Path) -> None:
    spec = benchmark(folder, **ROWS_OF)
    rows = measured(folder, spec, tmp_path / "out")
    summary = summarise(rows, spec.combinations(), 0)
    assert {e["normals_by"] for e in summary["left out"]} == {"three-light"}
    assert all("exactly three pictures" in e["why"] for e in summary["left out"])
    assert {e["normals_by"] for e in summary["ranking"]} == {"least-squares"}
    errors = {(e["gloss"], e["repair"]): e for e in summary["ranking"]}
    assert [e["normals"] for e in summary["ranking"]] == sorted(e["normals"] for e in summary["ranking"])
    assert errors["true-matte", "none"]["gap closed"] == pytest.approx(1)
    assert errors["none", "none"]["gap closed"] == pytest.approx(0)
    by_hand = {
        name: [row["normals"] for row in rows if (row["gloss"], row["repair"]) == (name, "none") and row.get("normals")]
        for name in GLOSS
    }
    glossy, removed, matte = (np.array(by_hand[name], float) for name in ("none", "chromaticity", "true-matte"))
    assert errors["chromaticity", "none"]["difference"] == pytest.approx((removed - glossy).mean())
    assert errors["chromaticity", "none"]["gap closed"] == pytest.approx((glossy - removed).sum() / (glossy - matte).sum())
    low, high = errors["chromaticity", "none"]["interval"]
    assert low <= errors["chromaticity", "none"]["difference"] <= high
    text = markdown("b", summary)
    assert "| by object | ball | tube |" in text
    assert "Left out" in text


def test_a_run_is_gone_on_with_and_the_same_however_many_work(folder: Path, tmp_path: Path) -> None:
    spec = benchmark(folder, gloss=["none", "chromaticity"], draws={"count": 2, "lights": 4})
    rows = measured(folder, spec, tmp_path / "a")
    assert [row["draw"] for row in rows[:: len(spec.combinations())]] == [0, 1, 0, 1]
    removed = sorted((tmp_path / "a" / UNITS).glob("*.json"))[1]
    removed.unlink()
    kept = sorted((tmp_path / "a" / UNITS).glob("*.json"))
    times = [path.stat().st_mtime_ns for path in kept]
    again = measured(folder, spec, tmp_path / "a")
    assert [path.stat().st_mtime_ns for path in kept] == times
    assert removed.is_file()
    both = measured(folder, spec, tmp_path / "b", workers=2)

    def plain(found: list[dict[str, object]]) -> list[dict[str, object]]:
        return [{key: value for key, value in row.items() if key != "seconds"} for row in found]

    assert plain(rows) == plain(again) == plain(both)
    lines = (tmp_path / "a" / RESULTS).read_text().splitlines()
    assert [json.loads(line)["gloss"] for line in lines] == [row["gloss"] for row in again]


def test_a_folder_of_something_else_is_refused(folder: Path, tmp_path: Path) -> None:
    spec, other = benchmark(folder), benchmark(folder, seed=2)
    check_folder(tmp_path / "a", spec, resume=False)
    begin(tmp_path / "a", spec)
    with pytest.raises(InputError, match="--resume"):
        check_folder(tmp_path / "a", spec, resume=False)
    with pytest.raises(InputError, match="other settings"):
        check_folder(tmp_path / "a", other, resume=True)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "x").touch()
    with pytest.raises(InputError, match="not a benchmark's"):
        check_folder(tmp_path / "b", spec, resume=True)


def test_a_damaged_unit_is_named(folder: Path, tmp_path: Path) -> None:
    spec = benchmark(folder)
    measured(folder, spec, tmp_path / "a")
    path = next((tmp_path / "a" / UNITS).glob("*.json"))
    path.write_text("[{}]")
    with pytest.raises(InputError, match=path.name):
        measured(folder, spec, tmp_path / "a")


def test_captures_without_truth_or_of_one_name_are_refused(folder: Path, tmp_path: Path, synthetic: Synthetic) -> None:
    from dataclasses import replace

    from gen.capture import Truth

    write_render(replace(synthetic("sphere", 24), truth=Truth()), tmp_path / "bare")
    spec = benchmark(tmp_path / "bare")
    with pytest.raises(InputError, match="no true normals"):
        units(spec, places(spec.captures, Path(), tmp_path))
    write_render(synthetic("sphere", 24), tmp_path / "other" / "ball")
    twice = benchmark(folder, captures=[{"path": str(folder)}, {"path": str(tmp_path / "other" / "ball")}])
    with pytest.raises(InputError, match="named ball"):
        places(twice.captures, Path(), tmp_path)


def test_the_bootstrap_covers_a_known_mean() -> None:
    """Of 200 samples of a known distribution, the 95 % interval of the mean holds the true one nearly as often as it says."""
    rng = np.random.default_rng(1)
    held = 0
    for i in range(200):
        values = rng.normal(1.0, 1.0, 30)
        low, high = np.percentile(values[resamples(["one"] * 30, i)].mean(1), [2.5, 97.5])
        held += low <= 1.0 <= high
    assert 178 <= held <= 199


def test_resamples_take_whole_captures() -> None:
    found = resamples(["a", "a", "b", "b"], 0)
    assert found.shape[1] == 4
    for row in found[:50]:
        assert sum(i < 2 for i in row) in (0, 2, 4)


def test_a_group_of_captures_may_be_called_like_a_column() -> None:
    combinations = [("none", "none", "least-squares", "dct"), ("chromaticity", "none", "least-squares", "dct")]
    rows = [
        {
            **dict(zip(("gloss", "repair", "normals_by", "height_by"), c, strict=True)),
            "capture": f"c-{group}",
            "group": group,
            "draw": 0,
            "lights": [1, 2, 3],
            "normals": error,
            "seconds": {"gloss": 0.0, "rest": 0.1},
        }
        for c, errors in zip(combinations, ((9.0, 8.0), (3.0, 2.0)), strict=True)
        for group, error in zip(("gloss", "normals_by"), errors, strict=True)
    ]
    text = markdown("b", summarise(rows, combinations, 0))
    assert "| by object | gloss | normals_by |" in text
    assert "| chromaticity | 3.00 | 2.00 |" in text
    assert "| none | 9.00 | 8.00 |" in text


def test_published_rows_stand_under_their_objects() -> None:
    assert all(len(values) == len(OBJECTS) for values in ROWS.values())
    found = published(["bearPNG", "something", "cat"])
    assert found["least squares"] == {"bearPNG": 8.39, "cat": 8.41}
    assert published(["something"]) == {}


def test_the_command(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "b.yaml").write_text("benchmark: mine\ngloss: [none, chromaticity]\n")
    command = [sys.executable, "-m", "degloss", "recon", "bench", str(tmp_path / "b.yaml")]
    missing = subprocess.run([*command, str(tmp_path / "nothing"), "-o", str(tmp_path / "new")], capture_output=True, text=True)
    assert missing.returncode == 2
    assert not (tmp_path / "new").exists()
    words = [*command, str(folder), "-o", str(tmp_path / "out")]
    run = subprocess.run([*words, "--json"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout)["captures"] == 2
    for name in ("results.jsonl", "summary.json", "table.md", "report.html"):
        assert (tmp_path / "out" / name).stat().st_size > 100, name
    assert "ball" in (tmp_path / "out" / "report.html").read_text()
    refused = subprocess.run(words, capture_output=True, text=True)
    assert refused.returncode == 2
    assert "--resume" in refused.stderr
    assert refused.stderr.count("\n") == 1


@pytest.mark.data
def test_least_squares_on_photographs_is_the_published_figure(data_folder: Path) -> None:
    place = data_folder / "diligent" / "cat"
    rows, _ = measure_unit(Unit("cat", "cat", str(place), 0, tuple(range(96))), [("none", "none", "least-squares", "quadratic")])
    assert rows[0]["normals"] == pytest.approx(ROWS["least squares"][OBJECTS.index("cat")], abs=0.01)
