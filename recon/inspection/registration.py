"""One step of rigid registration: the residuals of heights and outlines, and how they change as the nominal moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon.inspection.measured import Measured
from recon.inspection.nominal import Surface
from recon.inspection.pose import Pose
from recon.inspection.regions import outline, regions
from recon.inspection.view import Bools, Doubles, Seen, View, faces_seen, struck

FINER = 3
"""Parts a pixel is cut into for the nominal's outline, so that it moves in thirds of a pixel. Odd: a part's middle is the pixel's."""

TRIMMED = 0.9
"""Share of the correspondences that a step keeps, those with the smallest residuals."""

ALIKE = np.cos(np.radians(45))
"""Cosine of the angle between two normals under which a correspondence is none."""


@dataclass(frozen=True, eq=False)
class Level:
    """A measurement at one fineness. points, normal: (H, W, 3). known: (H, W). outline: (N, 2) row and column. about: (3,) the middle.
    length: half the longer side, the unit in which turns are counted."""

    points: Doubles
    normal: Doubles
    known: Bools
    view: View
    outline: Doubles
    about: Doubles
    length: float


@dataclass(frozen=True, eq=False)
class System:
    """The linearised residuals. surface, edge: (N, M) derivatives by the motion. surface_gap, edge_gap: (N,) residuals, in the
    measurement's unit. nominal: what is seen. region: (H, W), see `recon.inspection.regions`. used: (H, W) the correspondences kept."""

    surface: Doubles
    surface_gap: Doubles
    edge: Doubles
    edge_gap: Doubles
    nominal: Seen
    region: NDArray[np.int64]
    used: Bools


def level_of(measured: Measured, by: int) -> Level:
    """The measurement in blocks of `by` x `by` pixels, each the mean of its pixels where at least half of them are known."""
    view = measured.view.coarser(by)
    H, W = view.size
    pad = [(0, H * by - measured.known.shape[0]), (0, W * by - measured.known.shape[1])]
    known = np.pad(measured.known, pad).reshape(H, by, W, by)
    count = known.sum(axis=(1, 3))

    def mean(array: Doubles) -> Doubles:
        whole = np.pad(np.where(measured.known[..., None], array, 0), [*pad, (0, 0)]).reshape(H, by, W, by, 3)
        blocks: Doubles = whole.sum(axis=(1, 3)) / np.maximum(count, 1)[..., None]
        return blocks

    there = count * 2 >= by * by
    points = np.where(there[..., None], mean(measured.points), np.nan)
    normal = mean(measured.normal)
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-12)
    values = measured.points[measured.known]
    middle = (values.min(axis=0) + values.max(axis=0)) / 2
    length = float(np.ptp(values[:, :2], axis=0).max()) / 2
    return Level(points, normal * there[..., None], there, view, outline(there)[1], middle, length)


def motion_rows(points: Doubles, direction: Doubles, level: Level, free_scale: bool) -> Doubles:
    """(N, 6 or 7): how far points (N, 3) go along directions (N, 3) for a unit of turn (at `level.length`), shift and, where free, growth.

    The linearisation of point-to-plane registration. Source: Chen and Medioni, "Object modelling by registration of multiple range
    images" (1991); Rusinkiewicz and Levoy, "Efficient variants of the ICP algorithm" (2001).
    """
    arm = (points - level.about) / level.length
    rows = [np.cross(arm, direction), direction]
    if free_scale:
        rows.append(np.einsum("nk,nk->n", arm, direction)[:, None])
    return np.concatenate(rows, axis=1)


