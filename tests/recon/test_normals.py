"""Photometric stereo against closed forms: exact on Lambertian samples, whatever the name of the solver."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from gen.capture import Capture
from gen.errors import InputError
from recon.conditioning import MAX_CONDITION, condition_numbers, distinct, leave_out, lowered, require_spanning_lights
from recon.metrics import angular_error
from recon.normals.large_stacks import large_least_squares
from recon.normals.least_squares import least_squares
from recon.registry import NORMALS

Synthetic = Callable[..., Capture]


def lit_pixels(capture: Capture) -> NDArray[np.bool_]:
    assert capture.truth.normals is not None
    return capture.mask & (capture.truth.normals @ capture.lights.T > 0).all(-1)


def solve(name: str, capture: Capture, weights: NDArray[np.float32] | None = None):  # type: ignore[no-untyped-def]
    w = np.ones(capture.images.shape[:3], np.float32) if weights is None else weights
    return NORMALS.load(name)(capture.reflectance(), capture.lights, capture.mask, w)


@pytest.fixture(params=[*NORMALS])
def solver(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def matte_three(synthetic: Synthetic) -> Capture:
    """Three well-spread lights that every solver can take."""
    lights = np.array([[0.5, 0, 0.87], [-0.25, 0.43, 0.87], [-0.25, -0.43, 0.87]])
    return synthetic("sphere", 48, lights / np.linalg.norm(lights, axis=1, keepdims=True), layer="matte")


def test_exact_on_matte_samples(solver: str, synthetic: Synthetic) -> None:
    if solver == "coat":
        pytest.skip("coat takes the samples for a coated surface's; tests/recon/test_coat.py holds it to that")
    capture = matte_three(synthetic)
    result = solve(solver, capture)
    lit = lit_pixels(capture)
    assert np.nanmax(angular_error(result.normal, capture.truth.normals)[lit]) < 0.01
    assert np.abs(result.albedo - capture.truth.albedo)[lit].max() < 1e-4
    assert (result.normal[~capture.mask] == 0).all()
    assert result.measurable[lit].all()
    assert not result.measurable[~capture.mask].any()


def test_rotating_the_lights_rotates_the_normals(solver: str, synthetic: Synthetic) -> None:
    capture = matte_three(synthetic)
    t = 0.3
    R = np.array([[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1]])
    w = np.ones(capture.images.shape[:3], np.float32)
    function = NORMALS.load(solver)
    plain = function(capture.reflectance(), capture.lights, capture.mask, w).normal
    turned = function(capture.reflectance(), capture.lights @ R.T, capture.mask, w).normal
    assert np.abs(turned - plain @ R.T.astype(np.float32))[capture.mask].max() < 1e-4


def test_order_and_exposure_leave_normals_alone(solver: str, synthetic: Synthetic) -> None:
    capture = matte_three(synthetic)
    normal = solve(solver, capture).normal
    assert np.abs(solve(solver, capture.select([2, 0, 1])).normal - normal).max() < 1e-5
    brighter = capture.with_images(capture.images * 7)
    assert np.abs(solve(solver, brighter).normal - normal).max() < 1e-5


def test_light_intensity_is_applied(solver: str, synthetic: Synthetic) -> None:
    capture = matte_three(synthetic)
    power = np.array([[1, 2, 3], [0.5, 0.5, 0.5], [4, 1, 2.0]])
    uneven = Capture(
        images=capture.images * power[:, None, None].astype(np.float32),
        lights=capture.lights,
        mask=capture.mask,
        intensities=power,
    )
    assert np.abs(solve(solver, uneven).normal - solve(solver, capture).normal).max() < 1e-5


def test_least_squares_is_numpys(synthetic: Synthetic) -> None:
    """Even and uneven weights, both against numpy's own solver pixel by pixel."""
    capture = synthetic("sphere", 24)
    rng = np.random.default_rng(0)
    w = rng.random(capture.images.shape[:3]).astype(np.float32)
    w[:, :5] = 1
    result = solve("least-squares", capture, w)
    y = capture.reflectance() @ np.array([0.2989, 0.5870, 0.1140])
    for r, c in zip(*np.nonzero(capture.mask), strict=True):
        root = np.sqrt(w[:, r, c].astype(float))
        b = np.linalg.lstsq(capture.lights * root[:, None], y[:, r, c] * root, rcond=None)[0]
        assert np.abs(result.normal[r, c] - b / np.linalg.norm(b)).max() < 1e-4


