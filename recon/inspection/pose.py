"""A pose: how the nominal stands before the camera."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError

Doubles = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """x in the camera's frame = scale * rotation @ x of the nominal + translation. rotation: (3, 3). translation: (3,)."""

    rotation: Doubles = field(default_factory=lambda: np.eye(3))
    translation: Doubles = field(default_factory=lambda: np.zeros(3))
    scale: float = 1.0

    def apply(self, points: Doubles) -> Doubles:
        """Points (N, 3) of the nominal in the camera's frame."""
        return self.scale * (points @ self.rotation.T) + self.translation

    def moved(self, turn: Doubles, shift: Doubles, growth: float, about: Doubles) -> Pose:
        """This pose turned by the rotation vector `turn` (radians) and grown by 1 + `growth` about a point, then shifted."""
        R = rotation_of(turn)
        translation = (1 + growth) * R @ (self.translation - about) + about + shift
        return Pose(R @ self.rotation, translation, self.scale * (1 + growth))

    def matrix(self) -> Doubles:
        """The same as one (4, 4) matrix."""
        M = np.eye(4)
        M[:3, :3], M[:3, 3] = self.scale * self.rotation, self.translation
        return M


def rotation_of(vector: Doubles) -> Doubles:
    """(3, 3) of a rotation vector in radians. Source: Rodrigues' formula."""
    from scipy.spatial.transform import Rotation

    matrix: Doubles = Rotation.from_rotvec(vector).as_matrix()
    return matrix


def vector_of(rotation: Doubles) -> Doubles:
    """The rotation vector (3,) in radians of a matrix."""
    from scipy.spatial.transform import Rotation

    vector: Doubles = Rotation.from_matrix(rotation).as_rotvec()
    return vector


def initial_rotation(text: str) -> Doubles:
    """The rotation of "X,Y,Z": degrees about the camera's x, then y, then z (each fixed). Raises InputError where it is not that."""
    try:
        angles = [float(part) for part in text.split(",")]
    except ValueError:
        angles = []
    if len(angles) != 3 or not np.isfinite(angles).all():
        raise InputError(f"--initial-pose {text}: must be three angles in degrees about the camera's x, y and z, such as 0,90,0")
    from scipy.spatial.transform import Rotation

    matrix: Doubles = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    return matrix
