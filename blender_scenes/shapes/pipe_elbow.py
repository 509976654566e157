"""The pipe elbow."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import centred, divisions, join, turned
from blender_scenes.shapes.sweep import end, rings, tube


def pipe_elbow(
    radius: Annotated[float, Range(1e-3, 1e5)] = 9.0,
    bore_radius: Annotated[float, Range(1e-3, 1e5)] = 7.0,
    bend_radius: Annotated[float, Range(1e-3, 1e5)] = 18.0,
    leg: Annotated[float, Range(1e-3, 1e5)] = 11.0,
) -> Mesh:
    """A pipe bent by 90 degrees between two straight legs, one end down and the other half toward the viewer; analytic normals.

    radius, bore_radius: outside and inside, mm. bend_radius: of the middle line, mm. leg: length of each straight part, mm. Raises
    ValueError where the bore is as wide as the pipe or the bend as tight.
    """
    if not bore_radius < radius:
        raise ValueError(f"shape pipe_elbow: bore_radius {bore_radius:g} mm must be under the radius, {radius:g} mm")
    if not radius < bend_radius:
        raise ValueError(f"shape pipe_elbow: radius {radius:g} mm must be under the bend_radius, {bend_radius:g} mm")
    size = bend_radius + radius + leg
    # From the foot at (0, -leg) up, around (bend_radius, 0) and out along x.
    angle = np.linspace(0, np.pi / 2, divisions(bend_radius + radius, size, np.pi / 2) + 1)
    middle = bend_radius * np.stack([1 - np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    turn = np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    centres = np.concatenate([middle[:1] - leg * turn[0], middle, middle[-1:] + leg * turn[-1]])
    tangents = np.concatenate([turn[:1], turn, turn[-1:]])
    circles = rings(tangents, np.broadcast_to([0.0, 0.0, 1.0], centres.shape), divisions(radius, size))
    mesh = join(
        tube(centres, circles, radius),
        tube(centres, circles, bore_radius, inside=True),
        end(centres[0], circles[0], radius, bore_radius, -tangents[0]),
        end(centres[-1], circles[-1], radius, bore_radius, tangents[-1]),
    )
    half = np.sqrt(0.5)
    return centred(turned(mesh, np.array([[half, 0, half], [0, 1, 0], [-half, 0, half]]).T))


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A pipe of 6 to 11 mm radius, its bore .6 to .9 of that, bent to 1.3 to 2.5 radii."""
    radius = float(rng.uniform(6, 11))
    return {
        "radius": radius,
        "bore_radius": radius * float(rng.uniform(0.6, 0.9)),
        "bend_radius": radius * float(rng.uniform(1.3, 2.5)),
        "leg": float(rng.uniform(3, 14)),
    }
