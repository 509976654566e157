"""Lights from balls, against pictures of balls by other code, and against the calibrations that came with real ones."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Scale, grey
from gen.errors import InputError
from gen.images import read_frames, read_image, read_mask
from gen.photos.balls import BallLights, matte_ball, mirror_ball
from gen.photos.near import light_places, refined_places, triangulate
from gen.photos.outline import circle_points, contour, find_circle, fit_circle, sphere_of
from gen.photos.view import Sphere, View
from tests.gen.photos.photo_scenes import FINE, OURS, Balls, degrees, ring

SIZE = (240, 320)
K = np.array([[900.0, 0, 163], [0, 900, 115], [0, 0, 1]])
NAMES = tuple("abcdef")


@cache
def scene(perspective: bool, balls: int = 1) -> tuple[Balls, View, np.ndarray]:
    """(the balls, our view of them, the place in OpenCV's frame where the camera looks). Off the axis, so that outlines are ellipses."""
    if perspective:
        centres = [[50, -30, 500], [-52, 30, 520], [-42, -32, 480]][:balls]
        return Balls(SIZE, np.array(centres), 28, K), View(SIZE, Scale(camera=K, distance_mm=500)), np.array([0, 0, 500.0])
    centres = [[25, -12, 0], [-30, 18, 0], [-28, -16, 0]][:balls]
    return Balls(SIZE, np.array(centres), 16, None, 0.3), View(SIZE, Scale(mm_per_pixel=0.3)), np.zeros(3)


def found_sphere(balls: Balls, view: View, n: int = 0) -> Sphere:
    diameter = 56.0 if view.scale.camera is not None else 32.0
    return sphere_of(contour(balls.masks[n]), view, "ball", diameter)


@pytest.mark.parametrize("perspective", [False, True])
def test_a_sphere_is_found_from_its_outline(perspective: bool) -> None:
    balls, view, origin = scene(perspective)
    sphere = found_sphere(balls, view)
    true = (np.array([50, -30, 500]) - origin) * OURS if perspective else np.array([25, 12, 0.0])
    assert np.linalg.norm(sphere.centre - true) < (
        1.5 if perspective else 0.1
    )  # 1.5 of 500 mm is depth from a radius of 40 pixels
    assert abs(sphere.radius - (28 if perspective else 16)) < 0.1
    y, x = (np.mgrid[: SIZE[0] * FINE, : SIZE[1] * FINE] + 0.5) / FINE - 0.5
    _, normals, _, _ = sphere.meet(view, x, y)
    assert degrees(normals.reshape(-1, 3)[balls.rays], balls.normals * OURS).mean() < 0.3


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("clip", [False, True])
def test_a_mirror_ball_shows_distant_lights(perspective: bool, clip: bool) -> None:
    balls, view, _ = scene(perspective)
    lights = ring(40, 5)
    pictures = np.stack([balls.mirror(light * OURS) for light in lights])
    pictures = pictures + np.random.default_rng(0).normal(0, 0.003, pictures.shape)
    found = mirror_ball(np.minimum(pictures, 1) if clip else pictures, found_sphere(balls, view), view, "ball", NAMES)
    assert degrees(found.directions, lights).max() < 0.5


@pytest.mark.parametrize("perspective", [False, True])
def test_a_matte_ball_shows_lights_and_their_strengths(perspective: bool) -> None:
    """Noise, a cast shadow over a part of the ball, a painted dot, and clipped samples that say so."""
    balls, view, _ = scene(perspective)
    lights = ring(50, 5)
    strengths = np.array([1, 0.6, 1.3, 0.9, 0.7, 1.1])[:, None] * [1.0, 0.8, 0.5]
    rng = np.random.default_rng(1)
    pictures = np.stack([balls.matte(light * OURS) for light in lights])[..., None] * 0.8 * strengths[:, None, None]
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    rows, columns = np.nonzero(balls.mask)
    middle, left = rows.mean(), columns.mean() - 12
    pictures[:, (np.hypot(y - middle, x - left) < 4)] *= 0.1  # the dot
    pictures[2, (x < left) & (y < middle)] *= 0.02  # the shadow
    pictures = pictures + rng.normal(0, 0.004, pictures.shape)
    faults = np.where((pictures >= 1).any(-1), 2, 0).astype(np.uint8)
    assert (faults > 0).any()
    found = matte_ball(np.minimum(pictures, 1).astype(np.float32), faults, found_sphere(balls, view), view, "ball", NAMES)
    assert degrees(found.directions, lights).max() < 0.5
    assert found.strengths is not None
    np.testing.assert_allclose(found.strengths / found.strengths[0, 0], strengths, rtol=0.015)


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("kind", ["chrome", "matte"])
def test_several_balls_show_where_near_lights_are(perspective: bool, kind: str) -> None:
    balls, view, origin = scene(perspective, 3)
    places = ring(35, 4) * 200 + [10, 0, 0]
    there = places * OURS + origin
    spheres = [found_sphere(balls, view, n) for n in range(3)]
    if kind == "chrome":
        pictures = np.stack([balls.mirror(place=place) for place in there])
        pictures = pictures + np.random.default_rng(0).normal(0, 0.003, pictures.shape)
        seen = [mirror_ball(np.minimum(pictures, 1), sphere, view, "ball", NAMES[:5]) for sphere in spheres]
        found, misses = light_places(seen)
        assert misses.max() < 3
    else:
        shaded = np.stack([balls.matte(place=place) for place in there])
        shaded = shaded / shaded.max() + np.random.default_rng(0).normal(0, 0.002, shaded.shape)
        stack, faults = np.repeat(shaded[..., None], 3, -1).astype(np.float32), np.zeros(shaded.shape, np.uint8)
        seen = [matte_ball(stack, faults, sphere, view, "ball", NAMES[:5]) for sphere in spheres]
        rough, _ = light_places(seen)
        found = refined_places(rough, [stack] * 3, [faults] * 3, spheres, view)
    assert np.linalg.norm(found - places, axis=1).max() < 5, np.linalg.norm(found - places, axis=1)


def test_rays_meet_where_closed_form_says_and_parallel_ones_nowhere() -> None:
    place, miss = triangulate(np.array([[0, 0, 0], [0, 3.0, 2]]), np.array([[1.0, 0, 0], [0, 0, 1]]))
    np.testing.assert_allclose(place, [0, 1.5, 0], atol=1e-12)  # half-way between two crossing lines
    np.testing.assert_allclose(miss, [1.5, 1.5])
    assert np.isinf(triangulate(np.array([[0, 0, 0], [5.0, 0, 0]]), np.array([[0, 0, 1.0], [0, 0, 1]]))[0]).all()
    points = np.array([[0, 0, 0], [5.0, 0, 0]])[:, None]
    apart = np.array([[-0.1, 0, 1], [0.1, 0, 1.0]])[:, None]
    balls = [BallLights(p, d / np.linalg.norm(d), None, np.zeros(1)) for p, d in zip(points, apart, strict=True)]
    assert np.isinf(light_places(balls)[0]).all()


def test_a_circle_is_fitted_though_the_ball_stands_on_something() -> None:
    y, x = np.mgrid[:200, :200]
    mask = (np.hypot(x - 90.3, y - 80.6) < 55.2) | ((abs(x - 90) < 35) & (y > 120) & (y < 170))
    circle = fit_circle(contour(mask), "ball")
    assert abs(np.array([circle.x - 90.3, circle.y - 80.6, circle.radius - 55.2])).max() < 0.15
    assert 0.5 < circle.share < 0.9
    with pytest.raises(InputError, match="of the outline is a ball's"):
        fit_circle(contour((abs(x - 90) < 60) & (abs(y - 90) < 25)), "ball")
    with pytest.raises(InputError, match="too short"):
        fit_circle(contour(np.zeros((9, 9), bool)), "ball")


def test_a_ball_is_found_in_a_picture() -> None:
    y, x = np.mgrid[:300, :400]
    soft = 1 / (1 + np.exp((np.hypot(x - 231.4, y - 142.7) - 61.3) / 0.7))
    picture = 0.1 + 0.5 * soft * (1 + 0.3 * (x - 231) / 61) + np.random.default_rng(0).normal(0, 0.01, x.shape)
    circle = find_circle(picture, "ball")
    assert abs(np.array([circle.x - 231.4, circle.y - 142.7, circle.radius - 61.3])).max() < 0.3
    with pytest.raises(InputError, match="circle_px"):
        find_circle(np.random.default_rng(0).normal(0.5, 0.01, (200, 200)), "ball")
    with pytest.raises(InputError, match="black"):
        find_circle(np.zeros((100, 100)), "ball")


def test_the_wrong_kind_of_ball_is_refused() -> None:
    balls, view, _ = scene(False)
    sphere, lights = found_sphere(balls, view), ring(40, 5)
    mirror = np.minimum(np.stack([balls.mirror(light * OURS) for light in lights]), 1)
    matte = np.stack([balls.matte(light * OURS) for light in lights])
    with pytest.raises(InputError, match="matte ball"):
        mirror_ball(matte, sphere, view, "ball", NAMES)
    stack = np.repeat(mirror[..., None], 3, -1).astype(np.float32)
    with pytest.raises(InputError, match="is it a mirror ball"):
        matte_ball(stack, np.zeros(mirror.shape, np.uint8), sphere, view, "ball", NAMES)
    with pytest.raises(InputError, match="covers only"):
        mirror_ball(mirror, Sphere(np.array([1e4, 0, 0]), 18.0), view, "ball", NAMES)


@pytest.mark.data
def test_the_chrome_ball_of_the_psm_images(data_folder: Path) -> None:
    """Against the two tables that lie beside it.

    One agrees to half a degree. The other (lights.txt) holds highlights in whole pixels that lie up to nine pixels off the highlight's
    middle, toward the glow at the ball's left rim, as a mean over all that is not black would: 3 degrees from both.
    """
    folder = data_folder / "uw_psm"
    frames = read_frames([folder / "chrome" / f"chrome.{k}.png" for k in range(12)])
    mask = read_mask(folder / "chrome" / "chrome.mask.png")
    view = View((mask.shape[0], mask.shape[1]), Scale())
    found = mirror_ball(grey(frames.images), sphere_of(contour(mask), view, "chrome"), view, "chrome", tuple(map(str, range(12))))
    other = np.loadtxt(folder / "lights_zakmatt.txt", delimiter=",")
    error = degrees(found.directions, other)
    assert error.mean() < 0.5
    assert error.max() < 1
    table = np.loadtxt(folder / "lights.txt", skiprows=1)
    assert degrees(found.directions, table).mean() < degrees(other, table).mean()
    assert np.median(degrees(found.directions, table)) < 2.2


@pytest.mark.data
def test_the_scratched_mirror_ball_of_the_frog(data_folder: Path) -> None:
    """Twenty lights against the calibration that came with them; the ball is found by itself in a picture of the lit room."""
    folder = data_folder / "harvard_xiong" / "frog" / "LightProbe-1"
    circle = find_circle(grey(read_image(folder / "ref.JPG").linear), "ref.JPG")
    x, y_up, radius = np.loadtxt(folder / "circle_data.txt")
    assert abs(circle.radius - radius) < 1
    assert np.hypot(circle.x - x, circle.y - (1200 - y_up)) < 1.5  # theirs counts from 1, and from below
    chosen = [1, 10, 20]
    images = np.stack([grey(read_image(folder / f"Image_{k:02d}.JPG").linear) for k in chosen])
    view = View((1200, 1200), Scale())
    sphere = sphere_of(circle_points(circle), view, "probe")
    found = mirror_ball(images, sphere, view, "probe", tuple(map(str, chosen)))
    error = degrees(found.directions, np.loadtxt(folder / "light_directions.txt").T[[k - 1 for k in chosen]])
    assert error.mean() < 1
    assert error.max() < 2
