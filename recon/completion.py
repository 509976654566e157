"""Low-rank completion and recovery of a stack: three dimensions of shading, missing entries, sparse errors.

Source: L. Wu, A. Ganesh, B. Shi, Y. Matsushita, Y. Wang and Y. Ma, "Robust photometric stereo via low-rank matrix completion and
recovery" (ACCV 2010); the solver is the inexact augmented Lagrangian of Z. Lin, M. Chen and Y. Ma (2010).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

LIGHT_PRIOR = 0.2
"""Weight of the known lights' subspace beside the samples' own, when the three dimensions of the shading are chosen."""

GROWTH = 1.3
CHUNK = 16384
ITERATIONS = 60


def complete(
    D: Floats,
    known: NDArray[np.bool_],
    lights: NDArray[np.float64],
    sparsity: float = 1.0,
    *,
    both_signs: bool = True,
    converged: float = 1e-5,
) -> Floats:
    """The rank-3 part A of D = A + E on the known entries, E sparse, and not negative unless it may have both signs.

    D, known: (K, P). lights: (K, 3). sparsity: lambda times sqrt(P); 1 is the theory's value. converged: violation of D = A + E, over the
    size of D, at which it ends. Returns A (K, P).
    Inexact ALM: A by shrinking the singular values of F = D - E + Y / mu with the unknown entries taken from A, E by soft thresholding, Y
    by the violation, mu growing. P is large and K small, so the singular vectors are eigenvectors of the K x K Gram matrix, to which
    `LIGHT_PRIOR` adds the projector onto the lights' subspace.
    """
    K, P = D.shape
    D = np.where(known, D, 0).astype(np.float32)
    size = float(np.linalg.norm(D))
    if size == 0:
        return D
    span = np.linalg.svd(lights, full_matrices=False)[0]
    projector = span @ span.T
    observed, unknown = known.astype(np.float32), (~known).astype(np.float32)
    spectral = float(np.sqrt(np.linalg.eigvalsh((D @ D.T).astype(np.float64))[-1]))
    sparse = float(sparsity / np.sqrt(P))
    mu = 1.25 / spectral
    Y = D / np.float32(max(spectral, float(D.max()) / sparse))
    F = D + Y / np.float32(mu)
    gram = (F @ F.T).astype(np.float64)
    A = np.empty_like(D)
    for _ in range(ITERATIONS):
        V = np.linalg.eigh(gram + LIGHT_PRIOR * np.trace(gram) * projector)[1][:, -3:]
        singular = np.sqrt(np.maximum(np.einsum("ki,kl,li->i", V, gram, V), 0))
        shrunk = (V * (np.maximum(singular - 1 / mu, 0) / np.maximum(singular, 1e-12))).astype(np.float32)
        across = np.ascontiguousarray(V.T, dtype=np.float32)
        step, threshold, next_mu = np.float32(mu), np.float32(sparse / mu), np.float32(mu * GROWTH)
        lowest = -threshold if both_signs else -np.inf
        gram = np.zeros((K, K))
        violation = 0.0
        # One pass in pieces that stay in the processor's cache, which also gathers the next Gram matrix.
        for start in range(0, P, CHUNK):
            c = np.s_[:, start : start + CHUNK]
            A[c] = shrunk @ (across @ F[c])
            rest = D[c] - A[c]
            E = rest + Y[c] / step
            E -= np.clip(E, lowest, threshold)  # soft thresholding, of one side or both
            rest -= E
            rest *= observed[c]
            E *= observed[c]
            violation += float(np.vdot(rest, rest))
            Y[c] += step * rest
            F[c] = D[c] - E + Y[c] / next_mu + unknown[c] * A[c]
            gram += F[c] @ F[c].T
        mu *= GROWTH
        if violation < (converged * size) ** 2:
            break
    return A
