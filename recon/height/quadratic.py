"""Quadratic integration over a mask: one sparse least-squares problem, orthographic or perspective."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from gen.capture import Scale
from recon.height.edges import (
    REACH,
    Anchor,
    Domain,
    Doubles,
    Floats,
    anchor_of,
    domain_of,
    height_of,
    right_side,
)
from recon.height.large import Ragged, Sheet, is_large
from recon.height.multigrid import GridSystem
from recon.registry import Height

TOLERANCE = 1e-7
"""Residual, relative to the right-hand side, at which the linear system counts as solved: heights are then right to 1e-8 of their range."""


def quadratic(
    normal: Floats, mask: NDArray[np.bool_], scale: Scale, *, reference: Floats | None = None, reach: float = REACH
) -> Height:
    """Least squares on the chords between neighbours, over the mask; perspective where the scale has a camera K.

    For neighbours i and j with points P the chord is taken perpendicular to the sum of the two unit normals, (P_j - P_i) . (n_i +
    n_j) = 0, which is exact on every sphere and circular cylinder and of third order elsewhere. Each such equation is linear in
    the heights (orthographic) or in the logarithms of the depths (perspective). An edge weighs the product of the two squared
    cosines toward the viewer:
    that is the inverse variance of its slope when the normals err by the same angle everywhere, so steep, ill-defined edges count
    little.

    normal: (H, W, 3) unit; pixels of length zero count as outside. mask: (H, W). scale: see `gen.capture.Scale`.
    reference: (H, W) a coarse height or a plane in the unit of the result, NaN where unknown; forms wider than `reach` pixels follow it.
    Returns Height, mean zero in every connected part of the mask that the reference does not hold, in metres where the scale is
    known, else in pixels.
    Raises InputError where nothing can be integrated.
    Source: quadratic integration as surveyed by Queau, Durou and Aujol, "Normal Integration: A Survey" (2018), section 3.3;
    log-depth for perspective, their Eq. 12. The chord equation and the weights are worked out here.
    """
    if is_large(mask, reference):
        with suppress(Ragged):
            return smooth_height(Sheet(normal, mask, scale))
    domain = domain_of(normal, mask, scale)
    anchor = anchor_of(domain, reference, reach)
    return height_of(domain, least_squares(domain, domain.chords(), anchor), anchor)


def smooth_height(sheet: Sheet) -> Height:
    """`quadratic` of a large map."""
    sheet.chords()
    sheet.solve(TOLERANCE)
    return sheet.height()


def least_squares(domain: Domain, rise: Doubles, anchor: Anchor | None) -> Doubles:
    """Minimise sum w (z_j - z_i - rise)^2, w by the cosines, and the pull of the reference, over the unknowns z (P,)."""
    toward = domain.cosines()
    weight: Doubles = np.square(toward[domain.i] * toward[domain.j])
    right = right_side(domain, weight * rise, anchor)
    if not np.any(right):
        return np.zeros(len(right))
    system = GridSystem(domain, None if anchor is None else anchor.pull)
    system.weigh(weight)
    return system.solve(right, np.zeros(domain.count), TOLERANCE)
