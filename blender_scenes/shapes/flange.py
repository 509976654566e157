"""The flange, and without bolt holes the washer."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.extrusion import cap
from blender_scenes.shapes.lathe import azimuths, lathe, line, path
from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import Array, divisions, facing, grid, join, mirrored, moved


def flange(
    radius: Annotated[float, Range(1e-3, 1e5)] = 21.0,
    bore_radius: Annotated[float, Range(1e-3, 1e5)] = 8.0,
    thickness: Annotated[float, Range(1e-3, 1e5)] = 7.0,
    holes: Annotated[int, Range(0, 24)] = 6,
    hole_radius: Annotated[float, Range(1e-3, 1e5)] = 2.2,
    circle_radius: Annotated[float, Range(1e-3, 1e5)] = 14.5,
    chamfer: Annotated[float, Range(1e-3, 1e5)] = 0.8,
) -> Mesh:
    """A round plate with a bore and a circle of bolt holes, axis toward the viewer; 0 holes make a washer. Analytic normals.

    radius, bore_radius, thickness: mm. hole_radius: of each bolt hole, mm. circle_radius: of the circle on which their middles lie, mm.
    chamfer: width at 45 degrees of the outer and the bore's edges, mm; the bolt holes are sharp. Raises ValueError where bore, holes,
    chamfers and edges touch.
    """
    inner, outer = bore_radius + chamfer, radius - chamfer
    if not inner < outer or not 2 * chamfer < thickness:
        raise ValueError(
            f"shape flange: bore_radius {bore_radius:g} mm, radius {radius:g} mm and thickness {thickness:g} mm leave no room for chamfers"
        )
    if holes and not inner + hole_radius < 0.999 * circle_radius < 0.998 * (outer - hole_radius):
        raise ValueError(
            f"shape flange: holes of {hole_radius:g} mm radius on a circle of {circle_radius:g} mm reach the bore or the rim"
        )
    if holes and not 1.05 * hole_radius < circle_radius * np.sin(np.pi / max(2, holes)):
        raise ValueError(f"shape flange: {holes} holes of {hole_radius:g} mm radius touch each other")
    count = max(256, divisions(radius, 2 * radius))
    half = thickness / 2
    bolt = azimuths(divisions(hole_radius, 2 * radius))
    corners = [(bore_radius, half - chamfer), (bore_radius, chamfer - half), (inner, -half), (outer, -half)]
    corners += [(radius, chamfer - half), (radius, half - chamfer), (outer, half), (inner, half), (bore_radius, half - chamfer)]
    if holes == 0:
        return facing(lathe(path(*corners), azimuths(count)))
    # The flat front and back are made with their holes; the lathe turns the rest.
    angles, face = _pierced(inner, outer, holes, bolt, hole_radius, circle_radius, count)
    walls = facing(lathe([*path(*corners[:3]), *path(*corners[3:7]), *path(*corners[7:])], angles))
    bore = facing(lathe([line((hole_radius, half), (hole_radius, -half))], bolt))
    bores = [moved(bore, x, y) for x, y in _polar(circle_radius, azimuths(holes))]
    front = moved(face, z=half)
    return join(walls, *bores, front, mirrored(front))


def _polar(radius: Array | float, azimuth: Array) -> Array:
    """Points (..., 2) of the plane z = 0 where `facing` takes those of a lathe: azimuth 0 is at the bottom."""
    points: Array = np.stack([radius * np.sin(azimuth), -radius * np.cos(azimuth)], axis=-1)
    return points


def _pierced(inner: float, outer: float, holes: int, bolt: Array, hole: float, circle: float, count: int) -> tuple[Array, Mesh]:
    """The front's flat ring with its holes, at z = 0, and the azimuths that its two edges have.

    bolt: azimuths around each hole. Around each hole lies a cell, between whose edges and the hole triangles run once around;
    between cells lies a plain grid.
    """
    turn = 2 * np.pi / holes
    wide = min(turn / 2, 1.3 * float(np.arcsin(hole / circle)))
    if turn / 2 - wide < 0.02:
        wide = turn / 2
    columns = max(16, int(np.ceil(count * wide / np.pi)))
    between = int(np.ceil(count * (turn - 2 * wide) / (2 * np.pi)))
    rows = 1 + max(8, int(np.ceil((outer - inner) / (outer * 2 * wide / columns) / 3)))
    radii = np.linspace(inner, outer, rows)
    meshes, angles = [], []
    for k in range(holes):
        cell = k * turn + np.linspace(-wide, wide, columns + 1)
        loop = np.concatenate(
            [
                _polar(outer, cell[:-1]),
                _polar(radii[:0:-1], np.full(rows - 1, cell[-1])),
                _polar(inner, cell[:0:-1]),
                _polar(radii[:-1], np.full(rows - 1, cell[0])),
            ]
        )
        middle = _polar(circle, np.array(k * turn))
        meshes.append(cap(loop, middle + _polar(hole, bolt), middle, 0.0))
        angles.append(cell[:-1])
        if between:
            plain = np.linspace(cell[-1], (k + 1) * turn - wide, between + 1)
            points = _polar(radii[::-1, None], plain[None])
            level = np.concatenate([points, np.zeros((*points.shape[:2], 1))], axis=2)
            meshes.append(grid(level, np.array([0.0, 0.0, 1.0]), around=False))
            angles.append(plain[:-1])
    return np.concatenate(angles), join(*meshes)


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A plate of 16 to 25 mm radius with 0, or 3 to 8, holes in the middle of the ring that the bore leaves."""
    radius = float(rng.uniform(16, 25))
    bore = radius * float(rng.uniform(0.25, 0.5))
    holes = int(rng.choice([0, 3, 4, 5, 6, 8]))
    chamfer, ring = radius * float(rng.uniform(0.01, 0.05)), radius - bore
    circle = bore + ring / 2
    widest = min(ring / 2 - chamfer, circle * np.sin(np.pi / max(2, holes)))
    return {
        "radius": radius,
        "bore_radius": bore,
        "thickness": radius * float(rng.uniform(0.15, 0.5)),
        "holes": holes,
        "hole_radius": float(widest * rng.uniform(0.3, 0.75)),
        "circle_radius": circle,
        "chamfer": chamfer,
    }
