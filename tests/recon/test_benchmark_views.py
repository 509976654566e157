"""The benchmark of views: its spec, its objects, rows beside those of `compare_rows`, gone on with after a stop, tables, page."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from gen.capture import Truth
from gen.errors import InputError
from gen.formats.render_folder import write_render
from recon.benchmark import views as module
from recon.benchmark.cli import bench
from recon.benchmark.run import RESULTS, UNITS, run_tasks
from recon.benchmark.spec import Benchmark, Source, read_benchmark
from recon.benchmark.views import ViewsUnit, drawn, maps_of, measure_views_unit, objects, views_units
from recon.benchmark.views_page import views_page
from recon.benchmark.views_tables import FIGURES, summarise_views, views_label, views_markdown
from recon.benchmark.work import work_of
from recon.cli import app
from recon.multiview.compare import compare
from recon.multiview.measure import compare_rows
from recon.multiview.views import read_views, write_cameras
from recon.reconstruct import Settings
from tests.recon.multiview.ring import AXES, MIDDLE, capture_at, ring, turned, write_ring

Rows = list[dict[str, Any]]
SPEC = "benchmark: turned\nviews: [{path: objects}]\n"


def command(*arguments: object) -> None:
    app([str(argument) for argument in arguments], result_action="return_value", exit_on_error=False)


def rows_of(output: Path) -> Rows:
    return [json.loads(line) for line in (output / RESULTS).read_text().splitlines()]


def untimed(rows: Rows) -> Rows:
    return [{key: value for key, value in row.items() if key != "seconds"} for row in rows]


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two objects, a glossy egg in three views and a pebble in two, and a spec that names their folder."""
    place = tmp_path_factory.mktemp("desk")
    write_ring(place / "objects" / "egg", (0, 14, 28), size=48, gloss=0.3)
    write_ring(place / "objects" / "pebble", (40, 55), size=40, gloss=0.3)
    (place / "b.yaml").write_text(SPEC)
    return place


@pytest.fixture(scope="module")
def finished(desk: Path) -> Path:
    """A run of both objects, by the command."""
    command("bench", desk / "b.yaml", "-o", desk / "finished")
    return desk / "finished"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("views: [{path: a}]\nheight: [quadratic]\n", "height: does not go with views: their integrator is always quadratic"),
        ("views: [{path: a}]\ndraws: {count: 2, lights: 4}\n", "draws: does not go with views"),
        ("views: [{path: a}]\nskip: {a: [1, 2]}\n", "skip: does not go with views"),
        ("views: [{path: a}]\ncaptures: [{path: b}]\n", "captures: does not go with views: they are two benchmarks"),
        ("views: [{preset: paper-sphere}]\n", "views: the preset paper-sphere is one capture"),
        ("views: [{set: multiview-ring, limit: 3}]\n", "views: the set multiview-ring is one object"),
        ("views: [{path: a, set: b}]\n", "exactly one"),
        ("views: [{folder: a}]\n", r"views\[0\].folder: unknown key"),
        ("views: ring\n", "views: must be a list"),
    ],
)
def test_bad_specs_are_refused(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "b.yaml").write_text(f"benchmark: b\n{text}")
    with pytest.raises(InputError, match=says) as refused:
        read_benchmark(tmp_path / "b.yaml")
    assert "\n" not in str(refused.value)


def test_the_preset_asks_for_what_is_promised() -> None:
    """With gloss, without, and the matte twin, each with the integrator of views and no other."""
    found, _ = read_benchmark("multiview")
    assert {c[0] for c in found.combinations()} == {"none", "true-matte", "chromaticity", "group"}
    assert {c[3] for c in found.combinations()} == {"quadratic"}


def test_objects_are_found_in_their_order_and_once(desk: Path) -> None:
    folder = desk / "objects"
    both = objects([Source(path="objects")], desk, desk)
    assert both == [("egg", folder / "egg"), ("pebble", folder / "pebble")]
    again = objects([Source(path="objects/pebble"), Source(path="objects"), Source(path="objects", limit=1)], desk, desk)
    assert [name for name, _ in again] == ["pebble", "egg"]
    assert objects([Source(path="objects", limit=1)], desk, desk) == both[:1]


