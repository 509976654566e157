"""Large captures: what is worked out in strips, on the grid and in files is what is worked out at once."""

from __future__ import annotations

import gc
import mmap
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen import large
from gen.capture import Capture, Fault, Scale, Truth
from gen.errors import InputError
from recon import big_bench
from recon.metrics import angular_error
from recon.pipeline import measure
from recon.reconstruct import PIXELWISE
from recon.registry import HEIGHT, NORMALS
from tests.conftest import full_disk

Synthetic = Callable[..., Capture]


@pytest.fixture
def small_is_large(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[], Path]:
    """Call it, and captures of any size are treated as large ones; returns the folder of the working files."""

    def begin() -> Path:
        monkeypatch.setattr(large, "LARGE", 1000)
        monkeypatch.setattr(large, "STRIP", 5 * 64 * 7)
        monkeypatch.setattr("recon.normals.least_squares.CHUNK", 500)
        monkeypatch.setattr("recon.conditioning.CHUNK", 500)
        monkeypatch.setattr("recon.gloss.bilateral.CHUNK", 500)
        monkeypatch.setattr("recon.pictures.AT_ONCE", 3 * 64 * 5)
        monkeypatch.setattr("recon.height.large.MANY", 0)
        monkeypatch.setenv("TMPDIR", str(tmp_path))
        return tmp_path

    return begin


def in_a_file(array: np.ndarray) -> bool:
    base: Any = array
    while isinstance(base, np.ndarray):
        base = base.base
    return isinstance(base, mmap.mmap)


def spoilt(capture: Capture) -> Capture:
    """Noise, clipping, missing samples, unequal lights; no truth."""
    rng = np.random.default_rng(0)
    images = np.clip(capture.images + rng.normal(0, 0.003, capture.images.shape), 0, 0.9).astype(np.float32)
    faults = ((images >= 0.9).any(-1) * int(Fault.CLIPPED)).astype(np.uint8)
    faults[rng.random(faults.shape) < 0.01] = Fault.MISSING
    return replace(capture, images=images, faults=faults, intensities=rng.uniform(0.8, 1.3, (capture.count, 3)), truth=Truth())


@pytest.mark.parametrize(
    "choice",
    [
        {"gloss": "chromaticity", "repair": "telea"},
        {"gloss": "bilateral", "repair": "stack", "shadows": "drop"},
        {"gloss": "none", "repair": "drop", "normals": "l1", "saturated": "keep"},
    ],
    ids=lambda choice: choice["gloss"],
)
def test_a_large_capture_is_measured_as_a_small_one(
    choice: dict[str, str], synthetic: Synthetic, small_is_large: Callable[[], Path], tmp_path: Path
) -> None:
    capture = spoilt(synthetic("sphere", 64, alpha=0.15, specular=0.4))
    plain = measure(capture, **choice)
    folder = small_is_large()
    found = measure(capture, **choice)
    assert all(map(in_a_file, (found.normals.normal, found.weights, found.height.points)))
    assert not list(folder.iterdir()), "working files have no name"
    np.testing.assert_allclose(found.weights, plain.weights, atol=1e-6)
    np.testing.assert_array_equal(found.defects.mask, plain.defects.mask)
    np.testing.assert_array_equal(found.normals.measurable, plain.normals.measurable)
    assert np.nanmax(angular_error(found.normals.normal, plain.normals.normal)) < 1e-3
    np.testing.assert_allclose(found.normals.uncertainty, plain.normals.uncertainty, rtol=1e-3)
    span = np.nanmax(plain.height.height) - np.nanmin(plain.height.height)
    np.testing.assert_allclose(found.height.height, plain.height.height, atol=5e-4 * span)
    if choice["gloss"] == "none":
        assert found.write(folder / "out")["mesh"]["pixels from point to point"] == 1


@pytest.mark.parametrize("name", sorted(PIXELWISE))
def test_solvers_that_see_each_pixel_alone_are_those_solved_in_strips(name: str, synthetic: Synthetic) -> None:
    """The rows of the object's lower half are solved alike by themselves."""
    capture = spoilt(synthetic("sphere", 32, alpha=0.15, specular=0.4)).select([0, 1, 3] if name == "three-light" else range(5))
    solver, weights = NORMALS.load(name), (capture.faults == 0).astype(np.float32)
    reflectance, half = capture.reflectance(), slice(16, 32)
    whole = solver(reflectance, capture.lights, capture.mask, weights)
    part = solver(reflectance[:, half], capture.lights, capture.mask[half], weights[:, half])
    apart = angular_error(part.normal, whole.normal[half])
    assert np.nanmax(apart) < 1e-3


