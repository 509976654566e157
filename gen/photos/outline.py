"""Balls in pictures: the circle of a mask's contour or of the edges in a picture, and the sphere that such an outline belongs to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from gen.photos.view import Doubles, Sphere, View

NEAR_THE_CURVE = 1.5
"""Pixels from the fitted outline within which a contour point belongs to it: a mask drawn by hand wavers by about one."""

LEAST_SHARE = 0.5
"""Share of the contour that must lie on the outline. A ball on a stand, or cut by the picture's edge, keeps more than half."""

DRAWS = 300
"""Triples of points that are tried: with half of the points wrong, the chance to miss a right triple is (7/8)^300 = 4e-18."""


@dataclass(frozen=True)
class Circle:
    """A circle in a picture, pixels: centre x to the right, y down, pixel centres at integers. share: of the contour that lies on it."""

    x: float
    y: float
    radius: float
    share: float = 1.0


def contour(mask: NDArray[np.bool_]) -> Doubles:
    """Points (N, 2) x, y of the longest boundary of a mask, half-way between inside and outside, without those on the picture's border."""
    from skimage.measure import find_contours

    lines = find_contours(mask.astype(np.float32), 0.5)
    if not lines:
        return np.zeros((0, 2))
    rows, columns = max(lines, key=len).T
    height, width = mask.shape
    kept = (rows > 1) & (columns > 1) & (rows < height - 2) & (columns < width - 2)
    points: Doubles = np.stack([columns, rows], -1)[kept]
    return points


def fit_circle(points: Doubles, where: str) -> Circle:
    """The circle through most of the points (N, 2) x, y; the others may lie anywhere.

    Random triples and their circles, the one with the most points near it, and a least-squares fit of the distances to those.
    Raises InputError where the points are too few or no circle holds `LEAST_SHARE` of them.
    Source: M. Fischler, R. Bolles, "Random sample consensus", CACM 24(6), 1981.
    """
    from scipy.optimize import least_squares

    on = _consensus(points, _circles, lambda c, p: np.abs(_from_circle(c, p)), where)
    kept = points[on]
    start = np.linalg.lstsq(np.c_[2 * kept, np.ones(len(kept))], (kept**2).sum(1), rcond=None)[0]
    radius = np.sqrt(max(start[2] + start[0] ** 2 + start[1] ** 2, 1.0))
    found = least_squares(_from_circle, (start[0], start[1], radius), args=(kept,)).x
    return Circle(float(found[0]), float(found[1]), float(found[2]), float(on.mean()))


def sphere_of(
    points: Doubles, view: View, where: str, diameter_mm: float | None = None, height_mm: float | None = None
) -> Sphere:
    """The ball whose outline goes through most of the points (N, 2) x, y.

    Orthographic: a circle; the ball's middle lies height_mm (default 0) above the plane z = 0, to the viewer. Perspective: the tangent
    cone, which is an ellipse in the picture; the ball's distance follows from its diameter_mm, or else its middle is put at height_mm.
    Raises InputError where no such outline holds `LEAST_SHARE` of the points, or the diameter contradicts the scale by more than 20 %.
    """
    if view.distance is None:
        circle = fit_circle(points, where)
        (middle,), _ = view.rays(np.array([circle.x]), np.array([circle.y]))
        step = view.scale.mm_per_pixel or 1.0
        radius = circle.radius * step
        if diameter_mm is not None and view.metric and not 0.8 < 2 * radius / diameter_mm < 1.25:
            raise InputError(
                f"{where}: the ball is {2 * radius:.4g} mm wide by mm_per_pixel, but its diameter_mm says {diameter_mm:g}; correct one"
            )
        return Sphere(middle + np.array([0.0, 0.0, height_mm or 0.0]), radius, circle.share)
    _, along = view.rays(points[:, 0], points[:, 1])
    focal = float(view.scale.camera[0, 0]) if view.scale.camera is not None else 1.0
    on = _consensus(along, _cones, lambda c, p: np.abs(_angles(p, c)) * focal, where)
    axis = np.linalg.lstsq(along[on], np.ones(int(on.sum())), rcond=None)[0]
    cosine = 1 / float(np.linalg.norm(axis))
    axis = axis * cosine
    if not 0 < cosine < 1:
        raise InputError(f"{where}: no ball fits this outline; give its circle_px, or a mask of the ball alone")
    sine = np.sqrt(1 - cosine**2)
    by_height = (view.distance - (height_mm or 0.0)) / -float(axis[2])
    reach = diameter_mm / 2 / sine if diameter_mm is not None and view.metric else by_height
    return Sphere(np.array([0.0, 0.0, view.distance]) + reach * axis, float(reach * sine), float(on.mean()))


