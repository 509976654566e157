"""Lights of every kind against closed forms: fall-off, size, surroundings, ambient light, several at once, and light between surfaces."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_scenes.errors import JobError
from blender_scenes.job import parse
from gen.exr import write_exr
from gen.substrate import shade

pytestmark = pytest.mark.render

ALBEDO = np.array([0.5, 0.4, 0.3])
WHITE = [1.0, 1.0, 1.0]
Job = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module")
def matte(job: Job) -> Job:
    """A job of a Lambertian sphere under given lights."""

    def make(lights: list[Any], **changes: Any) -> dict[str, Any]:
        material = {"kind": "lambertian", "diffuse": ALBEDO.tolist()}
        return job(
            "sphere",
            "orthographic",
            size=(48, 48),
            material=material,
            lights=lights,
            layers=["combined", "matte", "lit"],
            **changes,
        )

    return make


def points(asked: dict[str, Any], layers: dict[str, np.ndarray], pixel_rays: Any) -> np.ndarray:
    """The surface point of each pixel, (H, W, 3)."""
    origin, direction = pixel_rays(asked)
    return origin + layers["depth"][..., None] * direction


def test_a_point_light_falls_off_with_the_square_of_the_distance(worker, matte, pixel_rays) -> None:
    place, colour = np.array([60.0, 40.0, 90.0]), np.array([1.0, 2.0, 0.5])
    asked = matte([{"kind": "point", "position": place.tolist(), "intensity": colour.tolist()}])
    layers = worker.render(asked)
    away = place - points(asked, layers, pixel_rays)
    distance2 = (away**2).sum(-1)
    cosine = ((layers["normal"] * away).sum(-1) / np.sqrt(distance2)).clip(0)
    expected = ALBEDO * colour * (cosine * (place @ place) / distance2)[..., None]
    seen = layers["coverage"] > 0
    assert expected[seen].max() > 0.8
    assert abs(layers["matte"][0] - expected)[seen].max() < 3e-5
    assert ((layers["lit"][0] > 0) == (cosine > 0))[seen & (abs(cosine) > 1e-3)].all()


@pytest.mark.parametrize("alpha", [0.1, 0.5])
def test_the_substrate_is_exact_under_a_point_light(worker, job, pixel_rays, alpha: float) -> None:
    place = np.array([-50.0, 30.0, 100.0])
    asked = job("sphere", "orthographic", alpha=alpha, lights=[{"kind": "point", "position": place.tolist(), "intensity": WHITE}])
    layers = worker.render(asked)
    away = place - points(asked, layers, pixel_rays)
    distance = np.linalg.norm(away, axis=-1, keepdims=True)
    seen = layers["coverage"] > 0
    n = layers["normal"][seen].astype(np.float64)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    m = asked["material"]
    parts = shade(n, (away / distance)[seen], np.array([0.0, 0, 1]), np.array(m["diffuse"]), np.array(m["specular"]), alpha)
    fall = (place @ place) / distance[seen] ** 2
    for name, part in zip(("diffuse", "specular", "matte"), parts, strict=True):
        # A sample lies within 0.005 px of where it is taken to lie; the lobe magnifies that.
        assert abs(layers[name][0][seen] - part * fall).max() < (1e-4 if name == "specular" else 3e-5) * (part * fall).max(), name


@pytest.mark.parametrize("diameter", [5.0, 60.0, 150.0])
def test_a_disc_has_the_stated_irradiance_at_the_origin(worker, matte, diameter: float) -> None:
    """On a speck at the origin that faces the disc; its top is nearer to the light by its radius, and the disc seen a little larger."""
    distance, radius = 100.0, 0.05
    asked = matte(
        [{"kind": "area", "position": [0, 0, distance], "diameter": diameter, "intensity": WHITE}],
        samples=1024,
        shape={"name": "sphere", "parameters": {"radius": radius}},
        camera={"kind": "orthographic", "width": 4 * radius, "distance": 200.0},
        pose={},
    )
    layers = worker.render(asked)
    assert layers["matte"][0, 23:25, 23:25] == pytest.approx(np.broadcast_to(ALBEDO, (2, 2, 3)), rel=0.01)


def test_ambient_light_is_the_same_everywhere(worker, matte) -> None:
    """The furnace: a convex Lambertian surface shows albedo times the radiance around it, a mirror the radiance itself."""
    asked = matte([{"kind": "ambient", "intensity": [1.0, 2.0, 0.5]}], samples=16)
    layers = worker.render(asked)
    mirror = worker.render({**asked, "material": {"kind": "mirror"}, "layers": ["combined", "specular"]})["specular"][0]
    facing = layers["normal"][..., 2] > 0.5
    for picture, colour in ((layers["matte"][0], ALBEDO * [1.0, 2.0, 0.5]), (mirror, np.array([1.0, 2.0, 0.5]))):
        error = abs(picture[facing] - colour).max(axis=-1)
        assert (error < 1e-3).mean() > 0.99  # on the rest a ray or two graze the facet that they start from
        assert error.max() < 0.2


DIRECTIONS = {
    "middle": (0.5, 0.5, 0.0, (0, 0, 1)),
    "left": (0.25, 0.5, 0.0, (1, 0, 0)),
    "above": (0.5, 0.04, 0.0, (0, 1, 0)),
    "turned": (0.5, 0.5, 90.0, (1, 0, 0)),
}


@pytest.mark.parametrize("case", DIRECTIONS)
def test_a_panorama_stands_as_it_is_said(worker, matte, tmp_path: Path, case: str) -> None:
    """A bright spot in a dark panorama lights the object from where the spot stands."""
    u, v, rotation, toward = DIRECTIONS[case]
    picture = np.zeros((64, 128, 3), np.float32)
    row, column = int(v * 64), int(u * 128)
    picture[row - 1 : row + 1, column - 1 : column + 1] = 300
    file = tmp_path / "panorama.exr"
    write_exr(file, {letter: picture[..., i] for i, letter in enumerate("RGB")})
    light = {"kind": "environment", "map": str(file), "rotation": rotation, "intensity": WHITE}
    layers = worker.render(matte([light], samples=16))
    picture = layers["matte"][0].sum(-1)
    lit = picture > 0.3 * picture.max()
    found = np.linalg.lstsq(layers["normal"][lit], picture[lit], rcond=None)[0]
    assert found / np.linalg.norm(found) @ np.array(toward) > np.cos(np.radians(12 if case == "above" else 3))


def test_light_is_additive(worker, job) -> None:
    """Two suns at once are the sum of each alone, in every layer, exactly."""
    suns = [{"direction": [0.6, 0.0, 0.8], "intensity": [1.0, 0.5, 2.0]}, {"direction": [0.0, -0.6, 0.8], "intensity": WHITE}]
    both = worker.render(job("sphere", "orthographic", lights=[suns]))
    apart = worker.render(job("sphere", "orthographic", lights=suns))
    for name in ("diffuse", "specular", "matte"):
        assert both[name].shape[0] == 1
        np.testing.assert_allclose(both[name][0], apart[name].sum(axis=0), rtol=1e-6, atol=1e-9)


def test_light_between_surfaces_brightens_hollows_alone(worker, job) -> None:
    """In the groove of a pulley-like shaft light comes back from the walls; a sphere has nobody to get light from."""
    material = {"kind": "lambertian", "diffuse": [0.9, 0.9, 0.9]}
    settings = {"samples": 128, "material": material, "lights": [{"direction": [0.0, 0.0, 1.0], "intensity": WHITE}]}
    for shape, more in (("sphere", False), ("pipe_elbow", True)):
        direct, bounced = (worker.render(job(shape, "orthographic", **settings, bounces=b, size=(32, 32))) for b in (0, 3))
        gain = bounced["combined"].sum() / direct["combined"].sum()
        assert bounced["sum_error"].max() < 1e-6
        assert (gain > 1.002) == more, (shape, gain)
        assert abs(bounced["matte"] - bounced["combined"]).mean() < 0.01


@pytest.mark.parametrize("camera", ["orthographic", "perspective"])
@pytest.mark.parametrize("n", [1, 2])
def test_a_crop_holds_the_same_pixels(worker, job, camera: str, n: int) -> None:
    """The box holds the whole object; its pixels are those of the full frame but for Cycles' jitter of a sample within 0.01 px."""
    asked = job("torus", camera, n=n, layers=["diffuse", "specular", "matte", "lit"])
    full, part = worker.render(asked), worker.render({**asked, "crop": True})
    x0, y0, x1, y1 = part["box"]
    assert part["coverage"].shape == (y1 - y0, x1 - x0)
    assert (x1 - x0) * (y1 - y0) < 0.8 * full["coverage"].size
    outside = full["coverage"].copy()
    outside[y0:y1, x0:x1] = 0
    assert not outside.any()
    inner = full["coverage"][y0:y1, x0:x1]
    assert (abs(inner - part["coverage"]) > 0).mean() < 0.02
    both = (inner == 1) & (part["coverage"] == 1)
    assert abs(full["depth"][y0:y1, x0:x1] - part["depth"])[both].max() < 0.5
    error = abs(full["diffuse"][:, y0:y1, x0:x1] - part["diffuse"])[:, both]
    assert np.percentile(error, 98) < 2e-3
    assert abs(full["diffuse"].sum() / part["diffuse"].sum() - 1) < 2e-3