def linearise(level: Level, surface: Surface, pose: Pose, free_scale: bool, gate: float) -> System:
    """The residuals of a pose. Heights correspond along the viewing ray (Blais and Levine 1995), measured along the nominal's normal and
    free by one height in every region but the largest; outlines to the nearest point of the nominal's, along its normal in the picture.

    gate: pixels beyond which outlines do not correspond.
    """
    fine = level.view.finer(FINER)
    faces = faces_seen(surface, pose, fine)
    face = faces[FINER // 2 :: FINER, FINER // 2 :: FINER]
    inside = face >= 0
    whole = [np.zeros((*inside.shape, 3)) for _ in range(3)]
    for array, values in zip(whole, struck(surface, pose, level.view, face[inside], *np.nonzero(inside)), strict=True):
        array[inside] = values
    nominal = Seen(inside, whole[0], whole[1], whole[2], np.einsum("hwk,hwk->hw", whole[1], whole[2]))
    region = regions(nominal, level.known, level.view.step)

    alike = np.einsum("hwk,hwk->hw", nominal.normal, level.normal) > ALIKE
    used = (region > 0) & alike
    rows, gap = _heights(level, nominal, region, used, free_scale)
    if len(gap) > 20:
        kept = np.abs(gap - np.median(gap)) <= np.quantile(np.abs(gap - np.median(gap)), TRIMMED) + 1e-12
        used[used] = kept
        rows, gap = _heights(level, nominal, region, used, free_scale)
    edge, edge_gap = _outlines(level, surface, pose, faces, fine, free_scale, gate)
    return System(rows, gap, edge, edge_gap, nominal, region, used)


def _heights(level: Level, nominal: Seen, region: NDArray[np.int64], used: Bools, free_scale: bool) -> tuple[Doubles, Doubles]:
    normal, cosine = nominal.normal[used], nominal.cosine[used]
    gap = np.einsum("nk,nk->n", level.points[used] - nominal.points[used], normal)
    rows = motion_rows(nominal.points[used], normal, level, free_scale)
    both = without_pistons(np.column_stack([rows, gap]), cosine, region[used])
    return both[:, :-1], both[:, -1]


def without_pistons(columns: Doubles, cosine: Doubles, region: NDArray[np.int64]) -> Doubles:
    """Columns (N, M) of residuals along the normal, less what one height along the view for each region but the first would explain."""
    of = np.maximum(region - 1, 0)
    power = np.bincount(of, cosine**2)
    free = (np.arange(len(power)) > 0) & (power > 0)
    result = columns.copy()
    for m in range(columns.shape[1]):
        height = np.where(free, np.bincount(of, cosine * columns[:, m]) / np.where(power > 0, power, 1), 0)
        result[:, m] -= cosine * height[of]
    return result


def _outlines(
    level: Level, surface: Surface, pose: Pose, faces: NDArray[np.int64], fine: View, free_scale: bool, gate: float
) -> tuple[Doubles, Doubles]:
    from scipy.spatial import cKDTree

    pixel, at, outward = outline(faces >= 0)
    empty = np.zeros((0, 7 if free_scale else 6)), np.zeros(0)
    if not len(at) or not len(level.outline):
        return empty
    at = (at - FINER // 2) / FINER  # in pixels of the level
    away, nearest = cKDTree(at).query(level.outline, distance_upper_bound=gate)
    found = np.isfinite(away)
    if not found.any():
        return empty
    nearest = np.asarray(nearest)[found]
    points, _, toward = struck(surface, pose, fine, faces[tuple(pixel[nearest].T)], *pixel[nearest].T)
    right, up = outward[nearest, 0], -outward[nearest, 1]
    offset = level.outline[found] - at[nearest]
    length = np.full(len(points), level.view.step)
    if level.view.focal is not None:  # a pixel is longer at greater depth, and what comes nearer moves outward
        length *= (level.view.distance - points[:, 2]) / level.view.distance
    gap = (offset[:, 1] * right - offset[:, 0] * up) * length
    direction = np.stack([right, up, -(right * toward[:, 0] + up * toward[:, 1]) / toward[:, 2]], axis=1)
    kept = np.abs(gap) <= max(float(np.quantile(np.abs(gap), TRIMMED)), level.view.step)
    return motion_rows(points[kept], direction[kept], level, free_scale), gap[kept]
