"""Faults of a set-up and its sensor: their statistics against the formulas, their order, and that nothing happens unasked."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from PIL import Image

from gen.capture import Capture, Fault, Truth, read_capture
from gen.capture_lights import true_lights
from gen.errors import InputError
from gen.farm import Farm
from gen.faults import quantised, rng_of, shot_noise, turned, with_faults
from gen.files import dumps
from gen.formats.render_folder import write_render
from gen.images import read_image
from gen.render import render_capture
from gen.sets.verify import verify
from gen.spec import Spec, spec_from
from gen.spec_faults import Faults
from gen.srgb import srgb_to_linear

Synthetic = Callable[..., Capture]
ARRAYS = ("images", "lights", "intensities", "faults")


def flat(level: float, count: int = 4, size: int = 100, **more: Any) -> Capture:
    """Even pictures of one level, one object on the left half of the frame."""
    mask = np.zeros((size, size), bool)
    mask[:, : size // 2] = True
    lights = np.random.default_rng(0).normal([0, 0, 3], size=(count, 3))
    images = np.full((count, size, size, 3), level, np.float32)
    return Capture(**{"images": images, "lights": lights, "mask": mask, **more})


def taken(capture: Capture, seed: int = 0, clip: bool = False, **faults: Any) -> Capture:
    return with_faults(capture, Faults(**faults), rng_of(seed), clip)


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees between unit vectors (K, 3), well-conditioned for small ones."""
    return np.degrees(2 * np.arcsin(np.linalg.norm(a - b, axis=1) / 2))


def test_nothing_asked_for_is_the_capture_itself(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 24)
    assert taken(capture) is capture
    same = taken(capture, noise={"read": 0.0}, light_intensity=0.0)
    for name in ARRAYS:
        assert np.array_equal(getattr(same, name), getattr(capture, name)), name
    assert same.provenance == capture.provenance


# --- noise


@pytest.mark.parametrize("level", [0.0, 0.02, 0.3, 1.0, 4.0])
@pytest.mark.parametrize("photons", [50.0, 20_000.0, 1e8])
def test_shot_noise_has_the_variance_of_poisson(level: float, photons: float) -> None:
    n = 100_000
    noisy = shot_noise(np.full(n, level, np.float32), photons, np.random.default_rng(3)).astype(np.float64)
    variance = level / photons
    # Five standard errors of the mean and of the variance (Poisson's fourth central moment is lambda + 3 lambda^2).
    assert noisy.mean() == pytest.approx(level, abs=5 * np.sqrt(variance / n) + 1e-6 * level)
    spread = np.sqrt((2 * variance**2 + variance / photons**2) / n)
    assert noisy.var() == pytest.approx(variance, abs=5 * spread + 1e-7 * level * np.sqrt(variance))
    assert noisy.min() >= 0


def test_shot_noise_of_little_light_comes_in_whole_electrons() -> None:
    counts = 50 * shot_noise(np.full(20_000, 0.04, np.float32), 50, np.random.default_rng(1))
    assert np.allclose(counts, np.round(counts), atol=1e-5)
    assert (counts == 0).mean() == pytest.approx(np.exp(-2), abs=5 * np.sqrt(np.exp(-2) / 20_000))


def test_read_noise_is_gaussian_and_independent_in_every_channel() -> None:
    noise = taken(flat(0.25), noise={"read": 0.01}).images.astype(np.float64) - 0.25
    n = noise.size
    assert noise.std() == pytest.approx(0.01, rel=5 / np.sqrt(2 * n))
    assert abs(noise.mean()) < 5 * 0.01 / np.sqrt(n)
    assert (np.abs(noise) > 0.02).mean() == pytest.approx(0.0455, abs=5 * np.sqrt(0.0455 / n))
    correlation = np.corrcoef(noise.reshape(-1, 3).T)
    assert np.abs(correlation - np.eye(3)).max() < 5 / np.sqrt(n / 3)
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 5 / np.sqrt(n / 4)


