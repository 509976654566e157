"""Comparison with the truth and with the non-glossy pictures: the paper's protocol (Fig. 4.2 to 4.5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Truth
from recon.metrics import (
    angle_summary,
    angular_error,
    gap_closed,
    height_bytes,
    height_error,
    mse,
    normal_bytes,
    regions,
)
from recon.reconstruct import Progress, Settings, Shape, reconstruct
from recon.registry import GLOSS
from recon.suitability import clipped_share, doubts

Floats = NDArray[np.float32]

LABELS = {
    "glossy": "glossy pictures",
    "removed": "gloss removed",
    "repaired": "gloss removed and repaired",
    "true diffuse": "true diffuse layer",
    "true matte": "non-glossy pictures",
}
"""The rows of a comparison, in order. The last two are ceilings: what perfect removal would give."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Shapes of one capture from different pictures, with one solver and one integrator. rows: name (see `LABELS`) -> Shape."""

    capture: Capture
    rows: Mapping[str, Shape] = field(default_factory=dict)

    @property
    def reference(self) -> Shape | None:
        """The shape from the non-glossy pictures, the paper's yardstick; None where they are not known."""
        return self.rows.get("true matte")

    def label(self, name: str) -> str:
        """What a row is called: its entry in `LABELS`, but nothing is called removed that was not."""
        bare = name == "repaired" and self.rows[name].settings.gloss == "none"
        return "glossy pictures, repaired" if bare else LABELS[name]

    def height_range(self) -> tuple[float, float]:
        """The range of the non-glossy result's heights, one scale for all height pictures; without it the first row's."""
        shape = self.reference or next(iter(self.rows.values()))
        known = shape.height.height[np.isfinite(shape.height.height)]
        return float(known.min()), float(known.max())

    def figures(self) -> dict[str, dict[str, Any]]:
        """Every row's figures, as `truth_figures` gives them, with "label", "measured" (percent of the mask), "non-glossy" (`deviation`
        from the non-glossy result) and "gap closed" where the glossy and the non-glossy pictures are known.

        All rows are judged on the same pixels, those that every row measured: leaving the difficult ones out closes no gap.
        """
        common = np.logical_and.reduce([shape.normals.measurable for shape in self.rows.values()])
        tree: dict[str, dict[str, Any]] = {}
        for name, shape in self.rows.items():
            measured = 100 * float(shape.normals.measurable[self.capture.mask].mean())
            tree[name] = {"label": self.label(name), "measured": measured, **truth_figures(shape, common)}
            if self.reference is not None:
                tree[name]["non-glossy"] = deviation(shape, self.reference, self.height_range())
        ends = [mean_error(tree.get(name, {})) for name in ("glossy", "true matte")]
        for row in tree.values():
            error = mean_error(row)
            if error is not None and ends[0] is not None and ends[1] is not None:
                row["gap closed"] = gap_closed(ends[0], error, ends[1])
        return tree


def planned_rows(settings: Settings, truth: Truth) -> list[str]:
    """The names of the rows that a comparison of a measurement by these settings has."""
    there = {
        "glossy": True,
        "removed": settings.gloss != "none",
        "repaired": settings.repair != "none",
        "true diffuse": truth.diffuse is not None,
        "true matte": truth.matte is not None,
    }
    return [name for name in LABELS if there[name]]


def compare(shape: Shape, progress: Progress | None = None) -> Comparison:
    """Measure the capture of `shape` again from the glossy pictures, without the repair, and from the true layers it has.

    The solver, the integrator and the exposure are those of `shape`, and so are the clipped samples; only the pictures differ.
    progress: called with the name of each row.
    """
    capture, settings = shape.capture, shape.settings
    bare = replace(settings, gloss="none", repair="none")
    wanted = {
        "glossy": bare,
        "removed": replace(settings, repair="none"),
        "repaired": settings,
        "true diffuse": replace(bare, gloss="true-diffuse"),
        "true matte": replace(bare, gloss="true-matte"),
    }
    rows: dict[str, Shape] = {}
    for name in planned_rows(settings, capture.truth):
        if progress is not None:
            progress(f"comparing: {LABELS[name]}")
        chosen = wanted[name]
        if chosen == settings:
            rows[name] = shape
        else:
            layers = shape.layers if chosen.gloss == settings.gloss else GLOSS.load(chosen.gloss)(capture)
            rows[name] = reconstruct(capture, layers, chosen)
    return Comparison(capture, rows)


