"""Compiled loops over pixels: the weighted 3x3 solve, those that iterate it (reweighted L1, sparse Bayesian learning), and the spread.

Pixels lie in rows, (P, K), so that a pixel's samples are neighbours in memory. Inputs are float32, everything inside float64. The loops
hold no lock, and `in_parts` spreads them over threads. Compiled code is kept on disk, so only the first call ever waits (`CACHE`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]

PACKAGE = Path(__file__).parent.parent


def sources_stamp(folder: Path) -> str:
    """A hash of all modules in a folder that hold compiled functions: it changes when one of them does."""
    texts = sorted((path.relative_to(folder).as_posix(), path.read_bytes()) for path in folder.rglob("*.py"))
    stamp = hashlib.sha256()
    for name, text in texts:
        if b"@compiled" in text:
            stamp.update(f"{name} {len(text)}\n".encode() + text)
    return stamp.hexdigest()[:16]


CACHE = Path(numba.config.CACHE_DIR or Path(__file__).parent / "__pycache__") / f"numba-{sources_stamp(PACKAGE)}"  # type: ignore[attr-defined]
"""Where compiled code is kept. By itself numba looks at a function's own module alone, and would go on with old code where a function that
is called from another module has changed. Under NUMBA_CACHE_DIR where that is set; where it cannot be written, numba keeps it in the
user's cache folder."""

numba.config.CACHE_DIR = str(CACHE)  # type: ignore[attr-defined]

PART = 4096
"""Pixels in a part: small enough to spread evenly over threads, large enough that starting one costs nothing."""

RELAXED = {"reassoc", "contract", "nsz", "arcp"}
"""What the compiler may do to sums over the samples, so that it can vectorise them. NaN and infinity keep their meaning."""

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """The function, compiled when it is first called. Where no folder can be written (see `CACHE`) it is compiled anew in each process."""

    def compiling(kept: bool) -> F:
        compile_when_called: Any = numba.njit(cache=kept, nogil=True, fastmath=RELAXED, error_model="numpy")
        result: F = compile_when_called(function)
        return result

    try:
        return compiling(kept=True)
    except RuntimeError:
        return compiling(kept=False)


def in_parts(loop: Callable[..., None], per_pixel: tuple[NDArray[Any], ...], *rest: object, part: int = PART) -> None:
    """Run loop(*per_pixel arrays, *rest) over parts of the pixels, on as many threads as numba is allowed (NUMBA_NUM_THREADS).

    per_pixel: arrays whose first axis is the pixel, inputs and outputs alike; each part gets views of its own pixels. part: pixels in one.
    """
    count = len(per_pixel[0])
    parts = [slice(start, start + part) for start in range(0, count, part)]
    if not parts:
        return

    def work(of: slice) -> None:
        loop(*(array[of] for array in per_pixel), *rest)

    work(parts[0])  # compiles, once and not in every thread
    threads = min(int(numba.config.NUMBA_NUM_THREADS), len(parts) - 1)  # type: ignore[attr-defined]
    if threads <= 1:
        for of in parts[1:]:
            work(of)
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, parts[1:]))