def find_circle(grey: NDArray[np.floating[Any]], where: str) -> Circle:
    """The ball in a picture (H, W), by itself: the strongest circle of its edges, refined along its radii.

    A ball must be lit all around, such as in the brightest of all pictures or in a flat picture of the room; a mirror ball in the
    dark shows no outline. Raises InputError where no circle is found.
    Source: the gradient Hough transform of OpenCV for the start.
    """
    import cv2

    top = float(np.percentile(grey, 99.5))
    if not top > 0:
        raise InputError(f"{where}: the picture is black, so no ball is found in it; give its mask or circle_px")
    height, width = grey.shape
    shrink = min(1.0, 600 / max(height, width))
    eight = (255 * np.sqrt(np.clip(grey / top, 0, 1))).astype(np.uint8)
    small = cv2.GaussianBlur(cv2.resize(eight, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), (0, 0), 1.5)
    side = min(small.shape)
    found = cv2.HoughCircles(
        small, cv2.HOUGH_GRADIENT_ALT, 1.5, side / 4, param1=100, param2=0.7, minRadius=max(8, side // 20), maxRadius=side // 2
    )
    if found is None:
        raise InputError(f"{where}: no ball is found in the picture; give its mask, or circle_px: [x, y, radius]")
    x, y, radius = (float(v) for v in found[0, 0] / shrink)
    return fit_circle(_radial_edges(grey, (x + 0.5 / shrink - 0.5, y + 0.5 / shrink - 0.5, radius)), where)


def circle_points(circle: Circle, count: int = 360) -> Doubles:
    """Points (count, 2) of a circle that is known."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack([circle.x + circle.radius * np.cos(angle), circle.y + circle.radius * np.sin(angle)], -1)


def _radial_edges(grey: NDArray[np.floating[Any]], start: tuple[float, float, float]) -> Doubles:
    """Along 360 radii, the place of the steepest change near a first circle, to a fraction of a pixel."""
    from scipy.ndimage import gaussian_filter, map_coordinates

    x, y, radius = start
    reach = np.arange(0.85 * radius, 1.15 * radius, 0.5)
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    columns, rows = x + np.outer(np.cos(angle), reach), y + np.outer(np.sin(angle), reach)
    values = map_coordinates(gaussian_filter(np.sqrt(np.maximum(grey, 0)).astype(np.float64), 1.0), [rows, columns], order=1)
    steep = np.abs(np.diff(values, axis=1))
    best = np.clip(steep.argmax(axis=1), 1, steep.shape[1] - 2)
    around = np.stack([steep[np.arange(360), best + step] for step in (-1, 0, 1)])
    bend = around[0] - 2 * around[1] + around[2]
    shift = np.where(bend < 0, 0.5 * (around[0] - around[2]) / np.where(bend < 0, bend, -1), 0)
    at = reach[0] + 0.5 * (best + 0.5 + np.clip(shift, -1, 1))
    height, width = grey.shape
    points = np.stack([x + at * np.cos(angle), y + at * np.sin(angle)], -1)
    inside = (points > 1).all(1) & (points[:, 0] < width - 2) & (points[:, 1] < height - 2)
    edges: Doubles = points[inside & (around[1] > 0.1 * np.median(around[1]))]
    return edges


def _consensus(
    points: Doubles, models: Callable[[Doubles], Doubles], distance: Callable[[Doubles, Doubles], Doubles], where: str
) -> NDArray[np.bool_]:
    """Which points lie on the best of many curves through three points each."""
    if len(points) < 20:
        raise InputError(f"{where}: the ball's outline is too short to be measured; give a larger picture of it, or circle_px")
    rng = np.random.default_rng(0)
    triples = np.stack([rng.choice(len(points), 3, replace=False) for _ in range(DRAWS)])
    best = np.zeros(len(points), bool)
    for model in models(points[triples]):
        if np.isfinite(model).all():
            on = distance(model, points) < NEAR_THE_CURVE
            if on.sum() > best.sum():
                best = on
    if best.mean() < LEAST_SHARE:
        raise InputError(
            f"{where}: only {100 * best.mean():.0f} % of the outline is a ball's; give its circle_px, or a mask of the ball alone"
        )
    return best


def _circles(triples: Doubles) -> Doubles:
    """Circles x, y, radius (N, 3) through triples (N, 3, 2) of points; NaN where they are in line."""
    a, b = triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0]
    turn = 2 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (b[:, 1] * (a**2).sum(1) - a[:, 1] * (b**2).sum(1)) / turn
        y = (a[:, 0] * (b**2).sum(1) - b[:, 0] * (a**2).sum(1)) / turn
    return np.stack([x + triples[:, 0, 0], y + triples[:, 0, 1], np.hypot(x, y)], -1)


def _from_circle(circle: Doubles, points: Doubles) -> Doubles:
    """Distances of points (N, 2) from a circle x, y, radius; negative inside."""
    distance: Doubles = np.hypot(points[:, 0] - circle[0], points[:, 1] - circle[1]) - circle[2]
    return distance


def _cones(triples: Doubles) -> Doubles:
    """Axes over the cosine of their opening, (N, 3), of the cones through triples (N, 3, 3) of unit vectors; NaN where there is none."""
    usable = np.abs(np.linalg.det(triples)) > 1e-12
    axes = np.full((len(triples), 3), np.nan)
    axes[usable] = np.linalg.solve(triples[usable], np.ones((int(usable.sum()), 3, 1)))[..., 0]
    axes[~(np.linalg.norm(axes, axis=1) > 1)] = np.nan
    return axes


def _angles(along: Doubles, axis: Doubles) -> Doubles:
    """Angles of unit vectors (N, 3) from a cone's surface."""
    length = float(np.linalg.norm(axis))
    angles: Doubles = np.arccos(np.clip(along @ axis / length, -1, 1)) - np.arccos(1 / length)
    return angles
