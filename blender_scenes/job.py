"""The job: one view of one shape in one material under K lights, every value resolved. Lengths in millimetres.

A job is a JSON object:

    {"id": "a", "out": "/path/a.npz", "resolution": [W, H], "supersampling": 1,
     "camera": {"kind": "orthographic", "width": mm across W pixels, "distance": mm}
             | {"kind": "perspective", "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], "distance": mm},
     "shape": {"name": "cylinder", "parameters": {"radius": 20}, "detail": [{"kind": "grooves", "pitch": 0.8}]} | {"file": "/path/b.npz"},
     "pose": {"rotation": [[...], [...], [...]], "translation": [x, y, z]},
     "material": {"kind": "substrate", "diffuse": [r, g, b], "specular": [r, g, b], "alpha": a},
     "lights": [{"kind": "sun", "direction": [x, y, z], "intensity": [r, g, b]}],
     "samples": 1, "bounces": 0, "seed": 0, "layers": ["combined", "diffuse", "specular", "matte"], "crop": false,
     "together": false}

The camera sits at (0, 0, distance) and looks along -z, x right, y up: the world is the camera frame with its origin at the object's
middle. K is OpenCV's (y down, pixel centres at integers). There is one entry of "lights" a picture: a light (see `blender_scenes.light`),
or a list of those that shine at once. Materials are those of `blender_scenes.materials`. "samples" of every sub-sample are drawn where
light comes from many directions (area, environment, ambient, bounces), by "seed"; suns and point lights need one. "bounces" is how often
light may pass from surface to surface. "layers": see `blender_scenes.shot`. "crop": only the box of pixels that holds the object is
rendered and handed back. "together": lights of a convex object may share a render (`blender_scenes.shot`). "shape": by name, or the arrays
of a file (see `blender_scenes.mesh_file`), either with or without "detail" (see `blender_scenes.shapes.detail`). "out" is needed by the
worker only; "supersampling", "pose" and the last two lines' entries may be left out.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from blender_scenes import shapes
from blender_scenes.entries import Entries, Numbers
from blender_scenes.errors import JobError
from blender_scenes.light import Light, Point, Sun, parse_light
from blender_scenes.materials import Material, Stand
from blender_scenes.materials import parse as parse_material
from blender_scenes.mesh_file import read_mesh
from blender_scenes.shapes.detail import add_detail, checked_details

MAX_SIDE = 16384
"""The longest side of a render in sub-samples, supersampling included."""

MAX_SAMPLES = 1 << 25
"""The most sub-samples of a render; each takes some 150 bytes of memory."""

MAX_LIGHTS = 4096

LAYERS = ("combined", "diffuse", "specular", "matte", "lit", "ks0", "mirror")
"""What a job may ask for of each picture; see `blender_scenes.shot`."""


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
class Job:
    """A job that has been checked. rotation: (3, 3) object to world, translation: (3,) mm. solid: whether the mesh is convex by name."""

    width: int
    height: int
    camera: Orthographic | Perspective
    mesh: shapes.Mesh
    material: Material
    lights: tuple[tuple[Light, ...], ...]
    rotation: Numbers = field(default_factory=lambda: np.eye(3))
    translation: Numbers = field(default_factory=lambda: np.zeros(3))
    supersampling: int = 1
    samples: int = 1
    bounces: int = 0
    seed: int = 0
    layers: tuple[str, ...] = LAYERS[:4]
    crop: bool = False
    together: bool = False
    solid: bool = False
    out: str | None = None

    @cached_property
    def convex(self) -> bool:
        """Whether the object is convex, so that it casts no shadow on itself."""
        return self.solid or self.mesh.is_convex()

    @property
    def stand(self) -> Stand:
        """How the object stands before the camera."""
        return Stand((0.0, 0.0, 1.0) if isinstance(self.camera, Orthographic) else None, self.rotation, self.translation)

    @cached_property
    def posed_mesh(self) -> shapes.Mesh:
        """The mesh in the world. Posed here in double precision, so that Blender keeps it as it stands."""
        normals = None if self.mesh.normals is None else self.mesh.normals @ self.rotation.T
        return shapes.Mesh(self.mesh.vertices @ self.rotation.T + self.translation, self.mesh.faces, normals)


def parse(job: object) -> Job:
    """The checked job of a JSON object. Raises JobError, one line that names the entry, where anything in it is wrong."""
    entries = Entries("job", job)
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
    mesh, solid = _shape(entries.entry("shape"))
    checked = Job(
        width=int(resolution[0]),
        height=int(resolution[1]),
        camera=_camera(entries.entry("camera")),
        mesh=mesh,
        solid=solid,
        material=parse_material(entries.entry("material")),
        lights=_lights(entries.value("lights")),
        rotation=rotation,
        translation=pose.numbers("translation", (3,), low=-1e6, high=1e6, default=np.zeros(3)),
        supersampling=int(n),
        samples=int(entries.number("samples", low=1, high=1 << 16, whole=True, default=1)),
        bounces=int(entries.number("bounces", low=0, high=64, whole=True, default=0)),
        seed=int(entries.number("seed", low=0, high=2**31 - 1, whole=True, default=0)),
        layers=_layers(entries.value("layers", default=LAYERS[:4])),
        crop=entries.flag("crop", default=False),
        together=entries.flag("together", default=False),
        out=entries.text("out", default=None),
    )
    pose.close()
    entries.text("id", default=None)
    entries.close()
    _check_light(checked)
    nearest = checked.camera.distance - float(checked.posed_mesh.vertices[:, 2].max())
    if nearest <= 1e-3 * checked.camera.distance:
        raise JobError(f"job: the shape reaches to {nearest:g} mm before the camera; increase camera.distance")
    return checked


def _camera(entries: Entries) -> Orthographic | Perspective:
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


def _shape(entries: Entries) -> tuple[shapes.Mesh, bool]:
    """The mesh, and whether its shape is convex by its name."""
    detail = entries.value("detail", default=[])
    file = entries.text("file", default=None)
    if file is not None:
        entries.close()
        mesh = read_mesh(file)
        return (_detailed(mesh, detail) if detail != [] else mesh), False
    name = entries.text("name")
    values = entries.value("parameters", default={})
    entries.close()
    if not isinstance(values, Mapping):
        raise JobError("job: shape.parameters must be an object of names and numbers")
    try:
        mesh = shapes.build(str(name), **{str(key): value for key, value in values.items()})
    except ValueError as error:
        raise JobError(f"job: {error}") from None
    return (_detailed(mesh, detail) if detail != [] else mesh), name in shapes.CONVEX and detail == []


_latest: list[tuple[str, shapes.Mesh]] = []
"""The mesh with detail that was made last, and what it was made from: jobs of one capture follow each other."""


def _detailed(mesh: shapes.Mesh, detail: object) -> shapes.Mesh:
    try:
        details = checked_details(detail)
        key = hashlib.sha256(json.dumps(details, sort_keys=True).encode())
        for array in (mesh.vertices, mesh.faces, mesh.normals):
            key.update(b"" if array is None else array.tobytes())
        if not _latest or _latest[0][0] != key.hexdigest():
            _latest[:] = [(key.hexdigest(), add_detail(mesh, details))]
    except ValueError as error:
        raise JobError(f"job: shape.{error}") from None
    return _latest[0][1]


def _lights(given: object) -> tuple[tuple[Light, ...], ...]:
    if not isinstance(given, list) or not 0 < len(given) <= MAX_LIGHTS:
        raise JobError(f"job: lights must be a list of 1 to {MAX_LIGHTS} pictures' lights")
    pictures = []
    for k, picture in enumerate(given):
        if isinstance(picture, list):
            if not 0 < len(picture) <= MAX_LIGHTS:
                raise JobError(f"job: lights[{k}] must hold 1 to {MAX_LIGHTS} lights")
            pictures.append(tuple(parse_light(Entries(f"job: lights[{k}][{i}]", light)) for i, light in enumerate(picture)))
        else:
            pictures.append((parse_light(Entries(f"job: lights[{k}]", picture)),))
    return tuple(pictures)


def _layers(given: object) -> tuple[str, ...]:
    if not isinstance(given, list | tuple) or not given or any(name not in LAYERS for name in given):
        raise JobError(f"job: layers must be a list of some of {', '.join(LAYERS)}")
    return tuple(name for name in LAYERS if name in given)


def _check_light(job: Job) -> None:
    """That the material can be rendered under these lights."""
    if not job.material.one_light:
        return
    for k, picture in enumerate(job.lights):
        for light in picture:
            if not isinstance(light, Sun | Point):
                raise JobError(
                    f"job: lights[{k}]: the material holds under suns and point lights only, not under {type(light).__name__.lower()} light"
                )
    if job.bounces:
        raise JobError("job: bounces: the material holds for direct light only; take approximate-substrate for interreflection")
