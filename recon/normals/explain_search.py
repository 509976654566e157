"""The search for the normal that explains a pixel best: where to begin, which of the ends to keep, and the neighbours' say."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from recon.normals.compiled import compiled, in_parts
from recon.normals.explain_pixel import BASE, LOBE, NOISE, WEIGHT, fitted_albedo, pull, refine, shades, spread

Doubles = NDArray[np.float64]
Bools = NDArray[np.bool_]

HOLD = 5.0
"""Pull of the least squares normal, against costs of standard deviations squared: it decides where the samples hardly do."""

PRIOR, REACH = 30.0, 0.25
"""Pull of the neighbours' normal, and the distance in radians from which on it grows no more, for edges."""

STARTS, ROUNDS = 2, 8
"""Beginnings that are refined a pixel, and steps of each."""

TRIPLETS = 20
"""Most triplets of lights whose exact normals are among the beginnings: all of six lights, the widest of more."""

GRID = 100
"""Normals spread over the hemisphere among the beginnings of a pixel that has no neighbour to learn from."""

COARSE = 4
"""Every so manyth pixel in both directions is searched on the grid; the others begin from these."""

APART = 0.995
"""Cosine between a beginning and one already tried, above which it is not worth another."""


@dataclass(frozen=True, eq=False)
class Rig:
    """What the lights fix. rays: (7, K), see `recon.normals.explain_pixel`. triplets: (T, 3) of lights. inverses: (T, 3, 3)."""

    rays: Doubles
    triplets: NDArray[np.int64]
    inverses: Doubles


@dataclass(frozen=True, eq=False)
class Pixels:
    """Pixels to explain. y, w: (P, K), samples over the scale and weights. scale: (P,). plain: (P, 3) least squares normals, unit."""

    y: Doubles
    w: Doubles
    scale: Doubles
    plain: Doubles

    def __len__(self) -> int:
        return len(self.y)

    def take(self, which: NDArray[np.intp]) -> Pixels:
        """Some of them."""
        return Pixels(self.y[which], self.w[which], self.scale[which], self.plain[which])


@dataclass(frozen=True, eq=False)
class Found:
    """Normals n (P, 3), albedo (P,) in the samples' scale, cost (P,), and variance (P,) of the angle among near-equal ends, radians^2."""

    n: Doubles
    albedo: Doubles
    cost: Doubles
    variance: Doubles


def rig(lights: Doubles) -> Rig:
    """The rig of lights (K, 3), unit, seen along +z."""
    half = lights + np.array([0.0, 0.0, 1.0])
    half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
    cos = np.maximum((half * lights).sum(axis=1), 1e-3)
    triplets = np.array(list(combinations(range(len(lights)), 3)))
    volume = np.abs(np.linalg.det(lights[triplets]))
    widest = np.argsort(-volume, kind="stable")[:TRIPLETS]
    chosen = triplets[widest[volume[widest] > 0.01]]
    rays = np.ascontiguousarray(np.vstack([lights.T, half.T, cos]))
    return Rig(rays=rays, triplets=chosen, inverses=np.linalg.inv(lights[chosen]))


def hemisphere(count: int, lowest: float = 0.1) -> Doubles:
    """(count, 3) normals spread evenly over the part of the hemisphere with z above `lowest`, on a spiral."""
    i = np.arange(count) + 0.5
    z = 1 - (1 - lowest) * i / count
    turn = i * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


def search(
    pixels: Pixels, of: Rig, optics: Doubles, strength: float, seeds: Doubles, grid: Doubles, starts: int, rounds: int
) -> Found:
    """The best normal of every pixel alone. optics, strength: the object's reflectance. seeds: (P, S, 3) beginnings, z 0 where none.

    grid: (G, 3) beginnings of all pixels. starts, rounds: see `STARTS`.
    """
    count = len(pixels)
    found = Found(n=pixels.plain.copy(), albedo=np.zeros(count), cost=np.full(count, np.inf), variance=np.zeros(count))
    per_pixel = (pixels.y, pixels.w, pixels.scale, pixels.plain, seeds, found.n, found.albedo, found.cost, found.variance)
    in_parts(_search, per_pixel, of.rays, of.triplets, of.inverses, grid, optics, strength, starts, rounds)
    return found


