"""What the uncertainty of the normals does to heights: seeded draws of their errors, integrated as the normals themselves are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gen.capture import Scale
from recon.height.algebraic import hierarchy
from recon.height.edges import domain_of, normal_equations, right_side
from recon.inspection.measured import Measured
from recon.inspection.view import Doubles

DRAWS = 12
"""Draws of the error. The spread of twelve is right to a fifth; `recon.inspection.deviation` pools it over neighbours."""

WORST_DEGREES = 30.0
"""A normal that is less certain than this is not believed to be even that uncertain: the linear road from angle to height ends here."""

TOLERANCE = 1e-4
"""Residual of the linear solves: far finer than a spread can be known."""


def height_errors(measured: Measured, draws: int = DRAWS, seed: int = 0) -> Iterator[Doubles]:
    """Draws (H, W) of the error of the heights, in the measurement's unit, 0 where nothing was measured.

    Each pixel's normal is turned by a random angle whose root mean square is its uncertainty (the median's where none is stated), and the
    change of the chords between neighbours is integrated by the least squares of `recon.height.quadratic`. How the errors of neighbours
    hang together is not known, so every octave of wavelength, from two pixels to the extent of what was measured, is given the same share
    of the variance. By itself a wave of slope s and length L has the height s L / (2 pi): the long waves make the spread, which is why form
    is not measured. Errors that all pixels share, such as a light that is off, come on top and are not drawn.
    """
    known = measured.known
    domain = domain_of(measured.normal.astype(np.float32), known, Scale())
    toward = domain.cosines()
    weight = np.square(toward[domain.i] * toward[domain.j])
    solver = hierarchy(normal_equations(domain, weight))
    chords = domain.chords()
    sigma = measured.uncertainty[domain.inside]
    sigma = np.where(np.isfinite(sigma), sigma, np.nanmedian(sigma))
    sigma = np.radians(np.minimum(sigma, WORST_DEGREES)) / np.sqrt(2)  # of each of the two axes across the normal
    n = domain.normal
    across = np.cross(n, np.where(np.abs(n[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(n, across)
    H, W = known.shape
    extent = 1 + max(int(np.ptp(domain.rows)), int(np.ptp(domain.columns)))
    rng = np.random.default_rng(seed)
    for _ in range(draws):
        a, b = (scale_free_noise((H, W), extent, rng)[domain.inside] * sigma for _ in range(2))
        turned = n + a[:, None] * across + b[:, None] * other
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        change = replace(domain, normal=turned).chords() - chords
        height = np.zeros(known.shape)
        height[domain.inside] = solver.solve(right_side(domain, weight * change), tol=TOLERANCE, accel="cg", maxiter=100)
        yield height * measured.view.step


def scale_free_noise(shape: tuple[int, int], extent: int, rng: np.random.Generator) -> Doubles:
    """Gaussian noise (H, W) of variance 1, of which each octave of wavelength from 2 pixels to `extent` holds the same share."""
    from scipy.fft import irfft2, next_fast_len, rfft2, rfftfreq

    # Twice the size, so that the noise at one edge knows nothing of that at the other.
    padded = tuple(next_fast_len(2 * n, real=True) for n in shape)
    frequency = np.hypot(np.fft.fftfreq(padded[0])[:, None], rfftfreq(padded[1]))
    passed = (frequency >= 1 / extent) & (frequency <= 0.5)
    amplitude = np.where(passed, 1 / np.maximum(frequency, 1e-9), 0)
    field = irfft2(rfft2(rng.standard_normal(padded)) * amplitude, padded)
    result: Doubles = (field / field.std())[: shape[0], : shape[1]]
    return result
