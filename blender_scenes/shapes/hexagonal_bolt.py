"""The hexagonal bolt."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.extrusion import walls
from blender_scenes.shapes.lathe import Piece, azimuths, lathe, path
from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import Array, centred, grid, join, moved, parametric, upright

COLUMNS = 48
"""Columns of vertices a side of the head."""


def hexagonal_bolt(
    diameter: Annotated[float, Range(1e-3, 1e5)] = 11.0,
    length: Annotated[float, Range(1e-3, 1e5)] = 34.0,
    thread_length: Annotated[float, Range(1e-3, 1e5)] = 20.0,
    pitch: Annotated[float, Range(1e-3, 1e5)] = 1.9,
) -> Mesh:
    """A bolt, head up along y: a hexagonal head with its conical chamfer, a shank, and a right-handed thread; analytic normals.

    diameter, length without the head, thread_length, pitch: mm. The head is 1.6 diameters across flats and .65 high, its chamfer has 30
    degrees. The thread is round: a cosine of half a pitch's depth that runs out over the first and the last pitch. Raises ValueError
    where the thread is longer than the shank, shorter than three pitches or over 35, or too coarse for the diameter.
    """
    radius, chamfer = diameter / 2, 0.08 * diameter
    if not thread_length <= length - 2 * chamfer:
        raise ValueError(f"shape hexagonal_bolt: thread_length {thread_length:g} mm must be {length - 2 * chamfer:g} mm or less")
    if not 3 * pitch <= thread_length <= 35 * pitch:
        raise ValueError(f"shape hexagonal_bolt: thread_length {thread_length:g} mm must be 3 to 35 pitches of {pitch:g} mm")
    if not pitch <= 0.4 * diameter:
        raise ValueError(f"shape hexagonal_bolt: pitch {pitch:g} mm must be .4 diameters or less, {0.4 * diameter:g} mm")
    angles = azimuths(6 * COLUMNS)
    end, top = path((0, 0), (radius - chamfer, 0), (radius, chamfer)), chamfer + thread_length
    return centred(
        join(
            lathe([*end, *path((radius, top), (radius, length))], angles),
            moved(_thread(radius, pitch, thread_length, angles), y=chamfer),
            moved(_head(0.8 * diameter, 0.65 * diameter, radius, angles), y=length),
        )
    )


def _thread(radius: float, pitch: float, length: float, angles: Array) -> Mesh:
    """The threaded wall from y = 0 to length: radius r(azimuth, y), equal to `radius` and level with it at both ends."""
    y = np.linspace(0, length, int(np.ceil(36 * length / pitch)) + 1)[:, None]
    fade, slope = np.ones_like(y), np.zeros_like(y)
    for t, sign in ((y / pitch, 1), ((length - y) / pitch, -1)):
        inside = t < 1
        fade = np.where(inside, t * t * (3 - 2 * t), fade)
        slope = np.where(inside, sign * 6 * t * (1 - t) / pitch, slope)
    phase = 2 * np.pi * y / pitch - angles
    depth = pitch / 4 * (1 - np.cos(phase))
    turn = pitch / 4 * np.sin(phase)
    r = radius - fade * depth
    r_azimuth, r_y = fade * turn, -slope * depth - fade * turn * 2 * np.pi / pitch
    s, c = np.sin(angles), np.cos(angles)
    zero, one = np.zeros_like(r), np.ones_like(r)
    return parametric(
        np.stack([r * s, y + zero, r * c], axis=-1),
        np.stack([r_azimuth * s + r * c, zero, r_azimuth * c - r * s], axis=-1),
        np.stack([r_y * s, one, r_y * c], axis=-1),
    )


def _head(apothem: float, height: float, shank: float, angles: Array) -> Mesh:
    """The head on y = 0: underside, six sides, cone and flat top. angles: azimuths, each corner among them."""
    corner = np.pi / 3
    reach = apothem / np.cos((angles + corner / 2) % corner - corner / 2)
    circle, tilt = 0.95 * apothem, np.radians(30)
    edge = height - (reach - circle) * np.tan(tilt)
    out = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=1)
    up = np.array([0.0, 1.0, 0.0])
    rim = reach[:, None] * out
    under = grid(np.stack([shank * out, rim])[::-1][:, ::-1], -up)
    cone = grid(np.stack([rim + edge[:, None] * up, circle * out + height * up]), np.sin(tilt) * out + np.cos(tilt) * up)
    lid = lathe(path((circle, height), (0, height)), angles)
    # The outline in the plane that `upright` lays down: azimuth a is (sin a, -cos a) there. Side k lies about azimuth 60 k degrees.
    plan, sides, edges = np.stack([rim[:, 0], -rim[:, 2]], axis=1), [], []
    for k in range(6):
        column = (np.arange(COLUMNS + 1) + COLUMNS * k - COLUMNS // 2) % len(angles)
        facing = k * corner
        normal = np.broadcast_to([np.sin(facing), -np.cos(facing)], (COLUMNS + 1, 2))
        sides.append(Piece(plan[column], normal))
        edges.append(edge[column])
    return join(under, cone, lid, upright(walls(sides, [0.0] * 6, edges)))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A bolt of 7 to 13 mm diameter, 2 to 4 diameters long, threaded over .4 to .9 of that."""
    diameter = float(rng.uniform(7, 13))
    length = diameter * float(rng.uniform(2, 4))
    return {
        "diameter": diameter,
        "length": length,
        "thread_length": (length - 0.16 * diameter) * float(rng.uniform(0.4, 0.9)),
        "pitch": diameter * float(rng.uniform(0.13, 0.22)),
    }
