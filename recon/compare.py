"""Comparison with the truth and with the non-glossy pictures: the paper's protocol (Fig. 4.2 to 4.5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture
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
from recon.pipeline import Progress, Settings, Shape, reconstruct, remove_gloss
from recon.registry import Layers

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

    def height_range(self) -> tuple[float, float]:
        """The range of the non-glossy result's heights, one scale for all height pictures; without it the first row's."""
        shape = self.reference or next(iter(self.rows.values()))
        known = shape.height.height[np.isfinite(shape.height.height)]
        return float(known.min()), float(known.max())

    def figures(self) -> dict[str, dict[str, Any]]:
        """Every row's figures: "truth" (errors against the true geometry) and "matte" (deviation from the non-glossy result)."""
        tree: dict[str, dict[str, Any]] = {}
        for name, shape in self.rows.items():
            tree[name] = {"label": LABELS[name], **truth_figures(shape)}
            if self.reference is not None:
                tree[name]["non-glossy"] = deviation(shape, self.reference, self.height_range())
        if "glossy" in tree and "true matte" in tree and "normals" in tree["glossy"]:
            ends = [tree[name]["normals"]["mask"]["mean"] for name in ("glossy", "true matte")]
            for row in tree.values():
                row["gap closed"] = gap_closed(ends[0], row["normals"]["mask"]["mean"], ends[1])
        return tree


def compare(shape: Shape, progress: Progress | None = None) -> Comparison:
    """Measure the capture of `shape` again from the glossy pictures, without the repair, and from the true layers it has.

    The solver, the integrator and the exposure are those of `shape`, and so are the clipped samples; only the pictures differ.
    """
    capture, settings = shape.capture, shape.settings
    bare = replace(settings, gloss="none", repair="none")
    rows: dict[str, Shape] = {}

    def row(name: str, layers: Layers | None, chosen: Settings) -> None:
        if progress is not None:
            progress(f"comparing: {LABELS[name]}")
        rows[name] = reconstruct(capture, layers or remove_gloss(capture, chosen), chosen)

    if (settings.gloss, settings.repair) != ("none", "none"):
        row("glossy", None, bare)
    else:
        rows["glossy"] = shape
    if settings.gloss != "none":
        if settings.repair != "none":
            row("removed", shape.layers, replace(settings, repair="none"))
        else:
            rows["removed"] = shape
    if settings.repair != "none":
        rows["repaired"] = shape
    if capture.truth.diffuse is not None:
        row("true diffuse", None, replace(bare, gloss="true-diffuse"))
    if capture.truth.matte is not None:
        row("true matte", None, replace(bare, gloss="true-matte"))
    return Comparison(capture, rows)


def truth_figures(shape: Shape) -> dict[str, Any]:
    """Errors against the true geometry: "normals" by region (degrees), "height" (after the best shift). Empty without truth."""
    truth, capture = shape.capture.truth, shape.capture
    tree: dict[str, Any] = {}
    if truth.normals is not None:
        error = angular_error(shape.normals.normal, truth.normals)
        parts = regions(capture.mask, truth.normals, capture.lights)
        tree["normals"] = {name: angle_summary(error, region) for name, region in parts.items()}
    true = true_height(capture)
    if true is not None:
        perspective_or_unscaled = capture.scale.camera is not None or shape.height.unit == "px"
        tree["height"] = height_error(shape.height.height, true, capture.mask, perspective_or_unscaled)
        tree["height"]["unit"] = shape.height.unit
    return tree


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
        "clipped percent": 100 * float(((capture.flags & 2) > 0)[:, capture.mask].mean()),
        "defects": {"threshold": shape.defects.threshold, "percent": 100 * float(shape.defects.mask[:, capture.mask].mean())},
        "height": {"unit": shape.height.unit, "low": float(known.min()), "high": float(known.max())},
        "uncertainty degrees": {"median": float(np.median(uncertainty))} if uncertainty.size else None,
        "seconds": dict(shape.seconds),
    }
    truth = truth_figures(shape)
    if truth:
        metrics["truth"] = truth
    if comparison is not None:
        metrics["comparison"] = comparison.figures()
    return metrics
