"""The paper's Table 1: errors of the methods (a), (b), (c) and (d) on the learning and the test data of paper-train, and Fig. 3.3."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from gen.errors import InputError
from learn.evaluate import ALL, CLASSICAL, NOTHING, Evaluation, evaluate
from learn.evaluation_table import aligned, cell
from learn.picture_sheet import picture_sheet
from learn.slices import Scenes, scenes_of
from recon.pictures import Picture
from recon.registry import Remover

METHODS: Mapping[str, str] = {"lime": "(a)", "specular": "(b)", "diffuse": "(c)", "group": "(d)"}
"""The methods and the paper's letters; (d) is ours, given one picture at a time here."""

PRINTED: Mapping[str, tuple[float, float]] = {"lime": (17.20, 60.40), "specular": (16.65, 34.51), "diffuse": (134.20, 25.95)}
"""What the paper prints for learning and test data. Its data is another: context, not a bar."""

PRESET = "paper-train"
LEARNING, TEST = "learning", "test"
SPLITS = {LEARNING: "train", TEST: "test"}
LIMIT = 200
"""Learning pictures that are rendered where no pack is given."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Table1:
    """The two evaluations, by `LEARNING` and `TEST`; one is missing where it was not asked for."""

    data: Mapping[str, Evaluation]

    def rows(self) -> dict[str, dict[str, Any]]:
        """Row -> the paper's letter, its printed figures, and per data set "mse" and "mse mask" on 8-bit values (None: does not apply)."""
        table: dict[str, dict[str, Any]] = {}
        for name in (NOTHING, *CLASSICAL, *METHODS):
            row: dict[str, Any] = {"letter": METHODS.get(name)}
            for data, evaluation in self.data.items():
                figures = evaluation.pictures[ALL][ALL].get(name, {}).get("diffuse", {})
                row[data] = {key: figures.get(key) for key in ("mse", "mse mask", "psnr highlight", "ssim", "pictures")}
            if name in PRINTED:
                row["paper"] = dict(zip((LEARNING, TEST), PRINTED[name], strict=True))
            table[name] = row
        return table

    def plain(self) -> dict[str, Any]:
        """All figures, as JSON takes them."""
        return {
            "rows": self.rows(),
            "pictures": {data: evaluation.counts["pictures"] for data, evaluation in self.data.items()},
            "slices": {data: evaluation.pictures for data, evaluation in self.data.items()},
            "notes": {data: list(evaluation.notes) for data, evaluation in self.data.items()},
        }

    def text(self) -> str:
        """The table for the terminal."""
        titles = [""]
        for data, evaluation in self.data.items():
            titles += [f"{data} ({evaluation.counts['pictures']})", "in the mask", "paper"]
        text = [titles]
        for name, row in self.rows().items():
            line = [f"{row['letter']} {name}" if row["letter"] else name]
            for data in self.data:
                line += [cell(row[data][key], ".2f") for key in ("mse", "mse mask")]
                line.append(cell(row.get("paper", {}).get(data), ".2f"))
            text.append(line)
        notes = [f"{data}: {note}" for data, evaluation in self.data.items() for note in evaluation.notes]
        head = "mean squared error on 8-bit values, full frame; the paper's own figures are of other data"
        return "\n".join([head, "", *aligned(text), "", *notes])

    def figure(self) -> Picture:
        """Input, truth and each method's output for a few test pictures, as in the paper's Fig. 3.3."""
        evaluation = self.data.get(TEST) or next(iter(self.data.values()))
        shown = [c for c, title in enumerate(evaluation.titles) if title not in CLASSICAL]
        titles = [f"{METHODS[t]} {t}" if t in METHODS else t for t in (evaluation.titles[c] for c in shown)]
        return picture_sheet(titles, [[line[c] for c in shown] for line in evaluation.lines])


def table1(
    removers: Mapping[str, Remover],
    learning: Path | None = None,
    test: Path | None = None,
    limit: int | None = LIMIT,
    workers: int = 1,
    progress: Progress | None = None,
) -> Table1:
    """Score the methods on learning and test data, each picture by itself.

    removers: by the names of `METHODS`. learning, test: packs, set folders or captures; of a divided one the splits train and test are
    taken; where both are one file, it is named twice or once as `learning`. Where neither is given, the preset paper-train is rendered: its
    test pictures all, of its learning pictures `limit`. limit: at most so many learning pictures, evenly spaced; None: all.
    workers: Blender processes. Raises InputError as `learn.slices.scenes_of` and `learn.evaluate.evaluate` do, MissingPart without Blender
    where pictures have to be rendered.
    """
    with _data(learning, test, limit, workers, progress) as places:
        found: dict[str, Evaluation] = {}
        for data, place in places.items():
            scenes = _scenes(place, data, limit if data == LEARNING else None)
            advance = None if progress is None else _named(progress, f"scoring the {data} data")
            found[data] = evaluate(removers, scenes, measure=False, progress=advance)
    return Table1(found)


def _scenes(place: Path, data: str, limit: int | None) -> Scenes:
    """The scenes of a split, or of all where the data is not divided."""
    try:
        return scenes_of(place, SPLITS[data], limit, kept_only=True)
    except InputError:
        scenes = scenes_of(place, None, limit, kept_only=True)
        if scenes.split is not None:  # it is divided, and what was asked for is not there
            raise
        return scenes


@contextmanager
def _data(
    learning: Path | None, test: Path | None, limit: int | None, workers: int, progress: Progress | None
) -> Iterator[dict[str, Path]]:
    """Where each of the data sets lies; rendered for as long as the block lasts where none was given."""
    given = {data: path for data, path in ((LEARNING, learning), (TEST, test)) if path is not None}
    if given:
        yield given
        return
    with TemporaryDirectory(prefix="degloss-table1-") as scratch:
        folder = Path(scratch) / PRESET
        _render(folder, limit, workers, None if progress is None else _named(progress, f"rendering {PRESET}"))
        yield {LEARNING: folder, TEST: folder}


def _render(folder: Path, limit: int | None, workers: int, advance: Callable[[int, int], None] | None) -> None:
    """Render the preset's test pictures and `limit` of its learning pictures."""
    from gen.sets.campaign import Engine, render_set
    from gen.sets.plan import Item, plan_of
    from gen.sets.set_spec import evenly

    engine = Engine(workers)
    plan = plan_of(PRESET)
    of: dict[str | None, Sequence[Item]] = {split: [i for i in plan.items if i.split == split] for split in SPLITS.values()}
    train = of["train"]
    items = [*(train[i] for i in evenly(len(train), limit)), *of["test"]]
    advanced = None if advance is None else lambda done, total, pictures=None: advance(done, total)
    tally = render_set(replace(plan, items=tuple(items)), folder, engine, progress=advanced)
    if tally.quarantined:
        raise InputError(
            f"{PRESET}: {tally.quarantined} of {len(items)} pictures could not be rendered; render the set with degloss gen"
        )


def _named(progress: Progress, title: str) -> Callable[[int, int], None]:
    return lambda done, total: progress(title, done, total)
