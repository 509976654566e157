"""Compiled passes over a grid of pixels whose neighbours are coupled by weights: what `recon.height.multigrid` is made of.

A grid of h x w pixels is kept as (h + 3, w + 3), with a margin of zeros of one row and column before and two after, so that no pass asks
where it ends. weight: (4, h + 3, w + 3), of each pixel's edges to the right, down, down right and down left; on the first level the last
two are zero, and `nine` is false. The matrix A is that of sum weight (z_i - z_j)^2 + sum held z^2. The pixels with even row and column,
counted without the margin, are the next level's: its row u and column v are here row i = 2 u - 1 and column j = 2 v - 1, with the margin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.normals.compiled import Doubles, compiled

ENDS = np.array(
    [
        (0, 1),
        (1, 2),
        (0, 3),
        (3, 6),
        (1, 4),
        (4, 7),
        (3, 4),
        (4, 5),
        (0, 4),
        (1, 5),
        (3, 7),
        (4, 8),
        (1, 3),
        (2, 4),
        (4, 6),
        (5, 7),
    ]
)
"""The edges of three by three pixels, which are numbered row by row: those along the axes, then those along the diagonals. The edges of the
last row and column are the next squares'."""


@compiled
def row_sums(weight: Doubles, out: Doubles) -> None:
    """out: the sum of the weights of each pixel's edges."""
    right, down, falling, rising = weight[0], weight[1], weight[2], weight[3]
    for i in range(1, out.shape[0] - 2):
        for j in range(1, out.shape[1] - 2):
            along = right[i, j] + right[i, j - 1] + down[i, j] + down[i - 1, j]
            out[i, j] = along + falling[i, j] + falling[i - 1, j - 1] + rising[i, j] + rising[i - 1, j + 1]


@compiled
def multiply(weight: Doubles, held: Doubles, x: Doubles, out: Doubles) -> float:
    """out = A x on the first level. Returns x . A x."""
    right, down = weight[0], weight[1]
    product = 0.0
    for i in range(1, x.shape[0] - 2):
        for j in range(1, x.shape[1] - 2):
            here = x[i, j]
            across = right[i, j] * (here - x[i, j + 1]) + right[i, j - 1] * (here - x[i, j - 1])
            along = down[i, j] * (here - x[i + 1, j]) + down[i - 1, j] * (here - x[i - 1, j])
            out[i, j] = across + along + held[i, j] * here
            product += here * out[i, j]
    return product


@compiled
def advance(step: float, direction: Doubles, image: Doubles, x: Doubles, r: Doubles) -> float:
    """x += step direction, r -= step image. Returns r . r."""
    product = 0.0
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            x[i, j] += step * direction[i, j]
            r[i, j] -= step * image[i, j]
            product += r[i, j] * r[i, j]
    return product


@compiled
def turn(ratio: float, z: Doubles, direction: Doubles) -> None:
    """direction = z + ratio direction."""
    for i in range(z.shape[0]):
        for j in range(z.shape[1]):
            direction[i, j] = z[i, j] + ratio * direction[i, j]


@compiled
def sweep_down(weight: Doubles, nine: bool, inverse: Doubles, b: Doubles, line: Doubles, x: Doubles, r: Doubles) -> None:
    """x: one sweep of Gauss and Seidel from zero, row by row from the top left. r: the residual that it leaves.

    inverse: of the diagonal, 0 outside the mask. line: (2, w + 3) to work in. A pixel's residual is what the pixels after it, which were
    still zero at its turn, have added since.
    """
    right, down, falling, rising = weight[0], weight[1], weight[2], weight[3]
    h, w = x.shape[0] - 3, x.shape[1] - 3
    known, share = line[0], line[1]
    for i in range(1, h + 2):
        for j in range(1, w + 1):
            known[j] = down[i - 1, j] * x[i - 1, j]
            share[j] = right[i, j - 1] * inverse[i, j]
        if nine:
            for j in range(1, w + 1):
                known[j] += falling[i - 1, j - 1] * x[i - 1, j - 1] + rising[i - 1, j + 1] * x[i - 1, j + 1]
        for j in range(1, w + 1):
            known[j] = (known[j] + b[i, j]) * inverse[i, j]
        last = 0.0
        for j in range(1, w + 1):  # the only part that is a chain: a product and a sum from pixel to pixel
            last = known[j] + share[j] * last
            x[i, j] = last
        for j in range(1, w + 1):
            r[i - 1, j] = right[i - 1, j] * x[i - 1, j + 1] + down[i - 1, j] * x[i, j]
        if nine:
            for j in range(1, w + 1):
                r[i - 1, j] += falling[i - 1, j] * x[i, j + 1] + rising[i - 1, j] * x[i, j - 1]


