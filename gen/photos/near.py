"""Near lights from several balls: where the rays to a lamp meet, and what the shading of matte balls adds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from gen.photos.balls import BallLights, ball_pixels, lit_samples
from gen.photos.view import Doubles, Sphere, View

FARTHEST = 100.0
"""A light is distant where it is more than so many times as far as the balls are apart: its direction then varies by under 0.6 degrees."""

PIXELS = 1500
"""Samples of a ball that a place is fitted to: three unknowns need no more."""


def triangulate(points: Doubles, directions: Doubles) -> tuple[Doubles, Doubles]:
    """The point nearest to N rays, and its distance from each (N,). points, directions: (N, 3), directions unit.

    Least squares over the perpendicular distances: sum_i (I - d_i d_i^T) x = sum_i (I - d_i d_i^T) p_i. Infinite where the rays are
    parallel.
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.cond(total) > 1e10:
        return np.full(3, np.inf), np.full(len(points), np.inf)
    place: Doubles = np.linalg.solve(total, np.einsum("nij,nj->i", across, points))
    miss = np.linalg.norm(np.einsum("nij,nj->ni", across, place - points), axis=1)
    return place, miss


def light_places(balls: Sequence[BallLights]) -> tuple[Doubles, Doubles]:
    """Positions (K, 3) of lights that two or more balls saw, and how far the rays miss them (K,), root mean square.

    Infinite where a light is distant: its rays are parallel, run apart, or meet beyond `FARTHEST` times the balls' spread.
    """
    points = np.stack([ball.points for ball in balls], 1)
    directions = np.stack([ball.directions for ball in balls], 1)
    spread = np.linalg.norm(np.ptp(points, axis=1), axis=-1)
    places, misses = [], []
    for k in range(len(points)):
        place, miss = triangulate(points[k], directions[k])
        ahead = np.einsum("ni,ni->n", place - points[k], directions[k]) if np.isfinite(place).all() else np.array([-1.0])
        if (ahead <= 0).any() or ahead.max() > FARTHEST * spread[k]:
            place = np.full(3, np.inf)
        places.append(place)
        misses.append(np.sqrt((miss**2).mean()))
    return np.array(places), np.array(misses)


def refined_places(
    places: Doubles,
    images: Sequence[NDArray[np.float32]],
    faults: Sequence[NDArray[np.uint8]],
    spheres: Sequence[Sphere],
    view: View,
) -> Doubles:
    """Positions (K, 3) after a fit of the shading of matte balls, which one direction a ball describes only roughly.

    Minimises over the place s the squared residuals of I = c n.(s - x) / |s - x|^3 over the lit pixels of all balls, with a factor c
    of its own for every ball: its paint is not asked for. places: (K, 3) first guesses. images, faults: (K, H, W, 3) and (K, H, W) a ball.
    """
    from scipy.optimize import least_squares

    parts = []
    for sphere, pictures, flags in zip(spheres, images, faults, strict=True):
        rows, columns, points, normals, _ = ball_pixels(sphere, view, "ball")
        parts.append((points, normals, pictures[:, rows, columns].astype(np.float64).mean(axis=-1), flags[:, rows, columns] == 0))
    result = places.copy()
    for k in range(len(places)):
        seen = []
        for points, normals, values, usable in parts:
            lit, _ = lit_samples(values[k] / _shading(places[k], points, normals, cosine=False), normals, usable[k])
            chosen = np.flatnonzero(lit)[:: max(1, int(lit.sum()) // PIXELS)]
            seen.append((points[chosen], normals[chosen], values[k][chosen]))
        size = np.linalg.norm(places[k])

        def residuals(s: Doubles, seen: list[tuple[Doubles, Doubles, Doubles]] = seen, size: float = float(size)) -> Doubles:
            off = []
            for points, normals, values in seen:
                model = _shading(s * size, points, normals)
                off.append((values - model * (model @ values) / (model @ model)) / np.linalg.norm(values))
            return np.concatenate(off)

        found = least_squares(residuals, places[k] / size)
        result[k] = found.x * size
    return result


def _shading(place: Doubles, points: Doubles, normals: Doubles, cosine: bool = True) -> Doubles:
    """What a point light of unit strength at `place` gives (P,): fall-off, and the cosine or not."""
    toward = place - points
    distance = np.linalg.norm(toward, axis=1)
    shading: Doubles = np.maximum((normals * toward).sum(1), 1e-9) / distance**3 if cosine else distance**-2
    return shading / shading.max()


def require_places(places: Doubles, where: str, names: tuple[str, ...]) -> None:
    """InputError where a light was said to be near and is not."""
    far = ~np.isfinite(places).all(axis=1)
    if far.any():
        raise InputError(
            f"{where}: the balls see the light of picture {names[int(np.argmax(far))]} in one direction, so its place is not measurable; "
            "put the balls farther apart, or say near: false"
        )
