"""Every material in real renders: parts that sum up, the twin, reference BRDFs, textures, and light from everywhere."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from blender_scenes.entries import Entries
from blender_scenes.errors import JobError
from blender_scenes.materials import MATERIALS, parse
from blender_scenes.materials.approximate_substrate import weights
from blender_scenes.materials.texture import PATTERNS, Texture
from gen.brdfs import BRDFS

RD, RS = [0.5, 0.4, 0.02], [0.2, 0.05, 0.6]
PHONG = {"diffuse": RD, "specular": [3.0, 0.05, 0.6]}
EXAMPLES: dict[str, list[dict[str, Any]]] = {
    "approximate-substrate": [{"diffuse": RD, "specular": RS, "alpha": 0.3}],
    "blinn-phong": [{**PHONG, "exponent": 12.0}, {**PHONG, "alpha": 0.05, "normalised": True}],
    "blinn-phong-lobe": [{**PHONG, "exponent": 12.0}, {**PHONG, "alpha": 0.1, "normalised": True}],
    "lambertian": [{"diffuse": RD}],
    "metal": [{"specular": [0.9, 0.6, 0.3], "alpha": 0.05}, {"specular": [0.9, 0.6, 0.3], "alpha": 0.5}],
    "mirror": [{}],
    "oren-nayar": [
        {"diffuse": RD, "specular": RS, "alpha": 0.1, "sigma": 0.5},
        {"diffuse": RD, "specular": RS, "alpha": 1.2, "sigma": 0.1},
    ],
    "principled": [
        {"diffuse": RD, "alpha": 0.2, "metallic": 0.3, "ior": 1.8, "coat": 0.6, "coat_alpha": 0.02, "sheen": 0.5},
        {"diffuse": RD, "alpha": 0.05, "sheen": 1.0, "sheen_roughness": 0.2},
        {"diffuse": RD, "alpha": 0.05, "metallic": 1.0},
    ],
    "substrate": [{"diffuse": RD, "specular": RS, "alpha": 0.1}, {"diffuse": RD, "specular": RS, "alpha": 0.4618}],
    "two-lobe": [
        {"diffuse": RD, "specular": RS, "alpha": 0.04, "alpha2": 0.3, "mix": 0.4},
        {"diffuse": RD, "specular": RS, "alpha": 0.3, "alpha2": 1.1, "mix": 0.9},
    ],
}
CASES = [(kind, i) for kind in MATERIALS for i in range(len(EXAMPLES[kind]))]
WHITE = [1.0, 1.0, 1.0]


def light_at(light: dict[str, Any], points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors to the light and its intensity at each of the points (H, W, 3)."""
    if light.get("kind", "sun") == "sun":
        return np.array(light["direction"]), np.array(light["intensity"])
    away = np.array(light["position"]) - points
    distance = np.linalg.norm(away, axis=-1, keepdims=True)
    return away / distance, np.array(light["intensity"]) * (np.linalg.norm(light["position"]) / distance) ** 2


def normals_and_points(job: dict[str, Any], layers: dict[str, np.ndarray], rays: Any) -> tuple[np.ndarray, np.ndarray]:
    normal = layers["normal"].astype(np.float64)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    origin, direction = rays(job)
    return normal, origin + np.nan_to_num(layers["depth"])[..., None] * direction


def reference(kind: str, values: dict[str, Any], normal: np.ndarray, toward: np.ndarray) -> list[np.ndarray]:
    """(H, W, 3) diffuse, specular, matte by `gen.brdfs`; NaN-free, black where there is no surface."""
    view = np.array([0.0, 0.0, 1.0])
    arrays = {key: np.array(value) if isinstance(value, list) else value for key, value in values.items()}
    hit = (normal != 0).any(-1, keepdims=True)
    n = np.where(hit, normal, view)
    return [part * hit * np.ones(3) for part in BRDFS[kind](n, toward, view, **arrays)]


