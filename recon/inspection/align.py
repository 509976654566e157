"""Rigid alignment of the nominal to what was measured, and which of its motions the measurement does not determine."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from recon.inspection.coarse import likeness, start_poses, thinned
from recon.inspection.measured import Measured
from recon.inspection.nominal import Surface
from recon.inspection.pose import Doubles, Pose, vector_of
from recon.inspection.registration import Level, System, level_of, linearise
from recon.inspection.view import Bools, Seen

COARSE, MIDDLE = 48, 128
"""Pixels along the longer side at which poses are tried, and at which the best are compared."""

TRIED = 24
"""Start poses that are refined."""

FREE, FREE_OUTLINE = 2e-4, 4e-3
"""Mean squared residual that a motion causes in heights and in outlines, in its own mean square, under which neither determines it. That of
outlines is higher: their directions are told from pixels, to some three degrees."""

ALIKE = 0.02
"""Likeness by which another pose may be worse and still pass for the same fit."""

APART_DEGREES = 5.0
"""Angle from which two poses are different ones."""

SETTLED = 0.01
"""Pixels under which a step ends the refinement."""

OUTLINE_PIXELS = (0.1, 0.5)
"""Pixels, the least and the largest error that outlines are taken to have. They do not drift: where heights contradict them, they hold."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where the nominal stands, and how well that is known.

    pose: of the nominal in the camera's frame, in the measurement's unit. residual: root mean square along the normals of the
    correspondences kept, same unit. outline: root mean square distance of the outlines in pixels, NaN without any. inliers: share of the
    measured pixels that correspond. covered: share of the nominal's visible pixels that were measured. likeness: see
    `recon.inspection.coarse.likeness`. free: sentences on the motions that are not determined. alternatives: degrees from this pose to
    others that fit as well. nominal: what the view shows of it. region: (H, W), see `recon.inspection.regions`. used: (H, W).
    level: the measurement as aligned. free_scale: whether the nominal was grown to fit. surface: the nominal itself.
    """

    pose: Pose
    residual: float
    outline: float
    inliers: float
    covered: float
    likeness: float
    free: tuple[str, ...]
    alternatives: tuple[float, ...]
    nominal: Seen
    region: NDArray[np.int64]
    used: Bools
    level: Level
    free_scale: bool
    surface: Surface


def align(measured: Measured, nominal: Surface, initial: Doubles | None = None) -> Alignment:
    """The pose of the nominal in which it looks like the measurement: poses are tried, refined, compared, and the best refined fully.

    initial: (3, 3) rotation to start from instead of trying all sides. The scale is free where the measurement is in pixels. Heights
    count along the nominal's normals, outlines in the picture; both as much, since neighbouring heights err alike.
    Raises InputError where the two do not meet at all.
    Source: projective point-to-plane ICP with trimming (Chen and Medioni 1991; Blais and Levine 1995; Rusinkiewicz and Levoy 2001;
    Chetverikov et al. 2002); outlines as in contour-based tracking (Drummond and Cipolla 2002).
    """
    free_scale = measured.unit == "px"
    rough = thinned(nominal)
    coarse, middle, fine = (level_of(measured, _blocks(measured, side)) for side in (COARSE, MIDDLE, 10**9))
    starts = start_poses(coarse, rough, free_scale, initial)
    if not starts:
        raise InputError(f"{nominal.source}: does not come into view; is its unit right? It is {nominal.size:g} mm long")
    poses = [_refined(coarse, rough, pose, free_scale, 12, coarse.length / coarse.view.step / 2) for _, pose in starts[:TRIED]]
    ranked = _ranked(coarse, rough, _different(poses, None), free_scale)
    poses = [_refined(middle, rough, pose, free_scale, 8, 4.0) for _, pose in ranked[:8]]
    ranked = _ranked(middle, rough, poses, free_scale)
    best = _refined(fine, nominal, ranked[0][1], free_scale, 8, 6.0)
    found = aligned_at(measured, nominal, fine, best, free_scale)
    if found.used.sum() < 20 or ranked[0][0] < 0.05:
        raise InputError(
            f"{nominal.source}: no pose was found in which it looks like {measured.source}; is its unit right? It is {nominal.size:g} mm "
            "long; or say how it stands with --initial-pose"
        )
    free, turns = _freedom(linearise(fine, nominal, best, free_scale, 3.0), fine)
    same = [pose for score, pose in ranked if score >= ranked[0][0] - ALIKE]
    alternatives = tuple(_angle(best, pose) for pose in _different([best, *same], turns)[1:])
    return replace(found, free=free, alternatives=alternatives)


def aligned_at(measured: Measured, surface: Surface, level: Level, pose: Pose, free_scale: bool) -> Alignment:
    """What there is to say of a pose as it stands; `free` and `alternatives` are left empty."""
    system = linearise(level, surface, pose, free_scale, 3.0)
    nominal = system.nominal
    inside = nominal.inside
    edge = system.edge_gap / level.view.step
    return Alignment(
        pose=pose,
        residual=float(np.sqrt(np.mean(system.surface_gap**2))) if len(system.surface_gap) else float("nan"),
        outline=float(np.sqrt(np.mean(edge**2))) if len(edge) else float("nan"),
        inliers=float(system.used.sum() / measured.known.sum()),
        covered=float((inside & measured.known).sum() / max(int(inside.sum()), 1)),
        likeness=likeness(level, nominal),
        free=(),
        alternatives=(),
        nominal=nominal,
        region=system.region,
        used=system.used,
        level=level,
        free_scale=free_scale,
        surface=surface,
    )


def _blocks(measured: Measured, side: int) -> int:
    return max(1, round(max(measured.known.shape) / side))


def _refined(level: Level, surface: Surface, pose: Pose, free_scale: bool, rounds: int, gate: float) -> Pose:
    """At most `rounds` of Gauss and Newton. gate: pixels within which outlines correspond at first; it narrows to three."""
    for _ in range(rounds):
        system = linearise(level, surface, pose, free_scale, gate)
        if len(system.surface_gap) < 12:
            return pose
        pose, length = moved(pose, *normal_equations(system, level), level)
        gate = max(3.0, 0.6 * gate)
        if length < SETTLED:
            break
    return pose


def moved(pose: Pose, H: Doubles, g: Doubles, level: Level) -> tuple[Pose, float]:
    """The pose after a step of least squares, none along directions that nothing determines; and the step's length in pixels."""
    values, vectors = np.linalg.eigh(H)
    inverse = np.where(values > 1e-6 * values[-1], 1 / np.maximum(values, 1e-300), 0)
    step = vectors @ (inverse * (vectors.T @ g))
    turn = step[:3] / level.length
    turn *= min(1.0, 0.3 / max(float(np.linalg.norm(turn)), 1e-12))
    growth = float(np.clip(step[6] / level.length, -0.2, 0.2)) if len(step) > 6 else 0.0
    return pose.moved(turn, step[3:6], growth, level.about), float(np.abs(step).max() / level.view.step)


