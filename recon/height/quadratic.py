"""Quadratic integration over a mask: one sparse least-squares problem, orthographic or perspective."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Scale
from gen.errors import InputError
from recon.registry import Height

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

STEEPEST = 0.05
"""Smallest cosine toward the viewer that a normal is given: a pixel cannot show a slope beyond some 20 pixels a pixel, and noisy rims
would hang down in spikes. Steeper normals, and those that face away, are read as this."""


TOLERANCE = 1e-7
"""Residual, relative to the right-hand side, at which the linear system counts as solved: heights are then right to 1e-8 of their range."""


def quadratic(normal: Floats, mask: NDArray[np.bool_], scale: Scale) -> Height:
    """Least squares on the chords between neighbours, over the mask; perspective where the scale has a camera K.

    For neighbours i and j with points P the chord is taken perpendicular to the sum of the two unit normals, (P_j - P_i) . (n_i +
    n_j) = 0, which is exact on every sphere and circular cylinder and of third order elsewhere. Each such equation is linear in
    the heights (orthographic) or in the logarithms of the depths (perspective). An edge weighs the product of the two squared
    cosines toward the viewer:
    that is the inverse variance of its slope when the normals err by the same angle everywhere, so steep, ill-defined edges count
    little.

    normal: (H, W, 3) unit; pixels of length zero count as outside. mask: (H, W). scale: see `gen.capture.Scale`.
    Returns Height, mean zero in every connected part of the mask, in metres where the scale is known, else in pixels.
    Raises InputError where nothing can be integrated.
    Source: quadratic integration as surveyed by Queau, Durou and Aujol, "Normal Integration: A Survey" (2018), section 3.3;
    log-depth for perspective, their Eq. 12. The chord equation and the weights are worked out here.
    """
    inside = mask & ((normal * normal).sum(axis=2) > 0.25) & np.isfinite(normal).all(axis=2)
    if not inside.any():
        raise InputError("there is no pixel with a normal to integrate; check the mask and the pictures")
    rows, columns = np.nonzero(inside)
    index = np.full(mask.shape, -1)
    index[inside] = np.arange(len(rows))
    n = normal[inside].astype(np.float64)
    rays = _rays(rows, columns, scale)
    i, j = (np.concatenate(pair) for pair in zip(_edges(index, 0, 1), _edges(index, 1, 0), strict=True))
    toward = np.maximum(-(n * rays).sum(axis=1) / np.linalg.norm(rays, axis=1), STEEPEST)
    mean = n[i] + n[j]
    if scale.camera is None:
        across = mean[:, 0] * (columns[j] - columns[i]) - mean[:, 1] * (rows[j] - rows[i])
        rise = -across / (toward[i] + toward[j])
    else:
        at_i, at_j = (np.maximum(-(mean * rays[k]).sum(axis=1), 2 * STEEPEST) for k in (i, j))
        rise = np.log(at_i / at_j)
    part, solution = _solve(len(rows), i, j, (toward[i] * toward[j]) ** 2, rise)
    height = np.full(mask.shape, np.nan, np.float32)
    points = np.full((*mask.shape, 3), np.nan, np.float32)
    if scale.camera is None:
        step = scale.metres_per_pixel or 1.0
        z = _centred(solution, part) * step
        x = (columns - (mask.shape[1] - 1) / 2) * step
        y = ((mask.shape[0] - 1) / 2 - rows) * step
        points[inside] = np.stack([x, y, z], axis=1)
    else:
        middle = scale.distance_mm / 1000 if scale.distance_mm is not None else float(scale.camera[0, 0])
        depth = np.exp(solution - _means(solution, part))
        depth *= middle / _means(depth, part)
        z = middle - depth
        points[inside] = rays * depth[:, None] + [0, 0, middle]
    height[inside] = z
    return Height(height=height, points=points, unit=scale.unit)


def _edges(index: NDArray[np.int_], down: int, right: int) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Pairs of unknowns that are neighbours one step down or right, both inside."""
    H, W = index.shape
    a, b = index[: H - down, : W - right].ravel(), index[down:, right:].ravel()
    both = (a >= 0) & (b >= 0)
    return a[both], b[both]


def _rays(rows: NDArray[np.int_], columns: NDArray[np.int_], scale: Scale) -> Doubles:
    """(P, 3) viewing rays of unit depth in our frame (OpenCV's K has y down): the point at depth d is d times the ray."""
    if scale.camera is None:
        return np.broadcast_to(np.array([0.0, 0.0, -1.0]), (len(rows), 3))
    x = np.linalg.inv(scale.camera) @ np.stack([columns, rows, np.ones(len(rows))]).astype(np.float64)
    return np.stack([x[0], -x[1], -np.ones(len(rows))], axis=1)


def _solve(
    count: int, i: NDArray[np.int_], j: NDArray[np.int_], weight: Doubles, rise: Doubles
) -> tuple[NDArray[np.int_], Doubles]:
    """Minimise sum w (z_j - z_i - rise)^2. Returns the number of the connected part of each unknown, and z."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    entries = np.concatenate([weight, weight, -weight, -weight])
    where = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
    A = sparse.csr_matrix((entries, where), shape=(count, count))
    right = np.bincount(j, weight * rise, count) - np.bincount(i, weight * rise, count)
    _, part = connected_components(A, directed=False)
    return part, _conjugate_gradients(A, right.astype(np.float64))


def _conjugate_gradients(A: Any, right: Doubles) -> Doubles:
    """Conjugate gradients under a classical algebraic multigrid cycle (Ruge and Stueben): linear time, and deterministic."""
    import pyamg

    if not np.any(right):
        return np.zeros(len(right))
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    # Heights are known only up to a constant in each part: a grain on the diagonal makes the matrix definite.
    definite = A + sparse.diags_array(np.full(A.shape[0], 1e-10 * A.diagonal().mean()))
    definite = definite.tocsr()
    solver = pyamg.ruge_stuben_solver(definite, max_coarse=100)
    solution: Doubles = solver.solve(right, tol=TOLERANCE, accel="cg", maxiter=200)
    if np.linalg.norm(right - definite @ solution) > 100 * TOLERANCE * np.linalg.norm(right):
        solution = spsolve(definite.tocsc(), right)  # slow and sure
    return solution


def _means(values: Doubles, part: NDArray[np.int_]) -> Doubles:
    """The mean of each value's connected part."""
    result: Doubles = (np.bincount(part, values) / np.bincount(part))[part]
    return result


def _centred(values: Doubles, part: NDArray[np.int_]) -> Doubles:
    result: Doubles = values - _means(values, part)
    return result
