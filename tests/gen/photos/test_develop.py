"""Dark, ambient, flat field and distortion, against pictures bent and dimmed by plain numpy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gen.capture import Fault
from gen.errors import InputError
from gen.images import Picture, write_png
from gen.photos.develop import Colour, Development, Frames, flat_field, undistorted

K = np.array([[220.0, 0, 101], [0, 230, 73], [0, 0, 1]])
LENS = np.array([-0.25, 0.08, 0.002, -0.001, 0.0])
SIZE = (150, 200)
HERE = Path("a.png")


def picture(linear: np.ndarray, faults: int = 0) -> Picture:
    none = np.zeros(linear.shape[:2], bool)
    return Picture(linear.astype(np.float32), none | bool(faults & 2), none, none, "linear", True, 16)


def through_the_lens(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the lens of Brown and Conrady puts the ideal pixel (x, y)."""
    u, v = (x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]
    k1, k2, p1, p2, k3 = LENS
    r2 = u**2 + v**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return (
        K[0, 0] * (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u**2)) + K[0, 2],
        K[1, 1] * (v * radial + p1 * (r2 + 2 * v**2) + 2 * p2 * u * v) + K[1, 2],
    )


def ideal_of(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The inverse, by fixed-point iteration."""
    a, b = x.copy(), y.copy()
    for _ in range(60):
        c, d = through_the_lens(a, b)
        a, b = a + (x - c), b + (y - d)
    return a, b


def pattern(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    grey = 0.5 + 0.3 * np.sin(x / 9) * np.cos(y / 7) + 0.001 * x
    return np.stack([grey, 0.8 * grey, 0.6 * grey], -1)


def test_the_lens_is_undone() -> None:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    bent = pattern(*ideal_of(x, y)).astype(np.float32)
    straight, faults = undistorted(bent, np.zeros(SIZE, np.uint8), K, LENS)
    inside = (slice(3, -3), slice(3, -3))
    assert not faults[inside].any()
    assert np.abs(bent - pattern(x, y))[inside].max() > 0.2
    assert np.abs(straight - pattern(x, y))[inside].max() < 0.008
    assert np.abs(straight - pattern(x, y))[inside].mean() < 0.002


def test_faults_follow_the_lens_and_what_it_did_not_see_is_missing() -> None:
    flags = np.zeros(SIZE, np.uint8)
    flags[20, 30] = Fault.CLIPPED
    _, found = undistorted(np.ones((*SIZE, 3), np.float32), flags, K, LENS)
    hit = np.argwhere((found & Fault.CLIPPED) > 0)
    a, b = ideal_of(np.array([30.0]), np.array([20.0]))
    assert 1 <= len(hit) <= 9
    assert np.abs(hit - [b[0], a[0]]).max() < 1.6
    assert not (found & Fault.MISSING).any(), "a barrel lens shows more than the straight picture"
    _, found = undistorted(np.ones((*SIZE, 3), np.float32), flags, K, -LENS)
    missing = (found & Fault.MISSING) > 0
    assert missing[0, 0]
    assert not missing[60:90, 80:120].any()


def test_dark_ambient_and_flat_come_off_exactly() -> None:
    rng = np.random.default_rng(0)
    scene, ambient = rng.uniform(0.1, 0.8, (2, 40, 50, 3))
    dark = rng.uniform(0.01, 0.03, (40, 50, 3))
    y, x = np.mgrid[:40, :50]
    vignette = (1 - 2e-4 * ((x - 25) ** 2 + (y - 20) ** 2))[..., None] * [0.9, 1.0, 0.7]
    raw, off = (scene + 0.1 * ambient) * vignette + dark, 0.1 * ambient * vignette + dark
    card = 0.5 * vignette + dark
    frames = Frames.of([picture(dark), picture(dark)], [HERE, HERE])
    assert frames.noise == 0
    bare = Development({None: frames})
    ambient_frame, _ = bare.without_dark(picture(off), None, HERE)
    flat_frame, _ = bare.without_dark(picture(card), None, HERE)
    whole = Development({None: frames}, ambient_frame, flat_field(flat_frame, HERE))
    found, faults = whole.finish(*whole.without_dark(picture(raw), None, HERE), HERE)
    # A grey card leaves one factor a channel open: that of its median.
    factor = (found / scene).reshape(-1, 3)
    np.testing.assert_allclose(factor, np.broadcast_to(factor[0], factor.shape), rtol=2e-5)
    np.testing.assert_allclose(factor[0], np.median(vignette, axis=(0, 1)), rtol=1e-5)
    assert not faults.any()


def test_noise_of_the_dark_frame_says_what_is_dark() -> None:
    rng = np.random.default_rng(0)
    darks = [picture(0.02 + rng.normal(0, 0.002, (60, 60, 3))) for _ in range(4)]
    frames = Frames.of(darks, [HERE] * 4)
    assert abs(frames.noise - 0.002) < 1e-4
    assert abs(Frames.of(darks[:1], [HERE]).noise - 0.002) < 2e-4
    raw = 0.02 + rng.normal(0, 0.002, (60, 60, 3))
    raw[:30] += 0.02
    values, faults = Development({None: frames}).without_dark(picture(raw), None, HERE)
    dark = (faults & Fault.DARK) > 0
    assert dark[30:].mean() > 0.98
    assert dark[:30].mean() < 0.01
    assert abs(values[30:].mean()) < 2e-4, "not cut at 0"


def test_a_dark_frame_belongs_to_its_exposure() -> None:
    one, two = (Frames.of([picture(np.full((4, 5, 3), v))], [HERE]) for v in (0.01, 0.02))
    development = Development({0.1: one, 0.4: two})
    values, _ = development.without_dark(picture(np.full((4, 5, 3), 0.5)), 0.4, HERE)
    np.testing.assert_allclose(values, 0.48, rtol=1e-6)
    with pytest.raises(InputError, match=r"no dark frame of its exposure 0\.2 s, only of 0\.1, 0\.4 s"):
        development.without_dark(picture(np.full((4, 5, 3), 0.5)), 0.2, HERE)
    with pytest.raises(InputError, match="one size"):
        development.without_dark(picture(np.full((4, 6, 3), 0.5)), 0.4, HERE)
    with pytest.raises(InputError, match="black in a channel"):
        flat_field(np.ones((4, 4, 3), np.float32) * [1, 1, 0], HERE)


def test_where_the_flat_field_is_black_nothing_is_known() -> None:
    flat = np.ones((4, 5, 3), np.float32)
    flat[0, 0] = 0.001
    found, faults = Development(flat=flat).finish(np.ones((4, 5, 3), np.float32), np.zeros((4, 5), np.uint8), HERE)
    assert faults[0, 0] == Fault.MISSING
    assert faults.sum() == Fault.MISSING
    assert np.isfinite(found).all()


def test_a_gamma_is_undone(tmp_path: Path) -> None:
    true = np.linspace(0.01, 1, 60).reshape(4, 5, 3)
    write_png(tmp_path / "a.png", np.round(true ** (1 / 1.8) * 65535).astype(np.uint16))
    found = Colour(gamma=1.8).read(tmp_path / "a.png")
    np.testing.assert_allclose(found.linear, true, atol=3e-5)
    assert found.clipped.sum() == 1