@compiled
def sweep_up(weight: Doubles, nine: bool, inverse: Doubles, b: Doubles, line: Doubles, x: Doubles) -> None:
    """x: one sweep of Gauss and Seidel from what it is, row by row from the bottom right. Arguments as in `sweep_down`."""
    right, down, falling, rising = weight[0], weight[1], weight[2], weight[3]
    h, w = x.shape[0] - 3, x.shape[1] - 3
    known, share = line[0], line[1]
    for i in range(h, 0, -1):
        for j in range(1, w + 1):
            known[j] = down[i - 1, j] * x[i - 1, j] + down[i, j] * x[i + 1, j] + right[i, j - 1] * x[i, j - 1]
            share[j] = right[i, j] * inverse[i, j]
        if nine:
            for j in range(1, w + 1):
                known[j] += falling[i - 1, j - 1] * x[i - 1, j - 1] + rising[i - 1, j + 1] * x[i - 1, j + 1]
                known[j] += falling[i, j] * x[i + 1, j + 1] + rising[i, j] * x[i + 1, j - 1]
        for j in range(1, w + 1):
            known[j] = (known[j] + b[i, j]) * inverse[i, j]
        last = 0.0
        for j in range(w, 0, -1):
            last = known[j] + share[j] * last
            x[i, j] = last


@compiled
def shares(weight: Doubles, p: Doubles) -> None:
    """p: (8, H + 3, W + 3), the shares by which the pixels between those of the next level follow these.

    p[0:2]: how the pixel to the right follows its left and right neighbour. p[2:4]: the one below, its neighbours above and below.
    p[4:8]: the one down right, the four around it, row by row. A pixel's shares sum to one, or are zero where it has no edge that way.
    """
    right, down, falling, rising = weight[0], weight[1], weight[2], weight[3]
    H, W = p.shape[1] - 3, p.shape[2] - 3
    for u in range(1, H + 1):
        i = 2 * u - 1
        for v in range(1, W + 1):
            j = 2 * v - 1
            a = max(right[i, j] + falling[i - 1, j] + rising[i, j + 1], 0.0)
            b = max(right[i, j + 1] + rising[i - 1, j + 2] + falling[i, j + 1], 0.0)
            scale = 1 / (a + b) if a + b > 0 else 0.0
            p[0, u, v], p[1, u, v] = a * scale, b * scale
            a = max(down[i, j] + falling[i, j - 1] + rising[i, j + 1], 0.0)
            b = max(down[i + 1, j] + rising[i + 1, j] + falling[i + 1, j], 0.0)
            scale = 1 / (a + b) if a + b > 0 else 0.0
            p[2, u, v], p[3, u, v] = a * scale, b * scale
    for u in range(1, H + 1):
        i = 2 * u - 1
        for v in range(1, W + 1):
            j = 2 * v - 1
            above, below, left, far = down[i, j + 1], down[i + 1, j + 1], right[i + 1, j], right[i + 1, j + 1]
            a = max(falling[i, j] + above * p[0, u, v] + left * p[2, u, v], 0.0)
            b = max(rising[i, j + 2] + above * p[1, u, v] + far * p[2, u, v + 1], 0.0)
            c = max(rising[i + 1, j + 1] + below * p[0, u + 1, v] + left * p[3, u, v], 0.0)
            d = max(falling[i + 1, j + 1] + below * p[1, u + 1, v] + far * p[3, u, v + 1], 0.0)
            scale = 1 / (a + b + c + d) if a + b + c + d > 0 else 0.0
            p[4, u, v], p[5, u, v], p[6, u, v], p[7, u, v] = a * scale, b * scale, c * scale, d * scale


