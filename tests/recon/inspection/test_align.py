"""Poses that are known, and motions that nothing determines."""

from __future__ import annotations

import numpy as np
import pytest

from gen.errors import InputError
from recon.inspection.align import Alignment, align
from recon.inspection.pose import Pose, initial_rotation, rotation_of, vector_of
from tests.recon.inspection.parts import seen_part, surface


def degrees(alignment: Alignment, true: Pose) -> float:
    return float(np.degrees(np.linalg.norm(vector_of(alignment.pose.rotation @ true.rotation.T))))


def test_a_pose_is_found_from_nowhere() -> None:
    """A blade has no symmetry: the pose is the true one, whatever it was, though the height drifts by half a millimetre."""
    nominal = surface("turbine_blade")
    measured, true, step = seen_part(nominal, rotation_of(np.array([0.5, -0.9, 1.9])), 80, bowl=0.3)
    found = align(measured, nominal)
    assert degrees(found, true) < 0.7
    assert np.abs(found.pose.translation - true.translation)[:2].max() < 0.2 * step
    assert found.pose.scale == 1
    assert found.free == ()
    assert found.alternatives == ()


@pytest.mark.parametrize("unit", ["m", "px"])
def test_a_pose_is_refined_to_a_fraction_of_a_pixel(unit: str) -> None:
    nominal = surface("rounded_box")
    R = rotation_of(np.array([0.3, 0.4, 0.2]))
    measured, true, _ = seen_part(nominal, R, unit=unit)
    found = align(measured, nominal, rotation_of(np.array([0.05, -0.08, 0.1])) @ R)
    assert degrees(found, true) < 0.15
    assert found.pose.scale == pytest.approx(true.scale, rel=2e-3)
    assert np.abs(found.pose.translation - true.translation)[:2].max() < 0.15 * measured.view.step
    assert found.covered > 0.97
    assert found.likeness > 0.95


def test_a_cylinder_turns_about_its_axis() -> None:
    nominal = surface("cylinder")
    R = rotation_of(np.array([0.3, 0.1, 0.5]))
    measured, true, _ = seen_part(nominal, R, 80)
    found = align(measured, nominal, R)
    assert len(found.free) == 1
    assert "turn freely about the axis" in found.free[0]
    axis = np.array([float(v) for v in found.free[0].split("(")[1].split(")")[0].split(",")])
    assert abs(axis @ R[:, 1]) == pytest.approx(1, abs=0.01)  # the shape's axis is y
    assert abs(found.pose.rotation[:, 1] @ true.rotation[:, 1]) > np.cos(np.radians(0.5))


def test_a_sphere_turns_about_every_axis() -> None:
    measured, _, step = seen_part(surface("sphere"), np.eye(3), 80)
    found = align(measured, surface("sphere"), np.eye(3))
    assert len(found.free) == 3
    assert all("turn freely" in sentence for sentence in found.free)
    assert np.abs(found.pose.translation - [0.7, -0.4, 0]).max() < 0.2 * step


def test_a_regular_part_fits_in_several_ways() -> None:
    """A plate with six bolt holes, seen along its axis: six turns, and their mirror images through the middle."""
    nominal = surface("flange")
    measured, _, _ = seen_part(nominal, rotation_of(np.array([0.1, 0.2, 0.0])), 80)
    found = align(measured, nominal)
    assert found.free == ()
    assert found.alternatives
    assert all(min(abs(a - b) for b in (60, 120, 180)) < 5 for a in found.alternatives)


def test_another_part_is_refused_or_said_to_be_unlike() -> None:
    measured, _, _ = seen_part(surface("hexagonal_bolt"), np.eye(3), 64)
    small = surface("sphere", radius=0.02)
    with pytest.raises(InputError, match="unit"):
        align(measured, small, np.eye(3))


def test_initial_poses_by_hand() -> None:
    assert initial_rotation("0,0,90") @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert initial_rotation("90,0,90") @ [0, 1, 0] == pytest.approx([0, 0, 1])  # about x first, then z
    for wrong in ("", "1,2", "1,2,x", "1,2,nan"):
        with pytest.raises(InputError, match="--initial-pose"):
            initial_rotation(wrong)
