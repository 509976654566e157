"""The turbine blade."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import Array, centred, grid, join, parametric


def turbine_blade(
    chord: Annotated[float, Range(1e-3, 1e5)] = 27.0,
    height: Annotated[float, Range(1e-3, 1e5)] = 44.0,
    thickness: Annotated[float, Range(0.04, 0.4)] = 0.17,
    camber: Annotated[float, Range(0, 0.4)] = 0.16,
    taper: Annotated[float, Range(0.3, 1)] = 0.7,
    twist_degrees: Annotated[float, Range(-90, 90)] = 35.0,
) -> Mesh:
    """A cambered, tapered and twisted blade, root down along y, its convex side to the viewer; analytic normals but for flat ends.

    chord at the root, height: mm. thickness, camber: shares of the chord. taper: chord at the tip over that at the root. twist_degrees:
    from root to tip. Section at u in [0, 1] along the chord: camber 4u(1-u) -+ the thickness, round at both edges. Raises ValueError
    where the chord is over five heights or the height over ten chords.
    """
    if not chord / 5 <= height <= 10 * chord:
        raise ValueError(f"shape turbine_blade: height {height:g} mm must be a fifth to ten times the chord, {chord:g} mm")
    rows, columns = 193, 384
    # Around the section from the trailing edge (u = 1) over the far side, so that columns x rows point outward.
    t = 2 * np.pi * np.arange(columns) / columns
    u, u_t = (1 + np.cos(t)) / 2, -np.sin(t) / 2
    half, half_t = _half_thickness(t, thickness)
    v, v_t = camber * 4 * u * (1 - u) - half, camber * 4 * (1 - 2 * u) * u_t - half_t
    u, v = u - 0.45, v - 0.5 * camber
    s = np.linspace(0, 1, rows)[:, None]
    scale, scale_s = chord * (1 - (1 - taper) * s), -chord * (1 - taper)
    turn = np.radians(twist_degrees)
    c, n = np.cos(turn * (s - 0.5)), np.sin(turn * (s - 0.5))
    # The section (u, v) in the plane (x, z), turned about y by (c, n).
    x, z, x_t, z_t = c * u + n * v, -n * u + c * v, c * u_t + n * v_t, -n * u_t + c * v_t
    x_s, z_s = turn * z, -turn * x
    zero = np.zeros_like(x)
    points = np.stack([scale * x, height * s + zero, scale * z], axis=-1)
    wall = parametric(
        points,
        np.stack([scale * x_t, zero, scale * z_t], axis=-1),
        np.stack([scale_s * x + scale * x_s, zero + height, scale_s * z + scale * z_s], axis=-1),
    )
    return centred(join(wall, _end(points[-1], 1.0), _end(points[0], -1.0)))


def _half_thickness(t: Array, thickness: float) -> tuple[Array, Array]:
    """Half the thickness at u = (1 + cos t) / 2 with its sign, and its derivative: thickest in front of the middle, blunt at the back."""
    size = thickness / 2 / 1.033
    value = size * np.sin(t) * (1 - 0.4 * np.cos(t))
    return value, size * (np.cos(t) - 0.4 * np.cos(2 * t))


def _end(loop: Array, up: float) -> Mesh:
    """The flat end over a section: strips between points of the two sides at one place of the chord."""
    m = len(loop) // 2 + 1
    far, near = loop[:m], loop[-np.arange(m)]
    return grid(np.stack([near, far] if up < 0 else [far, near]), np.array([0.0, up, 0.0]), around=False)


def sample(rng: np.random.Generator) -> dict[str, float]:
    """A blade of 18 to 32 mm chord, 1.2 to 2 chords high."""
    chord = float(rng.uniform(18, 32))
    return {
        "chord": chord,
        "height": chord * float(rng.uniform(1.2, 2)),
        "thickness": float(rng.uniform(0.1, 0.22)),
        "camber": float(rng.uniform(0.03, 0.22)),
        "taper": float(rng.uniform(0.5, 1)),
        "twist_degrees": float(rng.uniform(-50, 50)),
    }
