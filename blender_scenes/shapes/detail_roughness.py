"""Roughness that is coarse enough to be seen as relief: solid noise of random waves."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.detail_field import Field, Seed
from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import Array

WAVES = 32
PARTS = 6
"""The least number of edges over the shortest wave."""


def roughness(
    mesh: Mesh,
    rms: Annotated[float, Range(1e-6, 1e3)] = 0.01,
    wavelength: Annotated[float, Range(1e-3, 1e4)] = 1.5,
    seed: Seed = 1,
) -> Field:
    """A sum of 32 plane waves in random directions of space, as the height.

    rms: root mean square of the height, mm. wavelength: of the shortest wave, mm; the longest has three times that. Raises ValueError
    where the rms is over a thirtieth of the wavelength.
    """
    if rms > wavelength / 30:
        raise ValueError(
            f"detail roughness: rms {rms:g} mm must be {wavelength / 30:g} mm, a thirtieth of the wavelength, or less"
        )
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(WAVES, 3))
    length = wavelength * 3 ** rng.uniform(0, 1, WAVES)
    waves = way / np.linalg.norm(way, axis=1, keepdims=True) * (2 * np.pi / length)[:, None]
    phase, size = rng.uniform(0, 2 * np.pi, WAVES), rms * np.sqrt(2 / WAVES)

    def height(points: Array) -> tuple[Array, Array]:
        value, slope = np.empty(len(points)), np.empty((len(points), 3))
        for start in range(0, len(points), 65536):
            part = slice(start, start + 65536)
            angle = points[part] @ waves.T + phase
            value[part] = size * np.cos(angle).sum(axis=1)
            slope[part] = -size * np.sin(angle) @ waves
        return value, slope

    def spans(a: Array, middle: Array, b: Array) -> Array:
        long: Array = np.sqrt(np.einsum("ij,ij->i", b - a, b - a)) * (PARTS / wavelength)
        return long

    return Field(height, spans, 4 * rms, f"wavelength {wavelength:g} mm")


def sample(rng: np.random.Generator) -> dict[str, float]:
    """Waves of 1.2 mm and more to 4 mm and more, .001 to .012 of that high."""
    wavelength = float(rng.uniform(1.2, 4))
    return {"rms": wavelength * 0.001 * 12 ** float(rng.uniform()), "wavelength": wavelength, "seed": int(rng.integers(10**8))}
