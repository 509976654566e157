"""The spur gear."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.extrusion import bevel, cap, inset, walls
from blender_scenes.shapes.lathe import Piece, arc, azimuths, lathe, line
from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import Array, divisions, facing, flat, join, mirrored

PRESSURE = np.radians(20)
"""The pressure angle, at which involute teeth push."""


def gear(
    teeth: Annotated[int, Range(8, 80)] = 20,
    radius: Annotated[float, Range(1e-3, 1e5)] = 21.0,
    bore_radius: Annotated[float, Range(1e-3, 1e5)] = 7.0,
    width: Annotated[float, Range(1e-3, 1e5)] = 9.0,
) -> Mesh:
    """A spur gear with involute teeth of 20 degrees' pressure, axis toward the viewer, its outline chamfered; analytic normals.

    radius at the tips: mm; the module is 2 radius / (teeth + 2), the root lies 1.25 modules under the pitch circle, a tenth of the module
    is chamfered. bore_radius, width: mm. Near and under the base circle the flanks are straight. Raises ValueError where the bore
    leaves less than a module under the teeth, or the gear is too thin for its chamfers.
    """
    module = 2 * radius / (teeth + 2)
    pitch, root, chamfer = module * teeth / 2, module * (teeth / 2 - 1.25), 0.1 * module
    if not bore_radius < root - module:
        raise ValueError(
            f"shape gear: bore_radius {bore_radius:g} mm must be under {root - module:g} mm, a module under the roots of {teeth} teeth"
        )
    if not 4 * chamfer < width:
        raise ValueError(f"shape gear: width {width:g} mm must be over four chamfers, {4 * chamfer:g} mm")
    tooth = _tooth(root, pitch, radius, teeth, chamfer)
    outline = [piece for k in range(teeth) for piece in _turned(tooth, 2 * np.pi * k / teeth)]
    half = width / 2
    size, n = 2 * radius, len(tooth)
    loops = inset(outline, chamfer)
    fronts, roots = [], []
    for k in range(0, len(loops), n):
        # A tooth from its right root to its left is a ladder between two sides that mirror each other; then follows the bottom land.
        round_ = np.concatenate([loops[k], *(loop[1:] for loop in loops[k + 1 : k + n - 1])])
        fronts.append(_ladder(round_, half))
        roots.append(np.concatenate([round_[:1], loops[k + n - 1][:-1]]))
    bore = azimuths(max(teeth * 4, divisions(bore_radius, size)))
    hole = bore_radius * np.stack([np.sin(bore), -np.cos(bore)], axis=1)
    front = join(*fronts, cap(np.concatenate(roots), hole, (0.0, 0.0), half), bevel(outline, chamfer, half))
    levels = [half - chamfer] * len(outline)
    sides = walls(outline, [-level for level in levels], levels)
    return join(sides, front, mirrored(front), facing(lathe([line((bore_radius, half), (bore_radius, -half))], bore)))


def _tooth(root: float, pitch: float, tip: float, teeth: int, chamfer: float) -> list[Piece]:
    """One tooth about azimuth 0 (along x) and the land after it: right flank, tip, left flank, bottom land."""
    base = pitch * np.cos(PRESSURE)
    # Roll angle t of the involute at radius base sqrt(1 + t^2), where it bends with radius base t: no tighter than its chamfer bears.
    first = max(np.sqrt(max(0.0, (root / base) ** 2 - 1)), 1.5 * chamfer / base)
    roll = np.linspace(first, np.sqrt((tip / base) ** 2 - 1), 33)
    # The tooth fills half of the pitch.
    start = -(np.pi / (2 * teeth) + np.tan(PRESSURE) - PRESSURE)
    c, s = np.cos(roll + start), np.sin(roll + start)
    points = base * np.stack([c + roll * s, s - roll * c], axis=1)
    right = [Piece(points, np.stack([s, -c], axis=1))]
    if root < 0.9999 * np.hypot(*points[0]):
        # Straight on along the tangent, down to the root.
        tangent = np.array([c[0], s[0]])
        along = float(points[0] @ tangent)
        down = along - np.sqrt(along**2 - points[0] @ points[0] + root**2)
        right.insert(0, line(points[0] - down * tangent, points[0]))
    flip = np.array([1.0, -1.0])
    left = [Piece(piece.points[::-1] * flip, piece.normals[::-1] * flip) for piece in right[::-1]]
    edge, low = (float(np.arctan2(p[1], p[0])) for p in (points[-1], right[0].points[0]))
    top = arc((0, 0), tip, edge, -edge, 2 * max(2, divisions(tip, 2 * tip, -edge)))
    land = arc((0, 0), root, -low, 2 * np.pi / teeth + low, max(4, divisions(root, 2 * tip, 2 * np.pi / teeth + 2 * low)))
    return [*right, top, *left, land]


def _turned(pieces: list[Piece], angle: float) -> list[Piece]:
    c, s = np.cos(angle), np.sin(angle)
    back = np.array([[c, s], [-s, c]])
    return [Piece(points @ back, normals @ back) for points, normals in pieces]


def _ladder(side: Array, height: float) -> Mesh:
    """The flat inside of a counter-clockwise polyline (M, 2) that mirrors itself, up to its chord, facing z."""
    m = len(side)
    i = np.arange((m - 1) // 2)
    faces = np.concatenate([np.stack([i, i + 1, m - 2 - i], axis=1), np.stack([i, m - 2 - i, m - 1 - i], axis=1)])
    faces = faces[faces[:, 1] != faces[:, 2]]
    return flat(np.column_stack([side, np.full(m, height)]), faces.astype(np.int32), (0.0, 0.0, 1.0))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A gear of 12 to 40 teeth and 15 to 25 mm radius, the bore .2 to .5 of it."""
    teeth, radius = int(rng.integers(12, 41)), float(rng.uniform(15, 25))
    return {
        "teeth": teeth,
        "radius": radius,
        "bore_radius": radius * float(rng.uniform(0.2, 0.5)),
        "width": radius * float(rng.uniform(0.25, 0.8)),
    }
