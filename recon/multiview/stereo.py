"""Dense stereo between neighbouring views: rectification and semi-global matching by OpenCV, and what several pairs agree on.

Depths are (H, W) float32 along the optical axis in mm, NaN where unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from recon.multiview.views import OPENCV, Ball, Doubles, Floats, View

Picture = NDArray[np.uint8]

LEAST_DEGREES, MOST_DEGREES = 2.0, 40.0
"""Angles at the object between two cameras that are matched: under them depth is not determined, over them patches look too different."""

PARTNERS = 2
"""Views that each view is matched with at most, the nearest by angle."""

ENLARGED = 2.0
"""Pixels of a rectified picture to one of the view: turning a picture must not lose its detail."""

BLOCK = 5
"""Side of the matched block in rectified pixels. The penalties of semi-global matching are OpenCV's own advice for it."""

SPECKLE = 200
"""Rectified pixels: patches of one depth smaller than this are taken for chance."""

ONE_SIDE = 1.0
"""Pixels by which the disparities found from the left and from the right may differ."""

AGREED = 0.75
"""Pixels of disparity, in the view's own, within which the depths of two pairs or two views agree."""


@dataclass(frozen=True, eq=False)
class Rectified:
    """Two views turned into one plane, the second to the right of the first; `size` is the side of the square rectified pictures.

    rotations: of each view, (3, 3) from its OpenCV camera frame to the common one. projections: (3, 3) of each, equal but for the
    principal point's column, so that the ball's centre lies in the middle of both and has disparity 0. baseline: mm. reach: disparities
    run from -reach to reach.
    """

    left: View
    right: View
    rotations: tuple[Doubles, Doubles]
    projections: tuple[Doubles, Doubles]
    baseline: float
    size: int
    reach: int

    def warp(self, picture: NDArray[Any], side: int) -> NDArray[Any]:
        """A picture (H, W) of the left (side 0) or right (1) view, rectified; 0 outside."""
        import cv2

        K = (self.left, self.right)[side].K
        x, y = cv2.initUndistortRectifyMap(
            K, None, self.rotations[side], self.projections[side], (self.size, self.size), cv2.CV_32FC1
        )
        return np.asarray(cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0))

    def depth(self, disparity: Floats, side: int) -> Floats:
        """Depth of the left or right view on its own pixels from its disparity map (size, size), NaN where unknown."""
        import cv2

        view, P = (self.left, self.right)[side], self.projections[side]
        turned = view.rays() @ self.rotations[side].T
        with np.errstate(divide="ignore", invalid="ignore"):
            image = (turned / turned[..., 2:]) @ P.T
        x, y = image[..., 0].astype(np.float32), image[..., 1].astype(np.float32)
        known = np.isfinite(disparity)
        values = cv2.remap(np.where(known, disparity, 0).astype(np.float32), x, y, cv2.INTER_LINEAR, borderValue=0)
        share = cv2.remap(known.astype(np.float32), x, y, cv2.INTER_LINEAR, borderValue=0)
        shift = self.projections[0][0, 2] - self.projections[1][0, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = P[0, 0] * self.baseline / (values - shift) / turned[..., 2]
        sound = (share > 0.999) & (turned[..., 2] > 0) & (depth > 0) & view.capture.mask
        return np.where(sound, depth, np.nan).astype(np.float32)


def rectify(one: View, other: View, ball: Ball) -> Rectified:
    """Turn two views so that a point of the object lies in the same row of both.

    The common x axis is the baseline, the common z axis is the mean of the two optical axes made perpendicular to it. Raises InputError
    where the two cameras stand in one place, or one straight behind the other.
    Source: Fusiello, Trucco and Verri, "A Compact Algorithm for Rectification of Stereo Pairs" (2000).
    """
    forward = one.to_opencv[2, :3] + other.to_opencv[2, :3]
    across = one.to_opencv[0, :3] + other.to_opencv[0, :3]
    left, right = (one, other) if (other.centre - one.centre) @ across >= 0 else (other, one)
    baseline = right.centre - left.centre
    length = float(np.linalg.norm(baseline))
    x = baseline / max(length, 1e-12)
    z = forward - (forward @ x) * x
    if np.linalg.norm(z) < 0.5 or length < 1e-9:
        raise InputError(
            f"views {one.name} and {other.name}: one camera stands in the other's line of sight; they cannot be matched"
        )
    z /= np.linalg.norm(z)
    common = np.stack([x, np.cross(z, x), z])
    focal = ENLARGED * float(np.mean([view.K[i, i] for view in (left, right) for i in (0, 1)]))
    depth = float(common[2] @ (ball.centre - left.centre))
    near = depth - ball.radius
    if near <= 0:
        raise InputError(f"views {one.name} and {other.name}: a camera would stand inside the object; check the poses")
    reach = 16 * int(np.ceil(focal * length * (1 / near - 1 / depth) / 16))
    size = 2 * int(np.ceil(focal * ball.radius / near)) + 2 * reach + 4 * BLOCK
    projections = []
    for view in (left, right):
        middle = common @ (ball.centre - view.centre)
        place = (size - 1) / 2 - focal * middle[:2] / middle[2]
        projections.append(np.array([[focal, 0, place[0]], [0, focal, place[1]], [0, 0, 1]]))
    rotations = tuple(common @ (OPENCV @ view.rotation).T for view in (left, right))
    return Rectified(left, right, (rotations[0], rotations[1]), (projections[0], projections[1]), length, size, reach)


def match(pair: Rectified, pictures: tuple[Picture, Picture]) -> tuple[Floats, Floats]:
    """Depths of the left and of the right view, where the disparities found from either side agree within `ONE_SIDE`.

    pictures: 8-bit grey (H, W) of the two, gloss and shading removed, 0 outside the masks.
    Source: Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information" (2008), as OpenCV's StereoSGBM has it.
    """
    left, right = (pair.warp(picture, side) for side, picture in enumerate(pictures))
    inside = [pair.warp(view.capture.mask.astype(np.float32), side) > 0.999 for side, view in enumerate((pair.left, pair.right))]
    there = np.where(inside[0], _disparity(left, right, pair.reach), np.nan)
    # From the right: the mirrored pictures, the right one first, have the same disparities.
    back = np.where(inside[1], _disparity(right[:, ::-1], left[:, ::-1], pair.reach)[:, ::-1], np.nan)
    from_left, from_right = _agreeing(there, back, -1), _agreeing(back, there, 1)
    return pair.depth(from_left, 0), pair.depth(from_right, 1)


def _disparity(left: Picture, right: Picture, reach: int) -> Floats:
    """Disparity (H, W) of the left picture by semi-global matching, NaN where there is none."""
    import cv2

    matcher = cv2.StereoSGBM.create(
        minDisparity=-reach,
        numDisparities=2 * reach,
        blockSize=BLOCK,
        P1=8 * BLOCK**2,
        P2=32 * BLOCK**2,
        disp12MaxDiff=-1,
        uniquenessRatio=5,
        speckleWindowSize=SPECKLE,
        speckleRange=1,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    found = matcher.compute(np.ascontiguousarray(left), np.ascontiguousarray(right)).astype(np.float32) / 16
    return np.where(found >= -reach, found, np.nan).astype(np.float32)


def _agreeing(disparity: Floats, other: Floats, sign: int) -> Floats:
    """The disparities that the other picture has too, where they lead. sign: -1 from left to right, 1 back."""
    rows, columns = np.indices(disparity.shape)
    target = np.rint(columns + sign * np.nan_to_num(disparity)).astype(np.intp)
    inside = (target >= 0) & (target < disparity.shape[1]) & np.isfinite(disparity)
    answer = other[rows, np.clip(target, 0, disparity.shape[1] - 1)]
    with np.errstate(invalid="ignore"):
        return np.where(inside & (np.abs(answer - disparity) <= ONE_SIDE), disparity, np.nan).astype(np.float32)


def angle_between(one: View, other: View, ball: Ball) -> float:
    """The angle at the ball's centre between two cameras, in degrees."""
    a, b = one.centre - ball.centre, other.centre - ball.centre
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


def neighbours(views: Sequence[View], ball: Ball) -> list[tuple[int, int]]:
    """The pairs to match: each view with its `PARTNERS` nearest within the allowed angles. Raises InputError where one has none."""
    pairs: set[tuple[int, int]] = set()
    for i, view in enumerate(views):
        angles = {j: angle_between(view, other, ball) for j, other in enumerate(views) if j != i}
        near = sorted((j for j in angles if LEAST_DEGREES <= angles[j] <= MOST_DEGREES), key=angles.__getitem__)
        if not near:
            raise InputError(
                f"view {view.name}: no other view is from {LEAST_DEGREES:g} to {MOST_DEGREES:g} degrees away, the nearest is "
                f"{min(angles.values()):.1f}; take views closer together"
            )
        pairs |= {(min(i, j), max(i, j)) for j in near[:PARTNERS]}
    return sorted(pairs)


def stereo_depths(views: Sequence[View], ball: Ball, pictures: Sequence[Picture]) -> list[Floats]:
    """The depth of each view that its pairs, and the views beside it, agree on.

    pictures: 8-bit grey (H, W), see `match`. Where a view has several pairs, their mean is taken where they agree within `AGREED`
    pixels and nothing where they do not; then `agreement` is asked for. Raises InputError as `neighbours` does, and where not one depth
    was found.
    """
    pairs = neighbours(views, ball)
    found: list[list[Floats]] = [[] for _ in views]
    for i, j in pairs:
        pair = rectify(views[i], views[j], ball)
        order = (i, j) if pair.left is views[i] else (j, i)
        for k, depth in zip(order, match(pair, (pictures[order[0]], pictures[order[1]])), strict=True):
            found[k].append(depth)
    limits = _tolerances(views, ball, pairs)
    merged = [_merged(np.stack(depths), limit) for depths, limit in zip(found, limits, strict=True)]
    merged = agreement(views, ball, merged, pairs)
    if not any(np.isfinite(depth).any() for depth in merged):
        raise InputError("no two views agree on a single point: is the surface plain, or are the poses wrong?")
    return merged


def agreement(views: Sequence[View], ball: Ball, depths: Sequence[Floats], pairs: Sequence[tuple[int, int]]) -> list[Floats]:
    """The depths (H, W) that a paired view has too, within `AGREED` pixels of disparity. Of two views alone, all: there is no third."""
    if len(views) == 2:
        return list(depths)
    beside = [[j if i == k else i for i, j in pairs if k in (i, j)] for k in range(len(views))]
    limits = _tolerances(views, ball, pairs)
    return [confirmed(views[k], depths[k], [(views[j], depths[j]) for j in beside[k]], limits[k]) for k in range(len(views))]


def _tolerances(views: Sequence[View], ball: Ball, pairs: Sequence[tuple[int, int]]) -> list[float]:
    """Of each view, the mm of depth at the object that are `AGREED` pixels of disparity in its widest pair."""
    limits = []
    for k, view in enumerate(views):
        widest = max(float(np.linalg.norm(views[i].centre - views[j].centre)) for i, j in pairs if k in (i, j))
        distance = float(np.linalg.norm(view.centre - ball.centre))
        limits.append(AGREED * distance**2 / float(view.K[0, 0]) / widest)
    return limits


def _merged(depths: Floats, tolerance: float) -> Floats:
    """The mean of several depth maps (N, H, W) where those that know one differ by no more than the tolerance."""
    known = np.isfinite(depths)
    count = known.sum(axis=0)
    total = np.where(known, depths, 0).sum(axis=0)
    spread = np.where(known, depths, -np.inf).max(axis=0) - np.where(known, depths, np.inf).min(axis=0)
    return np.where((count > 0) & (spread <= tolerance), total / np.maximum(count, 1), np.nan).astype(np.float32)


def confirmed(view: View, depth: Floats, others: Sequence[tuple[View, Floats]], tolerance: float) -> Floats:
    """The depths (H, W) of a view that another view has too, within the tolerance in mm, and that none sees through."""
    points = view.points(depth)
    agreed, refused = np.zeros(depth.shape, bool), np.zeros(depth.shape, bool)
    for other, known in others:
        x, y, z = other.project(points)
        seen = sampled(known, x, y)
        with np.errstate(invalid="ignore"):
            agreed |= np.abs(seen - z) <= tolerance
            refused |= seen - z > 3 * tolerance
    return np.where(agreed & ~refused, depth, np.nan).astype(np.float32)


def sampled(values: Floats, x: Doubles, y: Doubles) -> Floats:
    """The nearest pixel of (H, W) values at columns x and rows y (...), NaN outside the picture."""
    H, W = values.shape
    with np.errstate(invalid="ignore"):
        inside = (x > -0.5) & (x < W - 0.5) & (y > -0.5) & (y < H - 0.5)
    column = np.where(inside, np.rint(np.where(inside, x, 0)), 0).astype(np.intp)
    row = np.where(inside, np.rint(np.where(inside, y, 0)), 0).astype(np.intp)
    return np.where(inside, values[row, column], np.nan).astype(np.float32)
