"""Repair across the stack: a sample lost in one picture is known in the others, but for what its surroundings tell.

The samples y of a pixel, one a light, would be l . b on a matte surface: a vector in the span of the lights. Real pictures leave that
span a little, by a part that changes slowly over the surface. So the lost samples are those for which, from each pixel to its neighbours,

    (y_p - y_q)^T C (y_p - y_q),    C = 1 - (1 - SHADING) U U^T,

summed with a weight an edge, is least; U is an orthonormal basis of the lights' span. What leaves the span counts fully: inside the
hole it is a membrane spanned over its rim, so the pixel's other samples decide and no seam shows. What lies in the span, the matte shading,
counts little, and decides only where the samples that remain do not determine it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen import large
from gen.capture import Bools, Capture, Floats
from recon.conditioning import MAX_CONDITION
from recon.registry import Repaired
from recon.repair.samples import missing, require_alike, weights_of

Doubles = NDArray[np.float64]
Indices = NDArray[np.intp]

SHADING = 0.05
"""What a change of the matte shading counts beside one of what leaves the lights' span. Like `CONTRAST` it was chosen on the presets
paper-stack and group-test and on DiLiGenT's bear and cat, which therefore say little of its worth elsewhere."""

CONTRAST = 3.0
"""Median squared steps between neighbours at which an edge counts half: the other pictures show where the surface or its albedo changes."""

TOLERANCE = 1e-5
"""Residual, relative to the right-hand side, at which the linear system counts as solved."""


def stack(images: Floats, defects: Bools, capture: Capture) -> Repaired:
    """Repair from the same pixel in the other pictures, joined to its surroundings without a seam, from inside the object's mask only.

    What leaves the lights' span is continued into the hole as a membrane, weaker across edges that the other pictures show; where too few
    samples of a pixel remain, so is the shading itself. Each channel alone; no filled sample is negative.
    images: (K, H, W, 3) float32. defects: (K, H, W). Samples outside the mask, and those that are not defects, come back bit for bit; so
    does a connected part of the object that a picture has no good sample of. Weights are 1, 0 where missing. Raises InputError where
    shapes disagree.
    Source: the membrane is that of P. Perez, M. Gangnet and A. Blake, "Poisson image editing" (SIGGRAPH 2003); that only three dimensions
    of shading tie the pictures, L. Wu et al., "Robust photometric stereo via low-rank matrix completion and recovery" (ACCV 2010), here
    spanned by the known lights. The energy that joins the two is this project's.
    """
    from scipy.ndimage import binary_dilation

    require_alike(images, defects, capture)
    result = large.copy(images)
    absent = missing(capture)
    lost = _with_source((defects | absent) & capture.mask, capture.mask)
    wanted = lost & ~absent
    if wanted.any():
        region = binary_dilation(lost.any(axis=0)) & capture.mask
        values = capture.reflectance(images)[:, region].astype(np.float64)
        filled = np.maximum(membrane(values, lost[:, region], *neighbours(region), capture.lights), 0)
        filled *= np.broadcast_to(capture.intensities[:, None], filled.shape)
        part = result[:, region]
        part[wanted[:, region]] = filled[wanted[:, region]]
        result[:, region] = part
    return Repaired(images=result, weights=weights_of(capture))


