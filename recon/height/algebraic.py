"""Algebraic multigrid: for matrices whose edges make no grid, and for grids that are too ragged for `recon.height.multigrid`."""

from __future__ import annotations

from typing import Any

import numpy as np

from recon.height.edges import Doubles


def hierarchy(A: Any) -> Any:
    """The solver of a sparse, symmetric, positive definite matrix: classical algebraic multigrid (Ruge and Stueben), linear time."""
    import pyamg
    from scipy import sparse

    return pyamg.ruge_stuben_solver(sparse.csr_matrix(A), max_coarse=500, coarse_solver="splu")


def settled(A: Any, right: Doubles, start: Doubles, solver: Any, tolerance: float) -> tuple[Doubles, int]:
    """The solution from a start by conjugate gradients, and how many steps it took.

    solver: the `hierarchy` of this matrix or one like it. tolerance: of the residual, relative to the right side. Where that is far from
    reached, a direct solver ends it, which is slow and sure.
    """
    from scipy.sparse.linalg import cg, spsolve

    steps = 0

    def count(_: Doubles) -> None:
        nonlocal steps
        steps += 1

    solution, _ = cg(A, right, x0=start, rtol=tolerance, maxiter=200, M=solver.aspreconditioner(cycle="V"), callback=count)
    if np.linalg.norm(right - A @ solution) > 100 * tolerance * np.linalg.norm(right):
        solution = spsolve(A.tocsc(), right)
    return solution, steps