def test_uncertainty_is_that_of_repeated_draws() -> None:
    """The mean of the stated variance is the variance seen over many noisy pixels of one normal."""
    rng = np.random.default_rng(1)
    lights = rng.normal(size=(12, 3))
    lights[:, 2] = np.abs(lights[:, 2]) + 1
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    n = np.array([0.2, -0.1, 0.97])
    n /= np.linalg.norm(n)
    r = (lights @ n)[:, None, None, None] * np.ones((1, 60, 60, 3)) + 0.01 * rng.normal(size=(12, 60, 60, 1))
    ones = np.ones((12, 60, 60), np.float32)
    result = NORMALS.load("least-squares")(r.astype(np.float32), lights, np.ones((60, 60), bool), ones)
    error = angular_error(result.normal, np.broadcast_to(n, (60, 60, 3)).astype(np.float32))
    assert np.sqrt((result.uncertainty**2).mean()) == pytest.approx(np.sqrt((error**2).mean()), rel=0.05)


def test_zero_weight_leaves_a_sample_out(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 32, layer="matte")
    spoiled = capture.images.copy()
    spoiled[1] += 3
    w = np.ones(capture.images.shape[:3], np.float32)
    w[1] = 0
    result = solve("least-squares", capture.with_images(spoiled), w)
    lit = lit_pixels(capture)
    assert np.nanmax(angular_error(result.normal, capture.truth.normals)[lit]) < 0.01


def test_too_few_lights_in_a_pixel_are_not_measured(solver: str, synthetic: Synthetic) -> None:
    capture = matte_three(synthetic)
    w = np.ones(capture.images.shape[:3], np.float32)
    w[0, 20:24] = 0
    result = solve(solver, capture, w)
    assert not result.measurable[20:24].any()
    assert (result.normal[20:24] == 0).all()
    assert result.measurable[10][capture.mask[10]].all()


def test_condition_numbers_are_numpys() -> None:
    rng = np.random.default_rng(2)
    lights = rng.normal(size=(6, 3))
    w = rng.random((6, 40))
    expected = [np.linalg.cond(lights * np.sqrt(w[:, i])[:, None]) for i in range(40)]
    assert np.allclose(condition_numbers(lights, w), expected, rtol=1e-6)
    w[3:] = 0
    w[2, 0] = 0
    assert np.isinf(condition_numbers(lights, w)[0])


@pytest.mark.parametrize("lights", [5, 62, 96])
def test_equal_weights_are_worked_out_once(lights: int) -> None:
    rng = np.random.default_rng(3)
    alike = np.repeat(rng.random((lights, 1)), 50, axis=1)
    binary = (rng.random((lights, 2)) < 0.5).astype(float)[:, rng.integers(0, 2, 50)]
    for weights, most in ((alike, 1), (binary, 2 if lights <= 62 else 50), (rng.random((lights, 50)), 50)):
        patterns, index = distinct(weights)
        assert patterns.shape[1] <= most
        assert (patterns[:, index] == weights).all()


