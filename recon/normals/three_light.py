"""Three lights, one inverse: photometric stereo as the paper writes it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.capture import grey
from gen.errors import InputError
from recon.normals.least_squares import assemble
from recon.registry import Normals


def three_light(
    reflectance: NDArray[np.float32], lights: NDArray[np.float64], mask: NDArray[np.bool_], weights: NDArray[np.float32]
) -> Normals:
    """The inverse of the 3x3 light matrix, for exactly three lights (the paper's Eq. 6 and 7).

    b = L^-1 r, normal = b / |b|, albedo = |b|, on luma; the albedo's colour is fitted to the lit samples.
    reflectance: (3, H, W, 3). lights: (3, 3). mask: (H, W). weights: (3, H, W); a pixel with a sample of weight 0 is not
    measurable.
    Uncertainty is NaN: three samples leave no residual. Raises InputError for any other number of lights, or lights in one plane.
    Source: Woodham 1980; "Removing gloss using Deep Neural Network for 3D Reconstruction", Eq. 6 and 7.
    """
    if len(lights) != 3:
        raise InputError(
            f"--normals three-light: needs exactly three pictures, there are {len(lights)}; choose them, such as --lights 1,2,3"
        )
    if np.linalg.cond(lights) > 1e4:
        raise InputError("--normals three-light: the three lights lie in one plane; choose others with --lights")
    samples = reflectance[:, mask]
    w = weights[:, mask]
    scaled = (np.linalg.inv(lights) @ grey(samples)).T
    measurable = (w > 0).all(axis=0) & (np.linalg.norm(scaled, axis=1) > 0)
    return assemble(scaled, samples, lights, w, np.full(len(scaled), np.nan), measurable, mask)
