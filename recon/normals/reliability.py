"""How far a solver's stated uncertainty can be trusted: `python -m recon.normals.reliability CAPTURE... --normals NAME [--json]`.

The captures' raw pictures are solved, no gloss removed, and the stated standard deviations are set against the errors to the true
normals.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError

Floating = NDArray[np.floating[Any]]

EDGES = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 180.0)
"""Bounds of the bins of stated uncertainty, in degrees; the last bin takes whatever is higher."""


@dataclass(frozen=True)
class Bin:
    """The pixels whose stated uncertainty lies in [low, high) degrees.

    share: of all pixels that have one. predicted: the mean of what is stated. actual: the root mean square error. Both in degrees.
    """

    low: float
    high: float
    share: float
    predicted: float
    actual: float


@dataclass(frozen=True)
class Reliability:
    """Stated uncertainty against error, by bins; empty bins are left out.

    calibration_error: expected calibration error in degrees, the mean over the pixels of their bin's |predicted - actual|.
    predicted, actual: root mean square over all pixels. pixels: how many have both. unknown: share of the pixels that have an
    error but no stated uncertainty.
    """

    bins: tuple[Bin, ...]
    calibration_error: float
    predicted: float
    actual: float
    pixels: int
    unknown: float


def tally(sigma: Floating, error: Floating, edges: Sequence[float] = EDGES) -> NDArray[np.float64]:
    """What a reliability table needs of some pixels: tallies of several captures add up to that of all. See `of_tally`.

    sigma, error: degrees, any shape, NaN where unknown. Returns (len(edges), 4): of each bin, and in the last row of the pixels that have
    an error alone: how many, and the sums of sigma, its square and the error's square.
    """
    has_error = np.isfinite(error)
    both = has_error & np.isfinite(sigma)
    s, e = sigma[both].astype(np.float64), error[both].astype(np.float64)
    place = np.clip(np.searchsorted(edges, s, side="right") - 1, 0, len(edges) - 2)
    sums = [np.bincount(place, values, len(edges)) for values in (np.ones(len(s)), s, s**2, e**2)]
    result = np.stack(sums, 1).astype(np.float64)
    result[-1, 0] = (has_error & ~both).sum()
    return result


def of_tally(counted: NDArray[np.float64], edges: Sequence[float] = EDGES) -> Reliability:
    """The reliability table of a `tally`. Raises InputError where no pixel has both an uncertainty and an error."""
    number, stated, square, erred = counted[:-1].T
    pixels = number.sum()
    if pixels == 0:
        raise InputError("reliability: no pixel has both an uncertainty and an error; this solver may state none")
    bins = tuple(
        Bin(float(edges[i]), float(edges[i + 1]), number[i] / pixels, stated[i] / number[i], float(np.sqrt(erred[i] / number[i])))
        for i in np.flatnonzero(number)
    )
    return Reliability(
        bins=bins,
        calibration_error=float(sum(b.share * abs(b.predicted - b.actual) for b in bins)),
        predicted=float(np.sqrt(square.sum() / pixels)),
        actual=float(np.sqrt(erred.sum() / pixels)),
        pixels=int(pixels),
        unknown=float(counted[-1, 0] / (pixels + counted[-1, 0])),
    )


def reliability(sigma: Floating, error: Floating, edges: Sequence[float] = EDGES) -> Reliability:
    """The reliability table of stated standard deviations.

    sigma: stated standard deviation in degrees, any shape, NaN where unknown. error: true angle in degrees, the same shape, NaN where
    unknown. edges: increasing bounds of the bins; values beyond them fall into the outermost.
    Raises InputError where shapes differ, the edges do not increase, a standard deviation is negative, or no pixel has both.
    Source: Guo, Pleiss, Sun and Weinberger, "On calibration of modern neural networks" (2017), for the bins and the expected
    calibration error; in terms of standard deviations, Levi, Gispan, Giladi and Fetaya, "Evaluating and calibrating uncertainty
    prediction in regression tasks" (2022).
    """
    if sigma.shape != error.shape:
        raise InputError(f"reliability: uncertainty is {sigma.shape}, the errors are {error.shape}; they must be of one shape")
    bounds = np.asarray(edges, dtype=np.float64)
    if bounds.ndim != 1 or len(bounds) < 2 or not (np.diff(bounds) > 0).all():
        raise InputError("reliability: the bins' edges must increase, and be two at least")
    if (sigma[np.isfinite(sigma) & np.isfinite(error)] < 0).any():
        raise InputError("reliability: a standard deviation is negative")
    return of_tally(tally(sigma, error, edges), edges)


def of_captures(paths: Sequence[str | Path], solver: str) -> Reliability:
    """The table over the pixels of several captures with true normals, each solved from its pictures as they are.

    solver: name in `recon.registry.NORMALS`. Clipped samples are left out where the other lights suffice, as in a measurement.
    Raises InputError where a capture has no true normals or the name is unknown.
    """
    from gen.capture import Fault, read_capture
    from recon.conditioning import leave_out
    from recon.metrics import angular_error
    from recon.registry import NORMALS

    solve = NORMALS.load(solver)
    sigma, error = [], []
    for path in paths:
        capture = read_capture(path)
        if capture.truth.normals is None:
            raise InputError(f"{path}: has no true normals to compare with; choose renders or captures with truth")
        weights = np.where(capture.faults & Fault.MISSING, 0, 1).astype(np.float32)
        weights = leave_out(weights, (capture.faults & Fault.CLIPPED) > 0, capture.lights)
        found = solve(capture.reflectance(), capture.lights, capture.mask, weights)
        sigma.append(found.uncertainty[capture.mask])
        error.append(angular_error(found.normal, capture.truth.normals)[capture.mask])
    return reliability(np.concatenate(sigma), np.concatenate(error))


def table(result: Reliability) -> str:
    """The table as text, one bin a line."""
    lines = [f"{'stated':>14} {'pixels':>8} {'mean':>8} {'RMS error':>10}"]
    lines += [f"{b.low:>6g} to {b.high:<4g} {100 * b.share:>7.1f}% {b.predicted:>7.2f}° {b.actual:>9.2f}°" for b in result.bins]
    lines.append(f"expected calibration error {result.calibration_error:.2f}° over {result.pixels} pixels")
    lines.append(f"root mean square: stated {result.predicted:.2f}°, actual {result.actual:.2f}°")
    if result.unknown > 0:
        lines.append(f"no uncertainty stated in {100 * result.unknown:.1f}% of the pixels")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table of some captures. Returns the exit code: 2 for a bad input, with one line on stderr."""
    from gen.files import dumps

    parser = argparse.ArgumentParser(prog="python -m recon.normals.reliability", description=__doc__)
    parser.add_argument("captures", nargs="+", metavar="CAPTURE", help="a folder that read_capture reads, with true normals")
    parser.add_argument("--normals", required=True, metavar="NAME", help="the photometric-stereo solver")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    try:
        result = of_captures(options.captures, options.normals)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(dumps(asdict(result)) if options.json else table(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
