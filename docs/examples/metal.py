"""What each method makes of a sphere of bare metal: `python docs/examples/metal.py`, the table of docs/faq.md.

One GGX lobe of the metal's colour and nothing diffuse, in closed form, by `gen.brdfs`; attached shadows only.
"""

from __future__ import annotations

import numpy as np

from gen.brdfs import BRDFS
from gen.capture import Capture, Truth
from gen.lights import ring
from recon.metrics import angular_error
from recon.pipeline import measure

METHODS = (("none", "least-squares"), ("none", "sparse-bayesian"), ("none", "explain"), ("group", "least-squares"))
LIGHTS = {
    "5 lights": ring(4, 35, frontal=True),
    "20 lights": np.concatenate([ring(7, 25, frontal=True), ring(12, 50)]),
}


def sphere(alpha: float, lights: np.ndarray, size: int = 128) -> Capture:
    """A sphere of a slightly warm metal, seen from afar."""
    radius = 0.45 * size
    y, x = np.mgrid[:size, :size].astype(float)
    x, y = x - (size - 1) / 2, (size - 1) / 2 - y
    mask = np.hypot(x, y) < radius
    z = np.sqrt(np.clip(radius**2 - x**2 - y**2, 0, None))
    normal = np.stack([x, y, z], -1) / radius * mask[..., None]
    view = np.array([0.0, 0.0, 1.0])
    pictures = [
        sum(BRDFS["metal"](normal, light, view, specular=np.array([0.9, 0.85, 0.8]), alpha=alpha)[:2]) for light in lights
    ]
    images = np.stack([picture * mask[..., None] * np.ones(3) for picture in pictures]).astype(np.float32)
    return Capture(
        images=images, lights=lights, mask=mask, truth=Truth(normals=normal.astype(np.float32)), source="a metal sphere"
    )


def main() -> None:
    """Print the table: mean angle to the true normals in degrees."""
    print("| alpha | lights |" + "".join(f" {gloss}, {normals} |" for gloss, normals in METHODS))
    print("|---|---|" + "---|" * len(METHODS))
    for title, lights in LIGHTS.items():
        for alpha in (0.1, 0.3, 0.7):
            capture = sphere(alpha, lights)
            errors = []
            for gloss, normals in METHODS:
                shape = measure(capture, gloss, "none", normals, "quadratic")
                errors.append(float(np.nanmean(angular_error(shape.normals.normal, capture.truth.normals)[capture.mask])))
            print(f"| {alpha:g} | {title} |" + "".join(f" {error:.1f} |" for error in errors), flush=True)


if __name__ == "__main__":
    main()