def test_what_holds_no_objects_is_refused(desk: Path, tmp_path: Path) -> None:
    write_ring(tmp_path / "other" / "egg", (0, 14), size=24)
    with pytest.raises(InputError, match="two objects are named egg"):
        objects([Source(path=str(desk / "objects")), Source(path=str(tmp_path / "other" / "egg"))], Path(), tmp_path)
    bare = capture_at(turned(0), 24)
    for angle in (0, 14):
        write_render(replace(bare, truth=Truth(matte=bare.truth.matte)), tmp_path / "bare" / f"{angle}")
    write_cameras(tmp_path / "bare", ["0", "14"], [turned(0), turned(14)])
    with pytest.raises(InputError, match="view 0 has no true depth"):
        views_units([("none", "none", "least-squares", "quadratic")], [("bare", tmp_path / "bare")])
    write_cameras(tmp_path / "one", ["../bare/0"], [turned(0)])
    with pytest.raises(InputError, match=r"one: .*leads out of the folder"):
        views_units([], [("one", tmp_path / "one")])
    write_ring(tmp_path / "one", (0,), size=24)
    with pytest.raises(InputError, match=r"one: multi-view needs from 2 to 1000 views, there are 1"):
        views_units([], [("one", tmp_path / "one")])
    (tmp_path / "empty").mkdir()
    for missing, says in ((tmp_path / "nothing", "is no folder of views"), (tmp_path / "empty", "holds no cameras.json")):
        with pytest.raises(InputError, match=says):
            command("bench", "multiview", missing, "-o", tmp_path / "new" / "out")
    assert not (tmp_path / "new").exists()


def test_a_row_says_what_compare_rows_says(desk: Path, finished: Path) -> None:
    views, ball = read_views(desk / "objects" / "pebble")
    _, expected = compare_rows(views, ball, [Settings("none", "none")])
    found = {row["gloss"]: row for row in rows_of(finished) if row["object"] == "pebble"}
    assert list(found) == list(expected) == ["none", "true-matte"]
    for gloss, row in found.items():
        figures = {key: value for key, value in expected[gloss].items() if key not in ("label", "seconds")}
        assert {key: row[key] for key in figures} == figures
        assert row["seconds"].keys() == expected[gloss]["seconds"].keys()
        assert row["views"] == 2


def test_what_a_run_leaves(finished: Path) -> None:
    """The means are those of the rows, the tables and the page name every mesh and object."""
    rows = rows_of(finished)
    summary = json.loads((finished / "summary.json").read_text())
    assert summary["objects"] == ["egg", "pebble"]
    said = json.loads((finished / "benchmark.json").read_text())["benchmark"]
    assert said.keys() == {"benchmark", "seed", "views", "gloss", "repair", "normals"}
    assert summary["views"] == 5
    assert summary["left out"] == []
    for entry in summary["ranking"]:
        own = [row for row in rows if row["gloss"] == entry["gloss"]]
        assert len(own) == 2
        assert entry["chamfer"] == pytest.approx(np.mean([row["chamfer"] for row in own]))
        assert entry["complete"] == pytest.approx(np.mean([row["completeness"]["within"] for row in own]))
        assert entry["normals"] == pytest.approx(np.mean([row["normals"]["mean"] for row in own]))
        assert entry["seconds"] == pytest.approx(np.mean([sum(row["seconds"].values()) for row in own]))
    assert [e["gloss"] for e in summary["ranking"]] == ["true-matte", "none"]
    table = (finished / "table.md").read_text()
    assert "| methods | accuracy, mm | completeness, mm | chamfer, mm | F, % |" in table
    assert re.search(r"^\| with gloss \|( [\d.]+ \|){10}$", table, re.MULTILINE)
    assert "| chamfer, mm | egg | pebble |" in table
    page = (finished / "report.html").read_text()
    for text in ("matte twin", "with gloss", "Chamfer distance by object", "Errors seen from 0", "Errors seen from 55"):
        assert text in page, text


