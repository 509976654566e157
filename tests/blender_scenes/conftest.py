"""Jobs, workers and closed-form surfaces for the tests on real renders."""

from __future__ import annotations

import importlib.util
import json
import os
import select
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from blender_scenes.shapes import Mesh, build

ROOT = Path(__file__).resolve().parents[2]

LIGHTS = np.array([[0.6, 0, 0.8], [0, 0.6, 0.8], [-0.48, 0.64, 0.6], [0.8, -0.6, 0], [0, 0, 1]])
"""Light from the right, from above, from the upper left, level with the picture, and from the camera."""


def need_bpy() -> None:
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy is not installed: pip install '.[render]'")


def run_python(code: str, *arguments: str) -> str:
    """Run `code` in a Python that may import bpy, and return what it wrote into the file named by its first argument."""
    need_bpy()
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stderr


class Client:
    """A worker of blender_scenes and both ends of its protocol."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder = folder
        jobs_out, self.jobs = os.pipe()
        self.replies, replies_in = os.pipe()
        fds = (jobs_out, replies_in)
        command = [sys.executable, "-m", "blender_scenes", "--worker", "--in", str(jobs_out), "--out", str(replies_in)]
        self.process = subprocess.Popen(
            [*command, "--threads", "2", *arguments], cwd=ROOT, pass_fds=fds, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for fd in fds:
            os.close(fd)
        self._rest = b""
        self.ready = self.reply(60)

    def send(self, line: str) -> None:
        os.write(self.jobs, (line + "\n").encode())

    def reply(self, timeout: float = 60) -> dict[str, Any]:
        while b"\n" not in self._rest:
            assert select.select([self.replies], [], [], timeout)[0], "the worker is silent"
            chunk = os.read(self.replies, 65536)
            assert chunk, "the worker is gone"
            self._rest += chunk
        line, self._rest = self._rest.split(b"\n", 1)
        answer: dict[str, Any] = json.loads(line)
        return answer

    def ask(self, job: dict[str, Any]) -> dict[str, Any]:
        self.send(json.dumps(job))
        return self.reply()

    def render(self, job: dict[str, Any]) -> dict[str, np.ndarray]:
        """The layers of a job."""
        out = self.folder / f"{uuid.uuid4().hex}.npz"
        answer = self.ask({**job, "id": out.stem, "out": str(out)})
        assert answer["ok"], answer
        assert answer["id"] == out.stem
        with np.load(out) as file:
            layers = dict(file)
        out.unlink()
        return layers

    def close(self) -> int:
        os.close(self.jobs)
        try:
            return self.process.wait(20)
        finally:
            if self.process.poll() is None:
                self.process.kill()
                self.process.wait()
            os.close(self.replies)


@pytest.fixture(scope="session")
def start(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Client]:
    """A function that starts another worker; the caller closes it."""
    need_bpy()
    return lambda *arguments: Client(tmp_path_factory.mktemp("worker"), *arguments)


@pytest.fixture(scope="session")
def worker(start: Callable[..., Client]) -> Iterator[Client]:
    """The worker that most tests share."""
    client = start()
    yield client
    assert client.close() == 0


def turned(x: float, z: float) -> np.ndarray:
    """The rotation by x degrees about x after z degrees about z."""
    a, c = np.radians([x, z])
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return about_x @ about_z


def make_job(
    shape: str, camera: str, /, size: tuple[int, int] = (80, 64), alpha: float = 0.2, n: int = 1, **changes: Any
) -> dict[str, Any]:
    """A job with a tilted shape off the middle, coloured light and colours; the perspective K has unequal focal lengths off-centre."""
    width, height = size
    cameras = {
        "orthographic": {"kind": "orthographic", "width": 88.0, "distance": 200.0},
        "perspective": {
            "kind": "perspective",
            "K": [[2.4 * width, 0, 0.46 * width], [0, 2.2 * width, 0.56 * height], [0, 0, 1]],
            "distance": 200.0,
        },
    }
    job = {
        "id": "a",
        "resolution": [width, height],
        "supersampling": n,
        "camera": cameras[camera],
        "shape": {"name": shape, "parameters": {}},
        "pose": {"rotation": turned(20, 35).tolist(), "translation": [1.5, -2.0, 3.0]},
        "material": {"kind": "substrate", "diffuse": [0.5, 0.4, 0.0], "specular": [0.2, 0.05, 0.4], "alpha": alpha},
        "lights": [{"direction": light.tolist(), "intensity": [1.0, 2.0, 0.5]} for light in LIGHTS],
    }
    return {**job, **changes}


@pytest.fixture(scope="session")
def job() -> Callable[..., dict[str, Any]]:
    """`make_job`."""
    return make_job


def rays(job: dict[str, Any], dx: float = 0.0, dy: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (H, W, 3), z component of the direction -1, of the rays through (dx, dy) pixels off the pixel centres."""
    width, height = job["resolution"]
    y, x = np.mgrid[:height, :width].astype(float)
    x, y = x + dx, y + dy
    camera = job["camera"]
    if camera["kind"] == "orthographic":
        mm = camera["width"] / width
        origin = np.stack([(x + 0.5 - width / 2) * mm, (height / 2 - y - 0.5) * mm, np.full_like(x, camera["distance"])], -1)
        return origin, np.broadcast_to([0.0, 0.0, -1.0], origin.shape)
    K = np.array(camera["K"])
    direction = np.stack([(x - K[0, 2]) / K[0, 0], -(y - K[1, 2]) / K[1, 1], -np.ones_like(x)], -1)
    return np.broadcast_to([0.0, 0.0, camera["distance"]], direction.shape), direction


