"""Damage in places drawn by a seed: straight scratches and round dents."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from blender_scenes.shapes.detail_field import Field, Seed, not_steep
from blender_scenes.shapes.mesh import Mesh, Range
from blender_scenes.shapes.surface import Array


class _Places(NamedTuple):
    """Where marks are: centres (M, 3), unit normals there, unit tangents at random, and sizes (M,) from .5 to 1."""

    centres: Array
    normals: Array
    tangents: Array
    sizes: Array


def scratches(
    mesh: Mesh,
    count: Annotated[int, Range(1, 500)] = 12,
    length: Annotated[float, Range(1e-3, 1e4)] = 12.0,
    width: Annotated[float, Range(1e-3, 1e3)] = 0.4,
    depth: Annotated[float, Range(1e-6, 1e3)] = 0.03,
    seed: Seed = 1,
) -> Field:
    """Scratches in random places and directions: cuts of a plane at right angles to the surface, shallower toward both ends.

    length, width, depth: mm, of the largest; each is .5 to 1 of it in every measure. Where two cross, the deeper wins. A scratch reaches
    half its length into the body, so a thin wall shows it on both sides. Raises ValueError where the depth is over a quarter of the
    width or the width over the length.
    """
    not_steep("scratches", depth, width, "width")
    if width > length:
        raise ValueError(f"detail scratches: width {width:g} mm must be the length, {length:g} mm, or less")
    places = _places(mesh, count, seed)
    across = np.cross(places.normals, places.tangents)
    half_widths, reach = width / 2 * places.sizes, length / 2 * places.sizes

    def height(points: Array) -> tuple[Array, Array]:
        whole = _Union(len(points), depth)
        for i, near in _candidates(points, places.centres, reach):
            off = points[near] - places.centres[i]
            u = off @ across[i] / half_widths[i]
            hit = np.abs(u) < 1
            near, off, u = near[hit], off[hit], u[hit]
            r2 = np.einsum("ij,ij->i", off, off) / reach[i] ** 2
            hit = r2 < 1
            near, off, u, r2 = near[hit], off[hit], u[hit], r2[hit]
            profile, taper = (1 - u**2) ** 2, (1 - r2**2) ** 2
            slope = (-4 * u * (1 - u**2) * taper / half_widths[i])[:, None] * across[i]
            slope -= (8 * r2 * (1 - r2**2) * profile / reach[i] ** 2)[:, None] * off
            whole.add(near, places.sizes[i] * profile * taper, places.sizes[i] * slope)
        return whole.height, whole.gradient

    def spans(a: Array, middle: Array, b: Array) -> Array:
        times = np.zeros(len(a))
        half = np.sqrt(np.einsum("ij,ij->i", b - a, b - a)) / 2
        for i, near in _candidates(middle, places.centres, reach, half):
            before, after = (a[near] - places.centres[i]) @ across[i], (b[near] - places.centres[i]) @ across[i]
            hit = (np.minimum(np.abs(before), np.abs(after)) < half_widths[i]) | (before * after < 0)
            near = near[hit]
            near = near[_distance(places.centres[i], a[near], b[near]) < reach[i]]
            times[near] = np.maximum(times[near], 2 * half[near] / half_widths[i] * 3)
        return times

    return Field(height, spans, depth, f"width {width:g} mm", places.centres, reach)


def dents(
    mesh: Mesh,
    count: Annotated[int, Range(1, 500)] = 8,
    radius: Annotated[float, Range(1e-3, 1e4)] = 2.0,
    depth: Annotated[float, Range(1e-6, 1e3)] = 0.2,
    seed: Seed = 1,
) -> Field:
    """Smooth round bowls in random places, (1 - (r / radius)^2)^3 deep.

    radius, depth: mm, of the largest; each is .5 to 1 of it in both. Where two meet, they do not add up: none gets deeper than `depth`.
    Raises ValueError where the depth is over a quarter of the radius.
    """
    not_steep("dents", depth, radius, "radius")
    places = _places(mesh, count, seed)
    reach = radius * places.sizes

    def height(points: Array) -> tuple[Array, Array]:
        whole = _Union(len(points), depth)
        for i, near in _candidates(points, places.centres, reach):
            off = points[near] - places.centres[i]
            r2 = np.einsum("ij,ij->i", off, off) / reach[i] ** 2
            hit = r2 < 1
            near, off, r2 = near[hit], off[hit], r2[hit]
            slope = (-6 * (1 - r2) ** 2 / reach[i] ** 2)[:, None] * off
            whole.add(near, places.sizes[i] * (1 - r2) ** 3, places.sizes[i] * slope)
        return whole.height, whole.gradient

    def spans(a: Array, middle: Array, b: Array) -> Array:
        times = np.zeros(len(a))
        half = np.sqrt(np.einsum("ij,ij->i", b - a, b - a)) / 2
        for i, near in _candidates(middle, places.centres, reach, half):
            near = near[_distance(places.centres[i], a[near], b[near]) < reach[i]]
            times[near] = np.maximum(times[near], 2 * half[near] / reach[i] * 8)
        return times

    return Field(height, spans, depth, f"radius {radius:g} mm", places.centres, reach)


class _Union:
    """Marks b_i in [0, 1] brought together as 1 - (1 - b_1)(1 - b_2)...: smooth, and no deeper than `depth`."""

    def __init__(self, count: int, depth: float) -> None:
        self.depth = depth
        self.left, self.slope = np.ones(count), np.zeros((count, 3))

    def add(self, where: NDArray[np.intp], mark: Array, slope: Array) -> None:
        """where: distinct indices (M,); mark: (M,); slope: its gradient, (M, 3)."""
        self.slope[where] = self.slope[where] * (1 - mark)[:, None] - self.left[where][:, None] * slope
        self.left[where] *= 1 - mark

    @property
    def height(self) -> Array:
        return -self.depth * (1 - self.left)

    @property
    def gradient(self) -> Array:
        return self.depth * self.slope


def _places(mesh: Mesh, count: int, seed: int) -> _Places:
    """Places drawn evenly over the surface. Triangles alone."""
    assert mesh.normals is not None
    rng = np.random.default_rng(seed)
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).cumsum()
    face = np.searchsorted(area, rng.uniform(0, area[-1], count)).clip(0, len(area) - 1)
    weights = rng.dirichlet(np.ones(3), count)
    centres = (weights[..., None] * corners[face]).sum(axis=1)
    normals = (weights[..., None] * mesh.normals[mesh.faces[face]]).sum(axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    side = rng.normal(size=(count, 3))
    tangents = side - (side * normals).sum(axis=1, keepdims=True) * normals
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-12)
    return _Places(centres, normals, tangents, rng.uniform(0.5, 1, count))


def _candidates(
    points: Array, centres: Array, reach: Array, slack: Array | None = None
) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Of each centre, the points that may lie within its reach (plus the largest slack): all that are that near in x."""
    order = np.argsort(points[:, 0], kind="stable")
    x = points[order, 0]
    more = float(slack.max()) if slack is not None and len(slack) else 0.0
    for i, (centre, r) in enumerate(zip(centres[:, 0], reach + more, strict=True)):
        first, last = np.searchsorted(x, [centre - r, centre + r])
        if last > first:
            yield i, order[first:last]


