"""The job: one view of one shape in one material under K lights, every value resolved. Lengths in millimetres.

A job is a JSON object:

    {"id": "a", "out": "/path/a.npz", "resolution": [W, H], "supersampling": 1,
     "camera": {"kind": "orthographic", "width": mm across W pixels, "distance": mm}
             | {"kind": "perspective", "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], "distance": mm},
     "shape": {"name": "cylinder", "parameters": {"radius": 20}},
     "pose": {"rotation": [[...], [...], [...]], "translation": [x, y, z]},
     "material": {"kind": "substrate", "diffuse": [r, g, b], "specular": [r, g, b], "alpha": a},
     "lights": [{"direction": [x, y, z], "intensity": [r, g, b]}]}

The camera sits at (0, 0, distance) and looks along -z, x right, y up: the world is the camera frame with its origin at the object's
middle. K is OpenCV's (y down, pixel centres at integers). Light directions point to the light; the intensity is the radiance of a
white Lambertian surface that faces it. "out" is needed by the worker only; "supersampling" and "pose" may be left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blender_scenes import shapes
from blender_scenes.errors import JobError

Numbers = NDArray[np.float64]

MAX_SIDE = 16384
"""The longest side of a render in sub-samples, supersampling included."""

MAX_SAMPLES = 1 << 25
"""The most sub-samples of a render; each takes some 150 bytes of memory."""

MAX_LIGHTS = 4096


@dataclass(frozen=True)
class Orthographic:
    """width: mm across the picture's W pixels. distance: mm from the camera to the origin."""

    width: float
    distance: float


@dataclass(frozen=True, eq=False)
class Perspective:
    """K: (3, 3) OpenCV intrinsics without skew. distance: mm from the camera to the origin."""

    K: Numbers
    distance: float


@dataclass(frozen=True, eq=False)
class Substrate:
    """diffuse, specular: (3,) Rd, Rs in [0, 1]. alpha: width of the Trowbridge-Reitz distribution."""

    diffuse: Numbers
    specular: Numbers
    alpha: float


@dataclass(frozen=True, eq=False)
class Sun:
    """direction: (3,) unit vector to the light. intensity: (3,) irradiance / pi."""

    direction: Numbers
    intensity: Numbers


@dataclass(frozen=True, eq=False)
class Job:
    """A job that has been checked. rotation: (3, 3) object to world, translation: (3,) mm."""

    width: int
    height: int
    camera: Orthographic | Perspective
    mesh: shapes.Mesh
    material: Substrate
    lights: tuple[Sun, ...]
    rotation: Numbers = field(default_factory=lambda: np.eye(3))
    translation: Numbers = field(default_factory=lambda: np.zeros(3))
    supersampling: int = 1
    out: str | None = None

    def posed_mesh(self) -> shapes.Mesh:
        """The mesh in the world. Posed here in double precision, so that Blender keeps it as it stands."""
        normals = None if self.mesh.normals is None else self.mesh.normals @ self.rotation.T
        return shapes.Mesh(self.mesh.vertices @ self.rotation.T + self.translation, self.mesh.faces, normals)


def parse(job: object) -> Job:
    """The checked job of a JSON object. Raises JobError, one line that names the entry, where anything in it is wrong."""
    entries = _Entries("job", job)
    resolution = entries.numbers("resolution", (2,), low=1, high=MAX_SIDE, whole=True)
    n = entries.number("supersampling", low=1, high=64, whole=True, default=1)
    if resolution.max() * n > MAX_SIDE or resolution.prod() * n**2 > MAX_SAMPLES:
        size = f"{resolution[0] * n:.0f}x{resolution[1] * n:.0f}"
        raise JobError(
            f"job: resolution times supersampling is {size}, more than {MAX_SAMPLES // 10**6} megapixels or {MAX_SIDE} a side"
        )
    pose = entries.entry("pose", default={})
    rotation = pose.numbers("rotation", (3, 3), default=np.eye(3))
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
        raise JobError("job: pose.rotation is not a rotation (orthonormal rows, determinant 1)")
    checked = Job(
        width=int(resolution[0]),
        height=int(resolution[1]),
        camera=_camera(entries.entry("camera")),
        mesh=_shape(entries.entry("shape")),
        material=_material(entries.entry("material")),
        lights=_lights(entries.value("lights")),
        rotation=rotation,
        translation=pose.numbers("translation", (3,), low=-1e6, high=1e6, default=np.zeros(3)),
        supersampling=int(n),
        out=entries.text("out", default=None),
    )
    pose.close()
    entries.text("id", default=None)
    entries.close()
    nearest = checked.camera.distance - float(checked.posed_mesh().vertices[:, 2].max())
    if nearest <= 1e-3 * checked.camera.distance:
        raise JobError(f"job: the shape reaches to {nearest:g} mm before the camera; increase camera.distance")
    return checked


