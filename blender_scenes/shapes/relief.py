"""The smooth random relief."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import parametric

WAVES = 24


def relief(
    width: Annotated[float, Range(1e-3, 1e5)] = 44.0,
    height: Annotated[float, Range(1e-3, 1e5)] = 44.0,
    depth: Annotated[float, Range(1e-3, 1e5)] = 6.0,
    wavelength: Annotated[float, Range(1e-3, 1e5)] = 14.0,
    seed: Annotated[int, Range(0, 1e8)] = 1,
) -> Mesh:
    """A smooth random height field toward the viewer, an open surface without a back; analytic normals.

    width, height: of its rectangle in x and y, mm. depth: from the lowest point to the highest, mm. wavelength: of its shortest waves,
    mm; the longest have four times that. seed: of the 24 waves, equal in slope. Raises ValueError where waves are too many for the
    mesh or too steep.
    """
    if not max(width, height) <= 12 * wavelength:
        raise ValueError(
            f"shape relief: wavelength {wavelength:g} mm must be a twelfth of the sides or more, {max(width, height) / 12:g} mm"
        )
    if not depth <= wavelength:
        raise ValueError(f"shape relief: depth {depth:g} mm must be {wavelength:g} mm, the wavelength, or less")
    rng = np.random.default_rng(seed)
    length = wavelength * 4 ** rng.uniform(0, 1, WAVES)
    way, phase = rng.uniform(0, np.pi, WAVES), rng.uniform(0, 2 * np.pi, WAVES)
    kx, ky = 2 * np.pi / length * np.cos(way), 2 * np.pi / length * np.sin(way)
    longest = max(width, height)
    columns, rows = (max(33, int(np.ceil(360 * side / longest))) for side in (width, height))
    x, y = np.linspace(-width / 2, width / 2, columns), np.linspace(-height / 2, height / 2, rows)
    # Sums of cosines as real parts of products of a function of x and one of y.
    across, up = np.exp(1j * kx * x[:, None]), length * np.exp(1j * (ky * y[:, None] + phase))
    z = (up @ across.T).real
    z_x, z_y = (up @ (1j * kx * across).T).real, (1j * ky * up @ across.T).real
    scale = depth / (z.max() - z.min())
    middle = (z.max() + z.min()) / 2
    xx, yy = np.broadcast_to(x, z.shape), np.broadcast_to(y[:, None], z.shape)
    zero, one = np.zeros_like(z), np.ones_like(z)
    return parametric(
        np.stack([xx, yy, scale * (z - middle)], axis=-1),
        np.stack([one, zero, scale * z_x], axis=-1),
        np.stack([zero, one, scale * z_y], axis=-1),
        around=False,
    )


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A relief of 30 to 50 mm a side, waves from a fifth to a half of that, .2 to .6 of a wave deep."""
    width, height = float(rng.uniform(30, 50)), float(rng.uniform(30, 50))
    wavelength = max(width, height) * float(rng.uniform(0.2, 0.5))
    return {
        "width": width,
        "height": height,
        "depth": wavelength * float(rng.uniform(0.2, 0.6)),
        "wavelength": wavelength,
        "seed": int(rng.integers(10**8)),
    }