def test_a_run_that_was_stopped_ends_as_one_that_was_not(
    desk: Path, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One object of the two, interrupted when its first mesh is kept; what is kept is not measured again."""
    words = ("bench", desk / "b.yaml", "-o", tmp_path / "out", "--limit", 1)
    kept = tmp_path / "out" / UNITS

    def interrupted(unit: ViewsUnit) -> Any:
        if kept.is_dir() and any(kept.glob("*.json")):
            raise KeyboardInterrupt
        return measure_views_unit(unit)

    with monkeypatch.context() as stop:
        stop.setattr(module, "measure_views_unit", interrupted)
        with pytest.raises(KeyboardInterrupt, match="--resume"):
            bench(str(desk / "b.yaml"), output=tmp_path / "out", limit=1)
    (first,) = kept.glob("*.json")
    then = first.stat().st_mtime_ns
    assert not (tmp_path / "out" / "report.html").exists()
    with pytest.raises(InputError, match="--resume"):
        command(*words)
    capsys.readouterr()
    command(*words, "--resume", "--json")
    assert json.loads(capsys.readouterr().out)["objects"] == ["egg"]
    assert first.stat().st_mtime_ns == then
    assert untimed(rows_of(tmp_path / "out")) == untimed(rows_of(finished)[:2])


def test_without_torch_its_remover_is_left_out_and_tried_again(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gen import parts
    from learn import removers

    removers._shipped.cache_clear()  # another test may have loaded it
    there = parts.find_spec
    monkeypatch.setattr(parts, "find_spec", lambda name: None if name == "torch" else there(name))
    spec = Benchmark.model_validate({"benchmark": "b", "views": [{"path": "objects/pebble"}], "gloss": ["group"]})
    work = work_of(spec, desk, tmp_path)
    (tmp_path / UNITS).mkdir()
    results = work.results(run_tasks(tmp_path, work.tasks))
    assert [e["gloss"] for e in results.summary["left out"]] == ["group"]
    assert re.search(r"^Left out: group: torch is missing .*: pip install", results.table, re.MULTILINE)
    assert any("torch is missing" in getattr(part, "text", "") for part in results.page().sections[0].parts)
    times = {path.name.split("-", 1)[1]: path.stat().st_mtime_ns for path in (tmp_path / UNITS).glob("*.json")}
    run_tasks(tmp_path, work.tasks)
    again = {path.name.split("-", 1)[1]: path.stat().st_mtime_ns for path in (tmp_path / UNITS).glob("*.json")}
    assert {name for name in times if times[name] != again[name]} == {"group-none-least-squares.json"}


def test_a_damaged_row_is_named(desk: Path, tmp_path: Path) -> None:
    work = work_of(Benchmark.model_validate({"benchmark": "b", "views": [{"path": "objects/egg"}]}), desk, tmp_path)
    (tmp_path / UNITS).mkdir()
    (tmp_path / UNITS / f"{work.tasks[0].key}.json").write_text('[{"gloss": "none"}]')
    with pytest.raises(InputError, match=work.tasks[0].key):
        run_tasks(tmp_path, work.tasks)


@pytest.fixture(scope="module")
def ellipsoid() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(5)
    return trimesh.Trimesh(mesh.vertices * AXES + MIDDLE, mesh.faces, process=False)


def test_a_mesh_is_drawn_where_the_camera_sees_it(ellipsoid: trimesh.Trimesh) -> None:
    """The ellipsoid as triangles against its closed form: depth and normals of every pixel but the rim's."""
    views, _ = ring((0, 28), size=64)
    for view in views:
        truth = view.capture.truth
        assert truth.depth is not None
        assert truth.normals is not None
        depth, normal = drawn(ellipsoid, view)
        both = np.isfinite(depth) & view.capture.mask
        assert both.sum() > 0.98 * view.capture.mask.sum()
        assert (np.isfinite(depth) & ~view.capture.mask).sum() == 0
        inner = both & (truth.normals[..., 2] > 0.3)
        assert np.abs(depth - 1000 * truth.depth)[inner].max() < 0.03
        assert np.einsum("nk,nk->n", normal[inner], truth.normals[inner]).min() > np.cos(np.radians(1.5))


def test_the_inner_side_of_a_mesh_is_not_drawn(ellipsoid: trimesh.Trimesh) -> None:
    """Of a shell whose near half is gone nothing is seen, not its far wall."""
    view = ring((0, 28), size=48)[0][0]
    toward = np.einsum("fk,k->f", ellipsoid.triangles_center - MIDDLE, view.rotation[2])
    far = trimesh.Trimesh(ellipsoid.vertices, ellipsoid.faces[toward < -2], process=False)
    assert np.isnan(drawn(far, view)[0]).all()


@cache
def figures_of_equals() -> dict[str, Any]:
    return compare(trimesh.creation.icosphere(1), trimesh.creation.icosphere(1), 0.3)


def figures_of(chamfer: float, angle: float | None = 2.0) -> dict[str, Any]:
    return figures_of_equals() | {"chamfer": chamfer, "normals": None if angle is None else {"mean": angle, "median": angle}}


def made_rows(*figures: dict[str, Any]) -> tuple[Rows, list[tuple[str, str, str, str]]]:
    """Rows of objects "o0", "o1" ... under two combinations; the figures of one after those of the other."""
    combinations = [("none", "none", "least-squares", "quadratic"), ("chromaticity", "telea", "least-squares", "quadratic")]
    rows = []
    for i, found in enumerate(figures):
        gloss, repair, normals, height = combinations[i % 2]
        methods = {"gloss": gloss, "repair": repair, "normals_by": normals, "height_by": height}
        rows.append({"object": f"o{i // 2}", "views": 4, **methods, "seconds": {"a": 1.0, "b": 2.0}, **found})
    return rows, combinations


def test_a_combination_that_fails_for_one_object_is_left_out() -> None:
    good = figures_of(0.1)
    rows, combinations = made_rows(good, figures_of(0.2), good, {"failed": "no two views agree"})
    summary = summarise_views(rows, combinations)
    assert [(e["gloss"], e["failed"], e["why"]) for e in summary["left out"]] == [("chromaticity", 1, "no two views agree")]
    assert [e["gloss"] for e in summary["ranking"]] == ["none"]
    assert summary["views"] == 8
    text = views_markdown("b", summary)
    assert "\nLeft out: chromaticity, telea: no two views agree\n" in text
    page = views_page("b", summary, [])
    assert "with gloss comes nearest" in page.lead


def test_nothing_measured_is_said() -> None:
    rows, combinations = made_rows({"failed": "x"}, {"failed": "y"})
    summary = summarise_views(rows, combinations)
    assert summary["ranking"] == []
    assert "Nothing could be measured" in views_page("b", summary, []).lead
    assert views_markdown("b", summary).count("Left out") == 2


def test_a_figure_that_one_object_lacks_is_a_dash() -> None:
    rows, combinations = made_rows(figures_of(0.3), figures_of(0.1), figures_of(0.3, None), figures_of(0.1))
    summary = summarise_views(rows, combinations)
    assert [views_label(e, summary["ranking"]) for e in summary["ranking"]] == ["chromaticity, telea", "with gloss"]
    assert set(FIGURES) - set(summary["ranking"][1]) == {"normals"}
    line = next(line for line in views_markdown("b", summary).splitlines() if line.startswith("| with gloss"))
    assert line.split(" | ")[4:7] == ["100.0", "-", "3.0"]


def test_several_solvers_are_told_apart_in_labels() -> None:
    entries = [{"gloss": "true-matte", "repair": "none", "normals_by": name} for name in ("least-squares", "l1")]
    assert [views_label(e, entries) for e in entries] == ["matte twin, least-squares", "matte twin, l1"]


def test_maps_show_the_first_view_and_the_one_half_way_round(ellipsoid: trimesh.Trimesh) -> None:
    views, _ = ring((0, 14, 28, 42), size=32)
    maps = maps_of(views, ellipsoid)
    assert maps["views"].tolist() == ["0", "28"]
    for v in (0, 1):
        shape = maps[f"true{v}"].shape
        assert maps[f"depth{v}"].shape == shape
        assert maps[f"picture{v}"].shape == maps[f"normal{v}"].shape == (*shape, 3)
        assert np.nanmedian(np.abs(maps[f"depth{v}"] - maps[f"true{v}"])) < 0.03
        assert float(maps[f"step{v}"]) == pytest.approx(1000 * (views[2 * v].capture.scale.metres_per_pixel or 0))
        (top, bottom, _), (left, right, _) = maps[f"window{v}"]
        true = 1000 * np.asarray(views[2 * v].capture.truth.depth)
        assert np.array_equal(maps[f"true{v}"], true[top:bottom, left:right].astype(np.float32), equal_nan=True)