@pytest.mark.render
@pytest.mark.parametrize(("kind", "example"), CASES)
def test_parts_sum_up_and_the_twin_is_lambertian(worker, job, pixel_rays, kind: str, example: int) -> None:
    """At one sample and at four: combined = diffuse + specular, nothing negative, and where lit matte = albedo * intensity * n.l."""
    lights = [
        {"direction": [0.6, 0.0, 0.8], "intensity": [1.0, 2.0, 0.5]},
        {"direction": [-0.48, 0.64, 0.6], "intensity": WHITE},
        {"kind": "point", "position": [-60.0, 50.0, 70.0], "intensity": WHITE},
    ]
    asked = job("sphere", "orthographic", size=(64, 48), material={"kind": kind, **EXAMPLES[kind][example]}, lights=lights)
    layers = worker.render(asked)
    for found in (layers, worker.render({**asked, "supersampling": 2, "lights": lights[:1]})):
        peak = found["combined"].max()
        assert found["sum_error"].max() < 1e-6
        assert abs(found["combined"] - found["diffuse"] - found["specular"]).max() <= 2e-6 * peak
        assert all(found[name].min() >= 0 and np.isfinite(found[name]).all() for name in ("diffuse", "specular", "matte"))
    assert (layers["combined"].max() > 0.01) == (kind != "mirror")
    normal, points = normals_and_points(asked, layers, pixel_rays)
    for k, light in enumerate(lights):
        toward, intensity = light_at(light, points)
        expected = layers["albedo"] * intensity * np.maximum((normal * toward).sum(-1), 0)[..., None]
        sure = normal[..., 2] > 1e-3
        # A point light's distance is known to the half width of the filter.
        assert abs(layers["matte"][k] - expected)[sure].max() <= (1e-6 if k < 2 else 5e-5) * max(expected.max(), 1)


@pytest.mark.render
@pytest.mark.parametrize(
    ("kind", "example", "shape"), [(kind, i, ("sphere", "cylinder")[i % 2]) for kind, i in CASES if kind in BRDFS]
)
def test_layers_are_the_reference_brdf(worker, job, pixel_rays, kind: str, example: int, shape: str) -> None:
    """Under suns to 1e-5 of the peak (Cycles' own lobe of Ashikhmin and Shirley, which takes powers in single precision: 1e-4), and
    near a point light, whose direction is known to the half width of the filter, to 5e-4."""
    values = EXAMPLES[kind][example]
    lights = [
        {"direction": [0.6, 0.0, 0.8], "intensity": [1.0, 2.0, 0.5]},
        {"direction": [-0.48, 0.64, 0.6], "intensity": WHITE},
        {"direction": [0.0, 0.0, 1.0], "intensity": WHITE},
        {"kind": "point", "position": [-60.0, 50.0, 70.0], "intensity": [1.0, 2.0, 0.5]},
    ]
    asked = job(shape, "orthographic", size=(64, 48), material={"kind": kind, **values}, lights=lights)
    layers = worker.render(asked)
    normal, points = normals_and_points(asked, layers, pixel_rays)
    sure = normal[..., 2] > 1e-3
    for k, light in enumerate(lights):
        toward, intensity = light_at(light, points)
        allowed = 5e-4 if "kind" in light else 1e-4 if kind == "blinn-phong-lobe" else 1e-5
        for name, part in zip(("diffuse", "specular", "matte"), reference(kind, values, normal, toward), strict=True):
            peak = (part * intensity).max()
            assert abs(layers[name][k] - part * intensity)[sure].max() <= allowed * peak + 1e-9, (name, k)


# ---- light from everywhere

FURNACE = {
    "approximate-substrate": [
        {"diffuse": [0.9, 0.5, 0.1], "specular": [0.02, 0.5, 1.0], "alpha": alpha} for alpha in (0.05, 0.3, 0.9)
    ],
    "blinn-phong-lobe": [{"diffuse": [0.9, 0.5, 0.1], "specular": [0.1, 1.0, 3.0], "exponent": s} for s in (30.0, 200.0)],
    "lambertian": [{"diffuse": [0.9, 0.5, 0.1]}],
}


def directional_albedo(kind: str, values: dict[str, Any], cosines: np.ndarray) -> np.ndarray:
    """(2, N, 3): diffuse and specular share of light that comes evenly from everywhere, by summing `gen.brdfs` over directions."""
    half, phi = np.meshgrid((np.arange(900) + 0.5) / 900, (np.arange(64) + 0.5) / 64 * np.pi, indexing="ij")
    # Denser about the mirrored direction: the half vector's angle is (pi/2) u^2.
    theta = np.pi / 2 * half**2
    h = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    area = np.sin(theta) * np.pi / 2 * 2 * half / 900 * 2 * np.pi / 64
    arrays = {key: np.array(value) if isinstance(value, list) else value for key, value in values.items()}
    found = []
    for mo in cosines:
        view = np.array([np.sqrt(1 - mo**2), 0.0, mo])
        ld = h @ view
        toward = 2 * ld[..., None] * h - view
        measure = (4 * np.maximum(ld, 0) * area)[..., None] / np.pi
        parts = BRDFS[kind](np.array([0.0, 0.0, 1.0]), toward, view, **arrays)
        found.append([(part * measure).sum((0, 1)) for part in parts[:2]])
    return np.swapaxes(np.array(found), 0, 1)


