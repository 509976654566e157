"""The inspection of one part: align, compare, judge; and what there is to say about it.

measured, nominal = read_measured("out/bolt"), read_nominal("bolt.stl")
inspection = inspect(measured, nominal, tolerance=0.05)
print(inspection.text())
inspection.write("out/bolt-inspected")
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recon.inspection.align import Alignment, align
from recon.inspection.deviation import Deviation, checked_cutoff, deviation
from recon.inspection.measured import Measured
from recon.inspection.nominal import Surface
from recon.inspection.polish import polished
from recon.inspection.pose import Doubles
from recon.inspection.uncertainty import DRAWS
from recon.inspection.verdict import GUARD, Place, Verdict, require_tolerance, verdict

POOR_LIKENESS = 0.7
"""Likeness under which the two hardly look like one part."""

NOTEWORTHY = 1.2
"""Factor from which it is said that the uncertainty was raised."""


@dataclass(frozen=True, eq=False)
class Inspection:
    """A part that was inspected. Lengths are millimetres of the nominal; `factor` and `unit` turn deviations into what is shown: mm where
    the measurement has a scale, else % of the nominal's longest side."""

    measured: Measured
    nominal: Surface
    alignment: Alignment
    deviation: Deviation
    verdict: Verdict

    @property
    def unit(self) -> str:
        """The unit in which deviations are shown."""
        return "%" if self.alignment.free_scale else "mm"

    @property
    def factor(self) -> float:
        """From millimetres of the nominal to `unit`."""
        return 100 / self.nominal.size if self.alignment.free_scale else 1.0

    @property
    def pixel(self) -> float:
        """Millimetres a pixel."""
        return self.measured.view.step / self.alignment.pose.scale

    def sentence(self) -> str:
        """The verdict in words: on the features, and that the form has none."""
        d, v = self.deviation, self.verdict
        band = f"features of {d.shortest:.3g} to {d.cutoff:.3g} mm"
        limit = f"±{v.tolerance * self.factor:.3g} {self.unit}"
        word = {"pass": "pass", "fail": "fail", "cannot be decided": "cannot be decided on"}[v.features]
        heading = f"{band[0].upper()}{band[1:]} {word}" if v.features != "cannot be decided" else f"It {word} {band}"
        return f"{heading} (tolerance {limit}, guard band {v.guard:g} u): {v.reason}. Form longer than {d.cutoff:.3g} mm: not measurable."

    def notes(self) -> list[str]:
        """What a reader of the figures must know."""
        a, d = self.alignment, self.deviation
        found = [
            f"Form longer than the cut-off of {d.cutoff:.3g} mm is not measured: photometric stereo sums up normals, and a small error "
            "that they share becomes a slow drift of the height. The raw map shows it; no verdict rests on it."
        ]
        if a.free_scale:
            found.append(
                "No scale is known for the measurement: its size was taken from the nominal, so an error of size cannot show. "
                f"Deviations are in % of the nominal's longest side, {self.nominal.size:.4g} mm."
            )
        found += [f"The pose is not fully determined: {sentence}." for sentence in a.free]
        if a.alternatives:
            turns = ", ".join(f"{angle:.0f}" for angle in a.alternatives[:6])
            found.append(f"Other poses fit as well, {turns} degrees away: the part is symmetric, or looks so from here.")
        if (parts := len(np.unique(d.region[np.isfinite(d.features)]))) > 1:
            found.append(
                f"{parts} areas are parted by steps or gaps that the view does not show: their heights against each other are not measured."
            )
        sigma = self.measured.uncertainty[d.region > 0]
        if not np.isfinite(sigma).any():
            found.append(
                "The measurement states no uncertainty of its normals, so nothing can be decided; state one with --uncertainty."
            )
        elif d.raised > NOTEWORTHY:
            found.append(
                f"Within the wavelengths judged the normals miss the nominal's by {d.raised:.2g} times what their stated uncertainty "
                f"({np.nanmedian(sigma):.2g} degrees, median) explains: the uncertainty was raised as much."
            )
        if a.likeness < POOR_LIKENESS:
            found.append(
                "The nominal hardly looks like what was measured: check the part, the unit and the pose before anything else."
            )
        if "default" in self.nominal.unit:
            found.append(f"The nominal's unit was taken as {self.nominal.unit}; say otherwise with --unit.")
        return found

    def figures(self) -> dict[str, Any]:
        """The content of inspection.json. Deviations are in `unit`, all other lengths in mm of the nominal."""
        a, d, v, f = self.alignment, self.deviation, self.verdict, self.factor
        maps = {"raw": (d.raw, d.raw_uncertainty), "form": (d.form, None), "features": (d.features, d.uncertainty)}
        return {
            "measured": self.measured.source,
            "nominal": {"file": self.nominal.source, "unit": self.nominal.unit, "longest side mm": self.nominal.size},
            "unit": "% of the nominal's longest side" if a.free_scale else "mm",
            "verdict": {
                "features": v.features,
                "form": "not measurable",
                "reason": v.reason,
                "sentence": self.sentence(),
                "tolerance": v.tolerance * f,
                "guard": v.guard,
                "least provable tolerance": v.provable * f,
                "judged percent of visible": 100 * v.judged,
                "percent of judged": {name: 100 * share for name, share in v.shares.items()},
                "places": [self._place(place) for place in v.places],
            },
            "wavelengths mm": {"shortest": d.shortest, "cutoff": d.cutoff},
            "deviation": {name: _summary(values[d.judged] * f, sigma, d, f) for name, (values, sigma) in maps.items()},
            "normals degrees": {
                "median angle to the nominal": float(np.nanmedian(d.angle)),
                "median stated uncertainty": _median(self.measured.uncertainty[d.region > 0]),
                "uncertainty raised by": d.raised,
            },
            "alignment": {
                "nominal to camera": a.pose.matrix(),
                "unit of the camera frame": self.measured.unit,
                "mm per pixel": self.pixel,
                "rms along the normals mm": a.residual / a.pose.scale,
                "rms of the outlines px": a.outline,
                "corresponding percent of measured": 100 * a.inliers,
                "measured percent of visible": 100 * a.covered,
                "likeness": a.likeness,
                "free motions": list(a.free),
                "other poses degrees": list(a.alternatives),
            },
            "notes": self.notes(),
        }

    def text(self) -> str:
        """A few lines for the terminal."""
        a, v, f = self.alignment, self.verdict, self.factor
        lines = [
            f"{self.measured.source} against {self.nominal.source} ({self.nominal.unit})",
            f"aligned: {a.residual / a.pose.scale:.3g} mm rms along the normals, outlines {a.outline:.2f} px, "
            f"{100 * a.covered:.1f} % of the visible side measured, {100 * v.judged:.1f} % judged",
            self.sentence(),
        ]
        for place in v.places[:5]:
            lines.append(
                f"  {place.deviation * f:+.3g} {self.unit} (u {place.uncertainty * f:.2g}) at column {place.column + 1}, "
                f"row {place.row + 1}, {place.area:.3g} mm² out of tolerance"
            )
        return "\n".join([*lines, *self.notes()])

    def write(self, folder: str | Path) -> dict[str, Any]:
        """Maps, inspection.json and report.html into a folder, all or nothing. Returns the figures."""
        from recon.inspection.output import write_inspection

        return write_inspection(self, Path(folder))

    def _place(self, place: Place) -> dict[str, Any]:
        """A failing place, and where it lies in the axes of the nominal's file."""
        at = self.alignment.nominal.points[place.row, place.column]
        pose = self.alignment.pose
        return {
            "deviation": place.deviation * self.factor,
            "uncertainty": place.uncertainty * self.factor,
            "area mm2": place.area,
            "column": place.column + 1,
            "row": place.row + 1,
            "on the nominal mm": (at - pose.translation) @ pose.rotation / pose.scale,
        }


