"""The stepped shaft."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.lathe import azimuths, lathe, path
from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import divisions


def stepped_shaft(
    first_radius: Annotated[float, Range(1e-3, 1e5)] = 7.0,
    second_radius: Annotated[float, Range(1e-3, 1e5)] = 12.0,
    third_radius: Annotated[float, Range(1e-3, 1e5)] = 9.0,
    first_length: Annotated[float, Range(1e-3, 1e5)] = 15.0,
    second_length: Annotated[float, Range(1e-3, 1e5)] = 13.0,
    third_length: Annotated[float, Range(1e-3, 1e5)] = 18.0,
    chamfer: Annotated[float, Range(0, 1e4)] = 1.0,
) -> Mesh:
    """Three cylinders on one axis, along y, the first at the bottom, every outer edge chamfered at 45 degrees; analytic normals.

    radii, lengths: mm. chamfer: width, mm; at a shoulder no more than half its height. Raises ValueError where a step is too short or
    too thin for its chamfers.
    """
    radii, lengths = (first_radius, second_radius, third_radius), (first_length, second_length, third_length)
    if 2 * chamfer >= min(lengths) or chamfer >= min(radii):
        raise ValueError(f"shape stepped_shaft: chamfer {chamfer:g} mm must be under half of every length and under every radius")
    y = -sum(lengths) / 2
    corners: list[tuple[float, float]] = [(0, y)]
    for i, (radius, length) in enumerate(zip(radii, lengths, strict=True)):
        low = _edge(radius, radii[i - 1] if i > 0 else None, chamfer)
        high = _edge(radius, radii[i + 1] if i < 2 else None, chamfer)
        corners += [(radius - low, y), (radius, y + low), (radius, y + length - high), (radius - high, y + length)]
        y += length
    return lathe(path(*corners, (0, y)), azimuths(max(256, divisions(max(radii), max(2 * max(radii), sum(lengths))))))


def _edge(radius: float, neighbour: float | None, chamfer: float) -> float:
    """The width of the chamfer where a step meets its neighbour, or the end."""
    return chamfer if neighbour is None else min(chamfer, max(0.0, (radius - neighbour) / 2))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """Radii of 5 to 15 mm, lengths of 8 to 18 mm, chamfers up to 1.5 mm."""
    places = ("first", "second", "third")
    radii = {f"{place}_radius": float(rng.uniform(5, 15)) for place in places}
    lengths = {f"{place}_length": float(rng.uniform(8, 18)) for place in places}
    return {**radii, **lengths, "chamfer": float(rng.uniform(0.2, 1.5))}
