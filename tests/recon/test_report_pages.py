"""The pages of the measuring commands in headless Chromium, each of a small capture: whole, quiet, readable, and answering."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.formats.render_folder import write_render
from recon.benchmark.cells import measure_unit
from recon.benchmark.page import benchmark_page
from recon.benchmark.spec import Benchmark
from recon.benchmark.summary import summarise
from recon.benchmark.units import Unit
from recon.compare import compare, shape_metrics
from recon.inspection.inspection import inspect
from recon.inspection.output import write_inspection
from recon.inspection.pose import rotation_of
from recon.metrics import angular_error
from recon.multiview.measure import compare_rows
from recon.multiview.output import write_models
from recon.page import write_page
from recon.page_parts import Gallery, Map, NormalMap, Page, Part, Profile, Row, Table
from recon.pipeline import measure
from recon.reconstruct import Settings
from recon.report import report_page
from tests.conftest import synthetic_capture
from tests.pages import CHECKS, Opened, open_page
from tests.recon.inspection.parts import seen_part, surface
from tests.recon.multiview.ring import ring

SIZE = 48


def of_run() -> Page:
    """A glossy sphere with all its truth, its gloss removed and repaired."""
    shape = measure(synthetic_capture("sphere", SIZE), "chromaticity", "telea")
    comparison = compare(shape)
    return report_page(shape, comparison, shape_metrics(shape, comparison))


def parts_of(page: Page, kind: type[Any]) -> list[Any]:
    """All parts of a kind, those that stand in rows too."""
    found: list[Part] = []
    for section in page.sections:
        for part in section.parts:
            found += part.figures if isinstance(part, Row) else [part]
    return [part for part in found if isinstance(part, kind)]


def write_run(folder: Path) -> None:
    write_page(folder / "report.html", of_run())


def write_bench(folder: Path) -> None:
    """Two removers and the twin on one capture."""
    write_render(synthetic_capture("cylinder", SIZE), folder / "tube")
    unit = Unit("tube", "cylinder", str(folder / "tube"), 0, tuple(range(5)))
    spec = Benchmark.model_validate(
        {"benchmark": "b", "captures": [{"path": "."}], "gloss": ["none", "chromaticity", "true-matte"]}
    )
    rows, maps = measure_unit(unit, spec.combinations())
    write_page(folder / "report.html", benchmark_page("b", summarise(rows, spec.combinations(), 0), [(unit, maps)]))


def write_inspected(folder: Path) -> None:
    """A box with a dent, in a known pose."""
    turned, nominal = rotation_of(np.array([0.25, 0.15, 0.3])), surface("rounded_box")
    measured, _, _ = seen_part(nominal, turned, size=80, dent=(2.0, 3.0, 0.3, 1.6))
    write_inspection(inspect(measured, nominal, 0.1, cutoff=12.0, initial=turned, draws=4), folder / "inspected")
    (folder / "inspected" / "report.html").rename(folder / "report.html")


def write_views(folder: Path) -> None:
    """Two views of an ellipsoid, with gloss and without."""
    views, ball = ring((0, 14), 48, gloss=0.3)
    models, figures = compare_rows(views, ball, [Settings("none", "none")], voxel=1.5)
    write_models(Path("ring"), ball, models, figures, "none", folder)


KINDS: dict[str, Callable[[Path], None]] = {
    "run": write_run,
    "bench": write_bench,
    "inspect": write_inspected,
    "multiview": write_views,
}


@pytest.fixture(scope="module", params=list(KINDS))
def report(request: pytest.FixtureRequest, chromium: Any, tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """The page of each kind, opened."""
    folder = tmp_path_factory.mktemp(request.param)
    KINDS[request.param](folder)
    return open_page(chromium, folder / "report.html")


@pytest.mark.browser
@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_every_page(report: Opened, check: Callable[[Opened], None]) -> None:
    check(report)
    assert report.trouble == []


def test_the_report_holds_what_was_measured() -> None:
    """The arrays behind the maps are the measurement's own, in the unit that is written beside them."""
    shape = measure(synthetic_capture("sphere", SIZE), "chromaticity", "telea")
    comparison = compare(shape)
    page = report_page(shape, comparison, shape_metrics(shape, comparison))
    maps = {part.title: part for part in parts_of(page, Map)}
    truth = shape.capture.truth
    assert truth.normals is not None
    assert truth.depth is not None
    assert maps["Height"].bar.unit == "px"  # the capture states no scale
    cut = maps["Height"].window.cut
    np.testing.assert_array_equal(maps["Height"].values, cut(shape.height.height))
    np.testing.assert_array_equal(maps["Uncertainty"].values, cut(shape.normals.uncertainty))
    wanted = cut(angular_error(shape.normals.normal, truth.normals))
    np.testing.assert_array_equal(maps["Angle to the true normals"].values, wanted)
    (lit,) = parts_of(page, NormalMap)
    inside = cut(shape.normals.measurable)
    np.testing.assert_array_equal(lit.normal[inside], cut(shape.normals.normal)[inside])
    (profile,) = parts_of(page, Profile)
    inside = cut(shape.capture.mask)
    assert profile.unit == "mm"  # the truth has one
    true = -1e3 * cut(truth.depth)
    np.testing.assert_allclose(np.diff(profile.true[inside]), np.diff(true[inside]), atol=1e-3)
    assert abs(np.nanmean(profile.height[inside])) < 1e-3
    assert np.sqrt(np.nanmean((profile.height - profile.true)[inside] ** 2)) < 0.05 * np.ptp(true[inside])
    (gallery,) = parts_of(page, Gallery)
    assert {"input", "gloss removed", "specular", "true matte"} <= set(gallery.layers)
    np.testing.assert_array_equal(gallery.lights, shape.capture.lights)
    errors = next(table for table in parts_of(page, Table) if table.title == "Errors against the true shape")
    assert len(errors.rows) == len(comparison.rows)
