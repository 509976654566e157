"""Every integrator by module, registered or not: round trips, steps, parts, references, refusals, and the benchmark's own arithmetic."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from gen.capture import Scale
from gen.errors import InputError
from recon.height.adaptive import adaptive, torn
from recon.height.bench import at_size, depth_error, main, read_object, relief
from recon.height.bilateral import bilateral
from recon.height.edges import domain_of
from recon.height.poisson import dct
from recon.height.quadratic import quadratic

ALL = [quadratic, dct, bilateral, adaptive]
CAMERA = np.array([[300.0, 0, 50], [0, 310.0, 42], [0, 0, 1]])


@pytest.fixture(params=ALL, ids=lambda f: f.__name__)
def integrate(request: pytest.FixtureRequest):  # type: ignore[no-untyped-def]
    return request.param


def bowl(H: int = 48, W: int = 64) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """A gentle relief in pixels with its exact normals."""
    row, column = np.mgrid[:H, :W].astype(float)
    x, y = column - (W - 1) / 2, (H - 1) / 2 - row
    z = 3 * np.sin(x / 12) * np.cos(y / 10) + 0.2 * x - 0.004 * y**2
    n = np.stack([-(np.cos(x / 12) * np.cos(y / 10) / 4 + 0.2), 0.3 * np.sin(x / 12) * np.sin(y / 10) + 0.008 * y, 1 + 0 * x], -1)
    return (n / np.linalg.norm(n, axis=-1, keepdims=True)).astype(np.float32), z


def seen(H: int = 80, W: int = 100) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """A wavy surface seen by `CAMERA`: the normals of depth(row, column), from the points' derivatives in closed form."""
    row, column = np.mgrid[:H, :W].astype(float)
    depth = 500 + 8 * np.sin(column / 14) + 6 * np.cos(row / 11)
    x, y = (column - CAMERA[0, 2]) / CAMERA[0, 0], -(row - CAMERA[1, 2]) / CAMERA[1, 1]
    ray = np.stack([x, y, -np.ones_like(x)], -1)
    right = ray * (8 / 14 * np.cos(column / 14))[..., None] + depth[..., None] * [1 / CAMERA[0, 0], 0, 0]
    down = ray * (-6 / 11 * np.sin(row / 11))[..., None] + depth[..., None] * [0, -1 / CAMERA[1, 1], 0]
    n = np.cross(down, right)
    return (n / np.linalg.norm(n, axis=-1, keepdims=True)).astype(np.float32), depth


def spread(error: NDArray[np.float64]) -> float:
    return float(np.sqrt(((error - error.mean()) ** 2).mean()))


@pytest.mark.parametrize("hole", [False, True])
def test_round_trip_orthographic(integrate, hole: bool) -> None:  # type: ignore[no-untyped-def]
    """integrate(differentiate(z)) = z: to third order by chords, to first by the one-sided differences of bilateral."""
    normal, z = bowl()
    mask = np.ones(z.shape, bool)
    if hole:
        mask[10:30, 20:33] = False
    result = integrate(normal, mask, Scale())
    assert spread((result.height - z)[mask]) <= (1e-2 if integrate is bilateral else 5e-4) * np.ptp(z[mask])


def test_round_trip_perspective(integrate) -> None:  # type: ignore[no-untyped-def]
    normal, depth = seen()
    assert normal[..., 2].min() > 0.3
    result = integrate(normal, np.ones(depth.shape, bool), Scale(camera=CAMERA, distance_mm=float(depth.mean())))
    found = -1000 * result.height.astype(float)
    assert spread(found - depth) <= (2e-2 if integrate is bilateral else 2e-3) * np.ptp(depth)
    assert np.allclose(result.points[..., 2], result.height, atol=1e-6)
    assert result.unit == "m"


