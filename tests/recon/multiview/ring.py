"""A ring of views of an ellipsoid in closed form: painted, Lambertian, with or without a highlight; no renderer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Scale, Truth
from gen.formats.render_folder import write_render
from recon.multiview.views import Ball, View, views_of, write_cameras

AXES = np.array([14.0, 17.0, 11.0])
"""Half axes of the ellipsoid in mm."""

MIDDLE = np.array([3.0, -2.0, 4.0])
"""Its centre in the object's frame."""

DISTANCE, FOCAL = 150.0, 340.0
LIGHTS = np.array([[0, 0, 1], [0.5, 0, 0.8], [-0.5, 0, 0.8], [0, 0.5, 0.8], [0, -0.5, 0.8]])


def turned(degrees: float, lean: float = 15.0) -> NDArray[np.float64]:
    """A pose: turned about the object's y axis, leant toward the viewer, `DISTANCE` before the camera."""
    a, b = np.radians([degrees, lean])
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    pose = np.eye(4)
    pose[:3, :3] = about_x @ about_y
    pose[:3, 3] = [1.0, 2.0, -DISTANCE]
    return pose


def paint(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """A solid pattern of waves between .25 and .95 at points (..., 3)."""
    rng = np.random.default_rng(5)
    waves = rng.normal(size=(40, 3)) * 1.1
    value = np.cos(points @ waves.T + rng.uniform(0, 6, 40)).sum(axis=-1) / np.sqrt(20)
    return 0.6 + 0.35 * np.tanh(value)


def capture_at(pose: NDArray[np.float64], size: int, gloss: float = 0.0) -> Capture:
    """The capture of the ellipsoid at a pose. gloss: height of a Blinn-Phong highlight of exponent 60."""
    K = np.array([[FOCAL * size / 96, 0, size / 2 - 2.5], [0, FOCAL * size / 96, size / 2 + 1.5], [0, 0, 1]])
    row, column = np.mgrid[:size, :size].astype(float)
    ray = np.stack([(column - K[0, 2]) / K[0, 0], -(row - K[1, 2]) / K[1, 1], -np.ones_like(row)], -1)
    R, start = pose[:3, :3], -pose[:3, :3].T @ pose[:3, 3] - MIDDLE
    u, o = ray @ R / AXES, start / AXES  # the unit ball
    a, b, c = (u * u).sum(-1), u @ o, o @ o - 1
    root = b * b - a * c
    mask = root > 0
    depth = np.where(mask, (-b - np.sqrt(np.where(mask, root, 0))) / a, np.nan)
    points = np.nan_to_num(start + depth[..., None] * (ray @ R))
    n = (points / AXES**2) @ R.T
    n = np.where(mask[..., None], n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-9), 0)
    albedo = np.repeat(np.where(mask, paint(points), 0)[..., None], 3, -1)
    lights = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)
    matte = albedo * np.maximum(np.einsum("hwc,kc->khw", n, lights), 0)[..., None]
    half = lights[:, None, None] - ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    shine = gloss * np.clip((half * n).sum(-1), 0, 1) ** 60 * mask
    images = (matte + shine[..., None]).astype(np.float32)
    truth = Truth(
        normals=n.astype(np.float32),
        depth=(depth / 1000).astype(np.float32),
        matte=matte.astype(np.float32),
        albedo=albedo.astype(np.float32),
    )
    return Capture(images=images, lights=lights, mask=mask, truth=truth, scale=Scale(camera=K), source="ring")


def ring(angles: Sequence[float], size: int = 96, gloss: float = 0.0) -> tuple[tuple[View, ...], Ball]:
    """Views of the ellipsoid turned by these angles."""
    poses = [turned(angle) for angle in angles]
    return views_of([capture_at(pose, size, gloss) for pose in poses], poses, [f"{angle:g}" for angle in angles])


def write_ring(folder: Path, angles: Sequence[float], size: int = 96, gloss: float = 0.0) -> None:
    """The same views as capture folders with their cameras.json."""
    for angle in angles:
        write_render(capture_at(turned(angle), size, gloss), folder / f"{angle:g}")
    write_cameras(folder, [f"{angle:g}" for angle in angles], [turned(angle) for angle in angles])


def distance_to_ellipsoid(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance in mm of points (N, 3) from the ellipsoid, to first order: exact where it is small."""
    p = points - MIDDLE
    value = np.sqrt(((p / AXES) ** 2).sum(axis=1))
    return np.abs(value - 1) * value / np.linalg.norm(p / AXES**2, axis=1)
