"""Which points of a height field a light reaches past the rest of it, and random shadows of things outside the picture."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from learn.random_fields import Draws, turned_plane

STEPS = 28
"""Points along a ray. Up to that many pixels they are no more than one pixel apart; on longer ways they grow wider."""

BIAS = 1e-3
"""Height in pixels by which a point must stand above a ray to hide the light: float32 rounding of heights of hundreds of pixels."""

DEEP = 1e3
"""Pixels from the lowest point of a view down to what surrounds it; much more would cost digits of float32."""


def visible(height: Tensor, mask: Tensor, lights: Tensor, softness: Tensor | None = None) -> Tensor:
    """Share of each distant light that reaches each pixel past the height field: 0 in cast shadow, 1 where nothing is in the way.

    height: (B, H, W) along +z, in pixels; outside mask (B, H, W) there is nothing. lights: (B, K, 3) unit, to the light. softness: (B,)
    tangent of the angle over which a shadow's rim fades, inside the geometric shadow; None or 0: hard. Returns (B, K, H, W) float.

    Attached shadows are not in it (n.l says those): the ray leaves the surface and is compared with heights that are interpolated
    between pixels, which never lie above a convex surface. Lights under the horizon count as at it. Occluders outside the picture are
    not known.
    """
    B, H, W = height.shape
    K = lights.shape[1]
    ground = torch.where(mask, height, height.new_tensor(math.inf)).amin((1, 2))
    ground = torch.where(torch.isfinite(ground), ground, 0.0)
    # What is outside the mask or the picture counts as far below: samples between it and the object then hide nothing, as the silhouette
    # of a round body would, were it joined to a floor.
    raised = torch.where(mask, height - ground[:, None, None] + DEEP, 0.0)
    across = lights[..., :2].norm(dim=-1).clamp_min(1e-6)
    rise = lights[..., 2].clamp_min(0) / across
    top = (raised.amax((1, 2)) - DEEP).clamp_min(0)
    # The last point lies just before a ray from the ground passes the top, or the tip of the longest shadow would be missed.
    reach = torch.minimum(0.998 * top[:, None] / rise.clamp_min(1e-6), height.new_tensor(math.hypot(H, W)))
    # s_i = reach (i/n)^p, with p such that the first step is one pixel on long ways, and equal steps on short ones.
    power = (reach.clamp_min(STEPS).log() / math.log(STEPS)).clamp_min(1.0)
    # grid_sample's coordinates run from -1 to 1 between the outer edges of the picture; rows run downward.
    toward = lights[..., :2] / across[..., None] * lights.new_tensor([2.0 / W, -2.0 / H])
    columns = ((torch.arange(W, device=height.device) + 0.5) * 2 / W - 1)[None, :].expand(H, W)
    rows = ((torch.arange(H, device=height.device) + 0.5) * 2 / H - 1)[:, None].expand(H, W)
    # x and y of a row side by side in one axis: broadcasting over an inner axis of two is slow.
    start = torch.stack([columns, rows], -1).view(H, 2 * W)
    toward = toward.repeat(1, 1, W)
    clearance = torch.full((B, K, H, W), math.inf, device=height.device)
    hard = softness is None or not bool((softness > 0).any())
    for i in range(1, STEPS + 1):
        s = reach * (i / STEPS) ** power
        grid = (start + (s[..., None] * toward)[:, :, None, :]).view(B, K * H, W, 2)
        met = F.grid_sample(raised[:, None], grid, mode="bilinear", align_corners=False)
        above = raised[:, None] + (s * rise)[..., None, None] - met.view(B, K, H, W)
        clearance = torch.minimum(clearance, above if hard else (above + BIAS) / s.clamp_min(0.5)[..., None, None])
    if hard:
        return (clearance >= -BIAS).float()
    fade = softness.clamp_min(1e-5)[:, None, None, None]  # type: ignore[union-attr] # None is hard
    return (1 + clearance / fade).clamp(0, 1)


def thrown_in(draws: Draws, count: int, lights: int, size: int, share: float, each: float) -> Tensor:
    """Random hard-edged shadows of things outside the picture, as `visible` has them: (count, lights, size, size) of 0 and 1.

    share: of captures that have any. each: probability of a shadow under each light of those. They are half planes, strips, wedges and
    discs.
    """
    n = count * lights
    lit = torch.ones(n, size, size, device=draws.device)
    has = draws.chance(share, count)[:, None] & draws.chance(each, count, lights)
    if not bool(has.any()):
        return lit.view(count, lights, size, size)
    inside = torch.ones(n, size, size, dtype=torch.bool, device=draws.device)
    for i in range(3):
        # The first edge is always there, the second and third in a half and a quarter of them.
        along, _ = turned_plane(size, draws.uniform(0, 2 * math.pi, n))
        cut = along < draws.uniform(-0.45, 0.25, n)[:, None, None] * size
        inside &= cut | ~draws.chance(0.5**i, n)[:, None, None]
    x, y = turned_plane(size, torch.zeros(n, device=draws.device))
    centre = draws.uniform(-size / 2, size / 2, 2, n)[..., None, None]
    disc = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 < (draws.uniform(0.05, 0.4, n)[:, None, None] * size) ** 2
    shape = torch.where(draws.chance(0.3, n)[:, None, None], disc, inside)
    return torch.where(has.view(n, 1, 1) & shape, 0.0, lit).view(count, lights, size, size)