def inspect(
    measured: Measured,
    nominal: Surface,
    tolerance: float,
    guard: float = GUARD,
    cutoff: float | None = None,
    initial: Doubles | None = None,
    *,
    draws: int = DRAWS,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Inspection:
    """Compare a measurement with the nominal and judge its features against +-tolerance (mm of the nominal).

    guard: standard deviations of the guard band. cutoff: mm, see `recon.inspection.deviation`. initial: (3, 3) rotation to align from.
    draws, seed: of the uncertainty. Raises InputError where the two cannot be compared.
    """
    require_tolerance(tolerance, guard)
    say = progress or (lambda title: None)
    say("aligning")
    aligned = align(measured, nominal, initial)
    say("comparing")
    chosen = checked_cutoff(measured, aligned, cutoff)
    aligned = polished(measured, aligned, chosen * aligned.pose.scale / measured.view.step)
    found = deviation(measured, aligned, chosen, draws, seed)
    pixel = measured.view.step / aligned.pose.scale
    judgement = verdict(found, int(aligned.nominal.inside.sum()), pixel, tolerance, guard)
    return Inspection(measured, nominal, aligned, found, judgement)


def _summary(values: Doubles, sigma: Doubles | None, found: Deviation, factor: float) -> dict[str, float]:
    """Figures of a map over the judged pixels, in the unit shown."""
    if not values.size:
        return {}
    summary = {
        "rms": float(np.sqrt(np.mean(values**2))),
        "lowest": float(values.min()),
        "highest": float(values.max()),
        "median absolute": float(np.median(np.abs(values))),
    }
    return summary if sigma is None else summary | {"median uncertainty": _median(sigma[found.judged] * factor)}


def _median(values: Doubles) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")