def _camera(entries: _Entries) -> Orthographic | Perspective:
    kind = entries.text("kind")
    distance = entries.number("distance", low=1e-3, high=1e7)
    camera: Orthographic | Perspective
    if kind == "orthographic":
        camera = Orthographic(entries.number("width", low=1e-3, high=1e6), distance)
    elif kind == "perspective":
        K = entries.numbers("K", (3, 3))
        if K[0, 0] <= 0 or K[1, 1] <= 0 or K[0, 1] or K[1, 0] or K[2].tolist() != [0, 0, 1]:
            raise JobError("job: camera.K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths")
        camera = Perspective(K, distance)
    else:
        raise JobError(f"job: camera.kind {kind!r} is unknown; there are orthographic, perspective")
    entries.close()
    return camera


def _shape(entries: _Entries) -> shapes.Mesh:
    name = entries.text("name")
    values = entries.value("parameters", default={})
    entries.close()
    if not isinstance(values, Mapping):
        raise JobError("job: shape.parameters must be an object of names and numbers")
    try:
        return shapes.build(str(name), **{str(key): value for key, value in values.items()})
    except ValueError as error:
        raise JobError(f"job: {error}") from None


def _material(entries: _Entries) -> Substrate:
    kind = entries.text("kind")
    if kind != "substrate":
        raise JobError(f"job: material.kind {kind!r} is unknown; there is substrate")
    material = Substrate(
        diffuse=entries.numbers("diffuse", (3,), low=0, high=1),
        specular=entries.numbers("specular", (3,), low=0, high=1),
        alpha=entries.number("alpha", low=1e-3, high=10),
    )
    entries.close()
    return material


def _lights(lights: object) -> tuple[Sun, ...]:
    if not isinstance(lights, list) or not 0 < len(lights) <= MAX_LIGHTS:
        raise JobError(f"job: lights must be a list of 1 to {MAX_LIGHTS} lights")
    suns = []
    for k, light in enumerate(lights):
        entries = _Entries(f"job: lights[{k}]", light)
        direction = entries.numbers("direction", (3,))
        length = float(np.linalg.norm(direction))
        if not abs(length - 1) < 1e-3:
            raise JobError(f"job: lights[{k}].direction must be a unit vector, its length is {length:g}")
        suns.append(Sun(direction / length, entries.numbers("intensity", (3,), low=0, high=1e6)))
        entries.close()
    return tuple(suns)


_REQUIRED = object()


class _Entries:
    """The entries of one JSON object, taken one by one; `close` refuses what nobody took."""

    def __init__(self, where: str, given: object) -> None:
        if not isinstance(given, Mapping):
            raise JobError(f"{where} must be an object, got {_short(given)}")
        self.where = where
        self.given = given
        self.taken: set[str] = set()

    def _name(self, key: str) -> str:
        return f"{self.where}: {key}" if self.where == "job" else f"{self.where}.{key}"

    def value(self, key: str, default: Any = _REQUIRED) -> Any:
        self.taken.add(key)
        if key not in self.given and default is _REQUIRED:
            raise JobError(f"{self._name(key)} is missing")
        return self.given.get(key, default)

    def entry(self, key: str, default: Any = _REQUIRED) -> _Entries:
        return _Entries(self._name(key), self.value(key, default))

    def text(self, key: str, default: Any = _REQUIRED) -> Any:
        value = self.value(key, default)
        if value is not default and not isinstance(value, str):
            raise JobError(f"{self._name(key)} must be a text, got {_short(value)}")
        return value

    def number(
        self, key: str, low: float = -math.inf, high: float = math.inf, whole: bool = False, default: Any = _REQUIRED
    ) -> float:
        return float(self.numbers(key, (), low, high, whole, default))

    def numbers(
        self,
        key: str,
        shape: tuple[int, ...],
        low: float = -math.inf,
        high: float = math.inf,
        whole: bool = False,
        default: Any = _REQUIRED,
    ) -> Numbers:
        value = self.value(key, default)
        what = "a number" if shape == () else f"numbers of shape {'x'.join(map(str, shape))}"
        try:
            array = np.asarray(value)
            right = array.shape == shape and array.dtype.kind in "iuf" and bool(np.isfinite(array).all())
        except ValueError:
            right = False
        if not right:
            raise JobError(f"{self._name(key)} must be {what}, all finite, got {_short(value)}")
        if array.min() < low or array.max() > high:
            raise JobError(f"{self._name(key)} must be from {low:g} to {high:g}, got {_short(value)}")
        if whole and (array != np.round(array)).any():
            raise JobError(f"{self._name(key)} must be whole, got {_short(value)}")
        return array.astype(np.float64)

    def close(self) -> None:
        unknown = sorted(str(key) for key in self.given if key not in self.taken)
        if unknown:
            raise JobError(f"{self._name(unknown[0])} is unknown; there are {', '.join(sorted(self.taken))}")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