def test_a_bent_flap_comes_off_the_sheet(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a wavy sheet, steps that grow from nothing: as they are both methods stop early and gain a little, a stiffer sigmoid finds it."""
    normal, z = relief(96)
    z = z - z.mean()
    mask = np.ones(z.shape, bool)

    def error(f) -> float:  # type: ignore[no-untyped-def]
        return float(np.abs(f(normal, mask, Scale()).height - z).mean() / np.ptp(z))

    plain = min(error(quadratic), error(dct))
    assert plain > 0.05
    assert max(error(bilateral), error(adaptive)) < 0.9 * plain
    monkeypatch.setattr("recon.height.bilateral.STIFFNESS", 8.0)
    assert error(bilateral) < 0.002


def test_two_level_relief_keeps_its_step() -> None:
    """A ramp beside a plane, both flat: the step between them is 0.5 (row - 40) px in closed form, and stays in one column."""
    H, W = 80, 60
    row, column = np.mgrid[:H, :W].astype(float)
    ramp = column >= 30
    z = np.where(ramp, 0.5 * (row - (H - 1) / 2), 0)
    n = np.where(ramp[..., None], [0, 0.5, 1.0], [0, 0, 1.0])
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    mask = np.ones((H, W), bool)
    far = np.abs(row - (H - 1) / 2) > 10
    jump = {}
    for f in (quadratic, bilateral, adaptive):
        height = f(n.astype(np.float32), mask, Scale()).height
        jump[f] = np.abs((height[:, 30] - height[:, 29]) - (z[:, 30] - z[:, 29]))[far[:, 0]].mean()
    assert jump[quadratic] > 5
    assert jump[bilateral] < 0.5
    assert jump[adaptive] < 0.5


def test_adaptive_is_quadratic_on_a_smooth_surface() -> None:
    normal, z = bowl()
    mask = np.ones(z.shape, bool)
    domain = domain_of(normal, mask, Scale())
    assert not torn(domain, domain.chords()).any()
    assert np.array_equal(adaptive(normal, mask, Scale()).height, quadratic(normal, mask, Scale()).height)


def test_dct_is_the_unweighted_least_squares() -> None:
    """On normals that belong to no surface, full frame and mask: against a sparse direct solve of the same sum."""
    rng = np.random.default_rng(3)
    n = np.concatenate([rng.normal(0, 0.3, (20, 26, 2)), np.ones((20, 26, 1))], -1)
    normal = (n / np.linalg.norm(n, axis=-1, keepdims=True)).astype(np.float32)
    ragged = rng.random((20, 26)) > 0.2
    for mask in (np.ones((20, 26), bool), ragged):
        d = domain_of(normal, mask, Scale())
        D = sparse.coo_array(
            (np.repeat([1.0, -1.0], len(d.i)), (np.tile(np.arange(len(d.i)), 2), np.concatenate([d.j, d.i]))), (len(d.i), d.count)
        )
        expected = spsolve((D.T @ D + 1e-9 * sparse.eye_array(d.count)).tocsc(), D.T @ d.chords())
        found = dct(normal, mask, Scale()).height[mask].astype(float)
        # Every edge's rise is the same, whatever the constants of the parts.
        assert np.abs(D @ found - D @ expected).max() < 1e-4


def test_dct_is_quadratic_on_a_full_frame() -> None:
    normal, z = bowl()
    mask = np.ones(z.shape, bool)
    both = [f(normal, mask, Scale()).height for f in (dct, quadratic)]
    assert np.abs(both[0] - both[1]).max() < 2e-3 * np.ptp(z)


def test_dct_by_slopes_is_of_second_order() -> None:
    """The textbook's rise: a plane exactly, a parabola too (its slope is linear), and coarser than the chord on a sphere."""
    row, column = np.mgrid[:30, :40].astype(float)
    z = 0.01 * column**2 - 0.02 * row
    n = np.stack([-0.02 * column, -0.02 + 0 * row, 1 + 0 * row], -1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    found = dct(n.astype(np.float32), np.ones((30, 40), bool), Scale(), slopes=True).height
    assert spread(found - z) < 1e-4
    x, y = column - 19.5, 14.5 - row
    ball = np.sqrt(26.0**2 - x**2 - y**2)
    m = (np.stack([x, y, ball], -1) / 26).astype(np.float32)
    errors = [spread(dct(m, np.ones((30, 40), bool), Scale(), slopes=s).height - ball) for s in (False, True)]
    assert errors[0] < 1e-4 < errors[1]


def test_parts_are_each_at_mean_zero(integrate) -> None:  # type: ignore[no-untyped-def]
    normal, z = bowl()
    mask = np.ones(z.shape, bool)
    mask[:, 20:23] = False
    mask[:, 40] = False
    mask[5, 21] = True  # a pixel by itself
    height = integrate(normal, mask, Scale()).height
    assert height[5, 21] == 0
    for part in (np.s_[:, :20], np.s_[:, 23:40], np.s_[:, 41:]):
        assert abs(height[part].mean()) < 1e-3


def test_a_reference_places_the_parts(integrate) -> None:  # type: ignore[no-untyped-def]
    """Two parts at heights that normals cannot know: a coarse height with a constant bias of nothing puts both where they are."""
    normal, z = bowl()
    mask = np.ones(z.shape, bool)
    mask[:, 31:33] = False
    high = (z + np.where(np.arange(64) > 31, 25, 0)).astype(np.float32)
    rng = np.random.default_rng(0)
    coarse = high + rng.normal(0, 0.5, z.shape).astype(np.float32)
    coarse[rng.random(z.shape) < 0.5] = np.nan
    found = integrate(normal, mask, Scale(), reference=coarse).height
    assert np.abs(found - high)[mask].mean() < 0.1
    metres = integrate(normal, mask, Scale(mm_per_pixel=2.0), reference=coarse * 2e-3, reach=50).height
    assert np.allclose(metres[mask], found[mask] * 2e-3, atol=1e-6)


def test_a_reference_places_a_perspective_view(integrate) -> None:  # type: ignore[no-untyped-def]
    normal, depth = seen()
    reference = np.full(depth.shape, np.nan, np.float32)
    reference[:10] = (480 - depth[:10]) / 1000
    found = integrate(
        normal, np.ones(depth.shape, bool), Scale(camera=CAMERA, distance_mm=480), reference=reference, reach=5
    ).height
    assert np.abs(480 - 1000 * found.astype(float) - depth).mean() < 0.5


def test_normals_that_are_no_normals(integrate) -> None:  # type: ignore[no-untyped-def]
    """NaN and zero normals count as outside; grazing and backward ones stay finite."""
    normal, z = bowl()
    normal = normal.copy()
    normal[4, 4] = np.nan
    normal[6, 9] = 0
    normal[20:22, 30:33] = [1, 0, 0]
    normal[30, 30] = [0, 0.6, -0.8]
    height = integrate(normal, np.ones(z.shape, bool), Scale()).height
    assert np.isnan(height[[4, 6], [4, 9]]).all()
    assert np.isnan(height).sum() == 2
    assert np.abs(height[np.isfinite(height)]).max() < 100


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mask": np.zeros((48, 64), bool)}, "no pixel"),
        ({"mask": np.ones((48, 60), bool)}, "differ in size"),
        ({"reference": np.zeros((3, 3), np.float32)}, "reference height is"),
        ({"reference": np.full((48, 64), np.nan, np.float32)}, "no value inside"),
        ({"reference": np.zeros((48, 64), np.float32), "reach": 0.0}, "positive number of pixels"),
        ({"reference": np.full((48, 64), 9.0, np.float32), "scale": Scale(camera=CAMERA, distance_mm=500)}, "behind the camera"),
    ],
)
def test_bad_input_is_refused(integrate, change, message: str) -> None:  # type: ignore[no-untyped-def]
    given = {"normal": bowl()[0], "mask": np.ones((48, 64), bool), "scale": Scale(), **change}
    with pytest.raises(InputError, match=message):
        integrate(given.pop("normal"), given.pop("mask"), given.pop("scale"), **given)


