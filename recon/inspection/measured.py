"""What was measured: the folder that `degloss recon run` writes, or a mesh that is seen from its +z side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError
from gen.exr import read_exr, stack
from gen.files import read_json
from recon.inspection.nominal import Surface, read_surface
from recon.inspection.pose import Pose
from recon.inspection.view import View, seen, view_of

if TYPE_CHECKING:
    from recon.reconstruct import Shape

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Bools = NDArray[np.bool_]

LARGEST_GRID = 1024
"""Pixels along the longer side of the grid that a mesh is sampled on, at most."""


@dataclass(frozen=True, eq=False)
class Measured:
    """A measured surface on the pixels of its view, camera frame.

    points: (H, W, 3) in `unit` ("mm" or "px"), NaN where there is none. normal: (H, W, 3) unit, zero there. known: (H, W), both are there.
    uncertainty: (H, W) one standard deviation of the normal's angle in degrees, NaN where unknown. source: where it came from.
    """

    points: Doubles
    normal: Doubles
    uncertainty: Doubles
    known: Bools
    unit: str
    view: View
    source: str


def measured_from(
    points: NDArray[Any], normal: NDArray[Any], uncertainty: NDArray[Any], unit: str, source: str = "memory"
) -> Measured:
    """`Measured` from maps in the unit of a measurement ("m" or "px"). Raises InputError where they do not fit together."""
    if points.shape != normal.shape or points.ndim != 3 or points.shape[2] != 3 or uncertainty.shape != points.shape[:2]:
        raise InputError(
            f"{source}: points {points.shape}, normals {normal.shape} and uncertainty {uncertainty.shape} do not fit"
        )
    if unit not in ("m", "px"):
        raise InputError(f"{source}: its heights are in {unit!r}, they must be in m or px")
    known = np.isfinite(points).all(axis=2) & np.isfinite(normal).all(axis=2) & (np.linalg.norm(normal, axis=2) > 0.5)
    place = np.where(known[..., None], points.astype(np.float64) * (1e3 if unit == "m" else 1.0), np.nan)
    n = np.where(known[..., None], normal, 0).astype(np.float64)
    n /= np.maximum(np.linalg.norm(n, axis=2, keepdims=True), 1e-12)
    sigma = np.where(known & (uncertainty >= 0), uncertainty, np.nan).astype(np.float64)
    return Measured(place, n, sigma, known, "mm" if unit == "m" else "px", view_of(place, source), source)


def of_shape(shape: Shape) -> Measured:
    """`Measured` of a measurement in memory."""
    normals, height = shape.normals, shape.height
    return measured_from(height.points, normals.normal, normals.uncertainty, height.unit, shape.capture.source)


def read_measured(path: str | Path, unit: str | None = None, uncertainty: float | None = None) -> Measured:
    """The measurement in a folder of `degloss recon run`, or a mesh file (GLB, STL, OBJ, PLY) in the camera's frame.

    unit: of a mesh's numbers (see `recon.inspection.nominal`). uncertainty: of the normals, one standard deviation in degrees, in place of
    what the measurement states; a mesh states none. Raises InputError where nothing can be read.
    """
    if uncertainty is not None and not 0 < uncertainty <= 45:
        raise InputError(f"--uncertainty {uncertainty:g}: must be above 0 and at most 45 degrees")
    path = Path(path)
    measured = _folder(path) if path.is_dir() else _mesh(read_surface(path, unit), path)
    if uncertainty is None:
        return measured
    stated = np.where(measured.known, uncertainty, np.nan)
    return Measured(**{**vars(measured), "uncertainty": stated})


def _folder(path: Path) -> Measured:
    metrics = read_json(path / "metrics.json", "of a measurement that degloss recon run wrote")
    height = metrics.get("height") if isinstance(metrics, Mapping) else None
    unit = height.get("unit") if isinstance(height, Mapping) else None
    heights, normals = read_exr(path / "height.exr"), read_exr(path / "normal.exr")
    points, normal = stack(heights, "points", "XYZ"), stack(normals, "normal", "XYZ")
    if points is None or normal is None or not isinstance(unit, str):
        raise InputError(
            f"{path}: is no measurement of degloss recon run (height.exr, normal.exr or metrics.json lack what it writes)"
        )
    nothing = np.full(points.shape[:2], np.nan, np.float32)
    return measured_from(points, normal, normals.get("uncertainty.V", nothing), unit, str(path))


def _mesh(surface: Surface, path: Path) -> Measured:
    """A mesh on a pixel grid of its own fineness, seen along -z."""
    corners = surface.vertices[surface.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    width, height = float(high[0] - low[0]), float(high[1] - low[1])
    longer = max(width, height)
    if not longer > 0:
        raise InputError(f"{path}: has no extent across the view (x and y)")
    step = max(float(np.median(sides.min(axis=1))), longer / LARGEST_GRID)
    size = (int(height / step) + 5, int(width / step) + 5)
    # The grid stands on the mesh's own corner, so that a mesh of a height map is met at its own points.
    view = View(size, (2 - low[0] / step, 2 + high[1] / step), step)
    there = seen(surface, Pose(), view)
    unit = "px" if surface.unit.startswith("px") else "mm"
    known = there.inside & (there.cosine > 0.02)
    if known.sum() < 16:
        raise InputError(f"{path}: shows hardly a pixel along z; a measured mesh must face the viewer (+z)")
    points = np.where(known[..., None], there.points, np.nan)
    return Measured(points, there.normal * known[..., None], np.full(size, np.nan), known, unit, view, str(path))
