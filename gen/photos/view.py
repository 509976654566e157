"""How the pixels of a photograph look into the world: rays in the camera's frame, millimetres from where the camera looks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Scale

Doubles = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """The camera of a capture. size: (H, W). scale: as in the Capture.

    Frame: x right, y up, z to the viewer. Origin: the picture's middle where the view is orthographic, else the point of the optical
    axis at the camera's distance. Unit: millimetres where the scale is known (`metric`), else pixels, or distances of the camera.
    """

    size: tuple[int, int]
    scale: Scale

    @property
    def metric(self) -> bool:
        """Whether lengths are millimetres."""
        return self.scale.metres_per_pixel is not None

    @property
    def distance(self) -> float | None:
        """From the camera to the origin in the view's unit; None where the view is orthographic."""
        if self.scale.camera is None:
            return None
        return self.scale.distance_mm or 1.0

    def rays(self, x: NDArray[Any], y: NDArray[Any]) -> tuple[Doubles, Doubles]:
        """(origins (..., 3), unit directions (..., 3) away from the camera) of the rays through pixels x, y (their centres at integers)."""
        x, y = np.asarray(x, float), np.asarray(y, float)
        if self.scale.camera is None:
            step = self.scale.mm_per_pixel or 1.0
            height, width = self.size
            origins = np.stack([(x - (width - 1) / 2) * step, ((height - 1) / 2 - y) * step, np.zeros_like(x)], -1)
            return origins, np.broadcast_to((0.0, 0.0, -1.0), origins.shape)
        K = self.scale.camera
        down = (y - K[1, 2]) / K[1, 1]
        along = np.stack([(x - K[0, 2] - K[0, 1] * down) / K[0, 0], -down, -np.ones_like(x)], -1)
        origin = np.broadcast_to((0.0, 0.0, float(self.distance or 1.0)), along.shape)
        return origin, along / np.linalg.norm(along, axis=-1, keepdims=True)

    def project(self, point: Doubles) -> tuple[float, float, float]:
        """(x, y, pixels a unit of length) of a point (3,) before the camera."""
        if self.scale.camera is None:
            step = self.scale.mm_per_pixel or 1.0
            height, width = self.size
            return (width - 1) / 2 + float(point[0]) / step, (height - 1) / 2 - float(point[1]) / step, 1 / step
        K = self.scale.camera
        depth = float(self.distance or 1.0) - float(point[2])
        u, v = float(point[0]) / depth, -float(point[1]) / depth
        return K[0, 0] * u + K[0, 1] * v + K[0, 2], K[1, 1] * v + K[1, 2], float(max(K[0, 0], K[1, 1])) / depth

    def plane_points(self, x: NDArray[Any], y: NDArray[Any]) -> Doubles:
        """Where the rays through pixels meet the plane z = 0, (..., 3)."""
        origins, along = self.rays(x, y)
        points: Doubles = origins - along * (origins[..., 2:] / along[..., 2:])
        return points


@dataclass(frozen=True)
class Sphere:
    """A ball in the frame and unit of a View. centre: (3,). radius. reliable: share of its outline that is a circle."""

    centre: Doubles
    radius: float
    reliable: float = 1.0

    def window(self, view: View) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns (N, M) of a part of the picture that the ball lies in; empty where it lies outside."""
        x, y, unit = view.project(self.centre)
        reach = 1.5 * self.radius * unit + 2  # a ball away from the axis is drawn out, and its near side is nearer
        height, width = view.size
        (top, bottom), (left, right) = (
            (int(np.clip(at - reach, 0, side)), int(np.clip(at + reach + 1, 0, side))) for at, side in ((y, height), (x, width))
        )
        rows, columns = np.mgrid[top:bottom, left:right]
        return rows, columns

    def meet(self, view: View, x: NDArray[Any], y: NDArray[Any]) -> tuple[Doubles, Doubles, Doubles, NDArray[np.bool_]]:
        """Where the rays through pixels meet the ball.

        Returns points (..., 3), outward normals (..., 3), unit vectors to the camera (..., 3), and which rays meet it (...). The others'
        values are those of the nearest point of the ray.
        """
        origins, along = view.rays(x, y)
        to_centre = self.centre - origins
        middle = (to_centre * along).sum(-1)
        below = self.radius**2 - ((to_centre**2).sum(-1) - middle**2)
        points = origins + along * (middle - np.sqrt(np.maximum(below, 0)))[..., None]
        normals = (points - self.centre) / self.radius
        return points, normals, -along, below > 0


def reflected(normals: Doubles, toward: Doubles) -> Doubles:
    """The mirror directions 2 (n.v) n - v of unit vectors toward the camera, (..., 3)."""
    result: Doubles = 2 * (normals * toward).sum(-1, keepdims=True) * normals - toward
    return result