def test_an_object_out_of_sight_gives_an_empty_frame(worker, job) -> None:
    layers = worker.render(job("sphere", "orthographic", pose={"translation": [500.0, 0, 0]}, crop=True))
    assert not layers["coverage"].any()
    assert np.isnan(layers["depth"]).all()


BAD: list[tuple[dict[str, Any], str]] = [
    ({"kind": "lamp", "intensity": WHITE}, r"lights\[0\].kind 'lamp' is unknown; there are sun, point"),
    ({"kind": "point", "intensity": WHITE}, r"lights\[0\].position is missing"),
    ({"kind": "point", "position": [0, 0, 0], "intensity": WHITE}, "must not be the origin"),
    ({"kind": "area", "position": [0, 0, 9], "diameter": -1, "intensity": WHITE}, "diameter must be from"),
    ({"kind": "ambient", "intensity": WHITE}, "holds under suns and point lights only, not under ambient light"),
    ({"kind": "environment", "map": "studio", "intensity": WHITE}, "not under environment light"),
    ({"kind": "sun", "direction": [0, 0, 2], "intensity": WHITE}, "must be a unit vector"),
    ({"kind": "sun", "direction": [0, 0, 1], "intensity": WHITE, "size": 3}, "size is unknown"),
]


@pytest.mark.parametrize(("light", "message"), BAD, ids=[message for _, message in BAD])
def test_bad_lights_are_one_line(job, light: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError, match=message):
        parse(job("sphere", "orthographic", lights=[light]))


def test_bad_settings_are_one_line(job) -> None:
    for changes, message in (
        ({"lights": [[]]}, r"lights\[0\] must hold 1 to"),
        ({"layers": ["diffus"]}, "layers must be a list of some of combined, diffuse"),
        ({"bounces": 2}, "bounces: the material holds for direct light only"),
        ({"samples": 0}, "samples must be from 1"),
        ({"crop": 1}, "crop must be true or false"),
    ):
        with pytest.raises(JobError, match=message):
            parse(job("sphere", "orthographic", **changes))


def test_a_map_that_is_no_picture_is_one_line(worker, matte, tmp_path: Path) -> None:
    (tmp_path / "a.exr").write_bytes(b"no picture")
    for name, message in (("nowhere", "is no file; Blender brings city, "), (str(tmp_path / "a.exr"), "is no picture")):
        asked = matte([{"kind": "environment", "map": name, "intensity": WHITE}])
        answer = worker.ask({**asked, "id": "x", "out": str(tmp_path / "x.npz")})
        assert not answer["ok"]
        assert message in answer["error"]
