"""The quick box around a shape holds the whole shape, closely, and a spec's check stays exact where the box is too large."""

from __future__ import annotations

import numpy as np
import pytest

from blender_scenes import shapes
from gen.errors import InputError
from gen.shape_extent import box, reach
from gen.spec import spec_from


@pytest.mark.parametrize("name", shapes.SHAPES)
def test_the_box_holds_the_shape_closely(name: str) -> None:
    parameters = shapes.sample(name, np.random.default_rng(2))
    corners, vertices = box(name, parameters), shapes.build(name, **parameters).vertices
    size = np.ptp(vertices, axis=0)
    assert (corners.min(axis=0) <= vertices.min(axis=0)).all()
    assert (corners.max(axis=0) >= vertices.max(axis=0)).all()
    assert (np.ptp(corners, axis=0) <= size + 0.021 * size.max()).all()
    assert len({tuple(corner) for corner in corners}) == 8


def test_refusals_are_the_shapes_own_and_types_are_told_apart() -> None:
    assert box("cylinder", {"radius": 1}).max() > 1
    with pytest.raises(ValueError, match=r"radius must be a number from .* got True"):
        box("cylinder", {"radius": True})
    with pytest.raises(ValueError, match=r"radius must be a number from .* got \[1\]"):
        box("cylinder", {"radius": [1]})
    with pytest.raises(ValueError, match="length 3 mm must be over two radii"):
        box("capsule", {"radius": 2, "length": 3})
    with pytest.raises(ValueError, match="unknown parameter size"):
        box("sphere", {"size": 2})


def test_a_camera_may_stand_between_the_shape_and_its_box() -> None:
    turn = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5)])
    assert reach("sphere", {"radius": 20}, turn) == pytest.approx(20, rel=1e-4)
    spec = {
        "name": "a", "shape": {"name": "sphere", "radius": 20}, "pose": {"rotation_degrees": [45, 30, 0], "translation_mm": [0, 0, 5]},
        "camera": {"kind": "orthographic", "width_mm": 60, "distance_mm": 25.1},
    }  # fmt: skip
    assert float((box("sphere", {"radius": 20}) @ turn).max()) > 28
    assert spec_from(spec, "x").camera.distance_mm == 25.1
    with pytest.raises(InputError, match=r"x: camera\.distance_mm: the object reaches (25|24\.99\d*) mm toward the camera"):
        spec_from({**spec, "camera": {"kind": "orthographic", "width_mm": 60, "distance_mm": 24.9}}, "x")
