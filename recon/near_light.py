"""Near lights: their directions and fall-off at every point of the surface, which is found along with the normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, grey
from gen.errors import InputError
from gen.photos.view import View
from recon.conditioning import lit
from recon.metrics import angular_error
from recon.normals.lights_per_pixel import fit
from recon.registry import Height, Integrator, Normals, Solver

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]

ROUNDS = 30
"""Most rounds between normals and heights; most captures come to rest in five to fifteen."""

SETTLED = 0.05
"""Change of the normals in a round, in degrees, under which `MOST` of them must be to have come to rest."""

MOST = 0.95
"""Share of the normals that is waited for: a few at shadows' edges may flip for ever under a robust solver."""

RESTLESS = 1.0
"""Change of a pixel's normal in the last round, in degrees, above which the pixel has not come to rest."""

PIXELS = 2000
"""Pixels that the surface's distance is fitted to: one unknown needs no more."""

CLEAR = 0.7
"""Share of the height of the lowest near light over the lens's axis up to which the surface may reach."""

FACING = 1e-3
"""Least cosine at a disc: a point in its plane or behind it gets no light, and nothing may be divided by that."""


@dataclass(frozen=True)
class NearFit:
    """How normals and heights under near lights came about.

    surface_mm: mean of the surface along z, from where the camera looks. fitted: whether the fall-off said it, or it was taken as 0.
    rounds: how many it took. change: degrees under which the last one turned `MOST` of the normals.
    """

    surface_mm: float
    fitted: bool
    rounds: int
    change: float


def places_known(capture: Capture) -> bool:
    """Whether a capture has near lights, and the scale that says where they stand over a pixel."""
    return capture.positions is not None and capture.scale.metres_per_pixel is not None


def solve_near(
    capture: Capture, reflectance: Floats, weights: Floats, solver: Solver, integrator: Integrator
) -> tuple[Normals, Height, NearFit]:
    """Normals and heights under near lights, by any solver and integrator made for distant ones.

    In turn: the surface's points give each light's direction and strength at every pixel; the samples are carried to the distant
    lights that the capture states (`carried`); the solver takes them; the integrator gives new points. The distance of the whole
    surface, which no integrator knows, is that at which the fall-off explains the samples best (`surface_distance`). It ends when the
    normals rest. At rest a matte surface is exact, and every sample's residual, which is what robust solvers go by, is that under the
    near lights. Pixels that the last round turned by more than `RESTLESS` are not measurable. In a perspective view the distance that was
    found scales the heights.

    capture: one of which `places_known` holds. reflectance: (K, H, W, 3) radiance over the light's intensity at the origin. weights:
    (K, H, W). solver, integrator: functions of `recon.registry`. Raises InputError where not one pixel is measurable.
    Source: the model and the alternation after Y. Queau, B. Durix, T. Wu, D. Cremers, F. Lauze and J.-D. Durou, "LED-based photometric
    stereo: modeling, calibration and numerical solution" (JMIV 2018), sections 2 and 3; fitting the distance, and carrying the samples
    so that every solver can serve, are worked out here.
    """
    mask = capture.mask
    samples = reflectance[:, mask].astype(np.float64)
    luma, kept = grey(samples), weights[:, mask]
    distant = np.zeros_like(reflectance)
    normals: Normals | None = None
    plane = points = _plane(capture)
    at, rounds = 0.0, 0
    while True:
        rounds += 1
        found = surface_distance(capture, points, luma, kept)
        at = at if found is None else found
        toward, fall = lighting(capture, moved(capture, points, at))
        distant[:, mask] = carried(samples / fall[..., None], toward, capture.lights, normals, mask)
        before, normals = normals, solver(distant, capture.lights, mask, weights)
        if not normals.measurable.any():
            raise InputError(f"{capture.source}: not one pixel could be measured; too few usable samples a pixel")
        height = integrator(normals.normal, normals.measurable, capture.scale)
        solved = 1000 * height.points[mask].astype(np.float64)
        points = np.where(np.isfinite(solved), solved, plane)
        turned = np.full(mask.shape, np.inf) if before is None else angular_error(before.normal, normals.normal)
        known = np.isfinite(turned)
        change = float(np.quantile(turned[known], MOST)) if known.any() else np.inf
        if change < SETTLED or rounds == ROUNDS:
            break
    resting = normals.measurable & ~(turned > RESTLESS)
    if not resting.any():
        raise InputError(
            f"{capture.source}: the normals do not come to rest: the lights are too near for the object's size; check positions and scale"
        )
    if not resting[normals.measurable].all():
        normals = _without(normals, resting)
        height = integrator(normals.normal, resting, capture.scale)
    return normals, _at_distance(capture, height, at), NearFit(at, found is not None, rounds, change)