def truth_figures(shape: Shape, among: NDArray[np.bool_] | None = None) -> dict[str, Any]:
    """Errors against the true geometry: "normals" by region (degrees), "height" (metres). Empty without truth.

    among: (H, W), the pixels to judge on; default: all that were measured. Heights are compared after the best shift and, where the
    view is perspective or no scale is known, the best scale.
    """
    truth, capture = shape.capture.truth, shape.capture
    judged = capture.mask if among is None else capture.mask & among
    tree: dict[str, Any] = {}
    if truth.normals is not None:
        error = angular_error(shape.normals.normal, truth.normals)
        parts = regions(capture, truth.normals)
        tree["normals"] = {name: angle_summary(error, region & judged) for name, region in parts.items()}
    true = true_height(capture)
    if true is not None and (judged & np.isfinite(true) & np.isfinite(shape.height.height)).any():
        tree["height"] = height_error(shape.height.height, true, judged, free_scale(shape))
    return tree


def free_scale(shape: Shape) -> bool:
    """Whether heights are compared after the best scale too: where none is known, or the view is perspective."""
    return shape.capture.scale.camera is not None or shape.height.unit == "px"


def mean_error(row: Mapping[str, Any]) -> float | None:
    """The mean angle to the true normals of a row of `Comparison.figures`, None where it has none."""
    value: float | None = row.get("normals", {}).get("mask", {}).get("mean")
    return value


def true_height(capture: Capture) -> Floats | None:
    """The true height map (H, W) in metres, up to a shift: minus the depth; None where the depth is not known."""
    return None if capture.truth.depth is None else (-capture.truth.depth).astype(np.float32)


def deviation(shape: Shape, reference: Shape, span: tuple[float, float]) -> dict[str, float]:
    """The paper's protocol: distance from the non-glossy result, on 8-bit normal maps and height maps, and as a mean angle.

    span: the heights that become 0 and 255, from the non-glossy result, the same for all rows.
    """
    mask = shape.capture.mask
    a, b = normal_bytes(shape.normals.normal), normal_bytes(reference.normals.normal)
    za, zb = (height_bytes(s.height.height, *span) for s in (shape, reference))
    angle = angle_summary(angular_error(shape.normals.normal, reference.normals.normal), mask)
    return {
        "mean angle": angle.get("mean", float("nan")),
        "normal MSE": mse(a, b, mask),
        "normal MSE full frame": mse(a, b),
        "height MSE": mse(za, zb, mask),
        "height MSE full frame": mse(za, zb),
    }


NOTEWORTHY_DOUBT, NOTEWORTHY_KEPT = 0.02, 0.5
"""Shares of the object from which it is said that gloss removal is doubted, and that it would change little."""


def pictures_kept(shape: Shape) -> list[str]:
    """Sentences on where the pictures were measured as they are, though gloss was removed."""
    layers, mask, method = shape.layers, shape.capture.mask, shape.settings.gloss
    doubted, kept = (0.0 if part is None else float(part[mask].mean()) for part in (layers.doubt, layers.kept))
    said = []
    if doubted >= NOTEWORTHY_DOUBT:
        said.append(
            f"On {100 * doubted:.0f} % of the object the pictures were measured as they are: gloss removal by {method} led to normals "
            "there that no surface has, as on metals that mirror."
        )
    if kept - doubted >= NOTEWORTHY_KEPT:
        said.append(
            f"On {100 * (kept - doubted):.0f} % of the object the pictures were measured as they are: gloss removal by {method} "
            "would hardly turn the normals there, as on what is matte."
        )
    return said


def shape_metrics(shape: Shape, comparison: Comparison | None = None) -> dict[str, Any]:
    """The content of metrics.json: what was measured, how, in which unit and time; "truth" only where the capture has truth."""
    capture = shape.capture
    known = shape.height.height[np.isfinite(shape.height.height)]
    uncertainty = shape.normals.uncertainty[np.isfinite(shape.normals.uncertainty)]
    metrics: dict[str, Any] = {
        "source": capture.source,
        "settings": vars(shape.settings),
        "consumed": shape.consumed,
        "encoding": capture.encoding,
        "lights": capture.count,
        "frames": list(capture.names),
        "size": list(reversed(capture.size)),
        "pixels": int(capture.mask.sum()),
        "measured percent": 100 * float(shape.normals.measurable[capture.mask].mean()),
        "clipped percent": 100 * clipped_share(capture),
        "defects": {"threshold": shape.defects.threshold, "percent": 100 * float(shape.defects.mask[:, capture.mask].mean())},
        "height": {"unit": shape.height.unit, "low": float(known.min()), "high": float(known.max())},
        "uncertainty degrees": {"median": float(np.median(uncertainty))} if uncertainty.size else None,
        "seconds": dict(shape.seconds),
        "notes": [*doubts(capture), *pictures_kept(shape)],
        "provenance": dict(capture.provenance),
    }
    if shape.near is not None:
        metrics["near lights"] = vars(shape.near)
    truth = truth_figures(shape)
    if truth:
        metrics["truth"] = truth
    if comparison is not None:
        metrics["comparison"] = comparison.figures()
    return metrics
