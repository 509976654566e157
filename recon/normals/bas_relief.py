"""Which of the bas-reliefs: what matte pictures leave open, decided by an assumption on the lights or on the brightest spots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError

Doubles = NDArray[np.float64]
Bools = NDArray[np.bool_]

UNEVEN = 0.1
"""Difference of the logarithms of two lights' powers beyond which it counts little: some lamps may be off."""

NEIGHBOURHOOD = 9
"""Pixels across within which a spot must be the brightest, after smoothing with a sixth of it."""

NEAR_ENOUGH = 15.0
"""Degrees between surface and light within which a brightest spot faces its light; others, at edges of albedo or shape, have little say.
This and `NEIGHBOURHOOD` were chosen among twelve pairs by the errors on DiLiGenT's bear and cat, which they change by some degrees."""

SPOTS = 1500
"""Brightest spots that have a say, at most: three numbers need no more."""

SLANT, STRETCH = 3.0, 2.5
"""Largest slants, and logarithm of the stretch around the one that gives the lights' z the power of x and y: beyond, all lights are one."""

GRID = 13
"""Starting values a number, over two thirds of the slants and stretches."""


def bas_relief(mu: float, nu: float, stretch: float) -> Doubles:
    """G (3, 3) of the surface z -> stretch z + mu x + nu y: lights become G s, scaled normals G^-T n."""
    return np.array([[1.0, 0, 0], [0, 1, 0], [mu, nu, stretch]])


def equally_strong(lights: Doubles) -> tuple[Doubles, float]:
    """The bas-relief transform under which scaled lights (K, 3) come nearest to one length, and the lengths' relative deviation."""
    from scipy.optimize import least_squares

    def uneven(g: Doubles) -> Doubles:
        power = np.square(lights @ _transform(g).T).sum(axis=1)
        difference: Doubles = np.log(power / power.mean())
        return difference

    even = _even_stretch(lights)
    starts = [(mu, nu, even + s) for mu in (-1, 0, 1) for nu in (-1, 0, 1) for s in (-1, 0, 1, 2)]
    limits = (-SLANT, -SLANT, even - STRETCH), (SLANT, SLANT, even + STRETCH)
    fits = [least_squares(uneven, start, loss="soft_l1", f_scale=UNEVEN, bounds=limits) for start in starts]
    G = _transform(min(fits, key=lambda fit: float(fit.cost)).x)
    length = np.linalg.norm(lights @ G.T, axis=1)
    return G, float(length.std() / length.mean())


def facing_maxima(surface: Doubles, lights: Doubles, y: NDArray[np.float32], used: Bools, mask: Bools) -> tuple[Doubles, float]:
    """The bas-relief transform under which the most brightest spots face their light, and the share of spots that do not.

    Where a picture of even albedo is brightest, the surface faces the light. surface: (P, 3) scaled normals, zero where unknown.
    lights: (K, 3) scaled. y: (K, P) the pictures, used: (K, P) their matte samples. Raises InputError where there are few such spots.
    """
    from scipy.optimize import least_squares

    normals, toward = _brightest(surface, lights, y, used, mask)
    if len(normals) < 2 * len(lights):
        raise InputError("the pictures show too few brightest spots to tell the lights' strengths; say that they are equal")

    def apart(g: Doubles) -> Doubles:
        """The angle of each spot over `NEAR_ENOUGH`."""
        G = _transform(g)
        a, b = normals @ np.linalg.inv(G), toward @ G.T
        along = np.einsum("ni,ni->n", a, b)
        across = np.einsum("ni,ni->n", a, a) * np.einsum("ni,ni->n", b, b) - along**2
        angle: Doubles = np.arctan2(np.sqrt(np.maximum(across, 0)), along) / np.radians(NEAR_ENOUGH)
        return angle

    def misses(g: Doubles) -> Doubles:
        """Square roots of what each spot costs, which is at most 1."""
        cost: Doubles = np.sqrt(1 - np.exp(-np.square(apart(g))) + 1e-12)
        return cost

    side = np.linspace(-2 / 3, 2 / 3, GRID)
    axes = SLANT * side, SLANT * side, STRETCH * side + _even_stretch(lights)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    order = np.argsort([np.square(misses(g)).sum() for g in grid], kind="stable")
    fits = [least_squares(misses, grid[start]) for start in order[:5]]
    best = min(fits, key=lambda fit: float(fit.cost)).x
    return _transform(best), float((apart(best) > 1).mean())


def caves_in(surface: Doubles, mask: Bools) -> bool:
    """Whether scaled normals (P, 3) turn inward, toward the middle of the mask, more than outward."""
    rows, columns = np.nonzero(mask)
    out = np.stack([columns - columns.mean(), rows.mean() - rows], axis=1)
    return float((surface[:, :2] * out).sum()) < 0


def _transform(g: Doubles) -> Doubles:
    return bas_relief(float(g[0]), float(g[1]), float(np.exp(g[2])))


def _even_stretch(lights: Doubles) -> float:
    """Logarithm of the stretch that gives the lights' z as much power as x and y together."""
    power = np.square(lights).sum(axis=0)
    return 0.5 * float(np.log((power[0] + power[1]) / power[2]))


def _brightest(surface: Doubles, lights: Doubles, y: NDArray[np.float32], used: Bools, mask: Bools) -> tuple[Doubles, Doubles]:
    """Scaled normals and lights, (N, 3) each, at the spots of each picture that are its brightest all around, away from the outline."""
    from scipy.ndimage import gaussian_filter, maximum_filter

    width = NEIGHBOURHOOD / 6
    share = gaussian_filter(mask.astype(np.float64), width)
    known = np.abs(surface).sum(axis=1) > 0
    normals, toward = [], []
    for k, row in enumerate(y):
        picture = np.zeros(mask.shape)
        picture[mask] = row
        picture = gaussian_filter(picture, width)
        top = (picture == maximum_filter(picture, NEIGHBOURHOOD)) & (share > 0.99)
        spots = np.flatnonzero(top[mask] & used[k] & known)
        normals.append(surface[spots])
        toward.append(np.repeat(lights[k : k + 1], len(spots), axis=0))
    step = max(1, -(-sum(map(len, normals)) // SPOTS))
    return np.concatenate(normals)[::step], np.concatenate(toward)[::step]
