"""The Capture: what it promises of its arrays, and what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gen.capture import Capture, Fault, Scale, Truth, grey
from gen.errors import InputError

K, H, W = 4, 5, 6
LIGHTS = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [-1, 0, 2.0]])


KINDS = ("sun", "point", "ambient", "area")
PLACES = np.array([[np.nan] * 3, [0, 100, 200], [np.nan] * 3, [-300, 0, 100]])


def capture(**changes: Any) -> Capture:
    rng = np.random.default_rng(1)
    given: dict[str, Any] = {
        "images": rng.random((K, H, W, 3)),
        "lights": LIGHTS,
        "mask": np.ones((H, W), bool),
        "truth": Truth(normals=np.zeros((H, W, 3), np.float32), matte=rng.random((K, H, W, 3)).astype(np.float32)),
        "source": "here",
    }
    return Capture(**{**given, **changes})


def test_defaults() -> None:
    c = capture()
    assert c.images.dtype == np.float32
    assert (c.count, c.size, c.names) == (K, (H, W), ("001", "002", "003", "004"))
    np.testing.assert_allclose(np.linalg.norm(c.lights, axis=1), 1)
    np.testing.assert_array_equal(c.intensities, np.ones((K, 3)))
    assert c.valid.all()
    assert c.scale.unit == "px"
    assert c.light_kinds == ("sun",) * K
    assert c.positions is None
    assert c.truth.names() == ["normals", "matte"]


def test_values_that_are_not_finite_become_missing() -> None:
    images = np.ones((K, H, W, 3))
    images[1, 2, 3, 0], images[2, 0, 0, 1] = np.nan, -np.inf
    faults = np.zeros((K, H, W), np.uint8)
    faults[1, 2, 3] = Fault.CLIPPED
    c = capture(images=images, faults=faults)
    assert c.faults[1, 2, 3] == Fault.MISSING | Fault.CLIPPED
    assert c.faults[2, 0, 0] == Fault.MISSING
    assert (~c.valid).sum() == 2
    assert np.isfinite(c.images).all()
    assert faults[2, 0, 0] == 0, "the caller's array is left as it was"


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"images": np.zeros((K, H, W))}, r"\(K, H, W, 3\)"),
        ({"images": np.zeros((0, H, W, 3))}, r"\(K, H, W, 3\)"),
        ({"mask": np.ones((H, W + 1), bool)}, "the mask is 7x5, the pictures are 6x5"),
        ({"mask": np.zeros((H, W), bool)}, "the mask is empty"),
        ({"lights": LIGHTS[:3]}, "3 light directions for 4 pictures"),
        ({"lights": LIGHTS[:, :2]}, "three numbers"),
        ({"lights": LIGHTS * [[1], [0], [1], [1]]}, "light direction 2 has no length"),
        ({"lights": LIGHTS * [[1], [1], [np.nan], [1]]}, "light direction 3 is not finite"),
        ({"intensities": np.ones(3)}, "intensities of shape"),
        ({"intensities": np.zeros((K, 3))}, "positive"),
        ({"intensities": np.full((K, 3), np.inf)}, "finite"),
        ({"faults": np.zeros((K, H), np.uint8)}, "faults"),
        ({"names": ("a", "b")}, "2 names for 4 pictures"),
        ({"images": np.full((K, H, W, 3), np.nan)}, "not one finite value"),
        ({"truth": Truth(normals=np.zeros((H, W + 1, 3), np.float32))}, "truth 'normals'"),
        ({"truth": Truth(matte=np.zeros((K - 1, H, W, 3), np.float32))}, "truth 'matte'"),
        ({"truth": Truth(mirror=np.zeros((K - 1, H, W, 3), np.float32))}, "truth 'mirror'"),
        ({"truth": Truth(specular_albedo=np.zeros((W, H, 3), np.float32))}, "truth 'specular_albedo'"),
        ({"light_kinds": ("sun", "point")}, "2 kinds of light for 4 pictures"),
        ({"light_kinds": ("sun", "sun", "moon", "sun")}, "light 3 is of the unknown kind 'moon'; there are sun, point, area"),
        ({"light_kinds": ("sun", "point", "sun", "sun")}, "light 2 is of the kind 'point', but has no position"),
        ({"light_kinds": KINDS, "positions": PLACES[:3]}, r"light positions of shape \(3, 3\)"),
        ({"light_kinds": KINDS, "positions": PLACES * [[1], [0], [1], [1]]}, "light 2 stands at the origin"),
        (
            {"light_kinds": KINDS, "positions": np.add(PLACES, [[0], [np.inf], [0], [0]])},
            "light 2 is of the kind 'point', but has no",
        ),
        ({"light_kinds": KINDS, "positions": np.ones((K, 3))}, "light 1 has a position, but is of the kind 'sun'"),
        ({"positions": PLACES}, "light 2 has a position, but is of the kind 'sun'"),
    ],
)
def test_contradictions_are_refused_in_one_line(changes: dict[str, Any], why: str) -> None:
    with pytest.raises(InputError, match=why) as error:
        capture(**changes)
    assert str(error.value).startswith("here: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("shape", [(K,), (K, 1), (K, 3)])
def test_reflectance_divides_by_the_lights(shape: tuple[int, ...]) -> None:
    strength = 1 + np.arange(np.prod(shape)).reshape(shape)
    c = capture(intensities=strength)
    full = np.broadcast_to(strength.reshape(K, -1), (K, 3))
    np.testing.assert_allclose(c.reflectance(), c.images / full[:, None, None, :], rtol=1e-6)
    np.testing.assert_allclose(c.reflectance(np.ones_like(c.images))[2, 1, 1], 1 / full[2], rtol=1e-6)


def test_the_matte_twin_of_a_white_surface_is_the_cosine(synthetic: Callable[..., Capture]) -> None:
    """The definition of light intensity: matte = albedo * intensity * max(n.l, 0)."""
    c = synthetic(layer="matte")
    assert c.truth.normals is not None
    cosine = np.maximum(np.einsum("hwc,kc->khw", c.truth.normals, c.lights), 0)
    np.testing.assert_allclose(c.reflectance()[..., 0], 0.6 * cosine, atol=1e-6)


def test_select_takes_everything_that_belongs_to_a_picture() -> None:
    c = capture(
        intensities=np.arange(1.0, 5), names=tuple("abcd"), faults=np.arange(K * H * W, dtype=np.uint8).reshape(K, H, W) % 3
    )
    part = c.select([2, 0])
    assert part.names == ("c", "a")
    np.testing.assert_array_equal(part.images, c.images[[2, 0]])
    np.testing.assert_array_equal(part.lights, c.lights[[2, 0]])
    np.testing.assert_array_equal(part.intensities[:, 0], [3, 1])
    np.testing.assert_array_equal(part.faults, c.faults[[2, 0]])
    assert part.truth.matte is not None
    assert c.truth.matte is not None
    np.testing.assert_array_equal(part.truth.matte, c.truth.matte[[2, 0]])
    assert part.truth.normals is c.truth.normals
    with pytest.raises(InputError, match="there is no picture 5; it has pictures 1 to 4"):
        c.select([0, 4])
    with pytest.raises(InputError, match="no picture 0"):
        c.select([-1])
    with pytest.raises(InputError, match="twice"):
        c.select([1, 1])
    with pytest.raises(InputError):
        c.select([])


def test_lights_keep_their_kind_and_place() -> None:
    mirror = np.arange(K, dtype=np.float32).reshape(K, 1, 1, 1) * np.ones((1, H, W, 3), np.float32)
    c = capture(
        light_kinds=KINDS,
        positions=PLACES,
        truth=Truth(mirror=mirror, specular_albedo=np.ones((H, W, 3), np.float32)),
        provenance={"true_lights": [[0, 0, k] for k in (1, 2, 3, 4)], "other": [1, 2, 3, 4]},
    )
    part = c.select([3, 0])
    assert part.light_kinds == ("area", "sun")
    np.testing.assert_array_equal(part.positions, PLACES[[3, 0]])
    np.testing.assert_array_equal(part.truth.mirror, mirror[[3, 0]])
    assert part.truth.specular_albedo is c.truth.specular_albedo
    assert part.provenance == {"true_lights": [[0, 0, 4], [0, 0, 1]], "other": [1, 2, 3, 4]}
    other = c.with_images(mirror)
    assert other.light_kinds == KINDS
    np.testing.assert_array_equal(other.positions, PLACES)
    assert c.select([0, 2]).positions is None


def test_with_images_keeps_the_faults_unless_told() -> None:
    c = capture(faults=np.full((K, H, W), Fault.DARK, np.uint8))
    assert c.truth.matte is not None
    np.testing.assert_array_equal(c.with_images(c.truth.matte).faults, c.faults)
    assert c.with_images(c.truth.matte, np.zeros((K, H, W), np.uint8)).valid.all()


def test_grey_is_the_luma() -> None:
    np.testing.assert_allclose(grey(np.eye(3)[None]), [[0.2989, 0.5870, 0.1140]])
    assert grey(np.ones((2, 4, 5, 3), np.float32)).dtype == np.float32
    assert grey(np.ones((2, 4, 5, 3))).shape == (2, 4, 5)


def test_scale() -> None:
    camera = np.array([[2000, 0, 100], [0, 2000, 90], [0, 0, 1.0]])
    assert Scale(mm_per_pixel=0.5).metres_per_pixel == pytest.approx(0.0005)
    assert Scale(camera=camera, distance_mm=1000).metres_per_pixel == pytest.approx(0.0005)
    assert [Scale().unit, Scale(camera=camera).unit, Scale(mm_per_pixel=1).unit] == ["px", "px", "m"]
    for wrong in ({"mm_per_pixel": 0}, {"mm_per_pixel": np.nan}, {"distance_mm": -1}, {"camera": np.eye(4)}, {"camera": -camera}):
        with pytest.raises(InputError):
            Scale(**wrong)


def test_a_capture_made_from_another_is_checked_too() -> None:
    with pytest.raises(InputError, match="empty"):
        replace(capture(), mask=np.zeros((H, W), bool))
