"""Synthetic photographs by plain numpy, in OpenCV's own frame (y down, z away): nothing of `gen.photos` is used to make them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from gen.capture import Capture
from gen.images import write_png
from gen.srgb import linear_to_srgb

OURS = np.array([1.0, -1.0, -1.0])
"""Turns OpenCV's axes into ours (y up, z to the viewer) and back."""


FINE = 2
"""Rays a pixel, each way."""


class Balls:
    """Spheres before a camera. centres: (N, 3) in OpenCV's frame, mm from the camera; from the picture's middle where K is None."""

    def __init__(
        self, size: tuple[int, int], centres: np.ndarray, radius: float, K: np.ndarray | None, step: float = 1.0
    ) -> None:
        self.size = height, width = size
        y, x = (np.mgrid[: height * FINE, : width * FINE] + 0.5) / FINE - 0.5
        if K is None:
            start = np.stack([(x - (width - 1) / 2) * step, (y - (height - 1) / 2) * step, np.full(x.shape, -1e4)], -1)
            along = np.broadcast_to([0.0, 0.0, 1.0], start.shape)
        else:
            start = np.zeros((*x.shape, 3))
            along = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones(x.shape)], -1)
            along = along / np.linalg.norm(along, axis=-1, keepdims=True)
        self.masks, rays, points, normals, toward = [], [], [], [], []
        for centre in np.asarray(centres, float):
            b = ((start - centre) * along).sum(-1)
            disc = b**2 - ((start - centre) ** 2).sum(-1) + radius**2
            hit = disc > 0
            rays.append(np.flatnonzero(hit))
            points.append(start[hit] + along[hit] * (-b[hit] - np.sqrt(disc[hit]))[:, None])
            normals.append((points[-1] - centre) / radius)
            toward.append(-along[hit])
            self.masks.append(self._pixels(np.ones(len(rays[-1])), rays[-1]) > 0.5)
        self.mask = np.any(self.masks, axis=0)
        self.rays, self.points, self.normals, self.toward = (np.concatenate(part) for part in (rays, points, normals, toward))

    def _pixels(self, values: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """(H, W): means over the rays of each pixel, rays past the balls being black."""
        fine = np.zeros(self.size[0] * FINE * self.size[1] * FINE)
        fine[rays] = values
        return fine.reshape(self.size[0], FINE, self.size[1], FINE).mean(axis=(1, 3))

    def to_light(self, direction: np.ndarray | None = None, place: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """(unit vectors to the light, fall-off) of every ray; the light in OpenCV's frame, near where a place is given."""
        if place is None:
            assert direction is not None
            return np.broadcast_to(direction, self.points.shape), np.ones(len(self.points))
        toward = place - self.points
        distance = np.linalg.norm(toward, axis=-1)
        return toward / distance[..., None], 1 / distance**2

    def mirror(self, direction: np.ndarray | None = None, place: np.ndarray | None = None, spread: float = 1.5) -> np.ndarray:
        """(H, W), a mirror's picture of a soft lamp `spread` degrees wide, 30 times over full scale, in a dim room brighter above."""
        toward, _ = self.to_light(direction, place)
        mirrored = 2 * (self.normals * self.toward).sum(-1, keepdims=True) * self.normals - self.toward
        off = np.degrees(np.arccos(np.clip((mirrored * toward).sum(-1), -1, 1)))
        return self._pixels(30 * np.exp(-0.5 * (off / spread) ** 2) + 0.02 - 0.015 * mirrored[..., 1], self.rays)

    def matte(self, direction: np.ndarray | None = None, place: np.ndarray | None = None) -> np.ndarray:
        """(H, W) shading of white Lambertian balls."""
        toward, fall = self.to_light(direction, place)
        return self._pixels(np.maximum((self.normals * toward).sum(-1), 0) * fall, self.rays)


def ring(tilt: float, count: int, frontal: bool = True) -> np.ndarray:
    """Unit light directions (K, 3) in our frame."""
    t, a = np.radians(tilt), 2 * np.pi * np.arange(count) / count + 0.3
    around = np.stack([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.full(count, np.cos(t))], -1)
    return np.r_[[[0.0, 0.0, 1.0]], around] if frontal else around


def degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between rows."""
    a, b = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (a, b))
    return np.degrees(np.arccos(np.clip((a * b).sum(-1), -1, 1)))


LIGHTS = ring(40, 5)
"""One frontal light and five around it: those of `matte_folder`."""


def save(path: Path, linear: np.ndarray, bits: int = 16, srgb: bool = False) -> None:
    top = (1 << bits) - 1
    coded = linear_to_srgb(np.clip(linear, 0, 1)) if srgb else np.clip(linear, 0, 1)
    write_png(path, np.round(coded * top).astype(np.uint16 if bits == 16 else np.uint8))


def say(folder: Path, **values: Any) -> None:
    """capture.yaml, written as JSON, which YAML 1.2 contains."""
    (folder / "capture.yaml").write_text(json.dumps({k: v for k, v in values.items() if v is not None}), encoding="utf-8")


def matte_folder(path: Path, scene: Capture) -> Path:
    """A matte sphere, six pictures of known lights, mask and scale: nothing is wrong with it."""
    path.mkdir()
    for k, picture in enumerate(scene.images):
        save(path / f"p{k + 1}.png", picture)
    save(path / "mask.png", np.repeat(scene.mask[..., None], 3, -1).astype(float))
    say(path, images="p*.png", lights={"directions": LIGHTS.tolist()}, intensities="equal", mm_per_pixel=0.1)
    return path
