"""One pixel's samples explained by a normal: a base and a lobe from the object's reflectance, the rest as highlight or shadow.

Compiled, and called from the loops of `recon.normals.explain_search`. A pixel's samples y come over its scale (about its third
brightest sample), in float64. What a set of lights and a view along +z fix is in rays (7, K): the light directions in rows 0 to 2, the
half vectors in 3 to 5, the cosine between the two in 6. What the object's reflectance fixes is in optics (4,), see
`recon.normals.explain_reflectance.Reflectance.optics`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.normals.compiled import compiled, inverse

Doubles = NDArray[np.float64]

NOISE = 0.02
"""Standard deviation of what base and lobe leave, over the pixel's scale: real matte surfaces depart from any model by some per cent."""

LOBE_NOISE = 0.2
"""The same for the lobe, over the lobe itself: nobody knows a highlight better than to a fifth."""

OUTLIER = 4.0
"""Standard deviations about which a residual counts as a highlight of its own; its cost tends to the square of this."""

SHADOW = 2.0
"""The same for cast shadows: cheaper, or normals that turn every dark sample's light below the horizon would win too often.

This, `NOISE`, and `HOLD` and `PRIOR` of `recon.normals.explain_search` were chosen among three or four values each, on renders with cast
shadows and on four of the seeded draws of five lights of DiLiGenT's bear and cat.
"""

DARK = 0.15
"""Share of the pixel's scale under which a sample may be a cast shadow. Brighter ones that are too dark cannot be explained away."""

GRAZING = 0.02
"""Cosine toward the viewer below which the coat dims no further."""

STEP = 1e-4
"""Turn of the normal, in radians, over which derivatives are taken: small beside the narrowest lobe."""

LONGEST = 0.5
"""Largest turn of the normal in one step of the refinement, in radians."""

BASE, LOBE, WEIGHT, NEXT_BASE, NEXT_LOBE, NEXT_WEIGHT, TURN_1, TURN_2 = range(8)
"""Rows of the scratch (8, K) that `refine` works in; the first three describe the normal that it returns."""


@compiled
def shades(x: float, y: float, z: float, rays: Doubles, optics: Doubles, strength: float, base: Doubles, lobe: Doubles) -> None:
    """The base over the albedo and the lobe, under every light, of the normal (x, y, z): both (K,), written; 0 where turned away.

    strength: the lobe's, in the samples' scale. The base is Lambert's, dimmed by a coat (`recon.normals.coat.dimming`) in the share
    optics[1], and flattened by roughness. The lobe is the substrate's, with its Fresnel term held at `strength`.
    Source: the substrate as in `gen.substrate`; roughness: M. Fujii's form of M. Oren and S. K. Nayar, "Generalization of Lambert's
    reflectance model" (SIGGRAPH 1994).
    """
    width, coat, level, rise = optics[0] * optics[0], optics[1], optics[2], optics[3]
    out = max(z, GRAZING)
    u = 1 - 0.5 * out
    toward_viewer = 28 / 23 * (1 - u * u * u * u * u)
    for k in range(rays.shape[1]):
        cos = x * rays[0, k] + y * rays[1, k] + z * rays[2, k]
        if cos <= 0:
            base[k] = 0.0
            lobe[k] = 0.0
            continue
        shade = cos
        if coat > 0:
            v = 1 - 0.5 * cos
            shade *= 1 + coat * ((1 - v * v * v * v * v) * toward_viewer - 1)
        if rise > 0:
            s = rays[2, k] - cos * out
            shade *= level + rise * (s / max(cos, out) if s > 0 else s)
        base[k] = shade
        lobe[k] = 0.0
        if strength > 0:
            dx, dy, dz = x - rays[3, k], y - rays[4, k], z - rays[5, k]
            apart = dx * dx + dy * dy + dz * dz
            half = 1 - 0.5 * apart
            d = half * half * width + apart * (1 - 0.25 * apart)
            lobe[k] = strength * width / (d * d) * cos / (4 * rays[6, k] * max(cos, out))