def lighting(capture: Capture, points: Doubles) -> tuple[Doubles, Doubles]:
    """Unit directions (K, P, 3) to each light from points (P, 3) mm, and its strength there over that at the origin, (K, P).

    A point light falls with the square of the distance. A disc that faces the origin falls with the cosine of its own angle too, as one
    that is small against its distance. Distant lights are the same everywhere.
    """
    directions = np.repeat(capture.lights[:, None], len(points), axis=1)
    fall = np.ones(directions.shape[:2])
    for k, place in enumerate(() if capture.positions is None else capture.positions):
        if not np.isfinite(place).all():
            continue
        toward, reach = place - points, float(np.linalg.norm(place))
        distance = np.linalg.norm(toward, axis=1)
        directions[k] = toward / distance[:, None]
        fall[k] = (reach / distance) ** 2
        if capture.light_kinds[k] == "area":
            fall[k] *= np.maximum(directions[k] @ place / reach, FACING)
    return directions, fall


def carried(
    samples: Doubles, toward: Doubles, lights: Doubles, normals: Normals | None, mask: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Samples (K, P, 3) under light from `toward` (K, P, 3) as they were under `lights` (K, 3), by the normals and albedo known so far.

    Adds what a matte surface would gain, albedo * n.(distant - near), shadowed or not: so samples keep their residuals. None: as they are.
    """
    if normals is None:
        return samples
    n, albedo = normals.normal[mask].astype(np.float64), normals.albedo[mask].astype(np.float64)
    gain = lights @ n.T - np.einsum("kpi,pi->kp", toward, n)
    result: Doubles = samples + gain[..., None] * albedo
    return result


def surface_distance(capture: Capture, points: Doubles, luma: Doubles, weights: Floats) -> float | None:
    """Where along z the surface lies whose shape is known: mm to its mean from where the camera looks.

    Minimises the mean over some pixels of the residual, over the pixel's brightness, of least squares under each pixel's own lights:
    highlights and shadows are a minority and shift it little. points: (P, 3) mm, mean z at 0. luma, weights: (K, P).
    None where it cannot be told: under fewer than four lights a pixel, or where the best is at the end of what is possible, which is
    the object's own size down and up, clear of the lights.
    """
    from scipy.optimize import minimize_scalar

    w = np.where(lit(luma.astype(np.float32)), weights, 0).astype(np.float64)
    chosen = np.flatnonzero((w > 0).sum(axis=0) > 3)
    chosen = chosen[:: max(1, -(-len(chosen) // PIXELS))]
    if not chosen.size or capture.positions is None:
        return None
    place, y, w = points[chosen], luma[:, chosen], w[:, chosen]
    size = float(np.ptp(points[:, :2], axis=0).max())
    over = float(np.nanmin(capture.positions[:, 2])) * CLEAR - float(points[:, 2].max())
    low, high = -size, min(size, over)
    if not low < high:
        return None

    def misfit(at: float) -> float:
        toward, fall = lighting(capture, moved(capture, place, at))
        _, residual = fit(y, toward * fall[..., None], w)
        return float(np.nanmean(residual))

    found = minimize_scalar(misfit, bounds=(low, high), method="bounded", options={"xatol": 1e-4 * size})
    edge = 1e-2 * (high - low)
    return float(found.x) if low + edge < found.x < high - edge else None


def moved(capture: Capture, points: Doubles, at: float) -> Doubles:
    """Surface points (P, 3) mm whose mean z is 0, brought to `at`: along z, or where the view is perspective along the pixels' rays."""
    if capture.scale.camera is None or capture.scale.distance_mm is None:
        return points + np.array([0, 0, at])
    eye = np.array([0, 0, capture.scale.distance_mm])
    result: Doubles = eye + (points - eye) * (1 - at / capture.scale.distance_mm)
    return result


def _at_distance(capture: Capture, height: Height, at: float) -> Height:
    """The height map of a surface whose middle lies at `at`: perspective heights grow with the distance, orthographic ones do not."""
    if capture.scale.camera is None or capture.scale.distance_mm is None:
        return height
    factor = np.float32(1 - at / capture.scale.distance_mm)
    points = moved(capture, 1000 * height.points.astype(np.float64), at) / 1000
    return Height(height=height.height * factor, points=points.astype(np.float32), unit=height.unit)


def _plane(capture: Capture) -> Doubles:
    """Points (P, 3) mm where the mask's pixels see the plane z = 0."""
    rows, columns = np.nonzero(capture.mask)
    return View(capture.size, capture.scale).plane_points(columns, rows)


def _without(normals: Normals, kept: NDArray[np.bool_]) -> Normals:
    """The same, measurable only where `kept`."""
    return Normals(
        normal=normals.normal * kept[..., None],
        albedo=normals.albedo * kept[..., None],
        uncertainty=np.where(kept, normals.uncertainty, np.nan).astype(np.float32),
        measurable=normals.measurable & kept,
    )
