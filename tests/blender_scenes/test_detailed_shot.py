"""Real renders of a detailed cylinder and of a user's mesh against the reference BRDF and a rasteriser in numpy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_scenes.job import parse
from gen.substrate import shade

pytestmark = pytest.mark.render

GROOVES = {"kind": "grooves", "pitch": 6.0, "depth": 0.4}


def user_mesh(folder: Path) -> str:
    import trimesh

    from gen.meshes import mesh_file, write_mesh

    part = trimesh.creation.annulus(r_min=8, r_max=15, height=12, sections=96)
    part.export(folder / "part.ply")
    return str(write_mesh(mesh_file({"file": "part.ply", "size_mm": 36}, folder), folder))


@pytest.mark.parametrize("kind", ["cylinder", "mesh", "mesh with detail"])
def test_it_is_the_reference_brdf_at_the_normals_of_the_mesh(kind: str, worker, job, pixel_rays, oracle, tmp_path: Path) -> None:
    shape: dict[str, Any] = {"name": "cylinder", "parameters": {}} if kind == "cylinder" else {"file": user_mesh(tmp_path)}
    if kind != "mesh":
        shape["detail"] = [GROOVES, {"kind": "dents", "radius": 4.0, "depth": 0.3}]
    asked = job("cylinder", "orthographic", size=(48, 48), shape=shape)
    layers = worker.render(asked)
    normal, seen = layers["normal"].astype(float), layers["coverage"] > 0
    assert 0.1 < seen.mean() < 0.7

    # The rendered normals and depths are those of the mesh.
    mesh = parse(asked).posed_mesh
    corners = [oracle.draw(asked, mesh, x, y) for x in (-0.01, 0.01) for y in (-0.01, 0.01)]
    met, there, depth = (np.stack(values) for values in zip(*corners, strict=True))
    sure = (met == met[0]).all(axis=0) & met[0] & (np.ptp(there, axis=0).max(axis=-1) < 0.05) & (np.ptp(depth, axis=0) < 0.2)
    assert sure.sum() > 0.8 * seen.sum()
    assert np.maximum(normal - there.max(axis=0), there.min(axis=0) - normal)[sure].max() < 1e-3
    assert np.maximum(layers["depth"] - depth.max(axis=0), depth.min(axis=0) - layers["depth"])[sure].max() < 1e-3

    # Where lit, the picture is the BRDF at those normals.
    _, direction = pixel_rays(asked)
    n = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    m = asked["material"]
    for k, light in enumerate(asked["lights"]):
        parts = shade(n, np.array(light["direction"]), -direction, np.array(m["diffuse"]), np.array(m["specular"]), m["alpha"])
        lit = (layers["matte"][k] > 0).any(axis=-1) & (n[..., 2] > 1e-3)
        assert (lit <= seen).all()
        for name, part in zip(("diffuse", "specular", "matte"), parts, strict=True):
            reference = part * np.array(light["intensity"])
            assert abs(layers[name][k] - reference)[lit].max() < 1e-5 * max(1.0, reference[lit].max()), name
    assert (layers["matte"][4] > 0).any(axis=-1)[seen & (n[..., 2] > 0.2)].mean() > 0.95


BAD = [
    ({"name": "cylinder", "detail": [{"kind": "rust"}]}, "job: shape.detail rust: unknown; there are dents"),
    ({"name": "cylinder", "detail": {"kind": "dents"}}, "job: shape.detail: must be a list"),
    ({"name": "cylinder", "file": "a.npz"}, "job: shape.name is unknown"),
    ({"file": "no.npz"}, "job: shape.file no.npz is not a mesh"),
    ({"file": 3}, "job: shape.file must be a text"),
]


@pytest.mark.parametrize(("shape", "message"), BAD)
def test_bad_shapes_are_refused_in_one_line(shape: dict[str, Any], message: str, worker, job, tmp_path: Path) -> None:
    answer = worker.ask(job("cylinder", "orthographic", shape=shape, out=str(tmp_path / "x.npz")))
    assert not answer["ok"]
    assert message in answer["error"]
    assert "\n" not in answer["error"]
