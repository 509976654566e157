"""Machining marks: grooves side by side along an axis, as turning and planing leave them, and rings around one, as facing does."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from blender_scenes.shapes.detail_field import Degrees, Field, direction, not_steep
from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import Array

PARTS = 8
"""The least number of edges over one groove."""


def grooves(
    mesh: Mesh,
    pitch: Annotated[float, Range(1e-3, 1e4)] = 0.8,
    depth: Annotated[float, Range(1e-6, 1e3)] = 0.03,
    sharpness: Annotated[float, Range(0, 0.95)] = 0.0,
    turn_degrees: Degrees = 90.0,
    tilt_degrees: Degrees = 0.0,
) -> Field:
    """Equal grooves at right angles to an axis, by default y: around a turned part, straight over a flat one.

    pitch, depth from crest to floor: mm. sharpness: 0 sinusoidal, toward 1 V-shaped with rounded crests and floors. turn_degrees,
    tilt_degrees: of the axis along which they follow each other: x turned toward y, then tilted toward z. Raises ValueError where the
    depth is over a quarter of the pitch.
    """
    not_steep("grooves", depth, pitch, "pitch")
    axis, longest = direction(turn_degrees, tilt_degrees), _longest(pitch, sharpness)

    def height(points: Array) -> tuple[Array, Array]:
        value, slope = _wave(points @ axis, pitch, depth, sharpness)
        return value, slope[:, None] * axis

    def spans(a: Array, middle: Array, b: Array) -> Array:
        along = middle @ axis
        return (np.abs(a @ axis - along) + np.abs(b @ axis - along)) / longest

    return Field(height, spans, depth, f"pitch {pitch:g} mm")


def rings(
    mesh: Mesh,
    pitch: Annotated[float, Range(1e-3, 1e4)] = 0.8,
    depth: Annotated[float, Range(1e-6, 1e3)] = 0.03,
    sharpness: Annotated[float, Range(0, 0.95)] = 0.0,
    turn_degrees: Degrees = 0.0,
    tilt_degrees: Degrees = 90.0,
) -> Field:
    """Equal rings around an axis through the origin, by default z: what facing leaves on an end.

    pitch, depth from crest to floor: mm. sharpness: 0 sinusoidal, toward 1 V-shaped with rounded crests and floors. turn_degrees,
    tilt_degrees: of the axis: x turned toward y, then tilted toward z. Raises ValueError where the depth is over a quarter of the pitch.
    """
    not_steep("rings", depth, pitch, "pitch")
    axis, longest = direction(turn_degrees, tilt_degrees), _longest(pitch, sharpness)

    def off_axis(points: Array) -> tuple[Array, Array]:
        across = points - (points @ axis)[:, None] * axis
        return across, np.sqrt(np.einsum("ij,ij->i", across, across))

    def height(points: Array) -> tuple[Array, Array]:
        across, radius = off_axis(points)
        value, slope = _wave(radius, pitch, depth, sharpness)
        # On the axis lies a crest: its slope is 0 there.
        return value, (slope / np.maximum(radius, 1e-12))[:, None] * across

    def spans(a: Array, middle: Array, b: Array) -> Array:
        radius, before, after = (off_axis(points)[1] for points in (middle, a, b))
        times = (np.abs(before - radius) + np.abs(after - radius)) / longest
        # Near the axis the slope turns around it.
        length = np.sqrt(((b - a) ** 2).sum(axis=1))
        turning: Array = np.minimum(length / longest, length / np.maximum(np.maximum(before, after) / 2, 1e-12))
        return np.maximum(times, turning)

    return Field(height, spans, depth, f"pitch {pitch:g} mm")


def _longest(pitch: float, sharpness: float) -> float:
    """The longest edge across: shorter where the wave bends more."""
    return pitch / PARTS * (1 - sharpness**2) ** 0.25


def _wave(at: Array, pitch: float, depth: float, sharpness: float) -> tuple[Array, Array]:
    """A wave with a crest of height 0 at 0 and its derivative: asin(s cos t) / asin(s), from a cosine (s = 0) to triangles (s = 1)."""
    k = 2 * np.pi / pitch
    s = max(sharpness, 1e-6)
    cosine, sine = np.cos(k * at), np.sin(k * at)
    size = depth / 2 / math.asin(s)
    return size * np.arcsin(s * cosine) - depth / 2, -size * k * s * sine / np.sqrt(1 - (s * cosine) ** 2)


def sample_grooves(rng: np.random.Generator) -> dict[str, float]:
    """Turning or planing marks, 0.4 to 2 mm apart, .005 to .08 of that deep, in any direction in two of five cases."""
    pitch = 0.4 * 5 ** float(rng.uniform())
    drawn = {"pitch": pitch, "depth": pitch * 0.005 * 16 ** float(rng.uniform()), "sharpness": float(rng.uniform(0, 0.9))}
    if rng.uniform() < 0.4:
        drawn |= {"turn_degrees": float(rng.uniform(0, 180)), "tilt_degrees": float(rng.uniform(-90, 90))}
    return drawn


def sample_rings(rng: np.random.Generator) -> dict[str, float]:
    """Rings 0.4 to 2 mm apart, .005 to .08 of that deep, around z or, in half of all cases, y."""
    pitch = 0.4 * 5 ** float(rng.uniform())
    drawn = {"pitch": pitch, "depth": pitch * 0.005 * 16 ** float(rng.uniform()), "sharpness": float(rng.uniform(0, 0.9))}
    return {**drawn, "turn_degrees": 90.0, "tilt_degrees": 0.0} if rng.uniform() < 0.5 else drawn