def test_leave_out_stops_where_the_lights_no_longer_suffice() -> None:
    t = np.radians(35)
    lights = np.array(
        [[0, 0, 1], [np.sin(t), 0, np.cos(t)], [-np.sin(t), 0, np.cos(t)], [0, np.sin(t), np.cos(t)], [0, -np.sin(t), np.cos(t)]]
    )
    weights = np.ones((5, 3), np.float32)
    unwanted = np.zeros((5, 3), bool)
    unwanted[3:, 0] = True  # what remains lies in one plane
    unwanted[[1, 3], 1] = True  # what remains does not
    reduced = leave_out(weights, unwanted, lights)
    assert reduced[:, 0].tolist() == [1, 1, 1, 1, 1]
    assert reduced[:, 1].tolist() == [1, 0, 1, 0, 1]
    assert reduced[:, 2].tolist() == [1, 1, 1, 1, 1]
    assert condition_numbers(lights, reduced).max() < MAX_CONDITION


def test_confidence_never_takes_a_pixels_lights_away() -> None:
    lights = np.array([[0.5, 0, 0.87], [-0.25, 0.43, 0.87], [-0.25, -0.43, 0.87], [0, 0, 1.0]])
    weights = np.ones((4, 2), np.float32)
    wanted = np.array([[1, 0.5], [1, 0.5], [0, 1], [0, 0.2]], np.float32)
    assert lowered(weights, wanted, lights)[:, 0].tolist() == [1, 1, 1, 1]
    assert lowered(weights, wanted, lights)[:, 1].tolist() == wanted[:, 1].tolist()


def cone(degrees: float) -> NDArray[np.float64]:
    """A frontal light and four around it, tilted by so much."""
    t = np.radians(degrees)
    ring = [[np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)] for a in np.radians([0, 90, 180, 270])]
    return np.array([[0, 0, 1], *ring])


def test_one_limit_decides_whether_lights_can_serve(synthetic: Synthetic) -> None:
    """What is accepted is measured, and what is not is refused with the reason."""
    require_spanning_lights(cone(5), "here")
    capture = synthetic("sphere", 24, cone(5), layer="matte")
    assert solve("least-squares", capture).measurable[capture.mask].all()
    with pytest.raises(InputError, match=r"here: the lights are too much alike \(condition number 39, at most 30\); spread them"):
        require_spanning_lights(cone(2.3), "here")
    t = np.radians([0, 20, 40, 60, 75])
    plane = np.stack([np.sin(t) * 0.6, np.sin(t) * 0.8, np.cos(t)], 1)
    for lights in (plane, plane + np.random.default_rng(0).normal(0, 1e-7, plane.shape), np.tile([[0, 0.6, 0.8]], (5, 1))):
        with pytest.raises(InputError, match="bolt: the light directions lie in one plane"):
            require_spanning_lights(lights, "bolt")
    with pytest.raises(InputError, match="at least three lights, there are 2"):
        require_spanning_lights(plane[:2], "bolt")
    with pytest.raises(InputError, match="exactly three"):
        solve("three-light", synthetic("sphere", 16))


@pytest.mark.parametrize("weights", ["equal", "all sorts"])
def test_large_stacks_are_solved_as_small_ones(weights: str) -> None:
    """The compiled pass against the numpy one, on a mask with gaps, more pixels a row than a block, and pixels that no lights determine."""
    rng = np.random.default_rng(4)
    K, shape = 9, (7, 600)
    lights = rng.normal(size=(K, 3)) * [1, 1, 0.3] + [0, 0, 1.5]
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    reflectance = rng.uniform(0, 1, (K, *shape, 3)).astype(np.float32)
    mask = rng.random(shape) < 0.7
    mask[3] = False
    w = np.ones((K, *shape), np.float32)
    if weights == "all sorts":
        w = rng.uniform(0, 1, w.shape).astype(np.float32) * (rng.random(w.shape) < 0.6)
        reflectance[:, 5, :40] = 0
    small, large = (solver(reflectance, lights, mask, w) for solver in (least_squares, large_least_squares))
    assert np.array_equal(small.measurable, large.measurable)
    assert (small.measurable[mask].mean() == 1) == (weights == "equal")
    for name in ("normal", "albedo", "uncertainty"):
        assert np.allclose(getattr(small, name), getattr(large, name), atol=2e-5, equal_nan=True), name
