"""Uncalibrated photometric stereo: lights, strengths and normals from the pictures alone, up to what pictures can tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gen.capture import grey
from gen.errors import InputError
from recon.conditioning import leave_out, lit, normal_matrices, require_spanning_lights
from recon.normals.bas_relief import caves_in, equally_strong, facing_maxima
from recon.normals.least_squares import least_squares, solve
from recon.registry import Normals

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

FEWEST = 5
"""Pictures that are needed: three numbers are determined by the first three, and the rest must speak for the bas-relief."""

PIXELS = 3000
"""Pixels that the three dimensions of the pictures are found from."""

FEW = 10
"""Pixels under which nothing is fitted."""

ROUNDS, REWEIGHTED = 40, 10
"""Most rounds of the factorisation, and rounds of reweighting of integrability."""

OPEN = 1e-9
"""Second smallest over largest eigenvalue of integrability under which more than one answer fits."""

SMOOTHING = 1.0
"""Pixels (standard deviation) by which the surface is smoothed before it is differenced; 0 to 2 differ little on photographs."""

OUTLIER = 2.5
"""Robust standard deviations beyond which a sample is no matte one."""

SETTLED = 1e-6
"""Change of the pictures' subspace in a round, as a sine, at which it has come to rest."""

Strengths = Literal["equal", "unknown"]


@dataclass(frozen=True, eq=False)
class Uncalibrated:
    """What the pictures say of their lights, and the normals under them.

    normals: by least squares under these lights, on the samples that three dimensions explain. lights: (K, 3) unit.
    strengths: (K,) relative, mean 1.
    misfit: what three dimensions leave of the lit samples, over their brightness (root mean square): 0 for a matte surface.
    against: how far the assumption fails that chose among the bas-reliefs: relative standard deviation of the strengths ("equal"), or the
    share of brightest spots that do not face their light ("unknown"): half and more on textured things.
    """

    normals: Normals
    lights: Doubles
    strengths: Doubles
    misfit: float
    against: float


AMBIGUOUS = (
    "Whether the surface is convex or concave cannot be told from matte shading: it was taken to bulge within its outline.",
    "How bright the lights are and how bright the surface is cannot be told apart: strengths are relative.",
)
"""What no pictures of a matte surface determine, in sentences."""


def uncalibrated(images: Floats, mask: Bools, weights: Floats, strengths: Strengths = "equal") -> Uncalibrated:
    """Lights and normals of a matte surface from its pictures alone.

    Matte pictures span three dimensions (`three_dimensions`): lights and surface are known up to a 3x3 matrix. That the normals are those
    of a surface leaves three numbers of it, the generalised bas-relief transform z -> lambda z + mu x + nu y (`integrable`). No matte
    pictures tell more without an assumption, which is one of two: all lights are equally strong ("equal"; `images` may be divided by
    known strengths before), or, with strengths unknown, the brightest spots of each picture face its light ("unknown"). What remains is
    in `AMBIGUOUS`. Shadows and highlights are left out as far as they stick out; gloss should be removed first.

    images: (K, H, W, 3) linear radiance. mask: (H, W). weights: (K, H, W), not negative. Raises InputError for fewer than `FEWEST`
    pictures, pictures that span less than three dimensions, or a surface whose shape says nothing.
    Source: H. Hayakawa, "Photometric stereo under a light source with arbitrary motion" (JOSA A 1994), the factorisation and equal
    strengths; A. Yuille and D. Snow, "Shape and albedo from multiple images using integrability" (CVPR 1997); P. Belhumeur, D.
    Kriegman and A. Yuille, "The bas-relief ambiguity" (IJCV 1999); P. Favaro and T. Papadhimitri, "A closed-form solution to
    uncalibrated photometric stereo via diffuse maxima" (CVPR 2012), here by consensus over all brightest spots.
    """
    if strengths not in ("equal", "unknown"):
        raise InputError(f"strengths {strengths}: must be equal or unknown")
    if len(images) < FEWEST:
        raise InputError(f"lights cannot be told from {len(images)} pictures; at least {FEWEST} are needed")
    y = grey(images[:, mask])
    w = weights[:, mask]
    U, b, used, misfit = three_dimensions(y, w)
    A = integrable(b, mask)
    surface, lights = b @ A, U @ np.linalg.inv(A).T
    if strengths == "equal":
        G, against = equally_strong(lights)
    else:
        G, against = facing_maxima(surface, lights, y, used, mask)
    surface, lights = surface @ np.linalg.inv(G), lights @ G.T
    if caves_in(surface, mask):
        lights = lights * [-1, -1, 1]
    power = np.linalg.norm(lights, axis=1)
    directions = lights / power[:, None]
    power = power / power.mean()
    try:
        require_spanning_lights(directions, "")
    except InputError:
        other = {"equal": "they may not be equally strong", "unknown": "the brightest spots may not face them"}[strengths]
        raise InputError(f"no lights that could serve explain the pictures: {other}, or they are too much alike") from None
    counted = np.zeros_like(weights)
    counted[:, mask] = leave_out(w, ~used, directions)
    normals = least_squares(images / power[:, None, None, None].astype(np.float32), directions, mask, counted)
    return Uncalibrated(normals, directions, power, misfit, against)