def test_variances_add_up_and_the_gain_is_that_of_the_photon_transfer_curve() -> None:
    """Variance against signal is a line: the slope is 1 / photons, the offset the read noise squared (Janesick 2007)."""
    levels, photons, read = np.linspace(0.05, 0.95, 10), 1000.0, 0.02
    ramp = np.repeat(levels, 10)[None, None, :, None] * np.ones((4, 100, 100, 3))
    noisy = taken(flat(0, images=ramp), noise={"read": read, "photons": photons}).images.astype(np.float64)
    variance = noisy.reshape(4, 100, 10, 10, 3).var(axis=(0, 1, 3, 4))
    slope, offset = np.polyfit(levels, variance, 1)
    assert slope == pytest.approx(1 / photons, rel=0.05)
    assert offset == pytest.approx(read**2, rel=0.1)


# --- lights


@pytest.mark.parametrize("rms", [0.1, 2.0, 20.0])
def test_the_stated_directions_are_off_by_the_angle_asked_for(rms: float) -> None:
    rng = np.random.default_rng(5)
    lights = rng.normal(size=(20_000, 3))
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    stated = turned(lights, rms, rng)
    assert np.linalg.norm(stated, axis=1) == pytest.approx(1, abs=1e-12)
    off = angles(stated, lights)
    assert np.sqrt((off**2).mean()) == pytest.approx(rms, rel=5 / np.sqrt(len(off)))
    # To every side alike: the mean error across each of the lights is nothing.
    across = (stated - lights).mean(axis=0)
    assert np.linalg.norm(across) < 5 * np.radians(rms) / np.sqrt(len(off)) + np.radians(rms) ** 2


def test_light_errors_leave_the_pictures_and_say_the_truth(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 24)
    off = taken(capture, light_direction_degrees=3, light_intensity=0.1)
    assert off.images is capture.images
    assert np.array_equal(off.faults & ~np.uint8(Fault.DARK), capture.faults)
    assert off.truth is capture.truth
    lights, intensities = true_lights(off)
    assert np.array_equal(lights, capture.lights)
    assert np.array_equal(intensities, capture.intensities)
    assert (angles(off.lights, capture.lights) > 0).all()
    part = off.select([3, 1])
    assert np.array_equal(true_lights(part)[0], capture.lights[[3, 1]])
    assert true_lights(capture) == (capture.lights, capture.intensities)
    assert json.loads(dumps(off.provenance)) == off.provenance


def test_stated_intensities_have_the_spread_asked_for() -> None:
    capture = flat(0.5, count=20_000, size=2, intensities=np.full((20_000, 3), [1, 2, 4.0]))
    ratio = taken(capture, light_intensity=0.2).intensities / capture.intensities
    assert ratio[:, 1] == pytest.approx(ratio[:, 0])
    assert ratio[:, 2] == pytest.approx(ratio[:, 0])
    assert ratio[:, 0].min() > 0
    assert ratio[:, 0].mean() == pytest.approx(1, abs=5 * 0.2 / np.sqrt(20_000))
    assert ratio[:, 0].std() == pytest.approx(0.2, rel=0.05)


def test_near_lights_keep_their_distance_and_light_from_everywhere_its_direction() -> None:
    places = np.array([[0, 0, 300.0], [100, 0, 200], [np.nan] * 3, [np.nan] * 3])
    lights = np.vstack([places[:2], [[0, 1, 2.0], [0, 0, 1]]])
    capture = flat(0.5, lights=lights, light_kinds=("point", "area", "sun", "ambient"), positions=places)
    off = taken(capture, light_direction_degrees=5)
    assert off.positions is not None
    assert np.linalg.norm(off.positions[:2], axis=1) == pytest.approx(np.linalg.norm(places[:2], axis=1))
    assert off.positions[:2] / np.linalg.norm(off.positions[:2], axis=1, keepdims=True) == pytest.approx(off.lights[:2])
    assert (angles(off.lights, capture.lights)[:3] > 0).all()
    assert off.lights[3].tolist() == [0, 0, 1]
    assert off.provenance["true_positions_mm"] == [[0, 0, 300], [100, 0, 200], None, None]


@pytest.mark.parametrize("wrong", [3, "x", [[1, 2]], [[0, 0, "a"]] * 4, [[0, 0, 0]] * 4, [[0, 0, 10**400]] * 4])
def test_a_provenance_that_lies_about_the_lights_is_one_line(wrong: Any) -> None:
    capture = flat(0.5, provenance={"true_lights": wrong}, source="here")
    with pytest.raises(InputError, match=r"^here: what its provenance says of the true lights cannot be used"):
        true_lights(capture)


