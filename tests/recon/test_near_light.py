"""Near lights: exact on matte surfaces in closed form and on real renders, where distant lights err by ten degrees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gen.capture import Capture, Scale, Truth
from gen.errors import InputError
from gen.farm import Farm
from gen.render import render
from gen.spec import spec_from
from recon.metrics import angular_error, regions
from recon.near_light import lighting, moved, places_known, solve_near, surface_distance
from recon.normals.lights_per_pixel import fit
from recon.pipeline import measure
from recon.registry import HEIGHT, NORMALS

RADIUS = 25.0


def near_sphere(distance: float = 150.0, lights: int = 6, size: int = 64, middle: float = 0.0, kind: str = "point") -> Capture:
    """A matte sphere of 25 mm, its centre at z = middle, under a frontal light and a ring at 35 degrees; orthographic, no cast shadows."""
    step = 2 * RADIUS / 0.95 / size
    row, column = np.mgrid[:size, :size].astype(float)
    x, y = (column - (size - 1) / 2) * step, ((size - 1) / 2 - row) * step
    mask = x**2 + y**2 < (0.96 * RADIUS) ** 2
    z = np.sqrt(np.maximum(RADIUS**2 - x**2 - y**2, 0))
    n = np.stack([x, y, z], -1) / RADIUS * mask[..., None]
    points = np.stack([x, y, z + middle], -1)
    t, a = np.radians(35), np.arange(lights - 1) * 2 * np.pi / (lights - 1)
    ring = np.stack([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.full(lights - 1, np.cos(t))], -1)
    L = np.vstack([[0, 0, 1], ring])
    pictures = []
    for place in L * distance:
        toward = place - points
        far = np.linalg.norm(toward, axis=-1)
        shading = np.maximum((n * toward).sum(-1), 0) / far * (distance / far) ** 2
        if kind == "area":
            shading *= (toward @ place) / far / distance
        pictures.append(shading[..., None] * [0.6, 0.3, 0.15])
    depth = np.where(mask, (500 - points[..., 2]) / 1000, np.nan)
    return Capture(
        images=np.array(pictures, np.float32),
        lights=L,
        mask=mask,
        light_kinds=(kind,) * lights,
        positions=L * distance,
        scale=Scale(mm_per_pixel=step),
        truth=Truth(normals=n.astype(np.float32), depth=depth.astype(np.float32)),
    )


def distant(capture: Capture) -> Capture:
    """The same pictures, as if their lights were far away."""
    return replace(capture, light_kinds=(), positions=None)


def lit_by_all(capture: Capture) -> Any:
    return capture.mask & (capture.images > 0).all(axis=(0, -1))


@pytest.mark.parametrize("solver", ["least-squares", "l1", "position-threshold", "rank-minimisation"])
def test_every_solver_is_exact_on_a_matte_sphere(solver: str) -> None:
    capture = near_sphere()
    error = {
        name: angular_error(measure(one, "none", "none", solver).normals.normal, capture.truth.normals)[lit_by_all(capture)]
        for name, one in (("near", capture), ("distant", distant(capture)))
    }
    assert np.nanmax(error["near"]) < 0.3
    assert np.nanmean(error["near"]) < 0.05
    assert np.nanmean(error["distant"]) > 3


@pytest.mark.parametrize(("distance", "middle", "kind"), [(300.0, 0.0, "point"), (80.0, 0.0, "point"), (150.0, -40.0, "area")])
def test_the_fall_off_says_how_far_the_surface_is(distance: float, middle: float, kind: str) -> None:
    """Without shadows, where the integrator's mean is that of the truth: the distance to a hundredth of the sphere's radius."""
    capture = near_sphere(distance, middle=middle, kind=kind)
    shape = measure(replace(capture, mask=lit_by_all(capture)), "none", "none")
    assert shape.near is not None
    assert shape.near.fitted
    assert shape.near.surface_mm == pytest.approx(500 - 1000 * np.mean(capture.truth.depth[lit_by_all(capture)]), abs=0.25)
    assert shape.near.rounds < 20
    metrics = shape.metrics()
    assert metrics["near lights"]["surface_mm"] == shape.near.surface_mm
    assert metrics["truth"]["normals"]["mask"]["mean"] < 0.05
    assert metrics["truth"]["height"]["percent"] < 0.3
    assert any("lights are near, and were solved so" in note for note in metrics["notes"])


def test_lighting_is_that_of_each_point() -> None:
    positions = np.vstack([[0, 0, 100.0], [60, 0, 80.0], np.full((4, 3), np.nan)])
    capture = replace(near_sphere(), light_kinds=("point", "area", *["sun"] * 4), positions=positions)
    directions, fall = lighting(capture, np.array([[0, 0, 0], [0, 0, 50.0], [60, 0, 0]]))
    assert fall[0] == pytest.approx([1, 4, 1 / 1.36])
    assert directions[0, 2] == pytest.approx(np.array([-60, 0, 100]) / np.sqrt(13600))
    assert fall[1] == pytest.approx([1, 100**2 / 4500 * (60 * 60 + 30 * 80) / 100 / np.sqrt(4500), (100 / 80) ** 2 * 0.8])
    assert (fall[2:] == 1).all()
    assert (directions[2:] == capture.lights[2:, None]).all()


def test_lights_of_each_pixel_are_fitted_as_numpy_does() -> None:
    rng = np.random.default_rng(0)
    v, y, w = rng.normal(size=(7, 20, 3)), rng.normal(size=(7, 20)), rng.uniform(0, 1, (7, 20))
    w[2:, 0] = 0
    b, residual = fit(y, v, w)
    assert np.isnan(b[0]).all()
    assert np.isnan(residual[0])
    for p in range(1, 20):
        root = np.sqrt(w[:, p])
        wanted = np.linalg.lstsq(v[:, p] * root[:, None], y[:, p] * root, rcond=None)[0]
        assert b[p] == pytest.approx(wanted)
        off = root * (y[:, p] - v[:, p] @ wanted)
        assert residual[p] == pytest.approx(np.linalg.norm(off) / np.linalg.norm(root * y[:, p]))


def test_what_cannot_be_known_is_taken_as_said() -> None:
    """Three lights say no distance: the surface is taken to lie where the camera looks. Without a scale all lights are distant."""
    capture = near_sphere(150.0, 4, middle=-17.0).select([1, 2, 3])
    shape = measure(capture, "none", "none")
    assert shape.near is not None
    assert not shape.near.fitted
    assert shape.near.surface_mm == 0
    assert np.nanmean(angular_error(shape.normals.normal, capture.truth.normals)[lit_by_all(capture)]) < 0.5
    unknown = replace(capture, scale=Scale())
    assert not places_known(unknown)
    bare = measure(unknown, "none", "none")
    assert bare.near is None
    assert any("solved as distant, since no scale" in note for note in bare.metrics()["notes"])
    points = np.zeros((5, 3))
    assert surface_distance(capture, points, np.ones((3, 5)), np.ones((3, 5), np.float32)) is None


def test_a_perspective_surface_moves_along_its_rays() -> None:
    K = np.array([[300.0, 0, 31.5], [0, 300, 31.5], [0, 0, 1]])
    capture = replace(near_sphere(), scale=Scale(camera=K, distance_mm=200.0))
    assert moved(capture, np.array([[0, 0, 0], [10.0, 0, 0], [0, 20, 100]]), 20.0) == pytest.approx(
        np.array([[0, 0, 20], [9.0, 0, 20], [0, 18, 110]])
    )


def test_nothing_to_measure_is_refused() -> None:
    capture = near_sphere(size=24)
    nothing = np.zeros(capture.images.shape[:3], np.float32)
    with pytest.raises(InputError, match="not one pixel could be measured"):
        solve_near(capture, capture.reflectance(), nothing, NORMALS.load("least-squares"), HEIGHT.load("quadratic"))


@pytest.fixture(scope="module")
def farm() -> Iterator[Farm]:
    """One Blender for all renders here."""
    with Farm() as opened:
        yield opened


ORTHOGRAPHIC = {"kind": "orthographic", "width_mm": 60}
PERSPECTIVE = {"kind": "perspective", "distance_mm": 200, "fov_degrees": 17}


@pytest.mark.render
@pytest.mark.parametrize(
    ("shape", "camera", "nearer"),
    [
        ({"name": "rounded_box"}, ORTHOGRAPHIC, 0.0),
        ({"name": "sphere", "radius": 25}, PERSPECTIVE, 0.0),
        ({"name": "sphere", "radius": 25}, PERSPECTIVE, -40.0),
    ],
    ids=["box", "sphere in perspective", "sphere beyond where the camera looks"],
)
def test_real_renders_under_near_lights(farm: Farm, shape: dict[str, Any], camera: dict[str, Any], nearer: float) -> None:
    spec = {
        "name": "near",
        "resolution": [64, 64],
        "shape": shape,
        "pose": {"translation_mm": [0, 0, nearer]},
        "material": {"albedo": [0.2, 0.35, 0.5], "specular": 0.1, "alpha": 0.3},
        "lights": {"pattern": "ring", "count": 6, "tilt_degrees": 35, "frontal": True, "distance_mm": 140},
        "camera": camera,
    }
    glossy = render(spec_from(spec, "test"), farm=farm).capture
    capture = glossy.with_images(glossy.truth.matte)
    lit = regions(capture, capture.truth.normals)["lit by all"]
    error = {}
    for name, one in (("near", capture), ("distant", distant(capture))):
        measured = measure(one, "none", "none", shadows="drop")
        error[name] = float(np.nanmean(angular_error(measured.normals.normal, capture.truth.normals)[lit]))
        if name == "near":
            height = measured.metrics()["truth"]["height"]
    assert error["near"] < 0.1
    assert error["distant"] > 4
    assert height["percent"] < 1
    assert height["scale"] == pytest.approx(1, abs=0.02)
    removed = [measure(one, "chromaticity", "none") for one in (glossy, distant(glossy))]
    near, far = (np.nanmean(angular_error(m.normals.normal, capture.truth.normals)[capture.mask]) for m in removed)
    assert near < 0.6 * far
