"""The helical compression spring."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import centred, divisions, join
from blender_scenes.shapes.sweep import end, rings, tube


def helical_spring(
    radius: Annotated[float, Range(1e-3, 1e5)] = 13.0,
    wire_radius: Annotated[float, Range(1e-3, 1e5)] = 1.9,
    pitch: Annotated[float, Range(1e-3, 1e5)] = 7.5,
    turns: Annotated[float, Range(0.25, 20)] = 5.0,
) -> Mesh:
    """A round wire wound right-handed about the y axis, its ends cut off flat; analytic normals.

    radius of the coil's middle, wire_radius, pitch (rise a turn): mm. Raises ValueError where the coils would touch or the spring is
    thinner than a fiftieth of its size.
    """
    rise = pitch / (2 * np.pi)
    if not wire_radius < 0.9 * radius:
        raise ValueError(f"shape helical_spring: wire_radius {wire_radius:g} mm must be under .9 of the radius, {radius:g} mm")
    # Neighbouring turns lie pitch * cos(climb) apart or, where they are steep, a little less.
    if not 2.1 * wire_radius < pitch * radius / np.hypot(radius, rise):
        raise ValueError(f"shape helical_spring: pitch {pitch:g} mm lets turns of {2 * wire_radius:g} mm wire touch")
    size = max(2 * (radius + wire_radius), turns * pitch)
    if wire_radius < size / 100:
        raise ValueError(
            f"shape helical_spring: wire_radius {wire_radius:g} mm must be a hundredth of the size, {size:g} mm, or more"
        )
    angle = np.linspace(0, 2 * np.pi * turns, int(np.ceil(turns * divisions(radius + wire_radius, 2 * size))) + 1)
    out = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    centres = radius * out + rise * angle[:, None] * np.array([0.0, 1.0, 0.0])
    tangents = np.stack([radius * np.cos(angle), np.full_like(angle, rise), -radius * np.sin(angle)], axis=1)
    tangents /= np.hypot(radius, rise)
    circles = rings(tangents, out, divisions(wire_radius, size))
    return centred(
        join(
            tube(centres, circles, wire_radius),
            end(centres[0], circles[0], wire_radius, 0.0, -tangents[0]),
            end(centres[-1], circles[-1], wire_radius, 0.0, tangents[-1]),
        )
    )


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A spring of 8 to 16 mm radius, 3 to 7 turns, the wire .08 to .2 of the radius and the pitch 2.5 to 4.5 wires."""
    radius, turns = float(rng.uniform(8, 16)), float(rng.uniform(3, 7))
    wire = radius * float(rng.uniform(0.08, 0.2))
    return {"radius": radius, "wire_radius": wire, "pitch": wire * float(rng.uniform(2.5, 4.5)), "turns": turns}