@compiled
def cost(y: Doubles, w: Doubles, albedo: float, base: Doubles, lobe: Doubles, weight: Doubles) -> float:
    """Minus twice the log likelihood of a pixel's samples, up to a constant: the sum over the samples of w times

    the squared residual over its variance, while it is small; what is too bright may be a highlight of its own, and what is near 0 a cast
    shadow, at a cost that does not grow beyond `OUTLIER` squared; and the log of the variance, which a bright lobe raises.

    y, w, base, lobe: (K,). weight: (K,), written: the weights of the least squares problem with the same gradient.
    Source of the bounded cost: S. Geman and D. E. McClure, "Statistical methods for tomographic image reconstruction" (1987).
    """
    noise, lobe_noise = NOISE * NOISE, LOBE_NOISE * LOBE_NOISE
    total = 0.0
    for k in range(len(y)):
        r = y[k] - albedo * base[k] - lobe[k]
        more = lobe_noise * lobe[k] * lobe[k] / noise
        square = r * r / (noise * (1 + more))
        share = 1.0
        if r > 0:
            share = 1 / (1 + square / (OUTLIER * OUTLIER))
        elif y[k] < DARK:
            share = 1 / (1 + square / (SHADOW * SHADOW))
        total += w[k] * square * share
        if more > 1e-4:
            total += w[k] * np.log(1 + more)
        weight[k] = w[k] * share * share / (noise * (1 + more))
    return total


@compiled
def fitted_albedo(y: Doubles, w: Doubles, base: Doubles, lobe: Doubles, weight: Doubles, rounds: int) -> tuple[float, float]:
    """(albedo, cost) of a normal held fast, by `rounds` of reweighted least squares. y, w, base, lobe: (K,). weight: (K,), written."""
    albedo = total = 0.0
    for k in range(len(y)):
        weight[k] = w[k]
    for _ in range(rounds):
        top = bottom = 0.0
        for k in range(len(y)):
            top += weight[k] * base[k] * (y[k] - lobe[k])
            bottom += weight[k] * base[k] * base[k]
        albedo = max(top / bottom, 0.0) if bottom > 0 else 0.0
        total = cost(y, w, albedo, base, lobe, weight)
    return albedo, total


@compiled
def pull(x: float, y: float, z: float, toward: Doubles, prior: float, reach: float) -> float:
    """The cost of a normal's distance from where it is expected: prior * d^2, bounded by prior * reach^2. toward: (3,) unit."""
    d2 = (x - toward[0]) ** 2 + (y - toward[1]) ** 2 + (z - toward[2]) ** 2
    return prior * d2 / (1 + d2 / (reach * reach))


@compiled
def across(x: float, y: float, z: float) -> tuple[float, float, float, float, float, float]:
    """Two unit vectors that are perpendicular to the unit (x, y, z) and to each other."""
    tx, ty, tz = (0.0, z, -y) if abs(x) < 0.7 else (-z, 0.0, x)
    length = np.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / length, ty / length, tz / length
    return tx, ty, tz, y * tz - z * ty, z * tx - x * tz, x * ty - y * tx


@compiled
def slopes(x: float, y: float, z: float, albedo: float, rays: Doubles, optics: Doubles, strength: float, work: Doubles) -> None:
    """Derivatives of the shading by turns of the normal along the two vectors of `across`, into the scratch's last two rows."""
    tx, ty, tz, ux, uy, uz = across(x, y, z)
    base, lobe = work[NEXT_BASE], work[NEXT_LOBE]
    shades(x + STEP * tx, y + STEP * ty, z + STEP * tz, rays, optics, strength, base, lobe)
    for k in range(rays.shape[1]):
        work[TURN_1, k] = (albedo * (base[k] - work[BASE, k]) + lobe[k] - work[LOBE, k]) / STEP
    shades(x + STEP * ux, y + STEP * uy, z + STEP * uz, rays, optics, strength, base, lobe)
    for k in range(rays.shape[1]):
        work[TURN_2, k] = (albedo * (base[k] - work[BASE, k]) + lobe[k] - work[LOBE, k]) / STEP


@compiled
def information(work: Doubles) -> tuple[float, float, float, float, float, float]:
    """The normal matrix of two turns and the albedo, from the scratch, in the order of `recon.normals.compiled.inverse`."""
    xx = yy = zz = xy = xz = yz = 0.0
    for k in range(work.shape[1]):
        g, p, q, s = work[WEIGHT, k], work[TURN_1, k], work[TURN_2, k], work[BASE, k]
        xx += g * p * p
        yy += g * q * q
        zz += g * s * s
        xy += g * p * q
        xz += g * p * s
        yz += g * q * s
    return xx, yy, zz, xy, xz, yz