# --- ambient light, black level, the top, whole numbers


def test_ambient_light_is_the_albedo_under_a_share_of_the_mean_light(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 24, albedo=(0.6, 0.3, 0.1))
    capture = replace(capture, intensities=np.array([[1, 2, 3.0]] * 4 + [[6, 2, 3.0]]))
    lit = taken(capture, ambient=0.25)
    glow = lit.images - capture.images
    np.testing.assert_allclose(glow[:, capture.mask] - 0.25 * np.array([0.6 * 2, 0.3 * 2, 0.1 * 3]), 0, atol=1e-6)
    assert not glow[:, ~capture.mask].any()
    assert (lit.faults[:, capture.mask] == 0).all()
    assert lit.truth is capture.truth
    with pytest.raises(InputError, match="ambient light needs the true albedo"):
        taken(replace(capture, truth=Truth()), ambient=0.25)


def test_the_sensor_comes_after_the_light_and_the_black_level_after_the_noise() -> None:
    """Each link of the chain, alone and together, on levels where the order tells."""
    albedo = np.full((100, 100, 3), 0.5, np.float32)
    capture = flat(0.0, truth=Truth(albedo=albedo))
    # Ambient light makes shot noise of its own; the black level makes none.
    left = np.s_[:, :, :50]
    noisy = taken(capture, ambient=0.4, noise={"photons": 1000}, black_level=0.1)
    assert noisy.images[left].var() == pytest.approx(0.2 / 1000, rel=0.05)
    assert np.unique(noisy.images[:, :, 50:]).tolist() == pytest.approx([0.1])
    # Noise at the top is cut off: what the sensor shows of an overexposed sample is even.
    cut = taken(flat(0.9), clip=True, noise={"read": 0.2}, black_level=0.05)
    assert cut.images.max() == 1
    assert (cut.images == 1).mean() == pytest.approx(0.4013, abs=0.01)  # 1 - Phi((1 - 0.95) / 0.2)
    assert taken(flat(0.9), noise={"read": 0.2}).images.max() > 1
    # Below 0 only whole numbers end.
    dark = taken(flat(0.0), noise={"read": 0.1})
    assert (dark.images < 0).mean() == pytest.approx(0.5, abs=0.01)
    assert taken(flat(0.0), noise={"read": 0.1}, bits=12).images.min() == 0


def test_whole_numbers_cut_at_full_scale_too() -> None:
    cut = taken(flat(1.7), bits=8)
    assert (cut.images == 1).all()
    assert (cut.faults == Fault.CLIPPED).all()


def test_the_capture_says_its_black_level_and_its_encoding() -> None:
    said = taken(flat(0.4), black_level=0.06, bits=10, encoding="srgb")
    assert said.provenance["black_level"] == 0.06
    assert said.provenance["faults"] == {"black_level": 0.06, "bits": 10, "encoding": "srgb"}
    assert said.encoding == "srgb"
    assert "black_level" not in taken(flat(0.4), bits=10).provenance


samples = npst.arrays(np.float32, st.integers(1, 50), elements=st.floats(-1, 2, width=32))
encodings = st.sampled_from(["linear", "srgb"])


@settings(max_examples=150, deadline=None)
@given(samples, st.integers(1, 16), encodings)
def test_quantisation_is_monotone_idempotent_and_near(values: np.ndarray, bits: int, encoding: str) -> None:
    found = quantised(values, bits, encoding)
    order = np.argsort(values, kind="stable")
    assert (np.diff(found[order]) >= 0).all()
    assert np.array_equal(quantised(found, bits, encoding), found)
    assert len(np.unique(found)) <= 2**bits
    assert (found >= 0).all()
    assert (found <= 1).all()
    within = np.clip(values.astype(np.float64), 0, 1)
    steepest = 2.4 / 1.055 if encoding == "srgb" else 1.0  # of the decoding, at 1
    assert np.abs(found - within).max() <= steepest * 0.5 / (2**bits - 1) + 1e-6


