"""Key figures of the product on fixed input, and the file that keeps them: `python -m tests.golden.key_figures` writes it anew.

Write it anew only where a change of the figures is meant, and say in the commit what changed them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gen.capture import Capture
from gen.files import writing
from gen.render import render
from gen.spec import spec_from
from recon.compare import true_height
from recon.metrics import angular_error, fitted_height
from recon.pipeline import Measurement, measure
from recon.registry import GLOSS, HEIGHT, NORMALS, REPAIR
from tests.conftest import synthetic_capture

FILE = Path(__file__).parent / "figures.json"
NETWORKS = ("lime", "specular", "diffuse", "group")

Figures = dict[str, float]

SPEC = {
    "name": "key-figures",
    "resolution": [32, 32],
    "samples": 4,
    "shape": {"name": "sphere", "radius": 20},
    "material": {"kind": "substrate", "albedo": [0.7, 0.4, 0.2], "specular": 0.3, "alpha": 0.2},
    "lights": {"pattern": "ring", "count": 2, "tilt_degrees": 35, "frontal": True},
    "camera": {"kind": "orthographic", "width_mm": 50},
}


def scene(lights: int = 5) -> Capture:
    """A glossy sphere of 48 pixels under three or five lights, in closed form."""
    tilt, turn = np.radians(35), 2 * np.pi * np.arange(lights) / lights
    around = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.full(lights, np.cos(tilt))], -1)
    return synthetic_capture("sphere", 48, around, specular=0.3, alpha=0.15)


def degrees(shape: Measurement) -> float:
    """Mean angular error over the mask."""
    capture = shape.capture
    assert capture.truth is not None
    assert capture.truth.normals is not None
    return float(angular_error(shape.normals.normal, capture.truth.normals)[capture.mask].mean())


def rendered_layers() -> Figures:
    """The mean of each layer that Cycles renders, of what is known of the view, and of light by light."""
    capture = render(spec_from(SPEC, "key figures")).capture
    truth = capture.truth
    assert truth is not None
    found = {"combined": capture.images}
    found |= {name: getattr(truth, name) for name in ("diffuse", "specular", "matte", "normals", "depth", "albedo")}
    means = {
        name: float(np.mean(layer[..., capture.mask, :] if layer.ndim > 2 else layer[capture.mask]))
        for name, layer in found.items()
    }
    means |= {f"combined, light {k}": float(image[capture.mask].mean()) for k, image in enumerate(capture.images)}
    return means | {"pixels": float(capture.mask.sum())}


def removers(networks: bool) -> Figures:
    """Least squares' mean angular error in degrees after each remover: the networks', or all others'."""
    names = [name for name in GLOSS if (name in NETWORKS) == networks]
    return {name: degrees(measure(scene(), gloss=name, repair="none", height="dct")) for name in names}


def repairs() -> Figures:
    """Mean square error over the lost samples after each repair, in thousandths of the brightest sample squared, by its weights."""
    capture = scene()
    assert capture.truth is not None
    matte = capture.truth.matte
    assert matte is not None
    lost = np.zeros(matte.shape[:3], bool)
    for k in range(len(lost)):
        lost[k, 12 + 3 * k : 20 + 3 * k, 18:26] = True
    figures = {}
    for name in REPAIR:
        repaired = REPAIR.load(name)(np.where(lost[..., None], np.float32(0), matte), lost, capture)
        error = np.square(repaired.images - matte).mean(-1) * repaired.weights
        figures[name] = 1000 * float(error[lost].mean()) / float(matte.max()) ** 2
    return figures


def solvers() -> Figures:
    """Mean angular error in degrees of each solver on the glossy pictures."""

    def solved(name: str) -> Measurement:
        return measure(scene(3 if name == "three-light" else 5), gloss="none", repair="none", normals=name, height="dct")

    return {name: degrees(solved(name)) for name in NORMALS}


def integrators() -> Figures:
    """Root mean square error of the height from true normals by each integrator, in pixels."""
    capture = scene()
    assert capture.truth is not None
    normals, true = capture.truth.normals, true_height(capture)
    assert normals is not None
    assert true is not None
    metres = float(np.nanmax(true) - np.nanmin(true)) / (0.45 * 48)
    figures = {}
    for name in HEIGHT:
        height = HEIGHT.load(name)(normals, capture.mask, capture.scale).height
        fitted, _ = fitted_height(height, true / metres, capture.mask, scaled=False)
        figures[name] = float(np.sqrt(np.square(fitted - true / metres)[capture.mask].mean()))
    return figures


def whole() -> Figures:
    """Mean angular error in degrees of a measurement with nothing chosen."""
    return {"defaults": degrees(measure(scene()))}


KINDS: dict[str, tuple[Callable[[], Figures], float, float, str]] = {
    "rendered layers": (
        rendered_layers,
        2e-5,
        1e-7,
        "Cycles adds in single precision, in an order that depends on the processor's vector width",
    ),
    "classical removers": (lambda: removers(False), 0, 0.01, "iterations stop at a tolerance; filters work in single precision"),
    "networks": (
        lambda: removers(True),
        0,
        0.03,
        "convolutions add in an order that depends on the processor, the threads and torch's build",
    ),
    "repairs": (repairs, 1e-3, 1e-6, "OpenCV inpaints on whole numbers: one more or less where rounding falls otherwise"),
    "solvers": (solvers, 0, 0.005, "iterations stop at a tolerance; samples at a threshold fall to either side"),
    "integrators": (integrators, 1e-3, 1e-5, "sparse solvers stop at a relative residual"),
    "measurement": (whole, 0, 0.03, "as of the networks, which the default begins with"),
}
"""Each kind: what computes it, the relative and the absolute tolerance of its figures, and the reason for them."""


def kept() -> dict[str, Any]:
    """What the file holds."""
    found: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def write() -> None:
    """Compute all figures and write the file."""
    found = {
        kind: {
            "relative": relative,
            "absolute": absolute,
            "reason": reason,
            "figures": {n: float(f"{v:.7g}") for n, v in compute().items()},
        }
        for kind, (compute, relative, absolute, reason) in KINDS.items()
    }
    with writing(FILE) as temporary:
        temporary.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write()