@pytest.mark.parametrize("scale", [Scale(), Scale(camera=np.array([[300.0, 0, 40], [0, 320, 30], [0, 0, 1]]), distance_mm=250)])
@pytest.mark.parametrize("name", ["quadratic", "bilateral", "adaptive"])
def test_integrating_on_the_grid_is_integrating_by_edges(name: str, scale: Scale, monkeypatch: pytest.MonkeyPatch) -> None:
    """Balls on a wavy ground, noise, holes, parts that do not touch."""
    H, W = 70, 90
    _, normal = big_bench.scene(slice(0, H), H, W)
    normal = (normal + np.random.default_rng(0).normal(0, 0.01, normal.shape)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    y, x = np.mgrid[:H, :W]
    mask = ((x - 45) / 40) ** 2 + ((y - 35) / 33) ** 2 < 1
    mask[:, 50:52] = mask[20:25, 20:30] = False
    by_edges = HEIGHT.load(name)(normal, mask, scale)
    monkeypatch.setattr("recon.height.large.MANY", 0)
    on_grid = HEIGHT.load(name)(normal, mask, scale)
    span = np.nanmax(by_edges.height) - np.nanmin(by_edges.height)
    for a, b in ((on_grid.height, by_edges.height), (on_grid.points, by_edges.points)):
        np.testing.assert_allclose(a, b, atol=(1e-5 if name == "quadratic" else 5e-4) * span)
    assert on_grid.unit == by_edges.unit


@pytest.mark.parametrize("name", ["quadratic", "bilateral", "adaptive"])
def test_a_mask_that_is_too_ragged_for_the_grid_goes_by_edges(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two steps of conjugate gradients do not do for a mask of lace: the answer is then that of the list of edges, to the bit."""
    rng = np.random.default_rng(1)
    _, normal = big_bench.scene(slice(0, 60), 60, 60)
    mask = rng.random((60, 60)) > 0.35
    by_edges = HEIGHT.load(name)(normal, mask, Scale())
    monkeypatch.setattr("recon.height.large.MANY", 0)
    monkeypatch.setattr("recon.height.large.STEPS", 2)
    np.testing.assert_array_equal(HEIGHT.load(name)(normal, mask, Scale()).height, by_edges.height)


def test_the_mesh_of_many_pixels_has_every_second_or_third(synthetic: Synthetic, monkeypatch: pytest.MonkeyPatch) -> None:
    shape = measure(synthetic("sphere", 64, layer="matte"), "none", "none")
    assert shape.mesh_step == 1
    whole = shape.mesh()
    monkeypatch.setattr("recon.mesh.MOST_POINTS", len(whole.vertices) // 5)
    assert shape.mesh_step == 3
    mesh = shape.mesh()
    assert len(mesh.vertices) <= len(whole.vertices) / 5
    assert set(map(tuple, mesh.vertices)) <= set(map(tuple, whole.vertices))
    assert (mesh.extents[:2] > whole.extents[:2] - 6).all()


def test_arrays_in_files_keep_their_values_and_go_with_their_last_use(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(large, "LARGE", 1000)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    plain, filed = large.empty((10,), np.float32), large.zeros((3, 500), np.float32)
    assert (in_a_file(plain), in_a_file(filed)) == (False, True)
    assert not filed.any()
    filed[:] = np.arange(1500).reshape(3, 500)
    kept = large.copy(filed)
    large.release(plain, filed, kept[1:], None)
    np.testing.assert_array_equal(filed.ravel(), np.arange(1500))
    np.testing.assert_array_equal(kept, filed)
    maps = Path("/proc/self/maps")
    if maps.exists():
        assert str(tmp_path) in maps.read_text()
        del filed, kept
        gc.collect()
        assert str(tmp_path) not in maps.read_text()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "absent"))
    with pytest.raises(InputError, match="set TMPDIR"):
        large.empty((1000,), np.float64)


def test_no_room_for_working_files_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(large, "LARGE", 1000)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with full_disk(100_000), pytest.raises(InputError, match=r"has no room for 0\.2 GB"):
        large.empty((2 * 10**8,), np.uint8)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="this system has no /proc")
def test_the_bench_sees_the_steps(capsys: pytest.CaptureFixture[str]) -> None:
    """Those that last: the command shows its step ten times a second."""
    big_bench.main(["--megapixels", "0.02", "--gloss", "none", "--inpaint", "none", "--height", "quadratic"])
    lines = capsys.readouterr().out.splitlines()
    assert {"starting", "integrating", "writing"} <= {line[:42].strip() for line in lines}
    assert "at most" in lines[-1]


@pytest.mark.soak
def test_24_megapixels_fit_into_8_gb(tmp_path: Path) -> None:
    figures = big_bench.measured(24.0, [], tmp_path)
    assert figures["resident"] < 8e9
    assert figures["height error px"] < 10  # of 240: a tile that had a brightness of its own, or a level, would show
