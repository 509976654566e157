"""Photometric stereo under a coat: least squares that undoes the dimming of the substrate's base."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gen.capture import grey
from recon.conditioning import leave_out, require_spanning_lights
from recon.normals.least_squares import assemble, solve
from recon.registry import Normals

Doubles = NDArray[np.float64]

ROUNDS = 30
"""Most rounds of the fixed point; most pixels come to rest in ten."""
STEP = 0.5
"""Share of a round's change that is taken; the rest damps the oscillation between too steep and too flat."""
SETTLED = 1e-5
"""Change of a unit normal in a round at which a pixel is done, in radians."""
RESTLESS = 1e-2
"""Change in the last round, in radians, above which a pixel has not come to rest."""
GRAZING = 0.05
"""Cosine toward light or viewer under which the dimming is taken as at this cosine: below, dividing by it would amplify noise."""


def coat(reflectance: NDArray[np.float32], lights: Doubles, mask: NDArray[np.bool_], weights: NDArray[np.float32]) -> Normals:
    """Least squares on samples freed of the dimming that a coat gives its base (the substrate's diffuse layer).

    The layer is 28/23 Rd (1 - Rs) [1 - (1 - mi/2)^5] [1 - (1 - mo/2)^5] mi, with mi = n.l and mo = n.v, seen along +z. Starting from
    plain least squares, each round divides the samples by the bracketed factors at the present normal and solves again; half of the
    change is taken, because whole steps oscillate. A sample that the present normal turns away from its light lies in attached shadow:
    it is left out where the others still determine the normal; where they do not, every sample stays, divided by the factor at a
    grazing angle. Pixels where the rounds do not come to rest keep the plain solution.

    reflectance: (K, H, W, 3) radiance over light intensity, of the diffuse layer. lights: (K, 3) unit. mask: (H, W). weights:
    (K, H, W), not negative.
    Returns Normals; the albedo is Rd (1 - Rs), by channel. Uncertainty follows from the residual and the derivatives of the
    dimmed samples, as in any regression; pixels that did not come to rest carry that of the plain fit.
    Raises InputError where the lights cannot determine a normal.
    Source: the layer is Ashikhmin and Shirley, "An anisotropic Phong BRDF model" (2000), in the form of Pharr, Jakob and Humphreys,
    "Physically Based Rendering", 3rd edition, Eq. 8.20; the damped fixed point is worked out here.
    """
    require_spanning_lights(lights, "--normals coat")
    samples = reflectance[:, mask]
    w = weights[:, mask]
    y = grey(samples)
    plain, plain_uncertainty, measurable = solve(y, lights, w)
    n = _unit(plain)
    moving = measurable.copy()
    change = np.zeros(len(n))
    for _ in range(ROUNDS):
        at = np.flatnonzero(moving)
        if not at.size:
            break
        bright, counted = undimmed(y[:, at], n[at], lights, w[:, at])
        after = _unit(n[at] + STEP * (_unit(solve(bright, lights, counted)[0]) - n[at]))
        change[at] = np.linalg.norm(after - n[at], axis=1)
        n[at] = after
        moving[at] = change[at] > SETTLED
    bright, counted = undimmed(y, n, lights, w)
    b, _, solved = solve(bright, lights, counted)
    uncertainty = _uncertainty(y, lights, counted, b)
    restless = measurable & ((change > RESTLESS) | ~solved | (b[:, 2] <= 0))
    b[restless], uncertainty[restless] = plain[restless], plain_uncertainty[restless]
    counted[:, restless] = w[:, restless]
    factor = np.where(restless, 1, dimming(np.maximum(lights @ _unit(b).T, GRAZING), np.maximum(_unit(b)[:, 2], GRAZING)))
    return assemble(b, samples / factor[..., None].astype(np.float32), lights, counted, uncertainty, measurable, mask)


def dimming(cos_i: Doubles, cos_o: Doubles) -> Doubles:
    """28/23 [1 - (1 - mi/2)^5] [1 - (1 - mo/2)^5]: what the coat leaves of a Lambertian base. Both cosines positive, any shape."""
    return 28 / 23 * (1 - (1 - 0.5 * cos_i) ** 5) * (1 - (1 - 0.5 * cos_o) ** 5)


def undimmed(
    y: NDArray[np.float32], n: Doubles, lights: Doubles, w: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Samples (K, P) over their dimming at the normals n (P, 3), and weights (K, P) that leave out what lies in attached shadow.

    Where the lit samples alone would not determine the normal all weights stay.
    """
    mi = lights @ n.T
    factor = dimming(np.maximum(mi, GRAZING), np.maximum(n[:, 2], GRAZING))
    return (y / factor).astype(np.float32), leave_out(w, mi <= 0, lights)


def _uncertainty(y: NDArray[np.float32], lights: Doubles, w: NDArray[np.float32], b: Doubles) -> Doubles:
    """Standard deviation of the normal's angle in degrees (P,), from the residual and the derivatives of the dimmed samples at b.

    NaN with three samples, or where the derivatives are singular.
    """
    n = _unit(b)
    length = np.linalg.norm(b, axis=1)
    mi, mo = np.maximum(n @ lights.T, GRAZING), np.maximum(n[:, 2:], GRAZING)
    factor = dimming(mi, mo)
    by_i = factor + mi * 28 / 23 * 2.5 * (1 - 0.5 * mi) ** 4 * (1 - (1 - 0.5 * mo) ** 5)
    by_o = mi * 28 / 23 * 2.5 * (1 - 0.5 * mo) ** 4 * (1 - (1 - 0.5 * mi) ** 5)
    toward_light = lights[None] - mi[..., None] * n[:, None]
    toward_viewer = np.array([0.0, 0.0, 1.0]) - mo * n
    slope = (mi * factor)[..., None] * n[:, None] + by_i[..., None] * toward_light + by_o[..., None] * toward_viewer[:, None]
    normal_matrix = np.einsum("kp,pki,pkj->pij", w, slope, slope, optimize=True)
    residual = (w * (y - (length * (mi * factor).T)) ** 2).sum(axis=0)
    freedom = (w > 0).sum(axis=0) - 3
    regular = np.linalg.det(normal_matrix) > 1e-9 * np.trace(normal_matrix, axis1=1, axis2=2) ** 3
    covariance = np.linalg.inv(np.where(regular[:, None, None], normal_matrix, np.eye(3)))
    across = np.trace(covariance, axis1=1, axis2=2) - np.einsum("pi,pij,pj->p", n, covariance, n, optimize=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.sqrt(residual / freedom * np.maximum(across, 0)) / length
    result: Doubles = np.where(regular & (freedom > 0), np.degrees(np.arctan(spread)), np.nan)
    return result


def _unit(b: Doubles) -> Doubles:
    length = np.linalg.norm(b, axis=1, keepdims=True)
    result: Doubles = b / np.where(length > 0, length, 1)
    return result