@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_eight_bits_are_what_a_picture_file_holds(tmp_path: Any, encoding: str) -> None:
    numbers = np.arange(256, dtype=np.uint8)
    Image.fromarray(np.repeat(numbers[None, :, None], 3, axis=2)).save(tmp_path / "ramp.png")
    decoded = read_image(tmp_path / "ramp.png", encoding).linear[0, :, 0]
    exact = numbers / 255 if encoding == "linear" else srgb_to_linear(numbers / 255)
    assert np.array_equal(quantised(exact.astype(np.float32), 8, encoding), decoded)


# --- flags


def test_flags_are_what_the_sensor_sees() -> None:
    levels = np.float32([0, 0.001, 0.2, 0.97, 2.0])
    images = np.repeat(levels, 20)[None, None, :, None] * np.ones((4, 100, 1, 3), np.float32)
    images[..., 1:] *= np.float32(0.5)
    found = taken(flat(0, images=images), black_level=0.04, bits=6).faults[:, :, ::20]
    assert (found[..., 0] == Fault.DARK).all()  # nothing but the black level
    assert (found[..., 1] == Fault.DARK).all()  # less than half a step above it
    assert (found[..., 2] == 0).all()
    assert (found[..., 3] == Fault.CLIPPED).all()  # red alone, with the black level
    assert (found[..., 4] == Fault.CLIPPED).all()


def test_what_is_lost_in_the_noise_is_dark_and_what_is_missing_stays_so() -> None:
    images = np.full((4, 100, 100, 3), 0.5, np.float32)
    images[:, :, :50] = 0
    images[0, 0, 0] = np.nan
    noisy = taken(flat(0, images=images), noise={"read": 0.01}, black_level=0.1)
    dark = (noisy.faults & Fault.DARK) > 0
    assert dark[:, :, :50].mean() == pytest.approx(0.99865**3, abs=0.003)
    assert not dark[:, :, 50:].any()
    assert noisy.faults[0, 0, 0] & Fault.MISSING
    assert ((noisy.faults & Fault.MISSING) > 0).sum() == 1


# --- seeds, files, specs

ALL: dict[str, Any] = {
    "light_direction_degrees": 2.0,
    "light_intensity": 0.1,
    "ambient": 0.1,
    "noise": {"read": 0.005, "photons": 5000},
    "black_level": 0.03,
    "bits": 12,
    "encoding": "srgb",
}


def test_the_same_seed_gives_the_same_and_another_one_another(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 24)
    first, again, other = (taken(capture, seed, **ALL) for seed in (7, 7, 8))
    for name in ARRAYS:
        assert np.array_equal(getattr(first, name), getattr(again, name)), name
    assert first.provenance == again.provenance
    assert not np.array_equal(first.images, other.images)
    assert not np.array_equal(first.lights, other.lights)


@pytest.mark.parametrize("left_out", [key for key in ALL if key != "encoding"])
def test_one_fault_does_not_change_the_draws_of_another(synthetic: Synthetic, left_out: str) -> None:
    capture = synthetic("sphere", 24)
    gone = {left_out, "encoding"} if left_out == "bits" else {left_out}
    full, part = taken(capture, **ALL), taken(capture, **{key: value for key, value in ALL.items() if key not in gone})
    assert np.array_equal(full.lights, part.lights) == (left_out != "light_direction_degrees")
    assert np.array_equal(full.intensities, part.intensities) == (left_out != "light_intensity")
    assert np.array_equal(full.images, part.images) == left_out.startswith("light_")


def test_a_faulty_capture_comes_back_from_its_folder(synthetic: Synthetic, tmp_path: Any) -> None:
    capture = taken(synthetic("sphere", 16), **ALL)
    write_render(capture, tmp_path / "c")
    found = read_capture(tmp_path / "c")
    for name in ARRAYS:
        assert np.array_equal(getattr(found, name), getattr(capture, name)), name
    for name in capture.truth.names():
        assert np.array_equal(getattr(found.truth, name), getattr(capture.truth, name), equal_nan=True), name
    assert (found.encoding, found.provenance) == (capture.encoding, capture.provenance)
    assert np.array_equal(true_lights(found)[0], true_lights(capture)[0])


