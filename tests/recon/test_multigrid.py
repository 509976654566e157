"""The grid's multigrid against a direct solver, and the reweighting against the same written plainly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve
from scipy.special import expit

from gen.capture import Scale
from recon.height.bilateral import FAINTEST, ROUNDS, SETTLED, STIFFNESS, reweighted
from recon.height.edges import Domain, domain_of, normal_equations, right_side
from recon.height.multigrid import GridSystem, Multigrid
from recon.height.quadratic import quadratic

Doubles = NDArray[np.float64]
Bools = NDArray[np.bool_]


def flat(mask: Bools) -> Domain:
    normal = np.zeros((*mask.shape, 3), np.float32)
    normal[..., 2] = 1
    return domain_of(normal, mask, Scale())


def disc(size: int = 90) -> Bools:
    """A disc with a hole, off the frame's middle, and a part by itself."""
    row, column = np.mgrid[: size + 7, : size + 20]
    off = np.hypot(row - size / 2 - 3, column - size / 2)
    mask: Bools = (off < 0.45 * size) & (off > 0.1 * size) | (column > size + 9) & (row > 12)
    return mask


def cut(domain: Domain) -> Doubles:
    """(E,) random weights, and next to none on the edges that cross a curve, which starts inside the disc and leaves it."""
    side = domain.rows > 50 + 9 * np.sin(domain.columns / 7)
    across = (side[domain.i] != side[domain.j]) & (domain.columns[domain.i] > 30)
    return np.where(across, 1e-6, np.random.default_rng(0).uniform(0.1, 1, len(domain.i)))


FRAMES = {"frame": np.ones((60, 83), bool), "disc": disc(), "row": np.ones((1, 300), bool), "small": np.ones((9, 7), bool)}


@pytest.mark.parametrize("pulled", [False, True])
@pytest.mark.parametrize("name", FRAMES)
def test_solution_is_a_direct_solvers(name: str, pulled: bool) -> None:
    """Every edge's rise, whatever the constants of the parts; then again with other weights, from the first solution."""
    rng = np.random.default_rng(1)
    domain = flat(FRAMES[name])
    pull = np.where(rng.random(domain.count) < 0.1, 1e-3, 0) if pulled else None
    system, found = GridSystem(domain, pull), np.zeros(domain.count)
    for weight in (rng.uniform(0.1, 1, len(domain.i)), cut(domain)):
        right = right_side(domain, weight * rng.normal(size=len(weight)))
        if pull is not None:
            right += pull * rng.normal(size=domain.count)
        system.weigh(weight)
        found = system.solve(right, found, 1e-9)
        expected = spsolve(normal_equations(domain, weight, pull).tocsc(), right)
        rises = [z[domain.j] - z[domain.i] for z in (found, expected)]
        # The cut's two sides hang together by a millionth: what they do against each other is known the less.
        assert np.abs(rises[0] - rises[1])[weight > 1e-3].max() < 1e-6 * np.abs(expected).max()
    assert system.algebraic is None


def test_masks_of_lace_are_solved_all_the_same() -> None:
    rng = np.random.default_rng(2)
    domain = flat(rng.random((70, 80)) > 0.4)
    system = GridSystem(domain)
    for _ in range(2):
        weight = 10 ** rng.uniform(-3, 0, len(domain.i))
        right = right_side(domain, weight * rng.normal(size=len(weight)))
        system.weigh(weight)
        found = system.solve(right, np.zeros(domain.count), 1e-9)
        expected = spsolve(normal_equations(domain, weight).tocsc(), right)
        assert np.abs((found - expected)[domain.j] - (found - expected)[domain.i]).max() < 1e-4
    assert system.algebraic is not None


def test_cycle_is_symmetric_and_halves_the_error_more_than_once() -> None:
    """Conjugate gradients need the first. u . M v = v . M u; the energy of M A z - z is a small share of z's."""
    rng = np.random.default_rng(3)
    domain = flat(disc())
    weight, pull = cut(domain), np.full(domain.count, 1e-4)
    system = GridSystem(domain, pull)
    system.weigh(weight)
    multigrid = Multigrid(*(n - 3 for n in system.held.shape))
    multigrid.prepare(system.weight, system.held)

    def cycle(values: Doubles) -> Doubles:
        right = np.zeros(system.held.shape)
        right.ravel()[system.pixels] = values
        return multigrid.cycle(right).ravel()[system.pixels]

    u, v = rng.normal(size=(2, domain.count))
    assert u @ cycle(v) == pytest.approx(v @ cycle(u), rel=1e-10)
    A = normal_equations(domain, weight, pull)
    left = cycle(A @ u) - u
    assert left @ (A @ left) < 0.04 * (u @ (A @ u))


def plainly_reweighted(domain: Domain, smooth: Bools) -> Doubles:
    """`reweighted` of an orthographic view in numpy, every linear system solved directly."""
    i, j, r, n = domain.i, domain.j, domain.right, domain.normal
    toward = domain.cosines()
    a, b = toward[i], toward[j]
    own_i, own_j = (np.concatenate([-n[end[:r], 0], n[end[r:], 1]]) for end in (i, j))
    trust_i, trust_j = np.full(len(i), 0.5), np.full(len(i), 0.5)
    energy = np.inf
    for _ in range(ROUNDS):
        weight = trust_i * a**2 + trust_j * b**2
        flow = np.where(smooth, weight * domain.chords(), trust_i * a * own_i + trust_j * b * own_j)
        z: Doubles = spsolve(normal_equations(domain, weight).tocsc(), right_side(domain, flow))
        move = z[j] - z[i]
        last, energy = energy, float((trust_i * (a * move - own_i) ** 2 + trust_j * (b * move - own_j) ** 2).sum())
        if abs(last - energy) <= SETTLED * last and np.isfinite(last):
            break
        for axis in (slice(None, r), slice(r, None)):
            at_i, at_j = i[axis], j[axis]
            behind, ahead = np.zeros(domain.count), np.zeros(domain.count)
            behind[at_j], ahead[at_i] = (b * move)[axis] ** 2, (a * move)[axis] ** 2
            trust_i[axis] = np.maximum(expit(STIFFNESS * (behind - ahead)[at_i]), FAINTEST)
            trust_j[axis] = np.maximum(expit(STIFFNESS * (ahead - behind)[at_j]), FAINTEST)
        trust_i[smooth] = trust_j[smooth] = 0.5
    return z


@pytest.mark.parametrize("some_smooth", [False, True])
def test_reweighting_is_that_of_a_plain_version(some_smooth: bool) -> None:
    """A ramp beside a wavy sheet, masked: the same to .02 px where reweighting does 10 (the rounds' systems are solved to 1e-4)."""
    row, column = np.mgrid[:50, :44].astype(float)
    n = np.stack([0 * row, np.where(column >= 22, 1.0, 0.1 * np.cos(row / 7)), 1 + 0 * row], -1)
    normal = (n / np.linalg.norm(n, axis=-1, keepdims=True)).astype(np.float32)
    mask = np.hypot(row - 25, column - 22) < 24
    domain = domain_of(normal, mask, Scale())
    smooth = np.abs(domain.columns[domain.i] - 22) > 8 if some_smooth else np.zeros(len(domain.i), bool)
    expected = plainly_reweighted(domain, smooth)
    found = reweighted(domain, None, smooth if some_smooth else None)
    apart = (found - found.mean()) - (expected - expected.mean())
    done = (expected - expected.mean()) - quadratic(normal, mask, Scale()).height[mask]
    assert np.abs(done).max() > 10
    assert np.abs(apart).max() < 0.02
