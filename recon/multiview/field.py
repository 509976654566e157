"""Compiled loops over the voxels of a truncated signed distance field: adding a view's surface, and carving by its outline.

A field is (N, N, N) float32, axes along the object's x, y, z; voxel (i, j, k) lies at origin + side * (i, j, k). Positive is outside.
"""

from __future__ import annotations

import numpy as np

from recon.multiview.views import Bools, Doubles, Floats
from recon.normals.compiled import compiled


@compiled
def project(P: Doubles, origin: Doubles, side: float, i: int, j: int, k: int) -> tuple[float, float, float]:
    """Column, row and depth at which P (3, 4) sees voxel (i, j, k); a depth of 0 or less is behind the camera, and leaves the others 0."""
    X, Y, Z = origin[0] + side * i, origin[1] + side * j, origin[2] + side * k
    z = P[2, 0] * X + P[2, 1] * Y + P[2, 2] * Z + P[2, 3]
    if z <= 0:
        return 0.0, 0.0, z
    x = P[0, 0] * X + P[0, 1] * Y + P[0, 2] * Z + P[0, 3]
    y = P[1, 0] * X + P[1, 1] * Y + P[1, 2] * Z + P[1, 3]
    return x / z, y / z, z


@compiled
def integrate(
    total: Floats, weight: Floats, origin: Doubles, side: float, limit: float, P: Doubles, depth: Floats, facing: Floats
) -> None:
    """Add a view's distances to the weighted sum `total` and to the sum of weights, both in place.

    limit: mm at which distances are cut off; voxels farther behind the surface are left as they are. P: (3, 4) object to pixels, the
    third row the depth. depth: (H, W) mm, NaN where not used, sampled between the pixels where all four are known and lie within the limit
    of each other. facing: (H, W) the cosine toward the camera.
    """
    H, W = depth.shape
    for i in range(total.shape[0]):
        for j in range(total.shape[1]):
            for k in range(total.shape[2]):
                x, y, z = project(P, origin, side, i, j, k)
                if z <= 0 or not (0 <= x < W - 1 and 0 <= y < H - 1):
                    continue
                c, r = int(x), int(y)
                u, v = x - c, y - r
                a, b, d, e = depth[r, c], depth[r, c + 1], depth[r + 1, c], depth[r + 1, c + 1]
                low, high = min(min(a, b), min(d, e)), max(max(a, b), max(d, e))
                if not (np.isfinite(a) and np.isfinite(b) and np.isfinite(d) and np.isfinite(e) and high - low <= 2 * limit):
                    continue
                surface = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * e)
                cosine = (1 - v) * ((1 - u) * facing[r, c] + u * facing[r, c + 1])
                cosine += v * ((1 - u) * facing[r + 1, c] + u * facing[r + 1, c + 1])
                distance = (surface - z) * cosine
                if distance < -limit:
                    continue
                w = cosine * cosine / (surface * surface)
                total[i, j, k] += w * min(distance, limit)
                weight[i, j, k] += w


@compiled
def carve(field: Floats, known: Bools, origin: Doubles, side: float, limit: float, P: Doubles, mask: Bools) -> None:
    """Make voxels that a view sees beside its mask (H, W) empty: known, at `limit`, in place. Those outside the picture stay."""
    H, W = mask.shape
    for i in range(field.shape[0]):
        for j in range(field.shape[1]):
            for k in range(field.shape[2]):
                x, y, z = project(P, origin, side, i, j, k)
                c, r = int(np.rint(x)), int(np.rint(y))
                if z > 0 and 0 <= c < W and 0 <= r < H and not mask[r, c]:
                    field[i, j, k] = limit
                    known[i, j, k] = True
