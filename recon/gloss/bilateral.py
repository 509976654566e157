"""Each picture alone, by colour: the maximum diffuse chromaticity spreads from matte to glossy pixels through a bilateral filter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gen.capture import Bools, Capture, Fault, Floats
from recon.gloss import remove, workable
from recon.gloss.geometry import smoothstep
from recon.registry import Layers

SPATIAL_SIGMA = 0.25
"""Width of the filter's spatial Gaussian over the longer side of the object's box (the paper's share of the picture)."""

RANGE_SIGMA = 0.04
"""Width of the filter's Gaussian on the guide, a chromaticity (the paper's)."""

CHANGE = 0.03
"""Iteration ends when no maximum chromaticity rises by more than this (the paper's)."""

ITERATIONS = 12

CHUNK = 1 << 21
"""Pixels that are looked up in the grid at a time, at a hundred bytes each."""

DARK = 0.02
"""Samples under this share of the picture's brightest (99.5th percentile) have no reliable colour: they neither give nor take."""

SATURATION = (0.2, 0.5)
"""3 * maximum diffuse chromaticity - 1: below the first a surface is grey and left alone, above the second the result is believed."""


def bilateral(capture: Capture) -> Layers:
    """Single-image highlight removal by bilateral filtering of the maximum chromaticity; every picture is handled on its own.

    With the light's colour divided out, gloss lowers a pixel's maximum chromaticity max(r) / sum(r) toward 1/3. It is filtered by a joint
    bilateral filter, guided by the maximum of the chromaticity that is left after the smallest channel is subtracted (which gloss does not
    change), and never falls below its own value; repeated until it settles. From the result L, gloss = (L sum(r) - max(r)) / (3 L - 1).
    The filter is a bilateral grid whose spatial cells and guide bins are half a sigma wide. Clipped and dark samples give no colour.

    Limits: needs some matte pixels of each hue in the same picture; pale and deep tints of one hue are taken for gloss and
    none; where the surface is grey (L near 1/3) it leaves the picture alone, by a smooth hand-over.
    It gives no confidence.
    Source: Q. Yang, S. Wang and N. Ahuja, "Real-time specular highlight removal using bilateral filtering" (ECCV 2010); the grid is that of
    J. Chen, S. Paris and F. Durand, "Real-time edge-aware image processing with the bilateral grid" (2007).
    """
    rows, columns = np.flatnonzero(capture.mask.any(axis=1)), np.flatnonzero(capture.mask.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    usable = workable(capture)
    clipped = (capture.faults & Fault.CLIPPED) != 0
    gloss = np.zeros(capture.faults.shape, np.float32)
    for k in range(capture.count):
        r = np.maximum(capture.images[k][box] / capture.intensities[k].astype(np.float32), 0)
        gloss[k][box] = gloss_of_picture(r, usable[k][box], clipped[k][box])
    return remove(capture, gloss)


def gloss_of_picture(r: Floats, usable: Bools, clipped: Bools) -> Floats:
    """Gloss of one picture. r: (H, W, 3) reflectance, not negative. usable, clipped: (H, W). Returns (H, W) in reflectance, >= 0."""
    gloss = np.zeros(usable.shape, np.float32)
    total = r.sum(axis=2)
    if not usable.any():
        return gloss
    bright = usable & (total > DARK * np.percentile(total[usable], 99.5)) & (total > 0)
    if not bright.any():
        return gloss
    s = total[bright]
    largest, smallest = r[bright].max(axis=1), r[bright].min(axis=1)
    chroma = largest / s
    # What is left without the smallest channel; a truly grey pixel has no such colour and gets a guide of its own, at the end of the range.
    rest = s - 3 * smallest
    coloured = rest > 0.01 * s
    guide = np.where(coloured, (largest - smallest) / np.where(coloured, rest, 1), 1 / 3).astype(np.float32)
    grid = _grid(np.argwhere(bright), guide, usable.shape)
    give = (~clipped[bright]).astype(np.float32)
    for _ in range(ITERATIONS):
        raised = np.maximum(chroma, joint_bilateral(chroma, give, grid))
        change = float((raised - chroma).max())
        chroma = raised
        if change < CHANGE:
            break
    saturation = 3 * chroma - 1
    found = (chroma * s - largest) / np.maximum(saturation, 0.01)
    gloss[bright] = np.clip(found, 0, smallest) * smoothstep(saturation, *SATURATION)
    return gloss


@dataclass(frozen=True, eq=False)
class Grid:
    """A bilateral grid, and where P pixels lie in it: position (P, 3), in cells."""

    shape: tuple[int, int, int]
    position: Floats

    def parts(self) -> Iterator[tuple[slice, NDArray[np.intp], Floats]]:
        """Some pixels at a time, with the flat indices of the corners around each (8, p) and its trilinear shares of them (8, p)."""
        if len(self.position) <= CHUNK:
            yield (slice(None), *self._few)
            return
        for start in range(0, len(self.position), CHUNK):
            of = slice(start, start + CHUNK)
            yield (of, *self._around(self.position[of]))

    @cached_property
    def _few(self) -> tuple[NDArray[np.intp], Floats]:
        """Of so few pixels that they need not be worked out anew each time."""
        return self._around(self.position)

    def _around(self, position: Floats) -> tuple[NDArray[np.intp], Floats]:
        low = np.floor(position).astype(np.intp)
        part = position - low
        corners, shares = [], []
        for corner in np.ndindex(2, 2, 2):
            at = low + np.array(corner)
            corners.append((at[:, 0] * self.shape[1] + at[:, 1]) * self.shape[2] + at[:, 2])
            shares.append(np.prod(np.where(np.array(corner) == 1, part, 1 - part), axis=1))
        return np.stack(corners), np.stack(shares).astype(np.float32)


def joint_bilateral(values: Floats, weights: Floats, grid: Grid) -> Floats:
    """Joint bilateral filter of P values, weighted, on a grid. Returns (P,); a pixel with no weight near it keeps its own value."""
    from scipy.ndimage import gaussian_filter

    size = int(np.prod(grid.shape))
    cells = np.zeros((2, size))
    for of, corners, shares in grid.parts():
        for cell, part in zip(cells, (weights[of], weights[of] * values[of]), strict=True):
            cell += sum(np.bincount(c, weights=w * part, minlength=size) for c, w in zip(corners, shares, strict=True))
    mass, moment = (
        gaussian_filter(np.reshape(cell, grid.shape), 2.0, mode="constant", truncate=3.0).reshape(-1) for cell in cells
    )
    mean = np.where(mass > 1e-6, moment / np.maximum(mass, 1e-6), -1).astype(np.float32)
    # Interpolating mass and moment apart would cost twice as much; the mean is as smooth as they are.
    result = np.empty(len(values), np.float32)
    for of, corners, shares in grid.parts():
        at = mean[corners]
        known = np.where(at >= 0, shares, 0)
        enough = known.sum(axis=0)
        result[of] = np.where(enough > 0, (known * at).sum(axis=0) / np.where(enough > 0, enough, 1), values[of])
    return result


def _grid(places: NDArray[np.intp], guide: Floats, size: tuple[int, ...]) -> Grid:
    """The grid of half-sigma cells for pixels at places (P, 2) with guide values (P,)."""
    cell = SPATIAL_SIGMA / 2 * max(size)
    position = np.empty((len(places), 3), np.float32)
    position[:, :2] = places / cell
    position[:, 2] = (guide - 1 / 3) / (RANGE_SIGMA / 2)
    rows, columns, bins = (int(n) + 2 for n in np.floor(position.max(axis=0)))
    return Grid((rows, columns, bins), position)
