"""Every reader of the project with a sound file to start from: what the fuzz tests of the suite and of `make soak` damage."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from gen.exr import write_exr
from gen.files import dumps, write_json
from gen.formats.render_folder import write_files
from tests.conftest import synthetic_capture
from tests.hostile.files import (
    LIGHTS,
    glb,
    jpeg,
    lay_photographs,
    obj,
    pack_bytes,
    ply,
    png,
    rows,
    safetensors,
    stl,
    tiff,
)

SPHERE = """\
name: ball
resolution: [16, 16]
shape: {name: sphere, radius: 10}
material: {kind: substrate, albedo: [0.8, 0.4, 0.2], specular: 0.5, alpha: 0.1}
lights: {pattern: ring, count: 4, tilt_degrees: 35, frontal: true}
camera: {kind: orthographic, width_mm: 30}
"""
SET = """\
set: small
seed: 3
groups:
  - name: one
    count: 2
    each: {material.alpha: [0.1, 0.2]}
    capture:
      resolution: [16, 16]
      shape: {name: sphere, radius: {uniform: [6, 10]}}
      material: {kind: substrate, alpha: 0.1}
      lights: {pattern: random, count: 2}
      camera: {kind: orthographic, width_mm: 30}
"""
BENCHMARK = """\
benchmark: small
seed: 1
captures: [{path: here, limit: 3}]
draws: {count: 2, lights: 3}
skip: {bear: [1, 20]}
gloss: [none, chromaticity]
normals: [least-squares]
"""
PHOTOS = """\
images: {glob: "*.png"}
lights: {directions: [[0, 0, 1], [0.5, 0, 0.9], [-0.5, 0, 0.9], [0, 0.5, 0.9], [0, -0.5, 0.9]]}
intensities: equal
mm_per_pixel: 0.1
"""


@dataclass(frozen=True)
class Reader:
    """A reader and what it reads.

    file: the name of the file that is damaged. lay: writes a sound folder that holds it. read: reads the folder; whatever the file holds,
    it returns or raises InputError. grammar: pieces that a fuzzer puts in, which random bytes would hardly hit upon.
    """

    file: str
    lay: Callable[[Path], None]
    read: Callable[[Path], object]
    grammar: tuple[bytes, ...] = ()


def _picture(name: str, data: Callable[[], bytes]) -> Reader:
    from gen.images import read_image

    return Reader(name, lambda folder: _put(folder / name, data()), lambda folder: read_image(folder / name))


def _put(path: Path, data: bytes | str) -> None:
    path.write_bytes(data.encode() if isinstance(data, str) else data)


def _text(name: str, content: str, read: Callable[[Path], object], grammar: tuple[bytes, ...] = ()) -> Reader:
    return Reader(name, lambda folder: _put(folder / name, content), lambda folder: read(folder / name), grammar)


def _photographs(name: str, content: bytes | str | None = None, grammar: tuple[bytes, ...] = ()) -> Reader:
    """A file beside the photographs of a plain capture. content: None where it is there anyway."""

    def lay(folder: Path) -> None:
        lay_photographs(folder)
        if content is not None:
            _put(folder / name, content)

    def read(folder: Path) -> object:
        from gen.capture import read_capture

        return read_capture(folder)

    return Reader(name, lay, read, grammar)


def _rendered(name: str, grammar: tuple[bytes, ...] = ()) -> Reader:
    def lay(folder: Path) -> None:
        write_files(synthetic_capture(size=8), folder)

    def read(folder: Path) -> object:
        from gen.capture import read_capture

        return read_capture(folder)

    return Reader(name, lay, read, grammar)


def _mesh(name: str, data: Callable[[], bytes], grammar: tuple[bytes, ...]) -> Reader:
    def read(folder: Path) -> object:
        from gen.meshes import load_mesh, mesh_file
        from recon.inspection.nominal import read_surface

        return read_surface(folder / name), load_mesh(mesh_file({"file": str(folder / name), "size_mm": 10}))

    return Reader(name, lambda folder: _put(folder / name, data()), read, grammar)


def _spec(path: Path) -> object:
    from gen.spec import read_spec

    return read_spec(path).pictures()


def _set_spec(path: Path) -> object:
    from gen.sets.plan import is_set, plan_of

    return is_set(path), plan_of(path, limit=2)


def _plan(path: Path) -> object:
    from gen.sets.plan import is_plan, read_plan

    return is_plan(path), [item.capture_spec() for item in read_plan(path).items]


def _plan_text() -> str:
    from gen.sets.plan import Item, Plan
    from gen.spec import spec_from
    from gen.strict_yaml import parse_yaml

    spec = spec_from({**parse_yaml(SPHERE, "sphere", "a spec"), "name": "one-000000"}, "sphere")
    return Plan("small", 3, "0" * 64, (Item("one-000000", "one", None, False, spec.plain()),)).text()


def _benchmark(path: Path) -> object:
    from recon.benchmark.spec import read_benchmark

    return read_benchmark(path)[0].combinations()


def _photo_spec(path: Path) -> object:
    from gen.photos.spec import read_photo_spec

    return read_photo_spec(path.parent)


def _config(path: Path) -> object:
    from learn.config import read_config

    return read_config(path)


def _config_text() -> str:
    from learn.config import FOLDER

    return (FOLDER / "smoke-lime.toml").read_text(encoding="utf-8")


def _pack(path: Path) -> object:
    from gen.sets.pack import read_pack

    pack = read_pack(path)
    return [pack["combined"][pack.frames(i)].sum() for i in range(len(pack.items))]


def _weights(path: Path) -> object:
    from learn.weights import load_weights

    return load_weights(path)


def _weights_bytes() -> bytes:
    from learn.weights import SHIPPED

    return (SHIPPED / "group.safetensors").read_bytes()


def _checkpoint(path: Path) -> object:
    from learn.checkpoint import read_state

    return read_state(path)


def _splits(path: Path) -> object:
    from gen.sets.set_folder import SetFolder
    from gen.sets.splits import read_splits

    return read_splits(SetFolder(path.parent))


def _cameras(path: Path) -> object:
    from recon.multiview.views import read_views

    return read_views(path.parent)


def _cameras_text() -> str:
    views = [{"capture": f"v{k}", "object_to_camera": np.eye(4).tolist()} for k in range(2)]
    return json.dumps({"format": "degloss views", "version": 1, "unit": "mm", "views": views})


def _measured(name: str) -> Reader:
    def lay(folder: Path) -> None:
        y, x = np.mgrid[:8, :8].astype(np.float32)
        write_json(folder / "metrics.json", {"height": {"unit": "m"}})
        write_exr(folder / "height.exr", {"points.X": x, "points.Y": -y, "points.Z": x * 0.1})
        write_exr(
            folder / "normal.exr", {"normal.X": 0 * x, "normal.Y": 0 * x, "normal.Z": 0 * x + 1, "uncertainty.V": 0 * x + 1}
        )

    def read(folder: Path) -> object:
        from recon.inspection.measured import read_measured

        return read_measured(folder)

    return Reader(name, lay, read)


def _index(name: str) -> Reader:
    """A file of a set that holds nothing yet but its head and one quarantined row."""
    from gen.sets.set_folder import COLUMNS, FORMAT, INDEX, SET, VERSION, row_text

    def lay(folder: Path) -> None:
        row = {"id": "one-000000", "group": "one", "single": True, "status": "quarantined", "error": "it broke"}
        row |= {"files": {}, "bytes": {}, "overexposed_pixels": []}
        write_json(folder / SET, {"format": FORMAT, "version": VERSION, "name": "small", "items": 1})
        _put(folder / INDEX, row_text(dict.fromkeys(COLUMNS) | row) + "\n")
        verdict = {"id": "one-000000", "frame": 1, "kept": False, "reason": "not rendered"}
        _put(folder / "screening.jsonl", json.dumps(verdict | {"overexposed_pixels": 0, "clipped_samples": 0}) + "\n")

    def read(folder: Path) -> object:
        from gen.sets.screening import screening_of
        from gen.sets.set_folder import SetFolder

        return screening_of(SetFolder(folder))

    return Reader(name, lay, read, JSON)


def _array(name: str) -> bytes:
    normals = np.zeros((6, 8, 3))
    normals[..., 2] = 1
    memory = io.BytesIO()
    if name.endswith(".mat"):
        from scipy.io import savemat

        savemat(memory, {"Normal_gt": normals}, do_compression=True)
    elif name.endswith(".npz"):
        np.savez_compressed(memory, normal=normals)
    else:
        np.save(memory, normals)
    return memory.getvalue()


def _depth() -> bytes:
    memory = io.BytesIO()
    np.savez_compressed(memory, depth=np.full((6, 8), 500.0))
    return memory.getvalue()


NUMBERS = (
    b"nan",
    b"-inf",
    b"1e400",
    b"-0",
    b"9" * 5000,
    b"0x1p3",
    b"\n",
    b" ",
    b";",
    b"#",
    b"\xef\xbb\xbf",
    b"1_0",
    "٣".encode(),
)
YAML = (
    b"&a ",
    b"*a",
    b"!!python/object:os.system ",
    b"!!timestamp x",
    b"!!binary x",
    b"!!float ",
    b"!!int x",
    b"!!set ",
    b"!!omap ",
    b"<<: ",
    b"? ",
    b"- ",
    b": ",
    b"{",
    b"}",
    b"[",
    b"]",
    b"|\n",
    b">\n",
    b"'",
    b'"',
    b"%YAML 1.1\n---\n",
    b"---\n",
    b"...\n",
    b".nan",
    b".inf",
    b"1e400",
    b"9" * 5000,
    b"2001-01-01",
    b"null",
    b"true",
    b"~",
    b"\t",
    b"\xef\xbb\xbf",
    b"\x85",
    b"\\x",
)
JSON = (
    b"NaN",
    b"Infinity",
    b"1e400",
    b"9" * 5000,
    b"[" * 2000,
    b'{"a":' * 2000,
    b"null",
    b"true",
    b"-1",
    b"1.5",
    b'"\\ud800"',
    b'"../x"',
    b'"/etc/passwd"',
    b'""',
    b"[]",
    b"{}",
    b'"\\u0000"',
    b"9007199254740993",
    b'"a":1,"a":2',
)
TOML = (
    b"[train]\n",
    b"[" * 500,
    b"a.b.c=1\n",
    b"nan",
    b"inf",
    b"9" * 5000,
    b"1979-05-27",
    b'"""',
    b"'''",
    b"[[x]]\n",
    b"\\U00110000",
)
PLY = (
    b"element vertex 9_999_999_999\n",
    b"element face +4000000000\n",
    b"property list uchar int vertex_indices\n",
    b"property double x\n",
    b"format ascii 1.0\n",
    b"format binary_little_endian 1.0\n",
    b"end_header\n",
    b"-1",
    b"nan",
    b"\xff\xff\xff\xff",
    b"comment unit mm\n",
)
OBJ = (
    b"f 1 2 3\n",
    b"f 1//1 2//2 9//9\n",
    b"f -1 -2 -3\n",
    b"v nan 0 0\n",
    b"vn 0 0 0\n",
    b"usemtl x\n",
    b"mtllib /etc/passwd\n",
    b"g a\n",
    b"o b\n",
)