def membrane(values: Doubles, lost: Bools, i: Indices, j: Indices, lights: Doubles) -> Doubles:
    """The values (K, P, 3) with the lost ones (K, P) filled by the least energy of this module; i, j: the pixels at the ends of each edge.

    Conjugate gradients in each channel, under a multigrid cycle for the pictures without their coupling. The coupled matrix lies between
    `SHADING` times that one and itself, so the number of steps does not grow with the holes. lights: (K, 3).
    """
    from scipy.sparse import block_diag
    from scipy.sparse.linalg import LinearOperator, cg

    from recon.height.algebraic import hierarchy

    count = len(values)
    known = ~lost[..., None]
    # A constant in each picture changes nothing: without it rounding and tolerance are relative to the contrast.
    level = (values * known).sum(axis=1, keepdims=True) / np.maximum(known.sum(axis=1, keepdims=True), 1)
    held = (values - level) * known
    laplacian = _laplacian(edge_weights(values, lost, i, j), i, j, values.shape[1])
    left, singular, _ = np.linalg.svd(lights, full_matrices=False)
    span = left[:, singular * MAX_CONDITION >= singular[0]]
    coupling = np.eye(count) - (1 - SHADING) * span @ span.T

    def energy_gradient(y: Doubles) -> Doubles:
        return (coupling @ (laplacian @ y.T).T)[lost]

    def of_unknowns(u: Doubles) -> Doubles:
        y = np.zeros(lost.shape)
        y[lost] = u.ravel()
        return energy_gradient(y)

    apart = block_diag([laplacian[row][:, row] for row in lost if row.any()], format="csr")
    solver = hierarchy(apart).aspreconditioner(cycle="V")
    matrix = LinearOperator(apart.shape, matvec=of_unknowns, dtype=np.float64)
    for channel in range(values.shape[2]):
        right = -energy_gradient(held[..., channel])
        if np.any(right):
            held[..., channel][lost] = cg(matrix, right, rtol=TOLERANCE, maxiter=200, M=solver)[0]
    return held + level


def edge_weights(values: Doubles, lost: Bools, i: Indices, j: Indices) -> Doubles:
    """The weight of each edge, near 1 where the pictures that know both its ends show no step, toward 0 where they show a large one.

    values: (K, P, 3). lost: (K, P). i, j: (E,). An edge that no picture knows weighs what one with the median step does. Returns (E,).
    """
    square, pictures = np.zeros(len(i)), np.zeros(len(i))
    for y, gone in zip(values, lost, strict=True):
        both = ~(gone[i] | gone[j])
        square += both * np.square(y[i] - y[j]).sum(axis=-1)
        pictures += both
    seen = pictures > 0
    usual = float(np.median(square[seen] / pictures[seen])) if seen.any() else 0.0
    if usual == 0:
        return np.ones(len(i))
    step = np.where(seen, square / np.maximum(pictures, 1), usual)
    weights: Doubles = CONTRAST * usual / (CONTRAST * usual + step)
    return weights


def neighbours(region: Bools) -> tuple[Indices, Indices]:
    """The edges between horizontal and vertical neighbours in a region (H, W), as indices i, j (E,) of its pixels in order."""
    index = np.full(region.shape, -1, dtype=np.intp)
    index[region] = np.arange(np.count_nonzero(region))
    ends = []
    for a, b in ((index[:, :-1], index[:, 1:]), (index[:-1], index[1:])):
        inside = (a >= 0) & (b >= 0)
        ends.append((a[inside], b[inside]))
    return np.concatenate([ends[0][0], ends[1][0]]), np.concatenate([ends[0][1], ends[1][1]])


def _laplacian(weights: Doubles, i: Indices, j: Indices, pixels: int) -> Any:
    """The sparse matrix (P, P) of the sum of weights * (z_i - z_j)^2."""
    from scipy.sparse import csr_matrix

    data = np.concatenate([weights, weights, -weights, -weights])
    rows, columns = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
    return csr_matrix((data, (rows, columns)), shape=(pixels, pixels))


def _with_source(lost: Bools, mask: Bools) -> Bools:
    """The lost samples (K, H, W) in connected parts of the mask of which their picture has a good sample left."""
    from scipy.ndimage import label

    parts, count = label(mask)
    sourced = np.zeros_like(lost)
    for k, gone in enumerate(lost):
        has = np.zeros(count + 1, dtype=bool)
        has[np.unique(parts[mask & ~gone])] = True
        sourced[k] = gone & has[parts]
    return sourced