def three_dimensions(y: Floats, w: Floats) -> tuple[Doubles, Doubles, Bools, float]:
    """Pictures y (K, P) = U b on their lit samples: U (K, 3) orthonormal and b (P, 3), zero where a pixel has too few.

    Least squares in turn over U and b, from the singular vectors of the pixels that all lights reach; samples far from the fit are left
    out in each round. w: (K, P). Returns U, b, the samples that were used (K, P), and their misfit over their brightness.
    """
    start = (w > 0) & lit(y)
    everywhere = start.all(axis=0)
    best = everywhere if everywhere.sum() >= 100 else start.sum(axis=0) >= max(4, len(y) // 2)
    if best.sum() < FEW:
        raise InputError("hardly a pixel is lit in half of the pictures; their lights cannot be told from them")
    left, values, _ = np.linalg.svd(
        np.where(start, y, 0)[:, best][:, _every(int(best.sum()))].astype(np.float64), full_matrices=False
    )
    if values[2] < 1e-4 * values[0]:
        raise InputError("the pictures differ too little: their lights lie in one plane or are alike, or the surface is flat")
    U = left[:, :3]
    sample, kept = y[:, _every(y.shape[1])], start[:, _every(y.shape[1])]
    used = kept
    for _ in range(ROUNDS):
        b, _, found = solve(sample, U, used.astype(np.float32))
        b = np.where(found[:, None], b, 0)
        off = np.abs(sample - U @ b.T)
        inside = kept & found
        if (inside.sum(axis=1) < FEW).any():
            dark = int(np.argmin(inside.sum(axis=1))) + 1
            raise InputError(f"picture {dark} is lit hardly anywhere that the others are; its light cannot be told, leave it out")
        used = inside & (off <= OUTLIER * (1.4826 * np.median(off[inside]) + 1e-7 * np.abs(sample).max()))
        after = np.linalg.solve(normal_matrices(b, used.T.astype(np.float64)), ((used * sample) @ b)[..., None])[..., 0]
        after = np.linalg.qr(after)[0]
        change = float(np.linalg.norm(after - U @ (U.T @ after)))
        U = after
        if change < SETTLED:
            break
    used = start
    for _ in range(2):
        b, _, found = solve(y, U, used.astype(np.float32))
        b = np.where(found[:, None], b, 0)
        off = np.abs(y - U @ b.T)
        used = start & found & (off <= OUTLIER * (1.4826 * np.median(off[start & found]) + 1e-7 * np.abs(y).max()))
    there = start & found
    return U, b, used, float(np.sqrt((off[there] ** 2).mean() / (y[there] ** 2).mean()))


def integrable(b: Doubles, mask: Bools) -> Doubles:
    """A (3, 3) that makes b @ A the (scaled) normals of a surface, up to a generalised bas-relief transform.

    With n = A^T b the curl of the slopes vanishes: (b_y x b) . (a1 x a3) = (b_x x b) . (a2 x a3), one equation a pixel, linear in the six
    numbers u = a1 x a3 and v = a2 x a3. The differences carry the noise, alike in all directions, so what is minimised is the misfit over
    its variance, sum |r . (u, v)|^2 / sum |u x b|^2 + |v x b|^2: plain least squares would choose the direction that noise fills least.
    Edges of the surface are left out by reweighting.

    b: (P, 3), zero where unknown, lightly smoothed here. Of all such matrices that one is taken whose third column is perpendicular to the
    others, and which gives the three parts of the normals equal shares.
    """
    from scipy.linalg import eigh

    centre, along_x, along_y = _slopes(b, mask)
    power = (centre**2).sum(axis=1, keepdims=True)
    rows = np.concatenate([np.cross(along_y, centre), -np.cross(along_x, centre)], axis=1) / power
    noise = (np.eye(3) - centre[:, :, None] * centre[:, None, :] / power[..., None]) / power[..., None]
    w = np.ones(len(rows))
    for _ in range(REWEIGHTED):
        spread = np.kron(np.eye(2), np.einsum("p,pij->ij", w, noise))
        values, vectors = eigh((rows * w[:, None]).T @ rows, spread)
        u, v = vectors[:3, 0], vectors[3:, 0]
        variance = np.einsum("pij,i,j->p", noise, u, u) + np.einsum("pij,i,j->p", noise, v, v)
        off = (rows @ vectors[:, 0]) ** 2 / variance
        w = 1 / (variance / np.median(variance) * (1 + off / (9 * np.median(off) + 1e-20)) ** 2)
    if values[1] < OPEN * values[-1]:
        raise InputError("the surface's shape leaves its lights open: it is flat, or bent one way only")
    third = np.cross(u, v)
    third /= np.linalg.norm(third)
    A = np.stack([np.cross(third, u), np.cross(third, v), third], axis=1)
    surface = b @ A
    A[:, 2] *= np.sqrt((surface[:, :2] ** 2).sum() / 2 / (surface[:, 2] ** 2).sum())
    result: Doubles = A * (1.0 if (surface[:, 2] > 0).sum() * 2 > (surface[:, 2] != 0).sum() else -1.0)
    return result


def _slopes(b: Doubles, mask: Bools) -> tuple[Doubles, Doubles, Doubles]:
    """b (Q, 3) smoothed, and its central differences along x and y, at the pixels whose four neighbours are known too."""
    from scipy.ndimage import gaussian_filter

    known = np.zeros(mask.shape, bool)
    known[mask] = np.abs(b).sum(axis=1) > 0
    field = np.zeros((*mask.shape, 3))
    field[mask] = b
    share = gaussian_filter(known.astype(np.float64), SMOOTHING)
    field = np.stack([gaussian_filter(part, SMOOTHING) for part in np.moveaxis(field, 2, 0)], axis=-1)
    field /= np.where(known, share, np.nan)[..., None]
    centre = field[1:-1, 1:-1]
    along_x, along_y = (field[1:-1, 2:] - field[1:-1, :-2]) / 2, (field[:-2, 1:-1] - field[2:, 1:-1]) / 2
    there = np.isfinite(along_x + along_y + centre).all(axis=-1)
    if there.sum() < 2 * FEW:
        raise InputError("too few pixels with four neighbours to tell the shape of a surface")
    return centre[there], along_x[there], along_y[there]


def _every(pixels: int) -> slice:
    """Which pixels the subspace is found from."""
    return slice(None, None, max(1, -(-pixels // PIXELS)))
