"""The group network's layers are checked by their normals: in closed form, and on the captures that the checks are for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gen import large
from gen.capture import Bools, Capture, Fault, Floats, read_capture
from learn.normals_check import STEEPEST, WORTH, CoarseNormals, check, curl, doubt, needless
from learn.real import errors
from recon.light_draws import draws
from recon.normals.least_squares import least_squares
from recon.registry import GLOSS, Layers

Synthetic = Callable[..., Capture]

FRONTAL = np.array([[0, 0, 1], [0.3, 0, 0.91**0.5], [-0.18, 0.24, 0.91**0.5], [-0.18, -0.24, 0.91**0.5]])
"""Toward four lights that reach nearly all of a sphere."""


def normals_of(p: Floats, q: Floats) -> Floats:
    """Unit normals (H, W, 3) of the slopes dz/dx and dz/dy."""
    n = np.stack([-p, -q, np.ones_like(p)], -1)
    return np.asarray(n / np.linalg.norm(n, axis=2, keepdims=True), np.float32)


def grid(size: int) -> tuple[Floats, Floats]:
    """x to the right and y up, in pixels from the middle."""
    y, x = np.mgrid[:size, :size].astype(float) - (size - 1) / 2
    return x, -y


@pytest.mark.parametrize("a", [0.002, -0.004])
def test_curl_of_turning_slopes_in_closed_form(a: float) -> None:
    """p = -a y, q = a x turn about the middle: dp/dy - dq/dx = -2 a everywhere."""
    x, y = grid(61)
    n = normals_of(-a * y, a * x)
    found, whole = curl(n, np.ones(x.shape, bool))
    z = (n[:-1, :-1, 2] + n[1:, :-1, 2] + n[:-1, 1:, 2] + n[1:, 1:, 2]) / 4
    assert whole.all()
    np.testing.assert_allclose(found, 2 * abs(a) * z, rtol=1e-4)


@pytest.mark.parametrize("surface", ["sphere", "waves", "plane"])
def test_surfaces_have_no_curl(surface: str) -> None:
    x, y = grid(80)
    inside = x**2 + y**2 < 30**2
    if surface == "sphere":
        z = np.sqrt(40**2 - np.minimum(x**2 + y**2, 39**2))
        p, q = -x / z, -y / z
    elif surface == "waves":
        p, q = 0.5 * np.cos(x / 8) * np.cos(y / 9), -4 / 9 * np.sin(x / 8) * np.sin(y / 9)
    else:
        p, q = np.full_like(x, 0.4), np.full_like(x, -0.3)
    found, whole = curl(normals_of(p, q), inside)
    assert whole.sum() < inside.sum()
    assert not found[~whole].any()
    assert float(found[whole].max()) < (1e-6 if surface == "plane" else 3e-3)


def test_curl_is_bounded_where_normals_lie_in_the_picture_plane() -> None:
    rng = np.random.default_rng(0)
    n = rng.normal(size=(40, 40, 3)).astype(np.float32)
    n[:10] = 0
    n[10:20, :, 2] = 0
    found, _ = curl(n, np.ones((40, 40), bool))
    assert np.isfinite(found).all()
    assert float(found.max()) <= 1
    assert STEEPEST > 0


def doubt_of(capture: Capture, layers: Layers) -> Floats:
    """`doubt` (H, W)."""
    fields = CoarseNormals.of(capture, layers, capture.mask)
    return fields.full(doubt(fields))


def layers_of(capture: Capture, matte: Floats) -> Layers:
    """Layers with that matte twin, all samples trusted alike but little."""
    there = capture.mask[None] & ((capture.faults & Fault.MISSING) == 0)
    return Layers(capture.images.copy(), np.zeros_like(capture.images), matte.astype(np.float32), 0.1 * there.astype(np.float32))


def half_turned(synthetic: Synthetic, size: int = 120) -> tuple[Capture, Layers, Bools]:
    """A matte sphere whose matte twin has, in the right half, the shading of slopes that turn about a point: no surface has them."""
    capture = synthetic(size=size, layer="matte")
    x, y = grid(size)
    right = (x > 0) & capture.mask
    turning = normals_of(4 * y / size, -4 * (x - size / 5) / size)
    shading = np.clip(np.einsum("hwc,kc->khw", turning, capture.lights), 0, None)
    matte = np.where(right[None, ..., None], 0.4 * shading[..., None], capture.images)
    return capture, layers_of(capture, matte), right


def test_only_what_is_no_surface_is_doubted(synthetic: Synthetic) -> None:
    capture, layers, right = half_turned(synthetic)
    x, y = grid(120)
    doubted = doubt_of(capture, layers)
    assert doubted.dtype == np.float32
    assert not doubted[~capture.mask].any()
    inner = right & (x > 20) & (np.hypot(x, y) < 40)
    assert float(doubted[inner].min()) > 0.6
    assert float(np.quantile(doubted[inner], 0.1)) == 1
    assert float(doubted[capture.mask & (x < -30)].max()) < 0.02
    same = layers_of(capture, capture.images)
    assert not doubt_of(capture, same).any()


def test_where_doubted_the_pictures_are_measured_and_elsewhere_nothing_changes(synthetic: Synthetic) -> None:
    capture, layers, _ = half_turned(synthetic)
    faults = capture.faults.copy()
    faults[1, 50:60] |= int(Fault.MISSING)
    capture = replace(capture, faults=faults)
    assert layers.matte is not None
    layers = layers_of(capture, layers.matte)
    before = Layers(*(None if layer is None else layer.copy() for layer in vars(layers).values()))  # type: ignore[arg-type]
    doubted = doubt_of(capture, layers)
    layers = check(capture, layers, capture.mask)
    np.testing.assert_array_equal(layers.doubt, doubted)
    assert layers.matte is not None
    assert layers.confidence is not None
    assert before.matte is not None
    assert before.confidence is not None
    for name in ("diffuse", "specular"):
        np.testing.assert_array_equal(getattr(layers, name), getattr(before, name))
    assert layers.kept is not None
    believed, out = layers.kept == 0, doubted == 1
    assert believed.any()
    np.testing.assert_array_equal(layers.matte[:, believed], before.matte[:, believed])
    np.testing.assert_array_equal(layers.confidence[:, believed], before.confidence[:, believed])
    there = ((faults & Fault.MISSING) == 0) & capture.mask
    np.testing.assert_allclose(layers.matte[there & out], capture.images[there & out], atol=1e-6)
    assert not layers.confidence[~there].any()
    assert (layers.confidence[there & out] > 0).all()
    raw, found = (
        least_squares(capture.reflectance(images), capture.lights, capture.mask, weights).normal
        for images, weights in ((capture.images, there.astype(np.float32)), (layers.matte, layers.confidence))
    )
    np.testing.assert_allclose(found[out], raw[out], atol=1e-4)


@pytest.mark.parametrize("strip", [700, 9000])
def test_strips_make_no_difference(synthetic: Synthetic, monkeypatch: pytest.MonkeyPatch, strip: int) -> None:
    capture, layers, _ = half_turned(synthetic, 300)
    whole = doubt_of(capture, layers)
    assert 0.2 < float(whole[capture.mask].mean()) < 0.8
    monkeypatch.setattr(large, "STRIP", strip)
    np.testing.assert_array_equal(doubt_of(capture, layers), whole)


def test_size_of_the_picture_hardly_matters(synthetic: Synthetic) -> None:
    """Objects of any whole multiple of `ACROSS` pixels are looked at alike."""
    small, large_ = (doubt_of(*half_turned(synthetic, size)[:2]) for size in (160, 480))
    assert float(np.abs(large_[1::3, 1::3] - small).mean()) < 0.02


def test_layers_without_a_matte_twin_are_refused(synthetic: Synthetic) -> None:
    capture = synthetic(size=20)
    with pytest.raises(ValueError, match="matte"):
        check(capture, Layers(capture.images, np.zeros_like(capture.images)), capture.mask)


@pytest.mark.data
def test_metal_of_the_reference_data_is_not_harmed(data_folder: Path) -> None:
    """A tile of metals that mirror more than they scatter: without the check of curl, most draws come out worse."""
    tile = read_capture(data_folder / "synthrti_tile/Dome")
    group = GLOSS.load("group")
    for chosen in draws(tile.lights, 3, 5):
        part = tile.select(chosen)
        assert errors(part, group) < errors(part, None)
    many = tile.select(draws(tile.lights, 1, 12)[0])
    assert errors(many, group) < errors(many, None) - 0.5


@pytest.mark.parametrize("specular", [0.04, 0.4])
@pytest.mark.parametrize("alpha", [0.05, 0.3])
def test_coated_things_are_not_doubted_and_worth_it(synthetic: Synthetic, alpha: float, specular: float) -> None:
    layers = GLOSS.load("group")(synthetic(size=96, specular=specular, alpha=alpha))
    assert layers.doubt is not None
    assert layers.kept is not None
    assert float(layers.doubt.max()) < 0.01
    assert float(layers.kept.max()) < 0.01


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_of_matte_things_the_pictures_stay(synthetic: Synthetic, shape: str) -> None:
    capture = synthetic(shape, size=96, layer="matte", lights=FRONTAL)
    layers = GLOSS.load("group")(capture)
    assert layers.kept is not None
    assert (layers.kept[capture.mask] == 1).all()
    np.testing.assert_allclose(layers.matte, capture.images, atol=1e-6)


def tilted(angle: Floats) -> CoarseNormals:
    """Of a plane that faces the camera, and what tilts it by angles (h, w) in degrees; all of it is the object."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    raw, found = (np.stack(n, -1).astype(np.float32) for n in ((0 * c, 0 * c, 0 * c + 1), (0 * c, s, c)))
    every = np.ones(angle.shape, bool)
    return CoarseNormals(raw, found, every, every, 1)