def search_coarse_to_fine(pixels: Pixels, mask: Bools, of: Rig, optics: Doubles, strength: float) -> Found:
    """As `search`, of all pixels of a mask (H, W): every `COARSE`th on a grid of normals, the others beginning from those near them."""
    where = np.argwhere(mask)
    first = np.flatnonzero((where % COARSE == 0).all(axis=1))
    no_grid = np.zeros((0, 3))
    if strength <= 0 or not first.size:
        return search(pixels, of, optics, strength, np.zeros((len(pixels), 0, 3)), no_grid, STARTS, ROUNDS)
    coarse = search(pixels.take(first), of, optics, strength, np.zeros((len(first), 0, 3)), hemisphere(GRID), STARTS, ROUNDS)
    known = np.zeros((mask.shape[0] // COARSE + 2, mask.shape[1] // COARSE + 2, 3))
    known[tuple((where[first] // COARSE).T)] = coarse.n
    i, j = (where // COARSE).T
    seeds = np.stack([known[i, j], known[i + 1, j], known[i, j + 1], known[i + 1, j + 1]], axis=1)
    return search(pixels, of, optics, strength, seeds, no_grid, STARTS, ROUNDS)


def smooth(pixels: Pixels, mask: Bools, found: Found, of: Rig, optics: Doubles, strength: float, times: int) -> None:
    """Refine all pixels with a pull toward their neighbours' mean normal, which is a beginning too. found: changed.

    A surface's normals vary little from pixel to pixel, but for edges, where the pull is bounded. All pixels of a round see the normals
    before it, so the order of the pixels has no say.
    """
    for _ in range(times):
        framed = np.zeros((mask.shape[0] + 2, mask.shape[1] + 2, 3))
        framed[1:-1, 1:-1][mask] = found.n
        toward = (framed[:-2, 1:-1] + framed[2:, 1:-1] + framed[1:-1, :-2] + framed[1:-1, 2:])[mask]
        toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-9)
        per_pixel = (pixels.y, pixels.w, pixels.scale, toward, found.n, found.albedo, found.cost)
        in_parts(_smooth, per_pixel, of.rays, optics, strength)


def explanations(
    pixels: Pixels, found: Found, of: Rig, optics: Doubles, strength: float
) -> tuple[Doubles, Doubles, Doubles, Doubles]:
    """How the normals found explain each sample: (lobe, base, share, variance).

    lobe: (P, K), in the samples' scale. base: (P, K), over the albedo. share: (P, K) in [0, 1], how far the sample is explained (0: a
    highlight or shadow of its own). variance: (P,) of the angle by the curvature of the cost, in square radians.
    """
    lobe, base, share = np.zeros_like(pixels.y), np.zeros_like(pixels.y), np.zeros_like(pixels.y)
    variance = np.zeros(len(pixels))
    per_pixel = (pixels.y, pixels.w, pixels.scale, found.n, found.albedo, lobe, base, share, variance)
    in_parts(_explanations, per_pixel, of.rays, optics, strength)
    return lobe, base, share, variance


@compiled
def _search(
    y: Doubles,
    w: Doubles,
    scale: Doubles,
    plain: Doubles,
    seeds: Doubles,
    n: Doubles,
    albedo: Doubles,
    costs: Doubles,
    variance: Doubles,
    rays: Doubles,
    triplets: NDArray[np.int64],
    inverses: Doubles,
    grid: Doubles,
    optics: Doubles,
    strength: float,
    starts: int,
    rounds: int,
) -> None:
    K, G = y.shape[1], len(grid)
    begin = np.empty((1 + len(triplets) + K + seeds.shape[1] + G, 3))
    price, bright = np.empty(len(begin)), np.empty(len(begin))
    ends, end_price = np.empty((starts, 3)), np.empty(starts)
    work = np.empty((8, K))
    base, lobe, weight = work[BASE], work[LOBE], work[WEIGHT]
    grid_base, grid_lobe = np.empty((G, K)), np.empty((G, K))
    for g in range(G):
        shades(grid[g, 0], grid[g, 1], grid[g, 2], rays, optics, 1.0, grid_base[g], grid_lobe[g])
    for p in range(len(y)):
        s = strength / scale[p]
        count = 0
        if plain[p, 2] > 0:
            begin[0] = plain[p]
            count = 1
        for t in range(len(triplets)):
            i, j, k = triplets[t, 0], triplets[t, 1], triplets[t, 2]
            if w[p, i] * w[p, j] * w[p, k] == 0:
                continue
            m = inverses[t]
            bx = m[0, 0] * y[p, i] + m[0, 1] * y[p, j] + m[0, 2] * y[p, k]
            by = m[1, 0] * y[p, i] + m[1, 1] * y[p, j] + m[1, 2] * y[p, k]
            bz = m[2, 0] * y[p, i] + m[2, 1] * y[p, j] + m[2, 2] * y[p, k]
            length = np.sqrt(bx * bx + by * by + bz * bz)
            if bz > 0.02 * length:
                begin[count, 0], begin[count, 1], begin[count, 2] = bx / length, by / length, bz / length
                count += 1
        if strength > 0:
            for k in range(K):
                begin[count, 0], begin[count, 1], begin[count, 2] = rays[3, k], rays[4, k], rays[5, k]
                count += 1
        for t in range(seeds.shape[1]):
            if seeds[p, t, 2] > 0:
                begin[count] = seeds[p, t]
                count += 1
        for c in range(count):
            shades(begin[c, 0], begin[c, 1], begin[c, 2], rays, optics, s, base, lobe)
            bright[c], price[c] = fitted_albedo(y[p], w[p], base, lobe, weight, 3)
        for g in range(G):
            for k in range(K):
                base[k] = grid_base[g, k]
                lobe[k] = s * grid_lobe[g, k]
            begin[count] = grid[g]
            bright[count], price[count] = fitted_albedo(y[p], w[p], base, lobe, weight, 2)
            count += 1
        for c in range(count):
            price[c] += pull(begin[c, 0], begin[c, 1], begin[c, 2], plain[p], HOLD, 10.0)
        tried = 0
        while tried < starts and count > 0:
            at = 0
            for c in range(1, count):
                if price[c] < price[at]:
                    at = c
            if price[at] == np.inf:
                break
            end = ends[tried]
            end[:] = begin[at]
            a, end_price[tried] = refine(y[p], w[p], end, bright[at], rays, optics, s, rounds, plain[p], HOLD, 10.0, work)
            for c in range(count):
                near = begin[c, 0] * begin[at, 0] + begin[c, 1] * begin[at, 1] + begin[c, 2] * begin[at, 2]
                near = max(near, begin[c, 0] * end[0] + begin[c, 1] * end[1] + begin[c, 2] * end[2])
                if near > APART and c != at:
                    price[c] = np.inf
            price[at] = np.inf
            if end_price[tried] < costs[p]:
                costs[p], albedo[p] = end_price[tried], a
                n[p] = end
            tried += 1
        total = second = 0.0
        for c in range(tried):
            odds = np.exp(-0.5 * (end_price[c] - costs[p]))
            total += odds
            second += odds * ((ends[c, 0] - n[p, 0]) ** 2 + (ends[c, 1] - n[p, 1]) ** 2 + (ends[c, 2] - n[p, 2]) ** 2)
        if total > 0:
            variance[p] = second / total


@compiled
def _smooth(
    y: Doubles,
    w: Doubles,
    scale: Doubles,
    toward: Doubles,
    n: Doubles,
    albedo: Doubles,
    costs: Doubles,
    rays: Doubles,
    optics: Doubles,
    strength: float,
) -> None:
    work = np.empty((8, y.shape[1]))
    own, other = np.empty(3), np.empty(3)
    for p in range(len(y)):
        if n[p, 2] <= 0 or toward[p, 2] <= 0:
            continue
        s = strength / scale[p]
        own[:] = n[p]
        bright, least = refine(y[p], w[p], own, albedo[p], rays, optics, s, 4, toward[p], PRIOR, REACH, work)
        if own[0] * toward[p, 0] + own[1] * toward[p, 1] + own[2] * toward[p, 2] < APART:
            other[:] = toward[p]
            shades(other[0], other[1], other[2], rays, optics, s, work[BASE], work[LOBE])
            a = fitted_albedo(y[p], w[p], work[BASE], work[LOBE], work[WEIGHT], 3)[0]
            a, now = refine(y[p], w[p], other, a, rays, optics, s, 4, toward[p], PRIOR, REACH, work)
            if now < least:
                own[:] = other
                bright, least = a, now
        n[p] = own
        albedo[p], costs[p] = bright, least


@compiled
def _explanations(
    y: Doubles,
    w: Doubles,
    scale: Doubles,
    n: Doubles,
    albedo: Doubles,
    lobes: Doubles,
    bases: Doubles,
    shares: Doubles,
    variance: Doubles,
    rays: Doubles,
    optics: Doubles,
    strength: float,
) -> None:
    work = np.empty((8, y.shape[1]))
    for p in range(len(y)):
        s = strength / scale[p]
        # No rounds: the scratch is filled for the normal as it is.
        refine(y[p], w[p], n[p], albedo[p], rays, optics, s, 0, n[p], 0.0, 1.0, work)
        lobes[p] = work[LOBE]
        bases[p] = work[BASE]
        for k in range(y.shape[1]):
            if w[p, k] > 0:
                shares[p, k] = work[WEIGHT, k] * NOISE * NOISE / w[p, k]
        variance[p] = spread(n[p], albedo[p], rays, optics, s, work)