@compiled
def coarsen(
    weight: Doubles, held: Doubles, nine: bool, p: Doubles, ends: NDArray[np.int64], W: Doubles, diagonal: Doubles
) -> None:
    """The next level's matrix P^T A P, P of the shares p: its weights W and its diagonal. ends: `ENDS`.

    Square by square of the next level: every edge inside it is a weight times the square of a difference of its four corners.
    """
    right, down, falling, rising = weight[0], weight[1], weight[2], weight[3]
    W[:] = 0.0
    diagonal[:] = 0.0
    taken = np.zeros((9, 4))  # what each of three by three pixels takes from the four corners
    taken[0, 0] = taken[2, 1] = taken[6, 2] = taken[8, 3] = 1.0
    of = np.zeros(16)
    energy = np.zeros((4, 4))
    for u in range(1, p.shape[1] - 2):
        i = 2 * u - 1
        for v in range(1, p.shape[2] - 2):
            j = 2 * v - 1
            of[0], of[1], of[2], of[3] = right[i, j], right[i, j + 1], down[i, j], down[i + 1, j]
            of[4], of[5], of[6], of[7] = down[i, j + 1], down[i + 1, j + 1], right[i + 1, j], right[i + 1, j + 1]
            if nine:
                of[8], of[9], of[10], of[11] = falling[i, j], falling[i, j + 1], falling[i + 1, j], falling[i + 1, j + 1]
                of[12], of[13], of[14], of[15] = rising[i, j + 1], rising[i, j + 2], rising[i + 1, j + 1], rising[i + 1, j + 2]
            taken[1, 0], taken[1, 1] = p[0, u, v], p[1, u, v]
            taken[3, 0], taken[3, 2] = p[2, u, v], p[3, u, v]
            taken[4, 0], taken[4, 1], taken[4, 2], taken[4, 3] = p[4, u, v], p[5, u, v], p[6, u, v], p[7, u, v]
            taken[5, 1], taken[5, 3] = p[2, u, v + 1], p[3, u, v + 1]
            taken[7, 2], taken[7, 3] = p[0, u + 1, v], p[1, u + 1, v]
            energy[:] = 0.0
            for n in range(16 if nine else 8):
                f, g = taken[ends[n, 0]], taken[ends[n, 1]]
                for a in range(4):
                    part = of[n] * (f[a] - g[a])
                    for b in range(a, 4):
                        energy[a, b] += part * (f[b] - g[b])
            for n, mass in ((0, held[i, j]), (1, held[i, j + 1]), (3, held[i + 1, j]), (4, held[i + 1, j + 1])):
                for a in range(4):
                    for b in range(a, 4):
                        energy[a, b] += mass * taken[n, a] * taken[n, b]
            diagonal[u, v] += energy[0, 0]
            diagonal[u, v + 1] += energy[1, 1]
            diagonal[u + 1, v] += energy[2, 2]
            diagonal[u + 1, v + 1] += energy[3, 3]
            W[0, u, v] -= energy[0, 1]
            W[0, u + 1, v] -= energy[2, 3]
            W[1, u, v] -= energy[0, 2]
            W[1, u, v + 1] -= energy[1, 3]
            W[2, u, v] -= energy[0, 3]
            W[3, u, v + 1] -= energy[1, 2]


@compiled
def gather(r: Doubles, p: Doubles, B: Doubles) -> None:
    """B = P^T r."""
    for u in range(1, p.shape[1] - 2):
        i = 2 * u - 1
        for v in range(1, p.shape[2] - 2):
            j = 2 * v - 1
            across = p[0, u, v] * r[i, j + 1] + p[1, u, v - 1] * r[i, j - 1]
            along = p[2, u, v] * r[i + 1, j] + p[3, u - 1, v] * r[i - 1, j]
            below = p[4, u, v] * r[i + 1, j + 1] + p[5, u, v - 1] * r[i + 1, j - 1]
            above = p[6, u - 1, v] * r[i - 1, j + 1] + p[7, u - 1, v - 1] * r[i - 1, j - 1]
            B[u, v] = r[i, j] + across + along + below + above


@compiled
def correct(X: Doubles, p: Doubles, x: Doubles) -> None:
    """x += P X."""
    for u in range(1, p.shape[1] - 2):
        i = 2 * u - 1
        for v in range(1, p.shape[2] - 2):
            j = 2 * v - 1
            a, b, c, d = X[u, v], X[u, v + 1], X[u + 1, v], X[u + 1, v + 1]
            x[i, j] += a
            x[i, j + 1] += p[0, u, v] * a + p[1, u, v] * b
            x[i + 1, j] += p[2, u, v] * a + p[3, u, v] * c
            x[i + 1, j + 1] += p[4, u, v] * a + p[5, u, v] * b + p[6, u, v] * c + p[7, u, v] * d
