"""Lights from a ball of known place: the highlight of a mirror ball, or the shading of a matte one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from gen.photos.view import Doubles, Sphere, View, reflected

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

CORE = 0.3
"""A highlight is what is brighter than this share of its peak: lower takes in glare, higher leaves few pixels to place it by."""

STANDS_OUT = 4.0
"""A highlight must be so many times as bright as 95 % of the ball: a lamp fills far less of what a mirror ball shows."""

RIM = 0.2
"""Cosine of the view's angle below which a pixel of the ball is left aside: at the rim a pixel spans many directions."""

SHADED = 0.1
"""Cosine of the light's angle, by the fit, below which a matte sample is left out: the terminator of a lamp that has a size is soft."""

OUTLIER = 3.0
"""Standard deviations (by the median) beyond which a matte sample is no shading: dirt, a highlight, the shadow of something else."""

GLARE = 10.0
"""Brightest sample over the fit's brightest from which it is a mirror's, in whose dim rest a shading is found too."""

MATTE_SHARE = 0.2
"""Root mean square residual over the brightness above which a ball is not matte."""


@dataclass(frozen=True, eq=False)
class BallLights:
    """What one ball says of K lights, in the frame and unit of a View.

    points: (K, 3) the place on the ball where the light was seen. directions: (K, 3) unit, from there to the light.
    strengths: (K, 3) relative radiance in each channel, None from a mirror ball, whose highlights are clipped.
    residuals: (K,) of a matte ball, root mean square over brightness; the share of the ball that the highlight fills for a mirror ball.
    """

    points: Doubles
    directions: Doubles
    strengths: Doubles | None
    residuals: Doubles


def mirror_ball(images: NDArray[np.floating[Any]], sphere: Sphere, view: View, where: str, names: tuple[str, ...]) -> BallLights:
    """Light directions from the highlights of a mirror ball: the view's mirror direction about the ball's normal.

    What shines alike in all pictures (the room, other lamps) is subtracted first. The directions of the highlight's pixels are
    averaged by their radiance: on a mirror ball seen from afar, equal areas of the picture are equal solid angles of the surroundings, so
    this is the lamp's middle however large it is. images: (K, H, W) linear grey.
    Raises InputError where the ball is out of the picture, or a picture of it shows no highlight.
    """
    rows, columns, points, normals, toward = ball_pixels(sphere, view, where)
    inside = images[:, rows, columns].astype(np.float64)
    if len(images) > 1:
        inside = inside - inside.min(axis=0)
    found_points, directions, shares = [], [], []
    for name, values in zip(names, inside, strict=True):
        peak, usual = values.max(), np.percentile(values, 95)
        if not peak > STANDS_OUT * max(usual, 0.0) or not peak > 0:
            raise InputError(f"{where}: no highlight stands out on the mirror ball of picture {name}; is it a matte ball?")
        core = _highlight(values, rows, columns, images.shape[1:])
        weight = np.where(core, values - CORE * peak, 0)
        mean = weight @ reflected(normals, toward)
        directions.append(mean / np.linalg.norm(mean))
        found_points.append(weight @ points / weight.sum())
        shares.append(core.mean())
    return BallLights(np.array(found_points), np.array(directions), None, np.array(shares))


def _highlight(values: Doubles, rows: NDArray[np.intp], columns: NDArray[np.intp], size: tuple[int, ...]) -> Bools:
    """Which pixels belong to the brightest highlight: of the connected parts above `CORE` of the peak, the one with the most light."""
    from scipy.ndimage import label

    bright = np.zeros(size, bool)
    bright[rows, columns] = values > CORE * values.max()
    parts, count = label(bright, structure=np.ones((3, 3)))
    here = parts[rows, columns]
    power = np.bincount(here, values, minlength=count + 1)
    power[0] = 0
    core: Bools = here == power.argmax()
    return core


def matte_ball(
    images: Floats, faults: NDArray[np.uint8], sphere: Sphere, view: View, where: str, names: tuple[str, ...]
) -> BallLights:
    """Light directions and strengths from the shading of a matte ball: I = strength * max(n.l, 0), shadows left out.

    Linear least squares on the samples that the fit itself says are lit, repeated until they stay the same; samples far from the fit are
    left out too. A selection by the measured brightness instead would favour bright noise. images: (K, H, W, 3) linear.
    faults: (K, H, W). Raises InputError where the ball is out of the picture, hardly lit, or not matte.
    Source: Lambert's law; the ball as calibration target is that of R. J. Woodham, Optical Engineering 19(1), 1980.
    """
    rows, columns, _, normals, _ = ball_pixels(sphere, view, where)
    directions, strengths, residuals, places = [], [], [], []
    for name, picture, flags in zip(names, images[:, rows, columns].astype(np.float64), faults[:, rows, columns], strict=True):
        lit, residual = lit_samples(picture.mean(axis=1), normals, flags == 0)
        if lit.sum() < 50:
            raise InputError(f"{where}: hardly a pixel of the matte ball is lit in picture {name}; take it with more exposure")
        scaled, *_ = np.linalg.lstsq(normals[lit], picture[lit].mean(axis=1), rcond=None)
        direction = scaled / np.linalg.norm(scaled)
        if residual > MATTE_SHARE * np.linalg.norm(scaled) or picture.max() > GLARE * np.linalg.norm(scaled):
            raise InputError(
                f"{where}: the ball in picture {name} is not shaded as a matte one is; is it a mirror ball, or in shadow?"
            )
        shading = normals[lit] @ direction
        directions.append(direction)
        strengths.append(shading @ picture[lit] / (shading @ shading))
        residuals.append(residual / np.linalg.norm(scaled))
        places.append(sphere.centre + sphere.radius * direction)
    return BallLights(np.array(places), np.array(directions), np.maximum(strengths, 1e-12), np.array(residuals))


def lit_samples(values: Doubles, normals: Doubles, usable: Bools) -> tuple[Bools, float]:
    """(which samples (P,) of a matte ball are lit and on the fit, their root mean square residual)."""
    lit = usable & (values > 0.3 * np.percentile(values[usable], 99)) if usable.any() else usable
    residual = np.inf
    for _ in range(30):
        if lit.sum() < 10:
            break
        scaled, *_ = np.linalg.lstsq(normals[lit], values[lit], rcond=None)
        off = values - normals @ scaled
        residual = float(np.sqrt((off[lit] ** 2).mean()))
        spread = 1.4826 * np.median(np.abs(off[lit]))
        length = np.linalg.norm(scaled)
        wanted = usable & (normals @ scaled > SHADED * length) & (np.abs(off) <= OUTLIER * spread + 1e-6 * length)
        if (wanted == lit).all():
            break
        lit = wanted
    return lit, residual


def ball_pixels(sphere: Sphere, view: View, where: str) -> tuple[NDArray[np.intp], NDArray[np.intp], Doubles, Doubles, Doubles]:
    """(rows, columns, points, normals, directions to the camera) of the ball's pixels, its rim left aside."""
    rows, columns = sphere.window(view)
    points, normals, toward, met = sphere.meet(view, columns, rows)
    kept = met & ((normals * toward).sum(-1) > RIM)
    if kept.sum() < 200:
        raise InputError(f"{where}: the ball covers only {int(kept.sum())} pixels of the picture; 200 are needed")
    return rows[kept], columns[kept], points[kept], normals[kept], toward[kept]
