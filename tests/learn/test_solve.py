"""The solving layer against numpy's least squares, its gradients, and the robust start."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from learn.models.evidence import diffuse_by_colour, luminance, triplet_predictions
from learn.solve import angle, robust_start, shading, unit, weighted_least_squares


def lights_of(count: int, seed: int = 0) -> torch.Tensor:
    directions = np.random.default_rng(seed).normal(size=(count, 3)) * [0.5, 0.5, 0.1] + [0, 0, 1]
    return torch.tensor(directions / np.linalg.norm(directions, axis=1, keepdims=True), dtype=torch.float32)[None]


@pytest.mark.parametrize("count", [3, 5, 12])
def test_equals_numpys_least_squares(count: int) -> None:
    rng = np.random.default_rng(1)
    lights, y, w = lights_of(count), rng.random((count, 7)), rng.random((count, 7)) + 0.3
    found = weighted_least_squares(
        torch.tensor(y[None, :, None], dtype=torch.float32), lights, torch.tensor(w[None, :, None]).float()
    )
    for i in range(7):
        root = np.sqrt(w[:, i])
        expected = np.linalg.lstsq(root[:, None] * lights[0].double().numpy(), root * y[:, i], rcond=None)[0]
        assert np.allclose(found[0, :, 0, i], expected, atol=0.01 * np.linalg.norm(expected) + 0.01)


def test_gradients_are_those_of_finite_differences() -> None:
    lights = lights_of(5).double()
    y = torch.rand(1, 5, 2, 2, dtype=torch.float64, requires_grad=True)
    w = (torch.rand(1, 5, 2, 2, dtype=torch.float64) + 0.2).requires_grad_()
    assert torch.autograd.gradcheck(lambda a, b: unit(weighted_least_squares(a, lights, b)), (y, w))


def test_angle_is_exact_and_has_a_gradient_at_zero() -> None:
    a = torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1).requires_grad_()
    assert float(angle(a, a.detach()).detach()) < 1e-5
    angle(a, a.detach()).sum().backward()
    assert torch.isfinite(a.grad).all()  # type: ignore[arg-type]
    b = torch.tensor([0.0, np.sin(0.3), np.cos(0.3)], dtype=torch.float32).reshape(1, 3, 1, 1)
    assert float(angle(a, b).detach()) == pytest.approx(0.3, abs=1e-5)


def test_robust_start_ignores_one_highlight() -> None:
    lights = lights_of(8)
    n = unit(torch.tensor([0.2, -0.1, 1.0]).reshape(1, 3, 1, 1))
    y = shading(n, lights)
    glossy = y.clone()
    glossy[:, 2] += 1.0
    plain = angle(unit(weighted_least_squares(glossy, lights, torch.ones_like(y))), n)
    robust = angle(unit(robust_start(glossy, lights, torch.ones_like(y), rounds=8)), n)
    assert float(robust) < 0.2 * float(plain)


def test_triplets_predict_a_lambertian_sample_exactly_and_shun_a_highlight() -> None:
    turns = np.radians([0, 50, 120, 200, 260, 310])  # no three of a cone are in one plane
    directions = np.stack([0.6 * np.cos(turns), 0.6 * np.sin(turns), 0.8 * np.ones(6)], 1)
    lights = torch.tensor(directions, dtype=torch.float32)[None]
    n = unit(torch.tensor([0.1, 0.2, 1.0]).reshape(1, 3, 1, 1))
    y = shading(n, lights)
    least, median = triplet_predictions(y, lights)
    assert torch.allclose(median, y, atol=2e-3)
    assert torch.allclose(least, y, atol=2e-3)
    glossy = y.clone()
    glossy[:, 4] += 2
    _, median = triplet_predictions(glossy, lights)
    assert abs(float(median[0, 4]) - float(y[0, 4])) < 2e-3  # the others' say does not depend on it


def test_triplets_that_are_nearly_in_a_plane_predict_nothing() -> None:
    """Three lights on a line through the view make up any shading from noise; the others predict it well."""
    tilts = np.radians([-40, 0.5, 40])
    flat = np.stack([np.sin(tilts), [0.0, 0.012, 0.0], np.cos(tilts)], 1)
    sides = np.array([[0.1, 0.6, 0.8], [0.2, -0.6, 0.75]])
    directions = np.concatenate([flat, sides])
    lights = torch.tensor(directions / np.linalg.norm(directions, axis=1, keepdims=True), dtype=torch.float32)[None]
    y = shading(unit(torch.tensor([0.1, 0.2, 1.0]).reshape(1, 3, 1, 1)), lights).expand(1, 5, 40, 40)
    noisy = y + 0.003 * torch.randn(y.shape, generator=torch.Generator().manual_seed(0))
    least, _ = triplet_predictions(noisy, lights)
    assert float((least - y).abs().max()) < 0.12


def test_colour_tells_the_diffuse_share_exactly_where_one_sample_has_no_gloss() -> None:
    rng = np.random.default_rng(0)
    colour = torch.tensor([0.6, 0.3, 0.1]).reshape(1, 1, 3, 1, 1)
    diffuse = colour * torch.tensor(rng.uniform(0.3, 1, (1, 5, 1, 4, 4)), dtype=torch.float32)
    gloss = torch.tensor(rng.uniform(0, 2, (1, 5, 1, 4, 4)), dtype=torch.float32)
    gloss[:, 2] = 0
    pictures = diffuse + gloss
    assert torch.allclose(diffuse_by_colour(pictures, luminance(pictures)), luminance(diffuse), atol=1e-5)
    grey = pictures.mean(2, keepdim=True).expand(-1, -1, 3, -1, -1)
    assert torch.equal(diffuse_by_colour(grey, luminance(grey)), luminance(grey))