@pytest.mark.render
@pytest.mark.parametrize(("kind", "example"), [(kind, i) for kind in FURNACE for i in range(len(FURNACE[kind]))])
def test_under_the_same_light_from_everywhere_albedo_is_the_exact_one(worker, job, kind: str, example: int) -> None:
    """Ring by ring on a sphere: the approximate substrate reflects as much as the exact one, diffusely and as gloss."""
    values = FURNACE[kind][example]
    asked = job(
        "sphere",
        "orthographic",
        size=(32, 32),
        pose={},
        camera={"kind": "orthographic", "width": 52.0, "distance": 200.0},
        material={"kind": kind, **values},
        lights=[{"kind": "ambient", "intensity": WHITE}],
        samples=1024,  # every pixel draws the same directions: pixels do not average them
    )
    layers = worker.render(asked)
    mo = layers["normal"][..., 2]
    exact = "substrate" if kind == "approximate-substrate" else kind
    for low, high in ((0.2, 0.35), (0.35, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 1.0)):
        ring = (mo > low) & (mo <= high)
        expected = directional_albedo(exact, values, np.array([mo[ring].mean(), mo[ring].min(), mo[ring].max()]))
        curved = abs(expected[:, 1] - expected[:, 2]) * 0.15
        for name, want, slack in zip(("diffuse", "specular"), expected[:, 0], curved, strict=True):
            found = layers[name][0][ring].mean(0)
            assert (abs(found - want) <= 0.025 * want + slack + 1e-4).all(), (name, low, found, want)


@pytest.mark.render
@pytest.mark.parametrize("values", [{"alpha": 0.3}, {"alpha": 0.05, "coat": 1.0}, {"alpha": 0.5, "metallic": 1.0}])
def test_a_white_principled_surface_gives_back_what_it_gets(worker, job, values: dict[str, Any]) -> None:
    material = {"kind": "principled", "diffuse": WHITE, **values}
    layers = worker.render(
        job(
            "sphere",
            "orthographic",
            size=(32, 32),
            material=material,
            lights=[{"kind": "ambient", "intensity": WHITE}],
            samples=64,
        )
    )
    # The pale rim of the coat, and the light that Cycles' single bounce between facets loses, are a few per cent.
    assert layers["combined"][0][layers["normal"][..., 2] > 0.3].mean() == pytest.approx(1, abs=0.05)


def test_weights_of_the_approximate_substrate_match_albedo() -> None:
    """Against the sum over directions, and F = 1 at grazing view where Rs does not matter."""
    mo = np.array([0.1, 0.4, 0.9])
    exact = directional_albedo("substrate", {"diffuse": [0.0] * 3, "specular": [0.0, 0.3, 1.0], "alpha": 0.4}, mo)[1]
    lobe = directional_albedo("metal", {"specular": [1.0] * 3, "alpha": 0.4}, mo)[1]
    a, b = weights(mo, 0.4).T
    found = (np.array([0.0, 0.3, 1.0]) * a[:, None] + np.array([1.0, 0.7, 0.0]) * b[:, None]) * lobe
    np.testing.assert_allclose(found, exact, rtol=0.01)


def test_weights_of_the_approximate_substrate_are_nearer_than_schlick_s(closed_form, job) -> None:
    """On a sphere under suns, Ks = .05 at pbrt's default gloss, where it matters."""
    alpha, specular = 0.4618, 0.05
    normal = closed_form(job("sphere", "orthographic"))[1]
    mo = normal[..., 2].clip(1e-3)
    a, b = weights(mo.ravel(), alpha, 24).T.reshape(2, *mo.shape)
    ours, schlick = specular * a + (1 - specular) * b, specular + (1 - specular) * (1 - mo) ** 5
    errors = np.zeros(2)
    for tilt in np.radians([0, 20, 35, 50, 70]):
        toward = np.array([np.sin(tilt), 0, np.cos(tilt)])
        exact = reference("substrate", {"diffuse": RD, "specular": [specular] * 3, "alpha": alpha}, normal, toward)[1][..., 0]
        lobe = reference("metal", {"specular": [1.0] * 3, "alpha": alpha}, normal, toward)[1][..., 0]
        errors += [((lobe * weight - exact) ** 2).sum() for weight in (ours, schlick)]
    assert errors[0] < 0.2 * errors[1]


