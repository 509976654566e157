"""Integration for whatever comes: chords where the normals belong to one smooth surface, one-sided differences where they do not."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from gen.capture import Scale
from recon.height.bilateral import reweighted, torn_height
from recon.height.edges import REACH, Domain, Doubles, Floats, anchor_of, domain_of, height_of
from recon.height.large import Ragged, Sheet, is_large
from recon.height.quadratic import least_squares, smooth_height
from recon.registry import Height

GAP = 0.05
"""Pixels along the normal by which the four chords around a square may fail to close on a smooth surface."""

OUTLYING = 5.0
"""Multiples of the median gap above which a square does not close: noise in the normals opens all squares alike, a step only its own."""


def adaptive(
    normal: Floats, mask: NDArray[np.bool_], scale: Scale, *, reference: Floats | None = None, reach: float = REACH
) -> Height:
    """Quadratic on smooth surfaces, bilateral where the normals do not close around a square of pixels: the one for all captures.

    The chords of `quadratic` around four neighbouring pixels add up to zero on any smooth surface, and do not at steps and
    self-occlusions. Where they all do, this is `quadratic`. Else the edges of the squares that do not, and those next to them, are
    weighted as in `bilateral`; the others keep the chord.

    Arguments, Height and errors as in `recon.height.quadratic.quadratic`.
    Source: the two it is made of, which see; the test by closure is worked out here.
    """
    if is_large(mask, reference):
        with suppress(Ragged):
            sheet = Sheet(normal, mask, scale)
            open_ = sheet.torn(GAP, OUTLYING)
            return torn_height(sheet, open_) if open_.any() else smooth_height(sheet)
    domain = domain_of(normal, mask, scale)
    anchor = anchor_of(domain, reference, reach)
    chords = domain.chords()
    smooth = ~torn(domain, chords)
    if smooth.all():
        return height_of(domain, least_squares(domain, chords, anchor), anchor)
    return height_of(domain, reweighted(domain, anchor, smooth), anchor)


def torn(domain: Domain, chords: Doubles) -> NDArray[np.bool_]:
    """(E,) the edges of squares whose chords do not close, and of the squares next to those."""
    from scipy.ndimage import maximum_filter

    H, W = domain.inside.shape
    r = domain.right
    focal = 1.0 if domain.rays is None else float(domain.scale.camera[0, 0])  # type: ignore[index]
    across, down = np.full((H, W), np.nan), np.full((H, W), np.nan)
    across[domain.rows[domain.i[:r]], domain.columns[domain.i[:r]]] = chords[:r]
    down[domain.rows[domain.i[r:]], domain.columns[domain.i[r:]]] = chords[r:]
    gap = np.abs(across[:-1, :-1] + down[:-1, 1:] - across[1:, :-1] - down[:-1, :-1]) * focal
    facing = np.zeros((H, W))
    facing[domain.inside] = domain.cosines()
    gap *= np.minimum(np.minimum(facing[:-1, :-1], facing[1:, 1:]), np.minimum(facing[:-1, 1:], facing[1:, :-1]))
    whole = np.isfinite(gap)
    if not whole.any():
        return np.zeros(len(chords), bool)
    open_ = np.zeros((H, W), bool)
    open_[:-1, :-1] = whole & (gap > max(GAP, OUTLYING * float(np.median(gap[whole]))))
    near = maximum_filter(open_, size=4)
    found = near[domain.inside]
    result: NDArray[np.bool_] = found[domain.i] | found[domain.j]
    return result
