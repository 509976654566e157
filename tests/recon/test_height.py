"""Integration against closed forms, for every registered integrator, orthographic and perspective."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gen.capture import Scale
from gen.errors import InputError
from gen.images import read_image
from recon.registry import HEIGHT

Surface = tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.float64]]


def grid(size: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    row, column = np.mgrid[:size, :size].astype(float)
    return column - (size - 1) / 2, (size - 1) / 2 - row


def sphere(size: int) -> Surface:
    x, y = grid(size)
    R = 0.48 * size
    mask = x**2 + y**2 < R**2
    z = np.sqrt(np.where(mask, R**2 - x**2 - y**2, 0))
    return (np.stack([x, y, z], -1) / R * mask[..., None]).astype(np.float32), mask, z


def cylinder(size: int) -> Surface:
    x, y = grid(size)
    R = 0.45 * size
    mask = (abs(x) < R) & (abs(y) < 0.4 * size)
    z = np.sqrt(np.where(mask, R**2 - x**2, 0))
    return (np.stack([x, 0 * x, z], -1) / R * mask[..., None]).astype(np.float32), mask, z


def waves(size: int) -> Surface:
    """A smooth relief on the whole frame, with a hole."""
    x, y = (v / size for v in grid(size))
    a, b = 0.1 * size, 0.03 * size
    z = a * np.sin(6 * x) * np.cos(5 * y) + b * np.sin(14 * x + 3 * y)
    zx = (6 * a * np.cos(6 * x) * np.cos(5 * y) + 14 * b * np.cos(14 * x + 3 * y)) / size
    zy = (-5 * a * np.sin(6 * x) * np.sin(5 * y) + 3 * b * np.cos(14 * x + 3 * y)) / size
    n = np.stack([-zx, -zy, np.ones_like(z)], -1)
    mask = (x - 0.1) ** 2 + y**2 > 0.01
    return (n / np.linalg.norm(n, axis=-1, keepdims=True)).astype(np.float32), mask, z


ROUNDED = {"bilateral": 3.5e-2}
"""Share of the range by which an integrator of one-sided differences may miss a coarsely sampled smooth surface; 1e-3 for all others."""

TORN = {"quadratic": (0.6, 0.9, 0.6), "dct": (1.1, 2.5, 0.8), "bilateral": (0.5, 0.11, 0.23), "adaptive": (0.334, 0.074, 0.17)}
"""Worst mean depth errors in mm on bear, cat and pot2. `dct` has no weights at all and does badly across their steps."""


@pytest.fixture(params=[*HEIGHT])
def integrate(request: pytest.FixtureRequest) -> Callable[..., object]:
    return HEIGHT.load(request.param)


@pytest.mark.parametrize("surface", [sphere, cylinder, waves])
@pytest.mark.parametrize("size", [64, 256])
def test_heights_of_analytic_shapes(integrate, surface, size: int) -> None:  # type: ignore[no-untyped-def]
    """Root mean square error at most 1e-3 of the range (or `ROUNDED`) where n_z is at least .1."""
    normal, mask, z = surface(size)
    result = integrate(normal, mask, Scale())
    counted = mask & (normal[..., 2] >= 0.1)
    error = (result.height - z)[counted]
    assert result.unit == "px"
    assert np.sqrt(((error - error.mean()) ** 2).mean()) <= ROUNDED.get(integrate.__name__, 1e-3) * np.ptp(z[counted])
    assert np.isnan(result.height[~mask]).all()
    assert abs(result.height[mask].mean()) < 1e-3


def perspective_sphere(size: int, f: float, distance: float, radius: float) -> tuple[Surface, Scale]:
    """A sphere on the axis seen by a pinhole camera with an off-centre principal point; z is its depth in mm."""
    K = np.array([[f, 0, size / 2 + 7], [0, f * 1.01, size / 2 - 5], [0, 0, 1]])
    row, column = np.mgrid[:size, :size].astype(float)
    ray = np.stack([(column - K[0, 2]) / K[0, 0], -(row - K[1, 2]) / K[1, 1], -np.ones_like(row)], -1)
    centre = np.array([0, 0, -distance])
    a, b, c = (ray**2).sum(-1), ray @ centre, centre @ centre - radius**2
    root = b**2 - a * c
    mask = root > 0
    depth = np.where(mask, (b - np.sqrt(np.where(mask, root, 0))) / a, 0)
    n = (ray * depth[..., None] - centre) / radius * mask[..., None]
    return (n.astype(np.float32), mask, depth), Scale(camera=K)


@pytest.mark.parametrize("distance_known", [False, True])
def test_perspective_sphere(integrate, distance_known: bool) -> None:  # type: ignore[no-untyped-def]
    (normal, mask, depth), scale = perspective_sphere(160, 500, 200, 25)
    middle = float(depth[mask].mean())
    if distance_known:
        scale = Scale(camera=scale.camera, distance_mm=middle)
    result = integrate(normal, mask, scale)
    unit = 1e-3 if distance_known else 500 / middle
    counted = mask & (normal[..., 2] >= 0.1)
    error = (result.height + depth * unit)[counted]
    assert result.unit == ("m" if distance_known else "px")
    assert np.sqrt(((error - error.mean()) ** 2).mean()) <= ROUNDED.get(integrate.__name__, 1e-3) * np.ptp(depth[counted]) * unit
    # The points lie on a sphere of the right radius.
    P = result.points[counted].astype(float)
    A = np.concatenate([2 * P, np.ones((len(P), 1))], 1)
    s = np.linalg.lstsq(A, (P**2).sum(1), rcond=None)[0]
    assert np.sqrt(s[3] + s[:3] @ s[:3]) == pytest.approx(25 * unit, rel=2 * ROUNDED.get(integrate.__name__, 1e-3))


def test_scale_gives_metres(integrate) -> None:  # type: ignore[no-untyped-def]
    normal, mask, _ = sphere(64)
    plain, scaled = integrate(normal, mask, Scale()), integrate(normal, mask, Scale(mm_per_pixel=0.5))
    assert scaled.unit == "m"
    assert np.allclose(scaled.height[mask], plain.height[mask] * 5e-4, atol=1e-8)
    assert np.allclose(scaled.points[mask], plain.points[mask] * 5e-4, atol=1e-8)


def test_tilted_plane_and_its_axes(integrate) -> None:  # type: ignore[no-untyped-def]
    """Rising to the right and upward: the signs of both axes."""
    n = np.array([-0.3, -0.2, 0.93])
    n /= np.linalg.norm(n)
    x, y = grid(32)
    result = integrate(np.broadcast_to(n, (32, 32, 3)).astype(np.float32), np.ones((32, 32), bool), Scale())
    expected = -(n[0] * x + n[1] * y) / n[2]
    assert np.abs(result.height - expected).max() < 1e-3
    assert np.allclose(result.points[..., 0], x)
    assert np.allclose(result.points[..., 1], y)


def test_parts_float_each_at_mean_zero(integrate) -> None:  # type: ignore[no-untyped-def]
    normal, mask, _ = sphere(64)
    mask = mask.copy()
    mask[:, 31:33] = False
    result = integrate(normal, mask, Scale())
    for part in (slice(0, 31), slice(33, 64)):
        assert abs(np.nanmean(result.height[:, part])) < 1e-3


def test_noise_and_backward_normals_do_not_break_it(integrate) -> None:  # type: ignore[no-untyped-def]
    normal, mask, z = sphere(96)
    rng = np.random.default_rng(0)
    noisy = normal + 0.05 * rng.normal(size=normal.shape)
    noisy[40:43, 50:53] = [0.3, 0, -0.95]
    noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
    result = integrate(noisy.astype(np.float32), mask, Scale())
    error = (result.height - z)[mask]
    assert np.isfinite(result.height[mask]).all()
    assert np.sqrt(((error - error.mean()) ** 2).mean()) < 0.05 * np.ptp(z[mask])


def test_nothing_to_integrate_is_refused(integrate) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match="no pixel"):
        integrate(np.zeros((8, 8, 3), np.float32), np.ones((8, 8), bool), Scale())


@pytest.mark.data
@pytest.mark.parametrize(("place", "name"), [(0, "bear"), (1, "cat"), (2, "pot2")])
def test_depth_of_true_normals(integrate, data_folder: Path, place: int, name: str) -> None:  # type: ignore[no-untyped-def]
    """Mean absolute depth error in mm after the median scale, from true normals; plain quadratic integration is at .511, .407 and .158."""
    folder = data_folder / "bini_diligent" / name
    mask = read_image(folder / "mask.png").linear[..., 0] > 0.5
    normal = read_image(folder / "normal_map.png", "linear").linear * 2 - 1
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    true = np.load(folder / "depth_gt.npz")["depth_gt"]
    result = integrate(normal * mask[..., None], mask, Scale(camera=np.loadtxt(folder / "K.txt"), distance_mm=1500))
    depth = 1500 - 1000 * result.height
    scale = np.median(true[mask] / depth[mask])
    assert np.abs(scale * depth - true)[mask].mean() <= TORN[integrate.__name__][place]