def normal_equations(system: System, level: Level) -> tuple[Doubles, Doubles]:
    """Heights and outlines, each over its own spread and its own number."""
    width = system.surface.shape[1]
    H, g = np.zeros((width, width)), np.zeros(width)
    for rows, gap, (least, most) in (
        (system.surface, system.surface_gap, (1e-3, np.inf)),
        (system.edge, system.edge_gap, OUTLINE_PIXELS),
    ):
        if len(gap):
            spread = float(np.clip(1.4826 * np.median(np.abs(gap)), least * level.view.step, most * level.view.step))
            H += rows.T @ rows / (len(gap) * spread**2)
            g += rows.T @ gap / (len(gap) * spread**2)
    return H, g


def _ranked(level: Level, surface: Surface, poses: list[Pose], free_scale: bool) -> list[tuple[float, Pose]]:
    from recon.inspection.view import seen

    return sorted(((likeness(level, seen(surface, pose, level.view)), pose) for pose in poses), key=lambda item: -item[0])


def _angle(a: Pose, b: Pose) -> float:
    return float(np.degrees(np.linalg.norm(vector_of(a.rotation @ b.rotation.T))))


def _different(poses: list[Pose], free_turns: Doubles | None) -> list[Pose]:
    """The poses less those that an earlier one equals, up to turns about the axes (N, 3) that are free anyway."""
    kept: list[Pose] = []
    for pose in poses:
        for other in kept:
            turn = vector_of(pose.rotation @ other.rotation.T)
            if free_turns is not None and len(free_turns):
                turn = turn - free_turns.T @ (free_turns @ turn)
            if np.degrees(np.linalg.norm(turn)) < APART_DEGREES:
                break
        else:
            kept.append(pose)
    return kept


def _freedom(system: System, level: Level) -> tuple[tuple[str, ...], Doubles]:
    """Sentences on the undetermined motions, and the axes (N, 3) of the turns among them, orthonormal.

    They are the eigenvectors of the heights' Hessian (turns counted at `level.length`) under `FREE`, and among these the eigenvectors of
    that of the outlines under `FREE_OUTLINE`. Source: Gelfand, Ikemoto, Rusinkiewicz and Levoy, "Geometrically stable sampling for the ICP
    algorithm" (2003).
    """
    heights, outlines = (rows.T @ rows / max(len(rows), 1) for rows in (system.surface, system.edge))
    values, vectors = np.linalg.eigh(heights)
    null = vectors[:, values < FREE]
    values, vectors = np.linalg.eigh(null.T @ outlines @ null)
    null = null @ vectors[:, values < FREE_OUTLINE]
    if not null.shape[1]:
        return (), np.zeros((0, 3))
    # Rotate the basis of the undetermined motions so that pure shifts come out as such.
    _, sizes, turned = np.linalg.svd(null[:3], full_matrices=True)
    sizes = np.pad(sizes, (0, null.shape[1] - len(sizes)))[: null.shape[1]]
    basis = null @ turned.T
    sentences, axes = [], []
    for size, motion in zip(sizes, basis.T, strict=True):
        turn, shift = motion[:3], motion[3:6]
        if size > 0.05:
            axis = turn / np.linalg.norm(turn)
            axes.append(axis)
            through = level.about + np.cross(turn, shift) / float(turn @ turn) * level.length
            slides = abs(float(shift @ axis)) > 0.2 * float(np.linalg.norm(turn))
            sentences.append(
                f"it can turn freely about the axis {_triple(axis)} through {_triple(through)}"
                + (", sliding along it" if slides else "")
            )
        elif len(motion) > 6 and abs(motion[6]) > 0.5:
            sentences.append("its size is not determined")
        else:
            sentences.append(f"it can slide freely along {_triple(shift / max(float(np.linalg.norm(shift)), 1e-12))}")
    return tuple(sentences), np.array(axes).reshape(-1, 3)


def _triple(values: Doubles) -> str:
    return "(" + ", ".join(f"{value + 0.0:.2f}" for value in np.round(values, 2)) + ")"
