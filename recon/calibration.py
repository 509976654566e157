"""From a solver's own uncertainty to one that holds: how far normals erred on renders whose normals are known, by remover and solver.

A solver knows how its samples scatter about its model, but not that the model is wrong: gloss that was taken away badly, or shadows and
interreflection, leave few residuals with few lights. `python -m recon.calibrate` measures what the stated angles are worth.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gen import large
from gen.capture import Capture, grey

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]

FILE = Path(__file__).parent / "calibration.json"
"""What `python -m recon.calibrate` wrote."""

KNOTS = 32
"""Points of a table, each with as many pixels."""

WEIGHTS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""What a change may weigh in the score; the likeliest is taken."""

LEAST = 0.05
"""Degrees: scores and errors below it are not told apart."""


@dataclass(frozen=True)
class Table:
    """Score in degrees to root mean square error in degrees, both increasing. weight: of the change (see `change`) in the score."""

    weight: float
    score: tuple[float, ...]
    error: tuple[float, ...]

    def __call__(self, sigma: Floats | Doubles, changed: Floats | Doubles) -> Doubles:
        """One standard deviation in degrees, where sigma (the solver's, degrees) is known; NaN elsewhere. Any shape."""
        score = np.hypot(sigma, self.weight * changed)
        logs = np.interp(np.log(np.maximum(score, LEAST)), np.log(self.score), np.log(self.error))
        result: Doubles = np.where(np.isfinite(score), np.exp(logs), np.nan)
        return result


def change(capture: Capture, images: Floats) -> Floats:
    """By how much the pictures that were solved differ from those that were taken: an angle in degrees a pixel, (H, W), 0 for not at all.

    The arc tangent of the two stacks' distance over the length of the solved one, in grey reflectance. images: (K, H, W, 3) radiance.
    """
    if images is capture.images:
        return np.zeros(capture.mask.shape, np.float32)
    angle = np.empty(capture.mask.shape, np.float32)
    for rows in large.strips(images.shape):
        solved = grey(capture.reflectance(images[:, rows]))
        apart = grey(capture.reflectance(capture.images[:, rows])) - solved
        angle[rows] = np.degrees(np.arctan2(np.linalg.norm(apart, axis=0), np.linalg.norm(solved, axis=0)))
        large.release(images, capture.images)
    return angle


def fit(sigma: Doubles, changed: Doubles, error: Doubles) -> Table:
    """The table that makes the errors (N,) likeliest: the weight by search, the errors by isotonic regression over `KNOTS` groups.

    sigma, changed, error: degrees, finite. The likelihood is that of an error whose square has the stated mean: -log v - e^2 / v.
    Source: isotonic calibration as in Kuleshov, Fenner and Ermon, "Accurate uncertainties for deep learning using calibrated regression"
    (ICML 2018), here of the second moment.
    """
    tables = []
    for weight in WEIGHTS if changed.any() else WEIGHTS[:1]:
        table = _isotonic(np.maximum(np.hypot(sigma, weight * changed), LEAST), error, weight)
        stated = table(sigma, changed) ** 2
        tables.append((float((np.log(stated) + error**2 / stated).mean()), weight, table))
    return min(tables, key=lambda t: t[:2])[2]


def _isotonic(score: Doubles, error: Doubles, weight: float) -> Table:
    from scipy.optimize import isotonic_regression

    order = np.argsort(score, kind="stable")
    groups = np.array_split(order, min(KNOTS, max(len(order) // 50, 1)))
    x = np.array([np.exp(np.log(score[g]).mean()) for g in groups])
    square = isotonic_regression([(error[g] ** 2).mean() for g in groups], weights=[len(g) for g in groups]).x
    kept = np.r_[True, np.diff(x) > 1e-9]
    rms = np.maximum(np.sqrt(square), LEAST)
    return Table(weight, tuple(float(f"{v:.4g}") for v in x[kept]), tuple(float(f"{v:.4g}") for v in rms[kept]))


@cache
def tables() -> Mapping[tuple[str, str], Table]:
    """The shipped tables by (remover, solver)."""
    said = json.loads(FILE.read_text(encoding="utf-8"))["tables"]
    return {(t["gloss"], t["normals"]): Table(t["weight"], tuple(t["score"]), tuple(t["error"])) for t in said}


def table_for(gloss: str, normals: str) -> Table | None:
    """The table of a remover and a solver by name, None where there is none: their uncertainty is then the solver's own."""
    return tables().get((gloss, normals))
