"""How good removed pictures are, by slice, and what they are worth to the measurement; beside doing nothing and the classical removers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Bools, Capture, Floats, grey
from gen.errors import InputError
from gen.sets.set_spec import evenly
from learn.end_to_end import measured, pooled
from learn.picture_sheet import picture_sheet
from learn.slices import SLICES, Scene, Scenes
from recon.pictures import Picture, tone
from recon.reconstruct import Settings
from recon.registry import GLOSS, Layers, Remover

NOTHING = "do nothing"
"""The row of the pictures as they are."""

CLASSICAL: Mapping[str, int] = {"bilateral": 1, "chromaticity": 3, "low-rank": 4}
"""The classical removers, and how many pictures of a view each needs to have any effect of its own."""

HIGHLIGHT = 0.1
"""True specular radiance (luma, 1 is display white) from which on a sample counts as highlight."""

LIGHTS = 3
"""Pictures of a view from which on its shape is measured."""

ALL = "all"
SHOWN = 6
"""Scenes on the sheet of pictures."""

SUMS = 8
"""Numbers that a tally adds up: squared errors and samples of the full frame, the mask and the highlights; SSIM; pictures."""

Progress = Callable[[int, int], None]
Tallies = dict[tuple[str, str], dict[str, dict[str, NDArray[np.float64]]]]


@dataclass(frozen=True)
class Evaluation:
    """What came of an evaluation.

    pictures: slice -> its value -> row -> layer -> figures (see `figures_of`); the slice "all" has the one value "all". measurement: rows
    of `learn.end_to_end.pooled`, empty where no capture could be measured. counts: pictures, captures, and captures measured. by_material:
    the measurement of each kind of material by itself. notes: sentences on what was left out. titles, lines: of the sheet of pictures.
    """

    pictures: Mapping[str, Mapping[str, Mapping[str, Mapping[str, Mapping[str, float | None]]]]]
    measurement: Mapping[str, Mapping[str, Any]]
    counts: Mapping[str, int]
    by_material: Mapping[str, Mapping[str, Mapping[str, Any]]] = field(default_factory=dict)
    notes: Sequence[str] = ()
    titles: Sequence[str] = ()
    lines: Sequence[Sequence[Picture | None]] = field(default_factory=list)

    def plain(self) -> dict[str, Any]:
        """Everything but the pictures, as JSON takes it."""
        return {
            "counts": dict(self.counts),
            "pictures": self.pictures,
            "measurement": self.measurement,
            "measurement by material": self.by_material,
            "notes": list(self.notes),
        }

    def sheet(self) -> Picture:
        """The sheet of pictures: input, truth, each method's."""
        return picture_sheet(self.titles, self.lines)


def rows_of(learned: Mapping[str, Remover], classical: bool = True) -> dict[str, tuple[Remover, int]]:
    """The rows of a table: doing nothing, the classical removers, the learned ones; each with the fewest pictures that it works on."""
    rows = {NOTHING: (GLOSS.load("none"), 1)}
    if classical:
        rows |= {name: (GLOSS.load(name), fewest) for name, fewest in CLASSICAL.items()}
    return rows | {name: (remover, 1) for name, remover in learned.items()}


def evaluate(
    learned: Mapping[str, Remover],
    scenes: Scenes,
    settings: Settings | None = None,
    seed: int = 0,
    measure: bool = True,
    progress: Progress | None = None,
) -> Evaluation:
    """Score removers on scenes with truth.

    learned: the removers to judge, by name, beside doing nothing and the classical ones. settings: of the measurement (its gloss is set
    by the row); default as in `recon run`. seed: of the bootstrap. measure: whether captures of three lights and more are measured too.
    The same scenes, removers and seed give the same figures. Raises InputError where no scene has a true diffuse layer, and as the
    removers do.
    """
    rows = rows_of(learned)
    tallies: Tallies = {}
    captures: list[dict[str, dict[str, float]]] = []
    materials: list[str] = []
    notes: dict[str, int] = {}
    lines: list[list[Picture | None]] = []
    shown = set(evenly(scenes.count, SHOWN))
    pictures = scored = 0
    for number, scene in enumerate(scenes):
        capture = scene.capture
        pictures += capture.count
        found = {name: remove(capture) for name, (remove, fewest) in rows.items() if capture.count >= fewest}
        for name, (_, fewest) in rows.items():
            if capture.count < fewest:
                _count(notes, f"{name} does not apply to views of fewer than {fewest} pictures")
        if capture.truth.diffuse is None:
            _count(notes, "there is no true diffuse layer to score pictures against")
        else:
            scored += 1
            _tally(tallies, scene, found)
            if number in shown:
                lines.append(_line(capture, found, rows))
        if measure and capture.count >= LIGHTS:
            try:
                judged = {name: layers for name, layers in found.items() if name != NOTHING}
                captures.append(measured(capture, judged, settings or Settings()))
                materials.append(scene.material)
            except InputError as error:
                _count(notes, f"not measured: {str(error).removeprefix(capture.source).lstrip(': ')}")
        if progress is not None:
            progress(number + 1, scenes.count)
    if not scored and not captures:
        raise InputError(f"{scenes.name}: carries no truth to judge by; renders of degloss gen do")
    return Evaluation(
        pictures=_figures(tallies, list(rows)),
        measurement=pooled(captures, seed),
        by_material={
            kind: pooled([rows for rows, of in zip(captures, materials, strict=True) if of == kind], seed)
            for kind in sorted(set(materials))
        },
        counts={"captures": scenes.count, "pictures": pictures, "captures measured": len(captures)},
        notes=[f"{text} ({n} of {scenes.count} captures)" for text, n in notes.items()],
        titles=["input", "true diffuse", *(name for name in rows if name != NOTHING)],
        lines=lines,
    )