@pytest.fixture(scope="session")
def pixel_rays() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """`rays`."""
    return rays


def meet_sphere(origin: np.ndarray, direction: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Parameter of the first meeting along each ray (inf where none) and the outward normal there, in the sphere's frame."""
    a, b, c = (direction**2).sum(-1), (origin * direction).sum(-1), (origin**2).sum(-1) - radius**2
    inside = b * b - a * c
    t = np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
    return t, (origin + np.where(np.isfinite(t), t, 0)[..., None] * direction) / radius


def meet_cylinder(origin: np.ndarray, direction: np.ndarray, radius: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """The same for a closed cylinder about y."""
    flat = np.array([1.0, 0.0, 1.0])
    t, normal = meet_sphere(origin * flat, direction * flat, radius)
    height = origin[..., 1] + np.where(np.isfinite(t), t, 0) * direction[..., 1]
    t = np.where(abs(height) <= length / 2, t, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for side in (-1.0, 1.0):
            s = (side * length / 2 - origin[..., 1]) / direction[..., 1]
            point = origin + np.where(np.isfinite(s), s, 0)[..., None] * direction
            nearer = ((point * flat) ** 2).sum(-1) <= radius**2
            nearer &= np.isfinite(s) & (s < t) & (side * direction[..., 1] < 0)
            t = np.where(nearer, s, t)
            normal = np.where(nearer[..., None], [0.0, side, 0.0], normal)
    return t, normal


SURFACES: dict[str, Callable[..., tuple[np.ndarray, np.ndarray]]] = {"sphere": meet_sphere, "cylinder": meet_cylinder}
DEFAULTS = {"sphere": {"radius": 25.0}, "cylinder": {"radius": 20.0, "length": 50.0}}


def meet(job: dict[str, Any], dx: float = 0.0, dy: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The job's shape in closed form at each pixel: whether it is met, unit normal, depth, and the unit vector to the camera."""
    origin, direction = rays(job, dx, dy)
    rotation, shift = np.array(job["pose"]["rotation"]), np.array(job["pose"]["translation"])
    name = job["shape"]["name"]
    t, normal = SURFACES[name](
        (origin - shift) @ rotation, direction @ rotation, **{**DEFAULTS[name], **job["shape"]["parameters"]}
    )
    view = -direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    met = np.isfinite(t)
    return met, np.where(met[..., None], normal @ rotation.T, 0), np.where(met, t, np.nan), view


@pytest.fixture(scope="session")
def closed_form() -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """`meet`, for the shapes in SURFACES."""
    return meet


def spans(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every whole number from low to high of each interval, with the interval's index."""
    count = (high - low + 1).clip(0).astype(int)
    which = np.repeat(np.arange(len(count)), count)
    return which, low.astype(int)[which] + np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)


def rasterise(
    points: np.ndarray, depth: np.ndarray, mesh: Mesh, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nearest triangle at each pixel, in plain numpy: whether there is one, its interpolated normal, and its depth.

    points: (V, 2) column and row of each vertex. depth: (V,). Straight interpolation in the picture, as in a parallel projection.
    """
    width, height = size
    corners = points[mesh.faces]
    # Row by row, from the leftmost to the rightmost meeting with an edge: long thin facets have large boxes and few pixels.
    which, y = spans(np.ceil(corners[..., 1].min(axis=1)).clip(0), np.floor(corners[..., 1].max(axis=1)).clip(None, height - 1))
    start, stop = corners[which], np.roll(corners[which], -1, axis=1)
    rise = stop[..., 1] - start[..., 1]
    t = (y[:, None] - start[..., 1]) / np.where(rise == 0, np.inf, rise)
    crossed = (t >= 0) & (t <= 1) & (rise != 0)
    x = start[..., 0] + t * (stop[..., 0] - start[..., 0])
    left, right = np.where(crossed, x, np.inf).min(axis=1), np.where(crossed, x, -np.inf).max(axis=1)
    left, right = np.where(crossed.any(axis=1), left, 1), np.where(crossed.any(axis=1), right, 0)
    row, x = spans(np.ceil(left).clip(0), np.floor(right).clip(None, width - 1))
    which, y = which[row], y[row]
    a, b, c = corners[which].transpose(1, 2, 0)

    def twice(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return (p[0] - x) * (q[1] - y) - (p[1] - y) * (q[0] - x)

    weights = np.stack([twice(b, c), twice(c, a), twice(a, b)], axis=1)
    area = weights.sum(axis=1)
    inside = (abs(area) > 1e-12) & ((weights * np.sign(area)[:, None]) >= 0).all(axis=1)
    which, x, y, weights = which[inside], x[inside], y[inside], weights[inside] / area[inside, None]
    far = (weights * depth[mesh.faces[which]]).sum(axis=1)
    nearest = np.lexsort([far, y * width + x])
    _, first = np.unique((y * width + x)[nearest], return_index=True)
    pick = nearest[first]
    met, normal, found = np.zeros((height, width), bool), np.zeros((height, width, 3)), np.full((height, width), np.nan)
    at = y[pick], x[pick]
    met[at], found[at] = True, far[pick]
    blend = (weights[pick][..., None] * mesh.normals[mesh.faces[which[pick]]]).sum(axis=1)
    normal[at] = blend / np.linalg.norm(blend, axis=1, keepdims=True)
    return met, normal, found


def posed(job: dict[str, Any]) -> Mesh:
    """The job's mesh in the camera's frame."""
    rotation, shift = np.array(job["pose"]["rotation"]), np.array(job["pose"]["translation"])
    mesh = build(job["shape"]["name"], **job["shape"]["parameters"])
    return Mesh(mesh.vertices @ rotation.T + shift, mesh.faces, mesh.normals @ rotation.T)


def draw(job: dict[str, Any], mesh: Mesh, dx: float, dy: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`rasterise` of a posed mesh under the job's parallel camera, (dx, dy) pixels off the pixel centres."""
    width, height = job["resolution"]
    mm = job["camera"]["width"] / width
    x, y = mesh.vertices[:, 0] / mm + width / 2 - 0.5 - dx, height / 2 - 0.5 - mesh.vertices[:, 1] / mm - dy
    return rasterise(np.stack([x, y], axis=1), job["camera"]["distance"] - mesh.vertices[:, 2], mesh, (width, height))


def occlusion(mesh: Mesh, points: np.ndarray, light: np.ndarray, margin: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Which points (N, 3) are surely shadowed and which surely lit under a distant light, from the mesh as the light sees it.

    Sure where all nine cells around a point in a map of 400 x 400 agree by `margin` mm.
    """
    across = np.cross(light, [0.3, 0.9, 0.2])
    frame = np.stack([across, np.cross(light, across), light]) / np.array([[np.linalg.norm(across)]] * 2 + [[1.0]])
    seen, asked = mesh.vertices @ frame.T, points @ frame.T
    low, cells = seen[:, :2].min(axis=0), 400
    step = np.ptp(seen[:, :2], axis=0).max() / (cells - 5)
    _, _, far = rasterise((seen[:, :2] - low) / step + 2, -seen[:, 2], mesh, (cells, cells))
    far = np.where(np.isnan(far), np.inf, far)
    column, row = np.rint((asked[:, :2] - low) / step + 2).astype(int).T.clip(1, cells - 2)
    around = np.stack([far[row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    return (around < -asked[:, 2] - margin).all(axis=0), (around > -asked[:, 2] - margin).all(axis=0)


@pytest.fixture(scope="session")
def oracle() -> SimpleNamespace:
    """`posed`, `draw` and `occlusion`: what a mesh looks like, without Blender."""
    return SimpleNamespace(posed=posed, draw=draw, occlusion=occlusion)


@pytest.fixture(scope="session")
def python() -> Callable[..., str]:
    """`run_python`."""
    return run_python
