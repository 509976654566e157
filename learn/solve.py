"""Photometric stereo as a layer of a network: weighted least squares in closed form, and robust starts, all differentiable in torch.

Tensors are channels first: samples y (B, K, H, W), lights (B, K, 3), weights (B, K, H, W). The solved b = albedo * normal is (B, 3, H, W).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import torch
from torch import Tensor

P = ParamSpec("P")
R = TypeVar("R")

DAMPING = 1e-4
"""Share of the mean diagonal that is added to the normal matrix: a pixel with too few weights has a solution, if a poor one."""


def in_full(function: Callable[P, R]) -> Callable[P, R]:
    """The function computed in single precision at least, also where autocast would halve it: it solves, and differences matter."""

    @wraps(function)
    def full(*args: P.args, **kwargs: P.kwargs) -> R:
        kind = next((a.device.type for a in args if isinstance(a, Tensor)), "cpu")
        if not torch.is_autocast_enabled(kind):
            return function(*args, **kwargs)
        with torch.autocast(kind, enabled=False):
            return function(*(_at_least_single(a) for a in args), **{k: _at_least_single(v) for k, v in kwargs.items()})  # type: ignore[arg-type]

    return full


def _at_least_single(value: object) -> object:
    return value.float() if isinstance(value, Tensor) and value.dtype in (torch.bfloat16, torch.float16) else value


@in_full
def weighted_least_squares(y: Tensor, lights: Tensor, weights: Tensor) -> Tensor:
    """b (B, 3, H, W) that minimises sum_k w_k (y_k - l_k . b)^2 at each pixel, lightly damped (Woodham 1980).

    y, weights: (B, K, H, W), weights not negative. lights: (B, K, 3). By the adjugate of the symmetric 3x3 matrix, so that it is a few
    dozen products a pixel and differentiable in y and in the weights.
    Source: R. J. Woodham, Optical Engineering 19(1), 1980.
    """
    b, k, h, w = y.shape
    l0, l1, l2 = lights.unbind(-1)
    products = torch.stack([l0 * l0, l1 * l1, l2 * l2, l0 * l1, l0 * l2, l1 * l2], 1)
    flat = weights.reshape(b, k, h * w)
    xx, yy, zz, xy, xz, yz = torch.bmm(products, flat).unbind(1)
    rx, ry, rz = torch.bmm(lights.transpose(1, 2), (flat * y.reshape(b, k, h * w))).unbind(1)
    damping = DAMPING / 3 * (xx + yy + zz) + 1e-8
    xx, yy, zz = xx + damping, yy + damping, zz + damping
    cxx, cxy, cxz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    cyy, cyz, czz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = (xx * cxx + xy * cxy + xz * cxz).clamp(min=1e-20)
    solved = torch.stack(
        [cxx * rx + cxy * ry + cxz * rz, cxy * rx + cyy * ry + cyz * rz, cxz * rx + cyz * ry + czz * rz], 1
    ) / determinant.unsqueeze(1)
    return solved.reshape(b, 3, h, w)


@in_full
def shading(b: Tensor, lights: Tensor) -> Tensor:
    """max(l_k . b, 0) of each light, (B, K, H, W). b: (B, 3, H, W). lights: (B, K, 3)."""
    n, _, h, w = b.shape
    return torch.bmm(lights, b.reshape(n, 3, h * w)).reshape(n, -1, h, w).clamp(min=0)


def unit(b: Tensor) -> Tensor:
    """b over its length along axis 1; zero where b is."""
    return b / b.square().sum(1, keepdim=True).clamp(min=1e-20).sqrt()


def angle(a: Tensor, b: Tensor) -> Tensor:
    """Angle in radians between unit vectors along axis 1, (B, H, W); its gradient stays finite at 0 and pi."""
    a, b = a.float(), b.float()  # an angle needs all its digits, also under bf16
    cross = torch.linalg.cross(a, b, dim=1)
    return torch.atan2((cross.square().sum(1) + 1e-12).sqrt(), (a * b).sum(1))


@in_full
def robust_start(y: Tensor, lights: Tensor, valid: Tensor, rounds: int = 4) -> Tensor:
    """b of a Lambertian fit that distrusts what stands out above it: Cauchy weights, three times as wide below as above, shadows out.

    y: (B, K, H, W), about 1 where the pixel is bright. valid: (B, K, H, W) 0 or 1. With fewer than four lights, plain least squares.
    Source: P. Holland and R. Welsch, "Robust regression using iteratively reweighted least-squares" (1977); the widths are ours.
    """
    lit = valid * (y > 0.03 * y.amax(1, keepdim=True).clamp(max=3)) + 1e-3
    weight = lit
    for i in range(rounds if y.shape[1] > 3 else 1):
        b = weighted_least_squares(y, lights, weight)
        residual = y - shading(b, lights)
        scale = 0.04 * 2.0 ** max(rounds - 2 - i, 0)
        weight = lit / (1 + (residual / torch.where(residual > 0, scale, 3 * scale)).square())
    return b