def bytes_of(linear: Floats) -> NDArray[np.uint8]:
    """8-bit sRGB values of a linear picture, clipped to 0..255: what the paper's errors are measured on."""
    return tone(linear)


def sums_of(estimate: Floats, truth: Floats, mask: Bools, highlight: Bools) -> NDArray[np.float64]:
    """The `SUMS` of one picture. estimate, truth: (H, W, 3) linear. mask, highlight: (H, W)."""
    from skimage.metrics import structural_similarity

    a, b = bytes_of(estimate), bytes_of(truth)
    squared = (a.astype(np.float64) - b.astype(np.float64)) ** 2
    similar = float(structural_similarity(a, b, channel_axis=2, data_range=255))
    regions = [squared, squared[mask], squared[highlight]]
    return np.array([*(value for region in regions for value in (region.sum(), region.size)), similar, 1.0])


def figures_of(sums: NDArray[np.float64]) -> dict[str, float | None]:
    """Figures of merit of a tally: mean squared errors of 8-bit values, PSNR in dB, SSIM.

    "mse", "psnr": full frame, as in the paper. "mse mask", "psnr mask": inside the mask. "psnr highlight": where the true specular layer
    exceeds `HIGHLIGHT`. "ssim": the mean over the pictures (full frame). PSNR is that of the pooled squared error; None where there is no
    sample, or no error.
    Source: PSNR and SSIM as in Z. Wang, A. Bovik, H. Sheikh and E. Simoncelli, "Image quality assessment", IEEE TIP 13(4), 2004.
    """
    full, inside, bright = (_over(sums[2 * i], sums[2 * i + 1]) for i in range(3))
    return {
        "mse": full,
        "mse mask": inside,
        "psnr": _psnr(full),
        "psnr mask": _psnr(inside),
        "psnr highlight": _psnr(bright),
        "ssim": _over(sums[6], sums[7]),
        "pictures": float(sums[7]),
    }


def _tally(tallies: Tallies, scene: Scene, found: Mapping[str, Layers]) -> None:
    """Add the sums of each picture of a scene to the slices that it falls into."""
    capture, truth = scene.capture, scene.capture.truth
    assert truth.diffuse is not None
    gloss = truth.specular if truth.specular is not None else np.maximum(capture.images - truth.diffuse, 0)
    for k in range(capture.count):
        highlight = capture.mask & (grey(gloss[k]) > HIGHLIGHT)
        places = [(ALL, ALL), *scene.slices(k).items()]
        for name, layers in found.items():
            pairs = {"diffuse": (layers.diffuse, truth.diffuse)}
            if truth.matte is not None and (layers.matte is not None or name == NOTHING):
                pairs["matte"] = (capture.images if layers.matte is None else layers.matte, truth.matte)
            for layer, (estimate, true) in pairs.items():
                sums = sums_of(estimate[k], true[k], capture.mask, highlight)
                for place in places:
                    row = tallies.setdefault(place, {}).setdefault(name, {})
                    row[layer] = row.get(layer, np.zeros(SUMS)) + sums


def _figures(tallies: Tallies, names: Sequence[str]) -> dict[str, dict[str, dict[str, dict[str, dict[str, float | None]]]]]:
    tree: dict[str, dict[str, dict[str, dict[str, dict[str, float | None]]]]] = {}
    for kind in (ALL, *SLICES):
        for (slice_of, value), rows in sorted(tallies.items()):
            if slice_of == kind:
                tree.setdefault(kind, {})[value] = {
                    name: {layer: figures_of(sums) for layer, sums in rows[name].items()} for name in names if name in rows
                }
    return tree


def _line(capture: Capture, found: Mapping[str, Layers], rows: Iterable[str]) -> list[Picture | None]:
    """Input, truth and each row's diffuse layer of the brightest picture."""
    assert capture.truth.diffuse is not None
    k = int(np.argmax(capture.images[:, capture.mask].sum(axis=(1, 2))))
    pictures: list[Picture | None] = [tone(capture.images[k]), tone(capture.truth.diffuse[k])]
    return pictures + [tone(found[name].diffuse[k]) if name in found else None for name in rows if name != NOTHING]


def _count(notes: dict[str, int], text: str) -> None:
    notes[text] = notes.get(text, 0) + 1


def _over(total: float, count: float) -> float | None:
    return float(total / count) if count > 0 else None


def _psnr(mse: float | None) -> float | None:
    return None if mse is None or mse == 0 else float(10 * np.log10(255**2 / mse))