def _distance(centre: Array, a: Array, b: Array) -> Array:
    """Distance (N,) of a point from the segments a to b."""
    along, off = b - a, centre - a
    t = (np.einsum("ij,ij->i", off, along) / np.maximum(np.einsum("ij,ij->i", along, along), 1e-30)).clip(0, 1)
    distance: Array = np.sqrt(((off - t[:, None] * along) ** 2).sum(axis=1))
    return distance


def sample_scratches(rng: np.random.Generator) -> dict[str, float]:
    """2 to 40 scratches of 4 to 20 mm, .15 to .6 mm wide and .02 to .15 of that deep."""
    width = float(rng.uniform(0.15, 0.6))
    return {
        "count": int(rng.integers(2, 41)),
        "length": float(rng.uniform(4, 20)),
        "width": width,
        "depth": width * float(rng.uniform(0.02, 0.15)),
        "seed": int(rng.integers(10**8)),
    }


def sample_dents(rng: np.random.Generator) -> dict[str, float]:
    """1 to 20 dents of .8 to 4 mm radius, .02 to .15 of that deep."""
    radius = float(rng.uniform(0.8, 4))
    return {
        "count": int(rng.integers(1, 21)),
        "radius": radius,
        "depth": radius * float(rng.uniform(0.02, 0.15)),
        "seed": int(rng.integers(10**8)),
    }
