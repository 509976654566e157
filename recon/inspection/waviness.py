"""Parting a height difference by wavelength: the areal filters of surface texture, inside a mask of any form.

In the words of ISO 25178-2 the S-filter takes away what is finer than a pixel can tell, the L-filter what is longer than the cut-off; what
is left between the two is the S-L surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]
Labels = NDArray[np.int64]

SHORTEST_PIXELS = 3.0
"""Pixels of the S-filter's cut-off: three samples to the shortest wavelength, as ISO 25178-3 asks of optical instruments."""

PLAIN = float(np.sqrt(np.log(2) / 2) / np.pi)
"""Standard deviation over cut-off of the Gaussian filter that halves a wave of the cut-off's length (ISO 16610-61)."""

SECOND_ORDER = 0.7309 / float(np.sqrt(2 * np.pi))
"""The same for regression of the second order, whose constant is 0.7309 (ISO 16610-31)."""

ROUNDS = 3
"""Rounds of robust reweighting."""

LEAST_PIXELS = 100
"""Pixels of a region, the fewest that a form can be told from."""

POWERS = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]


@dataclass(frozen=True, eq=False)
class Window:
    """The part of a picture that one region takes. box: its rows and columns. inside: (h, w)."""

    box: tuple[slice, slice]
    inside: NDArray[np.bool_]


def windows(region: Labels) -> list[Window]:
    """A window for each region (1, 2, ... in (H, W)) of at least `LEAST_PIXELS`."""
    from scipy.ndimage import find_objects

    found = []
    for number, box in enumerate(find_objects(region), 1):
        if box is not None:
            rows, columns = box
            inside = region[rows, columns] == number
            if int(inside.sum()) >= LEAST_PIXELS:
                found.append(Window((rows, columns), inside))
    return found


class Regression:
    """The L-filter: Gaussian regression of the second order over one window, linear in the heights once the weights are fixed.

    At every pixel the quadric that fits its surroundings best, weighted by a Gaussian and by `weight` (h, w), gives the waviness. Planes,
    bowls and saddles pass unchanged, up to the very rim: they are form. Source: ISO 16610-31 (areal, its linear and robust forms).
    """

    def __init__(self, weight: Doubles, sigma: float) -> None:
        from scipy.fft import next_fast_len

        self.weight, self._sigma = weight, sigma
        radius = int(np.ceil(4 * sigma))
        h, w = weight.shape
        self._padded = next_fast_len(h + radius, real=True), next_fast_len(w + radius, real=True)
        self._kernels = [[self._kernel(n, radius, power) for power in range(5)] for n in self._padded]
        spectrum = self._spectrum(weight)
        moments = {(i, j): self._convolved(spectrum, i, j) for i, j in {(a + c, b + d) for a, b in POWERS for c, d in POWERS}}
        M = np.stack([[moments[a + c, b + d] for c, d in POWERS] for a, b in POWERS], axis=0)
        M = np.moveaxis(M, (0, 1), (2, 3))
        # A grain on the diagonal: where the surroundings are too narrow for a quadric, it becomes a plane or a level.
        M = M + 1e-6 * M[..., :1, :1] * np.diag([0, 1, 1, 1, 1, 1]) + 1e-12 * np.eye(6)
        first = np.zeros((*M.shape[:-2], 6, 1))
        first[..., 0, 0] = 1
        self._share = np.stack([np.linalg.solve(row, one) for row, one in zip(M, first, strict=True)])[..., 0]

    def __call__(self, heights: Doubles) -> Doubles:
        """The waviness (h, w) of heights (h, w); what has no weight is not looked at."""
        spectrum = self._spectrum(np.where(self.weight > 0, self.weight * heights, 0))
        return sum(  # type: ignore[return-value]
            self._share[..., m] * self._convolved(spectrum, a, b) for m, (a, b) in enumerate(POWERS)
        )

    def _kernel(self, length: int, radius: int, power: int) -> NDArray[Any]:
        offset = np.arange(length, dtype=np.float64)
        offset[length // 2 :] -= length
        u = offset / self._sigma
        values = np.where(np.abs(offset) <= radius, u**power * np.exp(-(u**2) / 2), 0)
        return np.fft.fft(values / self._sigma / np.sqrt(2 * np.pi))

    def _spectrum(self, array: Doubles) -> NDArray[Any]:
        from scipy.fft import rfft2

        return rfft2(array, self._padded)

    def _convolved(self, spectrum: NDArray[Any], down: int, across: int) -> Doubles:
        from scipy.fft import irfft2

        h, w = self.weight.shape
        kernel = self._kernels[0][down][:, None] * self._kernels[1][across][: self._padded[1] // 2 + 1]
        result: Doubles = irfft2(spectrum * kernel, self._padded)[:h, :w]
        return result


def robust_regression(heights: Doubles, weight: Doubles, sigma: float) -> Regression:
    """The `Regression` after reweighting by Tukey's biweight, so that a dent does not pull the waviness toward itself.

    heights, weight: (h, w). Source: ISO 16610-31 and 16610-71, with c = 4.4478 times the median residual.
    """
    filtered = Regression(weight, sigma)
    for _ in range(ROUNDS):
        gap = heights - filtered(heights)
        c = 4.4478 * float(np.median(np.abs(gap[weight > 0])))
        if not c > 0:
            break
        filtered = Regression(np.where(weight > 0, weight * np.clip(1 - (gap / c) ** 2, 1e-6, 1) ** 2, 0), sigma)
    return filtered


def mean_around(heights: Doubles, inside: NDArray[np.bool_], sigma: float) -> Doubles:
    """The S-filter, or any plain Gaussian mean over the pixels inside: heights (h, w), inside (h, w), sigma in pixels."""
    from scipy.ndimage import gaussian_filter

    weight = gaussian_filter(inside.astype(np.float64), sigma, mode="constant")
    summed = gaussian_filter(np.where(inside, heights, 0), sigma, mode="constant")
    return np.where(inside, summed / np.maximum(weight, 1e-12), 0)