@compiled
def refine(
    y: Doubles,
    w: Doubles,
    n: Doubles,
    albedo: float,
    rays: Doubles,
    optics: Doubles,
    strength: float,
    rounds: int,
    toward: Doubles,
    prior: float,
    reach: float,
    work: Doubles,
) -> tuple[float, float]:
    """Descend to the nearest least cost in normal and albedo, by Levenberg and Marquardt's steps. Returns (albedo, cost).

    y, w: (K,). n: (3,) unit, facing the viewer, changed. toward, prior, reach: see `pull`. work: (8, K) scratch.
    """
    x, v, z = n[0], n[1], n[2]
    shades(x, v, z, rays, optics, strength, work[BASE], work[LOBE])
    least = cost(y, w, albedo, work[BASE], work[LOBE], work[WEIGHT]) + pull(x, v, z, toward, prior, reach)
    damping = 1e-3
    for _ in range(rounds):
        tx, ty, tz, ux, uy, uz = across(x, v, z)
        slopes(x, v, z, albedo, rays, optics, strength, work)
        xx, yy, zz, xy, xz, yz = information(work)
        gx = gy = gz = 0.0
        for k in range(len(y)):
            r = work[WEIGHT, k] * (y[k] - albedo * work[BASE, k] - work[LOBE, k])
            gx += r * work[TURN_1, k]
            gy += r * work[TURN_2, k]
            gz += r * work[BASE, k]
        d2 = (x - toward[0]) ** 2 + (v - toward[1]) ** 2 + (z - toward[2]) ** 2
        hold = prior / (1 + d2 / (reach * reach)) ** 2
        xx += hold
        yy += hold
        gx += hold * (toward[0] * tx + toward[1] * ty + toward[2] * tz)
        gy += hold * (toward[0] * ux + toward[1] * uy + toward[2] * uz)
        grain = 1e-9 * (xx + yy + zz) + 1e-12
        turned = gained = 0.0
        for _again in range(4):
            more = 1 + damping
            ixx, iyy, izz, ixy, ixz, iyz = inverse(xx * more + grain, yy * more + grain, zz * more + grain, xy, xz, yz)
            p = ixx * gx + ixy * gy + ixz * gz
            q = ixy * gx + iyy * gy + iyz * gz
            turn = np.sqrt(p * p + q * q)
            if turn > LONGEST:
                p, q = p * LONGEST / turn, q * LONGEST / turn
            mx, my, mz = x + p * tx + q * ux, v + p * ty + q * uy, z + p * tz + q * uz
            length = np.sqrt(mx * mx + my * my + mz * mz)
            mx, my, mz = mx / length, my / length, mz / length
            brighter = max(albedo + ixz * gx + iyz * gy + izz * gz, 0.0)
            shades(mx, my, mz, rays, optics, strength, work[NEXT_BASE], work[NEXT_LOBE])
            now = cost(y, w, brighter, work[NEXT_BASE], work[NEXT_LOBE], work[NEXT_WEIGHT])
            now += pull(mx, my, mz, toward, prior, reach)
            if now < least and mz > 0:
                turned, gained = turn, least - now
                x, v, z, albedo, least = mx, my, mz, brighter, now
                for row in range(3):
                    work[BASE + row] = work[NEXT_BASE + row]
                damping = max(0.2 * damping, 1e-6)
                break
            damping = 8 * damping + 1e-3
        if turned < 1e-4 and gained < 1e-3:
            break
    n[0], n[1], n[2] = x, v, z
    return albedo, least


@compiled
def spread(n: Doubles, albedo: float, rays: Doubles, optics: Doubles, strength: float, work: Doubles) -> float:
    """Variance of the normal's angle, in square radians, that the curvature of the cost leaves at what `refine` found; see there."""
    slopes(n[0], n[1], n[2], albedo, rays, optics, strength, work)
    xx, yy, zz, xy, xz, yz = information(work)
    # A grain on the diagonal: where what agrees is too little the angle comes out near 90 degrees, not undefined.
    grain = 1e-9 * (xx + yy + zz) + 1e-3
    ixx, iyy, _, _, _, _ = inverse(xx + grain, yy + grain, zz + grain, xy, xz, yz)
    return ixx + iyy