READERS: Mapping[str, Reader] = MappingProxyType(
    {
        "png": _picture("picture.png", png),
        "jpeg": _picture("picture.jpg", jpeg),
        "tiff": _picture("picture.tif", tiff),
        "tiff-lzw": _picture("picture.tif", lambda: tiff("lzw")),
        "exr": Reader(
            "1.exr", lambda folder: write_exr(folder / "1.exr", {c: np.ones((6, 8)) for c in "RGB"}), lambda folder: _exr(folder)
        ),
        "mask": _photographs("mask.png"),
        "lights": _photographs("lights.txt", None, NUMBERS),
        "named-lights": _photographs(
            "lights.txt", "".join(f"{k + 1}.png {row}\n" for k, row in enumerate(rows(LIGHTS).splitlines())), NUMBERS
        ),
        "intensities": _photographs("intensities.txt", "1 1 1\n" * 5, NUMBERS),
        "scale": _photographs("scale.txt", "mm_per_pixel 0.1\n", NUMBERS),
        "camera": _photographs("K.txt", "100 0 4\n0 100 3\n0 0 1\n", NUMBERS),
        "rti": _photographs(
            "dirs.lp", "5\n" + "".join(f"{k + 1}.png {row}\n" for k, row in enumerate(rows(LIGHTS).splitlines())), NUMBERS
        ),
        "true-normals-npz": _photographs("normal_gt.npz", _array("a.npz")),
        "true-normals-npy": _photographs("normal_gt.npy", _array("a.npy")),
        "true-normals-mat": _photographs("Normal_gt.mat", _array("a.mat")),
        "true-normals-txt": _photographs("normal.txt", "0 0 1\n" * 48, NUMBERS),
        "true-depth": _photographs("depth_gt.npz", _depth()),
        "capture.json": _rendered("capture.json", JSON),
        "frame": _rendered("frames/001.exr"),
        "view": _rendered("view.exr"),
        "capture.yaml": _text("capture.yaml", PHOTOS, _photo_spec, YAML),
        "capture-spec": _text("spec.yaml", SPHERE, _spec, YAML),
        "set-spec": _text("set.yaml", SET, _set_spec, YAML),
        "benchmark-spec": _text("bench.yaml", BENCHMARK, _benchmark, YAML),
        "config": _text("config.toml", _config_text(), _config, TOML),
        "plan": _text("plan.jsonl", _plan_text(), _plan, JSON),
        "set": _index("set.json"),
        "index": _index("index.jsonl"),
        "screening": _index("screening.jsonl"),
        "splits": _text("splits.json", dumps({"splits": {"train": ["a"], "test": []}}), _splits, JSON),
        "pack": Reader(
            "a.safetensors",
            lambda folder: _put(folder / "a.safetensors", pack_bytes()),
            lambda folder: _pack(folder / "a.safetensors"),
            JSON,
        ),
        "weights": Reader(
            "a.safetensors",
            lambda folder: _put(folder / "a.safetensors", _weights_bytes()),
            lambda folder: _weights(folder / "a.safetensors"),
            JSON,
        ),
        "checkpoint": Reader(
            "a.safetensors",
            lambda folder: _put(
                folder / "a.safetensors",
                safetensors(
                    {"network.w": np.ones(3, np.float32)}, {"format": "degloss checkpoint", "version": "1", "state": "{}"}
                ),
            ),
            lambda folder: _checkpoint(folder / "a.safetensors"),
            JSON,
        ),
        "cameras": _text("cameras.json", _cameras_text(), _cameras, JSON),
        "glb": _mesh("part.glb", glb, JSON),
        "obj": _mesh("part.obj", obj, OBJ),
        "stl": _mesh("part.stl", stl, ()),
        "stl-text": _mesh(
            "part.stl", lambda: stl("ascii"), (b"endfacet\n", b"vertex nan 0 0\n", b"solid\n", b"facet normal 0 0 0\n")
        ),
        "ply": _mesh("part.ply", ply, PLY),
        "ply-text": _mesh("part.ply", lambda: ply("ascii"), PLY),
        "measurement": _measured("metrics.json"),
        "measured-heights": _measured("height.exr"),
    }
)


def _exr(folder: Path) -> object:
    from gen.images import read_image

    return read_image(folder / "1.exr")