# ---- textures

COLOURS = {"low": [0.1, 0.5, 0.3], "high": [0.9, 0.2, 0.3]}
WIDTHS = {"low": 0.1, "high": 0.4}
PAINTED: dict[str, dict[str, Any]] = {
    "blinn-phong": {"specular": RS},
    "blinn-phong-lobe": {"specular": RS},
    "lambertian": {},
    "metal": {},
    "oren-nayar": {"specular": RS, "sigma": 0.4},
    "substrate": {"specular": RS},
    "two-lobe": {"specular": RS, "alpha2": 0.6, "mix": 0.3},
}


def painted(kind: str, pattern: str, seed: int = 3, scale: float = 9.0, **more: Any) -> dict[str, Any]:
    """A material whose colour and gloss are textures of a pattern."""
    common = {"texture": pattern, "scale": scale, **more}
    colour = "specular" if kind == "metal" else "diffuse"
    entry = {"kind": kind, **PAINTED[kind], colour: {**common, "seed": seed, **COLOURS}}
    return entry if kind == "lambertian" else {**entry, "alpha": {**common, "seed": seed + 1, **WIDTHS}}


@pytest.mark.render
@pytest.mark.parametrize(
    ("kind", "pattern"),
    [(kind, "noise") for kind in PAINTED] + [("substrate", pattern) for pattern in PATTERNS if pattern != "noise"],
)
def test_truth_is_what_was_shaded(worker, job, kind: str, pattern: str) -> None:
    """The reference BRDF with the rendered albedo and gloss maps gives the rendered layers, and the maps keep within their bounds."""
    lights = [{"direction": [0.6, 0.0, 0.8], "intensity": [1.0, 2.0, 0.5]}, {"direction": [0.0, 0.0, 1.0], "intensity": WHITE}]
    entry = painted(kind, pattern)
    asked = job("sphere", "orthographic", size=(64, 48), material=entry, lights=lights)
    layers = worker.render(asked)
    hit = layers["normal"][..., 2] > 1e-3
    albedo, gloss = layers["albedo"], layers["gloss"][..., None]
    for maps, bounds in ((albedo, COLOURS), (gloss, WIDTHS))[: 1 if kind == "lambertian" else 2]:
        low, high = np.minimum(bounds["low"], bounds["high"]), np.maximum(bounds["low"], bounds["high"])
        assert (maps[hit] >= low - 1e-6).all()
        assert (maps[hit] <= high + 1e-6).all()
        assert (np.ptp(maps[hit], axis=0) > 0.6 * (high - low) - 1e-6).all()
    values = {key: value for key, value in entry.items() if key != "kind"}
    values["specular" if kind == "metal" else "diffuse"] = albedo.astype(np.float64)
    if kind != "lambertian":
        values["alpha"] = np.where(gloss > 0, gloss, 0.2).astype(np.float64)
    normal = layers["normal"].astype(np.float64)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    for k, light in enumerate(lights):
        parts = reference(kind, values, normal, np.array(light["direction"]))
        for name, part in zip(("diffuse", "specular", "matte"), parts, strict=True):
            part = part * light["intensity"]
            allowed = 2e-4 if kind == "blinn-phong-lobe" else 2e-5
            assert abs(layers[name][k] - part)[hit].max() <= allowed * part.max(), (name, k)


@pytest.mark.render
@pytest.mark.parametrize("pattern", PATTERNS)
def test_textures_turn_and_move_with_the_object(worker, job, pattern: str) -> None:
    """On a sphere a quarter turn about the view turns the picture, and a shift by ten pixels shifts it."""
    quarter = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    same = {"material": painted("substrate", pattern), "lights": [{"direction": [0.0, 0.0, 1.0], "intensity": WHITE}]}
    same |= {"size": (64, 64), "camera": {"kind": "orthographic", "width": 64.0, "distance": 200.0}}
    still, turned, moved = (
        worker.render(job("sphere", "orthographic", pose=pose, **same))
        for pose in ({}, {"rotation": quarter}, {"translation": [7.0, 0.0, -3.0]})
    )
    for name in ("albedo", "gloss"):
        assert np.ptp(still[name]) > 0.1
        for found, expected in ((turned[name], np.rot90(still[name])), (moved[name], np.roll(still[name], 7, axis=1))):
            apart = abs(found - expected).reshape(64, 64, -1).max(-1)
            assert np.median(apart) < 1e-4
            assert (apart < 0.01).mean() > 0.95  # edges may fall on the other side of a sample
        assert (abs(turned[name] - still[name]) > 0.01).mean() > 0.05


