"""The depth of one view: the coarse, absolute form from stereo, the fine form from photometric normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gen.capture import grey
from gen.srgb import linear_to_srgb
from recon.height.quadratic import quadratic
from recon.multiview.stereo import Picture
from recon.multiview.views import OPENCV, Bools, Floats, View
from recon.reconstruct import Settings, reconstruct
from recon.registry import GLOSS, Normals

REACH = 5.0
"""Pixels: forms wider than this follow the stereo depth, narrower ones the normals. Of 5, 8, 12 and 25 the best on the preset
multiview-ring, with every remover: the normals' slow drift after gloss removal costs more than stereo's noise."""

CARRIED = 6
"""Pixels from the nearest stereo depth to which the normals carry the surface on."""

STEEP = 0.3
"""Cosine toward the camera under which a stereo depth is not relied on: matched blocks reach over the object's rim there."""

ROUNDS = 3
"""Times that the surface is solved for, each time without the stereo depths that the one before is far from."""

OUTLYING = 3.0
"""Median deviations of the stereo depth from the surface beyond which it is left out in the next round."""

WHITE = 99.0
"""Percentile of a view's albedo that becomes white in the picture that is matched."""


@dataclass(frozen=True, eq=False)
class Surface:
    """What is known of the surface from one view, on its pixels.

    depth: (H, W) mm along the optical axis, NaN where unknown. normal: (H, W, 3) camera frame, zero where unknown. albedo: (H, W, 3).
    """

    depth: Floats
    normal: Floats
    albedo: Floats

    def facing(self, view: View) -> Floats:
        """(H, W) cosine between the normal and the direction to the camera, 0 where unknown."""
        toward = -view.rays() @ OPENCV
        cosine = np.einsum("hwk,hwk->hw", self.normal, toward) / np.linalg.norm(toward, axis=-1)
        return np.maximum(cosine, 0).astype(np.float32)


def photometric(view: View, settings: Settings) -> Normals:
    """Normals and albedo of a view by photometric stereo, after gloss removal and repair. Raises InputError as `reconstruct` does."""
    return reconstruct(view.capture, GLOSS.load(settings.gloss)(view.capture), settings).normals


def matching_picture(view: View, albedo: Floats) -> Picture:
    """The albedo (H, W, 3) as 8-bit grey (H, W), 0 outside the mask: the one picture that turning the object does not change.

    Shading would: the lights stand still and the object turns, or the other way about. Every view is scaled to its own white.
    """
    value = np.where(view.capture.mask, grey(albedo), 0)
    white = float(np.percentile(value[view.capture.mask], WHITE)) or 1.0
    encoded = linear_to_srgb(np.clip(value / white, 0, 1))
    return np.rint(255 * encoded).astype(np.uint8)


def refined(view: View, depth: Floats, normals: Normals, reach: float = REACH) -> Floats:
    """The depth (H, W) in mm whose fine form is that of the normals and whose form wider than `reach` pixels is that of `depth`.

    depth: (H, W) mm, NaN where stereo found none: there the normals carry it on for up to `CARRIED` pixels, and all else stays NaN. It
    is one sparse least-squares problem in the logarithm of depth, solved again without the stereo depths that turn out to lie far off.
    Source: Nehab et al., "Efficiently Combining Positions and Normals for Precise 3D Geometry" (2005), with the equations of
    `recon.height.quadratic`; the rounds are our own.
    """
    surface = Surface(depth, normals.normal, normals.albedo)
    known = np.isfinite(depth) & normals.measurable & (surface.facing(view) >= STEEP)
    inside = _reached(normals.measurable & view.capture.mask, known)
    distance = view.capture.scale.distance_mm or 0.0
    for _ in range(ROUNDS):
        if not known.any():
            return np.full(depth.shape, np.nan, np.float32)
        reference = np.where(known, (distance - depth) / 1000, np.nan).astype(np.float32)
        height = quadratic(normals.normal, inside, view.capture.scale, reference=reference, reach=reach).height
        found = (distance - 1000 * height).astype(np.float32)
        off = np.abs(np.where(known, found - depth, 0))
        known &= off <= OUTLYING * max(float(np.median(off[known])), 1e-6 * distance)
    return np.where(_reached(inside, known), found, np.nan).astype(np.float32)


def _reached(inside: Bools, known: Bools) -> Bools:
    """The pixels of `inside` at most `CARRIED` steps, from pixel to pixel inside, away from a known one."""
    from scipy.ndimage import binary_dilation

    reached: Bools = binary_dilation(inside & known, mask=inside, iterations=CARRIED)
    return reached