@compiled
def inverse(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> tuple[float, float, float, float, float, float]:
    """The inverse of a symmetric positive definite 3x3 matrix, by its LDL^T factors; both in the order xx, yy, zz, xy, xz, yz.

    Factors rather than cofactors: the weights of an iteration may differ by 1e8, where cofactors cancel.
    """
    a = xy / xx
    b = xz / xx
    d = yy - a * xy
    e = yz - a * xz
    c = e / d
    f = zz - b * xz - c * e
    # Rows of the inverse of the unit lower factor: (1), (-a, 1), (u, -c, 1).
    u = a * c - b
    i, j, k = 1 / xx, 1 / d, 1 / f
    return i + a * a * j + u * u * k, j + c * c * k, k, -a * j - u * c * k, u * k, -c * k


@compiled
def weighted(y: Floats, w: Doubles, X: Doubles, Y: Doubles, Z: Doubles) -> tuple[float, ...]:
    """sum w l l^T (six entries, in the order of `inverse`) and sum w y l (three) of one pixel. y, w, X, Y, Z: (K,)."""
    xx = yy = zz = xy = xz = yz = x = y_ = z = 0.0
    for k in range(len(w)):
        wx, wy, wz = w[k] * X[k], w[k] * Y[k], w[k] * Z[k]
        xx += wx * X[k]
        yy += wy * Y[k]
        zz += wz * Z[k]
        xy += wx * Y[k]
        xz += wx * Z[k]
        yz += wy * Z[k]
        x += wx * y[k]
        y_ += wy * y[k]
        z += wz * y[k]
    return xx, yy, zz, xy, xz, yz, x, y_, z


@compiled
def reweighted_l1(
    y: Floats, w: Floats, usable: NDArray[np.bool_], b: Doubles, L: Doubles, rounds: int, tolerance: float, smallest: float
) -> None:
    """b of min sum w |y - l.b| for every usable pixel, by iteratively reweighted least squares; other pixels are left alone.

    y, w: (P, K), y of the order of 1. usable: (P,). b: (P, 3), written. L: (3, K). A pixel stops when b changes by less than `tolerance`
    of its length, or after `rounds`. smallest: residual below which a sample's weight grows no more.
    """
    X, Y, Z = L[0], L[1], L[2]
    K = y.shape[1]
    now = np.empty(K)
    for p in range(len(y)):
        if not usable[p]:
            continue
        for k in range(K):
            now[k] = w[p, k]
        bx = by = bz = 0.0
        for _ in range(rounds):
            xx, yy, zz, xy, xz, yz, x, y_, z = weighted(y[p], now, X, Y, Z)
            xx, yy, zz, xy, xz, yz = inverse(xx, yy, zz, xy, xz, yz)
            nx = xx * x + xy * y_ + xz * z
            ny = xy * x + yy * y_ + yz * z
            nz = xz * x + yz * y_ + zz * z
            change = abs(nx - bx) + abs(ny - by) + abs(nz - bz)
            bx, by, bz = nx, ny, nz
            if change < tolerance * (abs(bx) + abs(by) + abs(bz)):
                break
            for k in range(K):
                now[k] = w[p, k] / max(abs(y[p, k] - X[k] * bx - Y[k] * by - Z[k] * bz), smallest)
        b[p, 0], b[p, 1], b[p, 2] = bx, by, bz


@compiled
def sparse_bayes(
    y: Floats,
    w: Floats,
    usable: NDArray[np.bool_],
    b: Doubles,
    L: Doubles,
    noise: float,
    prior: float,
    rounds: int,
    tolerance: float,
) -> None:
    """Sparse Bayesian learning of y = l.b + e + noise, e_k ~ N(0, gamma_k), for every usable pixel.

    y, w: (P, K), y of the order of 1; a sample's variances are divided by its weight. usable: (P,). L: (3, K). noise: variance. prior:
    variance of b's entries. b: (P, 3), written: the posterior mean. The matrix inversion lemma turns the K x K covariance of the samples
    into one 3x3 solve a round.
    """
    X, Y, Z = L[0], L[1], L[2]
    K = y.shape[1]
    gamma = np.empty(K)
    now = np.empty(K)
    for p in range(len(y)):
        if not usable[p]:
            continue
        for k in range(K):
            gamma[k] = 1.0
        bx = by = bz = 0.0
        for _ in range(rounds):
            for k in range(K):
                now[k] = w[p, k] / (gamma[k] + noise)
            xx, yy, zz, xy, xz, yz, x, y_, z = weighted(y[p], now, X, Y, Z)
            xx, yy, zz, xy, xz, yz = inverse(xx + 1 / prior, yy + 1 / prior, zz + 1 / prior, xy, xz, yz)
            nx = xx * x + xy * y_ + xz * z
            ny = xy * x + yy * y_ + yz * z
            nz = xz * x + yz * y_ + zz * z
            change = abs(nx - bx) + abs(ny - by) + abs(nz - bz)
            bx, by, bz = nx, ny, nz
            if change < tolerance * (abs(bx) + abs(by) + abs(bz)):
                break
            for k in range(K):
                share = gamma[k] / (gamma[k] + noise)
                mean = share * (y[p, k] - X[k] * bx - Y[k] * by - Z[k] * bz)
                spread = X[k] * (xx * X[k] + 2 * (xy * Y[k] + xz * Z[k])) + Y[k] * (yy * Y[k] + 2 * yz * Z[k]) + zz * Z[k] * Z[k]
                # The expected square of e_k: its posterior mean squared and its posterior variance, times the weight that divides gamma.
                gamma[k] = w[p, k] * (mean * mean + share * share * spread) + share * noise
        b[p, 0], b[p, 1], b[p, 2] = bx, by, bz


@compiled
def sort(values: Doubles, count: int) -> None:
    """Sort the first `count` values in place, by Shell's method: nearly as fast here as numpy's own, which takes seconds to compile."""
    gap = count // 2
    while gap > 0:
        for i in range(gap, count):
            value = values[i]
            j = i
            while j >= gap and values[j - gap] > value:
                values[j] = values[j - gap]
                j -= gap
            values[j] = value
        gap = 1 if gap == 2 else gap * 5 // 11


@compiled
def robust_angles(
    y: Floats, w: Floats, usable: NDArray[np.bool_], b: Doubles, angle: Doubles, L: Doubles, efficiency: float
) -> None:
    """One standard deviation of the normal's angle, in degrees, from the residuals of the samples that agree with it.

    y, w, usable, b, L: as in `reweighted_l1`. angle: (P,), written: 0 where all fits, NaN where three samples or fewer leave no residual.
    The noise is 1.4826 times the median of all absolute residuals but the three smallest, which a robust fit makes nearly 0; with few
    lights those that are left exaggerate it by (1 + 4 / (K - 3))^(1/2), which is taken out (the 4 is from simulation: for L1 and sparse
    Bayesian learning the angle is then right to some 10 per cent from 5 lights to 96). The covariance of b is
    noise^2 * efficiency * (sum w l l^T)^-1 over the samples within three times the noise. efficiency: variance of the estimator over
    that of least squares, where the noise is Gaussian.
    """
    X, Y, Z = L[0], L[1], L[2]
    K = y.shape[1]
    residual = np.empty(K)
    ordered = np.empty(K)
    agreeing = np.empty(K)
    for p in range(len(y)):
        if not usable[p]:
            continue
        bx, by, bz = b[p, 0], b[p, 1], b[p, 2]
        used = 0
        for k in range(K):
            residual[k] = np.sqrt(w[p, k]) * abs(y[p, k] - X[k] * bx - Y[k] * by - Z[k] * bz)
            if w[p, k] > 0:
                ordered[used] = residual[k]
                used += 1
        freedom = used - 3
        if freedom < 1:
            angle[p] = np.nan
            continue
        sort(ordered, used)
        median = 0.5 * (ordered[3 + (freedom - 1) // 2] + ordered[3 + freedom // 2])
        noise = 1.4826 * median * np.sqrt(freedom / (freedom + 4))
        if noise == 0:
            angle[p] = 0.0
            continue
        for k in range(K):
            agreeing[k] = w[p, k] if residual[k] <= 3 * noise else 0.0
        xx, yy, zz, xy, xz, yz, _, _, _ = weighted(y[p], agreeing, X, Y, Z)
        # A grain on the diagonal: where those that agree are too few the angle comes out near 90 degrees, not undefined.
        grain = 1e-9 * (xx + yy + zz) + 1e-12
        xx, yy, zz, xy, xz, yz = inverse(xx + grain, yy + grain, zz + grain, xy, xz, yz)
        square = bx * bx + by * by + bz * bz
        along = (bx * (xx * bx + 2 * (xy * by + xz * bz)) + by * (yy * by + 2 * yz * bz) + bz * zz * bz) / square
        across = max(xx + yy + zz - along, 0.0)
        angle[p] = np.degrees(np.arctan(noise * np.sqrt(efficiency * across / square)))


@compiled
def between_ranks(y: Floats, w: Floats, kept: Floats, low: float, high: float) -> None:
    """The weights without the darkest and the brightest samples of each pixel.

    y, w: (P, K). kept: (P, K), written. low, high: shares of the pixel's samples of weight that are left out, rounded down. Samples equal
    to one that is left out go with it, so that no order decides between them.
    """
    K = y.shape[1]
    ordered = np.empty(K)
    for p in range(len(y)):
        used = 0
        for k in range(K):
            if w[p, k] > 0:
                ordered[used] = y[p, k]
                used += 1
        sort(ordered, used)
        dark, bright = int(low * used + 1e-6), int(high * used + 1e-6)
        floor = ordered[dark - 1] if dark > 0 else -np.inf
        ceiling = ordered[used - bright] if bright > 0 else np.inf
        for k in range(K):
            kept[p, k] = w[p, k] if floor < y[p, k] < ceiling else 0.0