def test_relief_of_the_benchmark_has_the_normals_of_its_height() -> None:
    normal, z = relief(400)
    slope = -normal[..., 0] / normal[..., 2]
    rise = (z[:, 2:] - z[:, :-2]) / 2
    assert np.percentile(np.abs(rise - slope[:, 1:-1]), 97) < 2e-3


def test_figures_at_size_are_those_of_the_relief() -> None:
    figures = at_size("recon.height.quadratic:quadratic", 0.004)
    normal, z = relief(63)
    error = np.abs(quadratic(normal, np.ones(z.shape, bool), Scale()).height - (z - z.mean())) / np.ptp(z) * 100
    assert figures["mean_percent"] == pytest.approx(error.mean(), rel=1e-6)
    assert 0 < figures["peak_gb"] < 64


def test_depth_error_ignores_scale_and_counts_millimetres() -> None:
    true = np.linspace(900, 1100, 20).reshape(4, 5)
    assert depth_error(true / 3, true, np.ones((4, 5), bool)) == pytest.approx(0, abs=1e-9)
    off = true.copy()
    off[0, 0] += 10
    assert depth_error(off, true, np.ones((4, 5), bool)) == pytest.approx(0.5)


def test_bench_refuses_a_bad_size(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--size", "0"]) == 2
    assert main(["--only", "nothing"]) == 2
    assert capsys.readouterr().err.count("\n") == 2


@pytest.mark.data
@pytest.mark.parametrize(("name", "plain"), [("bear", 0.55), ("cat", 0.41), ("pot2", 0.158)])
def test_plain_slopes_reach_the_published_errors_of_plain_integration(data_folder: Path, name: str, plain: float) -> None:
    """BiNI's authors report .511, .407 and .158 mm; all registered integrators are held to theirs in test_height.py."""
    normal, mask, camera, depth = read_object(data_folder / "bini_diligent" / name)
    result = dct(normal, mask, Scale(camera=camera, distance_mm=1500), slopes=True)
    assert depth_error(1500 - 1000 * result.height.astype(float), depth, mask) <= plain
