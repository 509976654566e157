"""Weighted least squares of a large stack in one compiled pass: every sample is read from memory once, for normal and albedo alike."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gen.capture import LUMA
from recon.conditioning import MAX_CONDITION
from recon.normals.compiled import Doubles, compiled, in_parts, inverse
from recon.registry import Normals

BLOCK = 256
"""Pixels of a row that are worked on at a time: their samples under a hundred lights stay in a core's cache for the second look."""

PARTS = 32
"""Parts that the rows are dealt out in."""

SUMS = 11
"""What is summed over a pixel's samples: w l l^T (six), w y l (three), w y^2, and how many have weight."""

FIRST, SECOND = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
"""Rows and columns of the six products, in the order of `recon.normals.compiled.inverse`."""


def large_least_squares(
    reflectance: NDArray[np.float32], lights: Doubles, mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """What `recon.normals.least_squares.least_squares` gives, faster where there are many samples. Arguments and result as there."""
    height, width = mask.shape
    normal = np.zeros((height, width, 3), np.float32)
    albedo = np.zeros((height, width, 3), np.float32)
    sigma = np.full((height, width), np.nan, np.float32)
    found = np.zeros((height, width), dtype=bool)
    rows = np.flatnonzero(mask.any(axis=1))
    L = np.ascontiguousarray(lights.T, dtype=np.float64)
    samples, w = np.ascontiguousarray(reflectance, np.float32), np.ascontiguousarray(weights, np.float32)
    samples = samples.reshape(*samples.shape[:2], -1)
    luma = np.array(LUMA, dtype=np.float32)
    in_parts(
        _solve_rows,
        (rows,),
        samples,
        w,
        mask,
        L,
        luma,
        MAX_CONDITION,
        normal,
        albedo,
        sigma,
        found,
        part=max(len(rows) // PARTS, 1),
    )
    return Normals(normal=normal, albedo=albedo, uncertainty=sigma, measurable=found)


@compiled
def _condition(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> float:
    """Square root of the largest over the smallest eigenvalue of a symmetric 3x3 matrix; infinite where it is not positive definite.

    Source: O. K. Smith, "Eigenvalues of a symmetric 3 x 3 matrix", Communications of the ACM 4(4), 1961.
    """
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    size = math.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    if size == 0:
        return 1.0 if mean > 0 else math.inf
    half = (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / (2 * size * size * size)
    angle = math.acos(min(max(half, -1.0), 1.0)) / 3
    largest = mean + 2 * size * math.cos(angle)
    smallest = mean + 2 * size * math.cos(angle + 2 * math.pi / 3)
    return math.sqrt(largest / smallest) if smallest > 1e-14 * largest else math.inf


@compiled
def _solve_rows(
    rows: NDArray[np.intp],
    samples: NDArray[np.float32],
    weights: NDArray[np.float32],
    mask: NDArray[np.bool_],
    L: Doubles,
    luma: NDArray[np.float32],
    most: float,
    normal: NDArray[np.float32],
    albedo: NDArray[np.float32],
    sigma: NDArray[np.float32],
    found: NDArray[np.bool_],
) -> None:
    """The pixels of some rows of the mask. samples: (K, H, 3 W). weights: (K, H, W). L: (3, K). The last four are written.

    The channels are side by side in one axis because the compiler vectorises loops along a contiguous axis, and none over three.
    """
    K, width = samples.shape[0], mask.shape[1]
    sums = np.empty((SUMS, BLOCK))
    grey = np.empty((K, BLOCK), np.float32)
    n = np.empty((3, BLOCK), np.float32)
    fitted, share = np.empty(3 * BLOCK, np.float32), np.empty(3 * BLOCK, np.float32)
    power = np.empty(BLOCK, np.float32)
    products = np.empty(6)
    for c in range(6):
        products[c] = (L[FIRST[c]] * L[SECOND[c]]).sum()
    well_alike = _condition(products[0], products[1], products[2], products[3], products[4], products[5]) <= most
    m_alike = inverse(products[0], products[1], products[2], products[3], products[4], products[5])
    for i in rows:
        for start in range(0, width, BLOCK):
            count = min(BLOCK, width - start)
            if not mask[i, start : start + count].any():
                continue
            sums[:] = 0.0
            unlike = 0
            for k in range(K):
                row, of_row = samples[k, i, 3 * start : 3 * (start + count)], weights[k, i, start : start + count]
                for j in range(count):
                    unlike += of_row[j] != 1
                for j in range(count):
                    grey[k, j] = luma[0] * row[3 * j] + luma[1] * row[3 * j + 1] + luma[2] * row[3 * j + 2]
            alike = unlike == 0
            if alike:  # the usual case: the lights' products are the same for all
                for k in range(K):
                    x, y, z = L[0, k], L[1, k], L[2, k]
                    for j in range(count):
                        r = np.float64(grey[k, j])
                        sums[6, j] += r * x
                        sums[7, j] += r * y
                        sums[8, j] += r * z
                        sums[9, j] += r * r
                sums[10] = K
            else:
                for k in range(K):
                    x, y, z = L[0, k], L[1, k], L[2, k]
                    of_row = weights[k, i, start : start + count]
                    for j in range(count):
                        w, r = np.float64(of_row[j]), np.float64(grey[k, j])
                        wr, wx, wy = w * r, w * x, w * y
                        sums[0, j] += wx * x
                        sums[1, j] += wy * y
                        sums[2, j] += w * z * z
                        sums[3, j] += wx * y
                        sums[4, j] += wx * z
                        sums[5, j] += wy * z
                        sums[6, j] += wr * x
                        sums[7, j] += wr * y
                        sums[8, j] += wr * z
                        sums[9, j] += wr * r
                        sums[10, j] += 1.0 if w > 0 else 0.0
            for j in range(count):
                n[0, j] = n[1, j] = n[2, j] = 0.0
                s = sums[:, j]
                well, m = well_alike, m_alike
                if not alike:
                    well = _condition(s[0], s[1], s[2], s[3], s[4], s[5]) <= most
                    m = inverse(s[0], s[1], s[2], s[3], s[4], s[5])
                if not (well and mask[i, start + j]):
                    continue
                bx = m[0] * s[6] + m[3] * s[7] + m[4] * s[8]
                by = m[3] * s[6] + m[1] * s[7] + m[5] * s[8]
                bz = m[4] * s[6] + m[5] * s[7] + m[2] * s[8]
                length = math.sqrt(bx * bx + by * by + bz * bz)
                if not length > 0:
                    continue
                nx, ny, nz = bx / length, by / length, bz / length
                n[0, j], n[1, j], n[2, j] = nx, ny, nz
                found[i, start + j] = True
                if s[10] > 3:
                    left = max(s[9] - (bx * s[6] + by * s[7] + bz * s[8]), 0.0)
                    along = nx * (m[0] * nx + 2 * (m[3] * ny + m[4] * nz)) + ny * (m[1] * ny + 2 * m[5] * nz) + m[2] * nz * nz
                    across = max(m[0] + m[1] + m[2] - along, 0.0)
                    sigma[i, start + j] = math.degrees(math.atan(math.sqrt(left / (s[10] - 3) * across) / length))
            fitted[:] = 0
            power[:] = 0
            for k in range(K):
                x, y, z = np.float32(L[0, k]), np.float32(L[1, k]), np.float32(L[2, k])
                row, of_row = samples[k, i, 3 * start : 3 * (start + count)], weights[k, i, start : start + count]
                for j in range(count):
                    shading = max(n[0, j] * x + n[1, j] * y + n[2, j] * z, np.float32(0))
                    w = of_row[j] * shading
                    share[3 * j] = share[3 * j + 1] = share[3 * j + 2] = w
                    power[j] += w * shading
                for j in range(3 * count):
                    fitted[j] += share[j] * row[j]
            for j in range(count):
                if found[i, start + j]:
                    for c in range(3):
                        normal[i, start + j, c] = n[c, j]
                        if power[j] > 0:
                            albedo[i, start + j, c] = max(fitted[3 * j + c] / power[j], np.float32(0))