@pytest.mark.parametrize(("angle", "left"), [(0, 1), (3, 1), (3.5, 0.75), (4.5, 0.25), (5, 0), (60, 0)])
def test_a_change_over_the_whole_object_counts_from_three_to_five_degrees(angle: float, left: float) -> None:
    fields = tilted(np.full((60, 80), angle, np.float32))
    np.testing.assert_allclose(needless(fields, np.zeros((60, 80), np.float32)), left, atol=1e-3)


@pytest.mark.parametrize(("angle", "radius"), [(30, 8), (60, 4), (17, 25)])
def test_a_spot_that_changes_much_is_used_and_no_more(angle: float, radius: float) -> None:
    """Though the mean over the object, of 120 x 120 pixels, is under the least at which the whole of it would be used."""
    x, y = grid(120)
    r = np.hypot(x, y)
    spot = np.where(r < radius, angle, 0).astype(np.float32)
    assert spot.mean() < WORTH[0][1]
    left = needless(tilted(spot), np.zeros(spot.shape, np.float32))
    assert float(left[r < radius / 2].max()) < 0.1
    assert float(left[r > 50].min()) == 1
    np.testing.assert_array_equal(needless(tilted(spot), (r < radius).astype(np.float32)), 1)  # doubted, it turns nothing


def test_where_little_changes_the_pictures_are_measured_with_the_confidence(synthetic: Synthetic) -> None:
    """A matte twin that is the pictures under lights a little aside: its normals are turned by two degrees."""
    capture = synthetic(size=96, layer="matte")
    t = np.radians(2)
    aside = capture.lights @ np.array([[1, 0, 0], [0, np.cos(t), -np.sin(t)], [0, np.sin(t), np.cos(t)]])
    assert capture.truth.normals is not None
    shading = np.clip(np.einsum("hwc,kc->khw", capture.truth.normals, aside), 0, None)[..., None]
    given = layers_of(capture, 0.4 * np.broadcast_to(shading, capture.images.shape))
    assert given.confidence is not None
    trust = given.confidence.copy()
    layers = check(capture, given, capture.mask)
    assert layers.kept is not None
    assert layers.doubt is not None
    assert not layers.doubt.any()
    np.testing.assert_array_equal(layers.kept, capture.mask)
    np.testing.assert_allclose(layers.matte, capture.images * capture.mask[..., None], atol=1e-6)
    np.testing.assert_array_equal(layers.confidence, trust)


def test_black_around_an_object_without_a_mask_does_not_count_as_what_hardly_changes(synthetic: Synthetic) -> None:
    tight = synthetic(size=96, specular=0.04, alpha=0.1)
    images = np.pad(tight.images, ((0, 0), (60, 60), (60, 60), (0, 0)))
    layers = GLOSS.load("group")(Capture(images, tight.lights, np.ones(images.shape[1:3], bool)))
    assert layers.kept is not None
    assert float(layers.kept[60:-60, 60:-60][tight.mask].max()) < 0.01
