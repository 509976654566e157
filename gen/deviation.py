"""How far the materials for any light lie from the exact ones, measured on real renders: `python -m gen.deviation` prints the tables.

Both are rendered on a sphere under suns at 0, 20, 35, 50 and 70 degrees, where the exact ones hold to float rounding.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gen.capture import Floats, Truth
from gen.errors import InputError
from gen.farm import Farm
from gen.render import render
from gen.spec import spec_from

TILTS = (0.0, 20.0, 35.0, 50.0, 70.0)
ALPHAS = (0.02, 0.05, 0.1, 0.2, 0.4618, 0.7, 1.0)
SPECULARS = (0.05, 0.5)
EXPONENTS = (5.0, 20.0, 100.0, 1000.0)
LAYERS = ("diffuse", "specular", "total")


@dataclass(frozen=True)
class Row:
    """One pair of materials. rms, peak: by layer, the root mean square and the largest difference, over those of the exact layer."""

    kind: str
    label: str
    rms: dict[str, float]
    peak: dict[str, float]

    def line(self) -> str:
        cells = [f"{100 * self.rms[name]:7.1f} {100 * self.peak[name]:7.1f}" for name in LAYERS]
        return f"{self.label:<24}" + "  ".join(cells)


def deviations(
    farm: Farm, alphas: Sequence[float] = ALPHAS, speculars: Sequence[float] = SPECULARS, exponents: Sequence[float] = EXPONENTS
) -> Iterator[Row]:
    """Rows of approximate-substrate against substrate, over alpha and Ks, then of blinn-phong-lobe against blinn-phong, over exponents."""
    for specular in speculars:
        for alpha in alphas:
            values = {"albedo": 0.5, "specular": specular, "alpha": alpha}
            yield _row(farm, "substrate", "approximate-substrate", f"alpha {alpha:g}, Ks {specular:g}", values)
    for exponent in exponents:
        yield _row(farm, "blinn-phong", "blinn-phong-lobe", f"exponent {exponent:g}", {"albedo": 0.5, "exponent": exponent})


def relative(found: Floats, exact: Floats) -> tuple[float, float]:
    """(RMS, peak) of the difference over RMS and peak of the exact one."""
    apart = found.astype(np.float64) - exact
    return float(np.sqrt((apart**2).mean() / (exact.astype(np.float64) ** 2).mean())), float(abs(apart).max() / exact.max())


def _row(farm: Farm, exact: str, other: str, label: str, values: dict[str, Any]) -> Row:
    one, two = (_layers(_truth(farm, {"kind": kind, **values})) for kind in (exact, other))
    found = {name: relative(two[name], one[name]) for name in LAYERS}
    return Row(other, label, {name: rms for name, (rms, _) in found.items()}, {name: peak for name, (_, peak) in found.items()})


def _truth(farm: Farm, material: dict[str, Any]) -> Truth:
    spec = {
        "name": "deviation",
        "resolution": [96, 96],
        "shape": {"name": "sphere", "radius": 25},
        "material": material,
        "lights": [[math.sin(math.radians(tilt)), 0.0, math.cos(math.radians(tilt))] for tilt in TILTS],
        "camera": {"kind": "orthographic", "width_mm": 54},
        "exposure": 1.0,
    }
    return render(spec_from(spec, "deviation"), farm=farm).capture.truth


def _layers(truth: Truth) -> dict[str, Floats]:
    diffuse, specular = truth.diffuse, truth.specular
    if diffuse is None or specular is None:
        raise InputError("the render lacks its layers")
    return {"diffuse": diffuse, "specular": specular, "total": diffuse + specular}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m gen.deviation", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--workers", type=int, default=1)
    try:
        with Farm(parser.parse_args().workers) as farm:
            kind = ""
            for row in deviations(farm):
                if row.kind != kind:
                    kind = row.kind
                    print(f"\n{kind}: difference from the exact material, % of its RMS and of its peak")
                    print(f"{'':<24}" + "  ".join(f"{name:>15}" for name in LAYERS))
                    print(f"{'':<24}" + "  ".join(f"{'rms':>7} {'peak':>7}" for _ in LAYERS))
                print(row.line(), flush=True)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