@pytest.mark.render
def test_seeds_are_other_patterns_and_shares_are_kept(worker, job) -> None:
    light = [{"direction": [0.0, 0.0, 1.0], "intensity": WHITE}]

    def albedo(pattern: str, seed: int, **more: Any) -> np.ndarray:
        material = painted("lambertian", pattern, seed, scale=2.0, **more)
        layers = worker.render(job("sphere", "orthographic", material=material, lights=light, n=2))
        seen: np.ndarray = (layers["albedo"][layers["coverage"] == 1][:, 0] - 0.1) / 0.8
        return seen

    first = albedo("noise", 1)
    assert first.tobytes() == albedo("noise", 1).tobytes()
    assert abs(np.corrcoef(first, albedo("noise", 2))[0, 1]) < 0.2
    assert albedo("stripes", 1, share=0.2).mean() == pytest.approx(0.2, abs=0.03)
    assert albedo("spots", 1, share=0.2).mean() == pytest.approx(0.2, abs=0.05)
    assert albedo("checker", 1).mean() == pytest.approx(0.5, abs=0.03)


@pytest.mark.render
def test_shader_outputs_come_by_both_routes(worker, start, job) -> None:
    by_file = start("--route", "exr")
    try:
        asked = job("sphere", "perspective", size=(40, 32), material=painted("metal", "cells"))
        asked["lights"] = asked["lights"][:2]
        layers = by_file.render(asked)
        for name, array in worker.render(asked).items():
            assert array.tobytes() == layers[name].tobytes(), name
    finally:
        by_file.close()


# ---- entries

BAD = [
    ({"kind": "blinn-phong", **PHONG}, "needs one of exponent and alpha"),
    ({"kind": "blinn-phong", **PHONG, "exponent": 5, "alpha": 0.1}, "needs one of exponent and alpha"),
    ({"kind": "blinn-phong", **PHONG, "exponent": 0.5}, "exponent must be from 1 to 100000"),
    ({"kind": "blinn-phong", **PHONG, "specular": [2e4, 0, 0], "exponent": 5}, "specular must be from 0 to 10000"),
    ({"kind": "metal", "specular": RS, "alpha": 0.1, "diffuse": RD}, "diffuse is unknown; there are alpha, kind, specular"),
    ({"kind": "approximate-substrate", "diffuse": RD, "specular": RS, "alpha": 1.1}, "alpha must be from 0.001 to 1"),
    ({"kind": "principled", "diffuse": RD, "alpha": 0.1, "metallic": 2}, "metallic must be from 0 to 1"),
    ({"kind": "lambertian", "diffuse": {"texture": "wood"}}, "diffuse.texture 'wood' is unknown; there are noise, cells"),
    ({"kind": "lambertian", "diffuse": {"texture": "noise", **COLOURS}}, "diffuse.scale is missing"),
    (
        {"kind": "lambertian", "diffuse": {"texture": "noise", "scale": 1, "low": 0.1, "high": 0.2}},
        "diffuse.low must be numbers of shape 3",
    ),
    ({"kind": "lambertian", "diffuse": {"texture": "cells", "scale": 1, "detail": 3, **COLOURS}}, "diffuse.detail is unknown"),
    (
        {"kind": "lambertian", "diffuse": {"texture": "cells", "scale": 1, "low": RD, "high": [2, 0, 0]}},
        "diffuse.high must be from 0 to 1",
    ),
]


@pytest.mark.parametrize(("entry", "message"), BAD, ids=[message[:30] for _, message in BAD])
def test_bad_entries_are_refused_in_one_line(entry: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError) as error:
        parse(Entries("job: material", entry))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("kind", "example"), CASES)
def test_every_material_says_what_truth_needs(kind: str, example: int) -> None:
    material = parse(Entries("job: material", {"kind": kind, **EXAMPLES[kind][example]}))
    assert np.shape(material.albedo) == (3,)
    assert 0 <= material.gloss <= 10
    bare = material.without_gloss()
    if bare is not None:
        assert not bare.specular.any()
        assert (bare.albedo == material.albedo).all()
    if kind in PAINTED:
        textured = parse(Entries("job: material", painted(kind, "spots")))
        assert isinstance(textured.albedo, Texture)
        assert kind == "lambertian" or isinstance(textured.gloss, Texture)
