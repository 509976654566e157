"""The pages of `degloss learn eval` and `table1`: their figures, and in headless Chromium whole, quiet, readable, and answering."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from gen.capture import Capture
from learn.evaluate import ALL, NOTHING, Evaluation, evaluate
from learn.report import evaluation_page, table1_page
from learn.slices import Scene, Scenes
from learn.table1 import LEARNING, METHODS, PRINTED, TEST, Table1
from recon.page import write_page
from recon.page_parts import Gallery, Map, Page, Row, Table
from recon.registry import GLOSS
from tests.conftest import Synthetic
from tests.pages import CHECKS, Opened, open_page


@pytest.fixture(scope="module")
def evaluation(synthetic: Synthetic) -> Evaluation:
    """A view of five pictures and a single picture, scored for a remover that is never wrong and some that do nothing."""
    view = synthetic("cylinder", 32, alpha=0.4, specular=0.5)
    captures = [view, view.select([0])]

    def read() -> Iterator[Scene]:
        return (Scene(f"item-{i}", capture, capture.source.split()[-1], "substrate") for i, capture in enumerate(captures))

    learned = {name: GLOSS.load("none") for name in METHODS} | {"group": GLOSS.load("true-diffuse")}
    return evaluate(learned, Scenes("made here", len(captures), read))


def pages(evaluation: Evaluation) -> dict[str, Page]:
    return {
        "eval": evaluation_page("group", "made here", evaluation),
        "table1": table1_page(Table1({LEARNING: evaluation, TEST: evaluation})),
    }


def tables(page: Page) -> dict[str, Table]:
    return {part.title: part for section in page.sections for part in section.parts if isinstance(part, Table)}


@pytest.fixture(scope="module", params=["eval", "table1"])
def report(
    request: pytest.FixtureRequest, evaluation: Evaluation, chromium: Any, tmp_path_factory: pytest.TempPathFactory
) -> Opened:
    path = tmp_path_factory.mktemp(request.param) / "report.html"
    write_page(path, pages(evaluation)[request.param])
    return open_page(chromium, path)


@pytest.mark.browser
@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_every_page(report: Opened, check: Callable[[Opened], None]) -> None:
    check(report)
    assert report.trouble == []


def test_the_evaluations_page_holds_its_figures(evaluation: Evaluation) -> None:
    page = pages(evaluation)["eval"]
    found = tables(page)
    diffuse = found["Diffuse, against the true diffuse layer"]
    names = [row[0] for row in diffuse.rows]
    assert [names[i] for i in diffuse.highlight] == ["group"]
    figures = evaluation.pictures[ALL][ALL]
    assert diffuse.rows[names.index(NOTHING)][1] == figures[NOTHING]["diffuse"]["mse"]
    assert diffuse.rows[names.index("group")][1] == 0
    measured = {row[0]: row[1] for row in found["Photometric stereo"].rows}
    assert measured["glossy"] == evaluation.measurement["glossy"]["normals"]
    assert measured["group"] == pytest.approx(measured["true diffuse"])
    assert f"{measured['group']:.2f} from the network's" in page.lead


def test_pictures_and_errors_are_those_of_the_scenes(evaluation: Evaluation) -> None:
    parts = [part for section in pages(evaluation)["eval"].sections for part in section.parts]
    gallery = next(part for part in parts if isinstance(part, Gallery))
    assert gallery.layers["chromaticity"][1] is None  # it does not apply to a single picture
    np.testing.assert_array_equal(gallery.layers["input"][0], evaluation.lines[0][0])
    rows = [part for part in parts if isinstance(part, Row)]
    assert [row.title for row in rows] == ["Error of scene 1", "Error of scene 2"]
    maps = {figure.title: figure for figure in rows[0].figures if isinstance(figure, Map)}
    a, b = (picture.astype(float) for picture in evaluation.lines[0][:2] if picture is not None)
    np.testing.assert_allclose(maps["do nothing"].values, abs(a - b).mean(axis=2))
    assert maps["group"].values.max() == 0


def test_table1_has_the_papers_letters_and_figures(evaluation: Evaluation) -> None:
    table = tables(pages(evaluation)["table1"])["Errors of the methods"]
    rows = {row[0]: row for row in table.rows}
    assert {f"{letter} {name}" for name, letter in METHODS.items()} | {NOTHING} <= set(rows)
    assert [rows["(a) lime"][3], rows["(a) lime"][6]] == list(PRINTED["lime"])
    assert rows["(d) group"][1] == 0
    assert rows["(d) group"][3] is None


def test_an_evaluation_without_a_measurement_or_a_diffuse_layer_has_a_page(synthetic: Synthetic) -> None:
    from dataclasses import replace

    capture: Capture = synthetic("sphere", 32)
    bare = replace(capture, truth=replace(capture.truth, diffuse=None))
    scenes = Scenes("bare", 1, lambda: iter([Scene("one", bare)]))
    page = evaluation_page("group", "bare", evaluate({"group": GLOSS.load("none")}, scenes))
    assert "there are no pictures to compare" in str(page.sections[0].parts[0])