BASE: dict[str, Any] = {
    "name": "a",
    "shape": {"name": "sphere"},
    "camera": {"kind": "orthographic", "width_mm": 60},
}


def spec(**more: Any) -> Spec:
    return spec_from({**BASE, **more}, "f.yaml")


def test_a_spec_may_ask_for_faults() -> None:
    asked = spec(faults=ALL)
    assert asked.faults == Faults(**ALL)
    assert spec_from(asked.plain(), "x") == asked
    assert "faults" not in spec().plain()
    assert spec(faults={"bits": 12}).digest() != spec().digest()


@pytest.mark.parametrize(
    ("faults", "says"),
    [
        ({"ambiant": 0.1}, "faults.ambiant: unknown key; did you mean 'ambient'?"),
        ({"noise": {"reed": 0.1}}, "faults.noise.reed: unknown key; did you mean 'read'?"),
        ({"noise": {"read": -1}}, "faults.noise.read: must be at least 0"),
        ({"noise": {"photons": 0}}, "faults.noise.photons: must be at least 1"),
        ({"noise": 0.1}, "faults.noise: must hold 'key: value' pairs"),
        ({"bits": 0}, "faults.bits: must be at least 1"),
        ({"bits": 8.5}, "faults.bits: must be a whole number"),
        ({"black_level": 1}, "faults.black_level: must be less than 1"),
        ({"light_direction_degrees": float("nan")}, "faults.light_direction_degrees: must be a finite number"),
        ({"encoding": "srgb"}, "faults: encoding says what whole numbers mean; it needs bits"),
        ({"bits": 8, "encoding": "log"}, "faults.encoding: must be 'linear' or 'srgb'"),
        ([], "faults: must hold 'key: value' pairs"),
    ],
)
def test_what_a_spec_gets_wrong_is_one_line(faults: Any, says: str) -> None:
    with pytest.raises(InputError) as error:
        spec(faults=faults)
    assert str(error.value).startswith(f"f.yaml: {says}")


@pytest.mark.render
def test_a_render_with_faults_is_the_clean_one_with_faults(tmp_path: Any) -> None:
    """Through the whole factory: light errors, near lights and a sensor, and a set-up that only its light table is wrong of."""
    lights = [[0, 0, 1], {"kind": "point", "position_mm": [150, 0, 250], "intensity": 2}, [0, 3, 4], [-3, 0, 4]]
    small = {"resolution": [32, 32], "seed": 5, "lights": lights, "clip": True, "exposure": 3.0}
    only_lights = {"light_direction_degrees": 4.0, "light_intensity": 0.2}
    with Farm() as farm:
        clean, wrong, noisy, half = (
            render_capture(spec(**small, **more), tmp_path / name, farm=farm).capture
            for name, more in {
                "clean": {},
                "wrong": {"faults": only_lights},
                "noisy": {"faults": ALL},
                "half": {"faults": ALL, "half": True},
            }.items()
        )
    for name in ("clean", "wrong", "noisy", "half"):
        assert verify(tmp_path / name).faults == (), name
    assert clean.light_kinds == ("sun", "point", "sun", "sun")
    assert clean.positions is not None
    assert clean.positions[1].tolist() == [150, 0, 250]
    assert np.array_equal(wrong.images, clean.images)
    assert np.array_equal(wrong.faults, clean.faults)
    for capture in (wrong, noisy):
        assert np.array_equal(true_lights(capture)[0], clean.lights)
        assert np.array_equal(true_lights(capture)[1], clean.intensities)
        for name in clean.truth.names():
            assert np.array_equal(getattr(capture.truth, name), getattr(clean.truth, name), equal_nan=True), name
    assert np.array_equal(read_capture(tmp_path / "half").images, half.images)
    for capture in (clean, noisy):
        assert capture.images.max() == 1
        assert np.array_equal((capture.faults & Fault.CLIPPED) > 0, (capture.images >= 1).any(axis=3))
    # The noise of what would be overexposed is cut off together with it, not added to what was cut.
    beyond = (clean.truth.diffuse + clean.truth.specular).min(axis=3) > 1.3  # type: ignore[operator]
    assert beyond.any()
    assert (noisy.images[beyond] == 1).all()
