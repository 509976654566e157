"""Every registered shape: a closed, outward surface with exact normals, found by name and checked at the door."""

from __future__ import annotations

import inspect
import subprocess
import sys
from importlib import import_module
from math import gamma

import numpy as np
import pytest

from blender_scenes.shapes import SHAPES, Mesh, build, describe, parameters, sample


def beta(x: float, y: float) -> float:
    return gamma(x) * gamma(y) / gamma(x + y)


def shaft(chamfer: float, **given: float) -> float:
    """Three cylinders less a triangle turned about the axis (Pappus) at each outer edge."""
    radii, lengths = ([given[f"{place}_{what}"] for place in ("first", "second", "third")] for what in ("radius", "length"))
    volume = sum(np.pi * r**2 * length for r, length in zip(radii, lengths, strict=True))
    for i, r in enumerate(radii):
        for j in (i - 1, i + 1):
            c = min(chamfer, max(0.0, (r - radii[j]) / 2)) if 0 <= j < 3 else chamfer
            volume -= np.pi * c**2 * (r - c / 3)
    return volume


def plate(radius, bore_radius, thickness, holes, hole_radius, chamfer, **_) -> float:
    rings = 2 * np.pi * chamfer**2 * (radius - chamfer / 3 + bore_radius + chamfer / 3)
    return np.pi * thickness * (radius**2 - bore_radius**2 - holes * hole_radius**2) - rings


def wire(radius, pitch, turns, **_) -> float:
    return turns * np.hypot(2 * np.pi * radius, pitch)


def box(width, height, depth, radius) -> tuple[float, float]:
    """Area and volume by Steiner's formula of the inner box."""
    a, b, c = (side - 2 * radius for side in (width, height, depth))
    faces, edges = 2 * (a * b + b * c + c * a), a + b + c
    area = faces + 2 * np.pi * radius * edges + 4 * np.pi * radius**2
    return area, a * b * c + faces * radius + np.pi * radius**2 * edges + 4 / 3 * np.pi * radius**3


AREA = {
    "sphere": lambda radius, **_: 4 * np.pi * radius**2,
    "cylinder": lambda radius, length, **_: 2 * np.pi * radius * (radius + length),
    "capsule": lambda radius, length, **_: 2 * np.pi * radius * length,
    "cone": lambda radius, height, **_: np.pi * radius * (radius + np.hypot(radius, height)),
    "truncated_cone": lambda bottom_radius, top_radius, height, **_: (
        np.pi * (bottom_radius**2 + top_radius**2 + (bottom_radius + top_radius) * np.hypot(height, bottom_radius - top_radius))
    ),
    "torus": lambda radius, tube_radius, **_: 4 * np.pi**2 * radius * tube_radius,
    "helical_spring": lambda wire_radius, **given: 2 * np.pi * wire_radius * (wire(**given) + wire_radius),
    "rounded_box": lambda **given: box(**given)[0],
}
VOLUME = {
    "sphere": lambda radius, **_: 4 / 3 * np.pi * radius**3,
    "cylinder": lambda radius, length, **_: np.pi * radius**2 * length,
    "capsule": lambda radius, length, **_: np.pi * radius**2 * (length - 2 / 3 * radius),
    "cone": lambda radius, height, **_: np.pi / 3 * radius**2 * height,
    "truncated_cone": lambda bottom_radius, top_radius, height, **_: (
        np.pi / 3 * height * (bottom_radius**2 + bottom_radius * top_radius + top_radius**2)
    ),
    "ellipsoid": lambda width, height, depth, **_: np.pi / 6 * width * height * depth,
    "torus": lambda radius, tube_radius, **_: 2 * np.pi**2 * radius * tube_radius**2,
    "helical_spring": lambda wire_radius, **given: np.pi * wire_radius**2 * wire(**given),
    "pipe_elbow": lambda radius, bore_radius, bend_radius, leg: (
        np.pi * (radius**2 - bore_radius**2) * (2 * leg + np.pi / 2 * bend_radius)
    ),
    "rounded_box": lambda **given: box(**given)[1],
    "superquadric": lambda width, height, depth, vertical, horizontal: (
        width
        * height
        * depth
        / 4
        * vertical
        * horizontal
        * beta(vertical / 2 + 1, vertical)
        * beta(horizontal / 2, horizontal / 2)
    ),
    "stepped_shaft": shaft,
    "flange": plate,
    "turbine_blade": lambda chord, height, thickness, taper, **_: (
        np.pi / 4 * thickness / 1.033 * chord**2 * height * (1 + taper + taper**2) / 3
    ),
}
"""The closed forms that there are; gear, bolt, vase and relief have none."""

OPEN = {"relief"}
"""Shapes that are open surfaces."""

IMPOSSIBLE = [
    ("capsule", {"radius": 30}),
    ("ellipsoid", {"width": 1000}),
    ("torus", {"tube_radius": 15}),
    ("rounded_box", {"radius": 12}),
    ("stepped_shaft", {"chamfer": 7}),
    ("flange", {"bore_radius": 20.5}),
    ("flange", {"hole_radius": 6}),
    ("flange", {"holes": 24}),
    ("flange", {"thickness": 1.5}),
    ("gear", {"bore_radius": 17}),
    ("gear", {"teeth": 8, "bore_radius": 12}),
    ("gear", {"width": 0.5}),
    ("helical_spring", {"pitch": 3.5}),
    ("helical_spring", {"wire_radius": 12.9}),
    ("helical_spring", {"wire_radius": 0.1}),
    ("hexagonal_bolt", {"thread_length": 33}),
    ("hexagonal_bolt", {"pitch": 0.2}),
    ("hexagonal_bolt", {"pitch": 6}),
    ("pipe_elbow", {"bore_radius": 9}),
    ("pipe_elbow", {"bend_radius": 9}),
    ("turbine_blade", {"height": 1000}),
    ("turned_vase", {"neck_radius": 16}),
    ("turned_vase", {"wall": 4}),
    ("relief", {"wavelength": 2}),
    ("relief", {"depth": 20}),
]


def triangles(mesh: Mesh) -> np.ndarray:
    faces = mesh.faces if mesh.faces.shape[1] == 3 else np.concatenate([mesh.faces[:, :3], mesh.faces[:, [0, 2, 3]]])
    return mesh.vertices[faces]


def cross_products(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    p = triangles(mesh)
    return p, np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])


@pytest.mark.parametrize("name", VOLUME)
@pytest.mark.parametrize("seed", [None, 1, 2])
def test_surface_has_the_area_and_volume_of_its_formula(name: str, seed: int | None) -> None:
    values = {} if seed is None else sample(name, np.random.default_rng(seed))
    p, cross = cross_products(build(name, **values))
    given = {key: values.get(key, parameter.default) for key, parameter in parameters(name).items()}
    # A thin tube's chords may lie deeper, as a share of the tube, than those of the body.
    rel = 2e-4 if name in ("sphere", "cylinder") else 2e-3
    if name in AREA:
        assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(AREA[name](**given), rel=rel)
    # The signed volume is positive, and right, only if every face is wound outward.
    assert (p[:, 0] * cross).sum() / 6 == pytest.approx(VOLUME[name](**given), rel=rel)


@pytest.mark.parametrize("name", SHAPES)
def test_surface_is_closed(name: str) -> None:
    import trimesh

    for values in ({}, sample(name, np.random.default_rng(3))):
        mesh = build(name, **values)
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        solid.merge_vertices(merge_norm=True, merge_tex=True)
        assert solid.is_winding_consistent
        assert solid.is_watertight == (name not in OPEN)
        assert solid.volume > 0 or name in OPEN


@pytest.mark.parametrize("name", SHAPES)
def test_samples_are_sound(name: str) -> None:
    """The defaults and eight samples: small enough, centred, facets within 1e-4 of the size and turned as their normals are."""
    rng = np.random.default_rng(11)
    for values in [{}, *(sample(name, rng) for _ in range(8))]:
        mesh = build(name, **values)
        assert len(mesh.vertices) <= 400_000
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        size = (high - low).max()
        assert 15 < size < 130
        assert abs(low + high).max() < 0.02 * size
        assert mesh.normals is not None
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-12)
        p, cross = cross_products(mesh)
        area = np.linalg.norm(cross, axis=1)
        assert area.min() > 1e-9 * size**2
        n = mesh.normals[mesh.faces]
        cosine = (cross[:, None] * n).sum(-1) / area[:, None]
        assert cosine.min() > 0.97
        assert np.degrees((np.arccos(cosine.clip(-1, 1)).mean(axis=1) * area).sum() / area.sum()) < 2.5
        # Over an edge d whose normals differ by e along it, the surface stands d e / 8 high.
        bulge = ((p - np.roll(p, 1, axis=1)) * (n - np.roll(n, 1, axis=1))).sum(-1) / 8
        assert abs(bulge).max() < 1e-4 * size


@pytest.mark.parametrize("name", SHAPES)
def test_default_stands_about_40_mm_high_and_is_the_same_twice(name: str) -> None:
    one, two = build(name), build(name)
    assert 35 < np.ptp(one.vertices, axis=0).max() <= 50
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.normals.tobytes() == two.normals.tobytes()
    assert one.faces.tobytes() == two.faces.tobytes()


@pytest.mark.parametrize("name", [name for name in SHAPES if "seed" in parameters(name)])
def test_seeds_tell_shapes_apart(name: str) -> None:
    assert abs(build(name, seed=1).vertices[:1000] - build(name, seed=2).vertices[:1000]).max() > 0.1


@pytest.mark.parametrize(("name", "values"), IMPOSSIBLE)
def test_impossible_combinations_are_refused_in_one_line(name: str, values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"^shape {name}: [^\n]+$"):
        build(name, **values)


def test_implicit_surfaces_hold_their_points_and_normals() -> None:
    """Superquadric, ellipsoid and torus: their equation holds at every vertex, and its numerical gradient is the normal."""
    a, b, c, p, q = 20.0, 14.0, 17.0, 2 / 0.8, 2 / 0.6
    equations = [
        ("superquadric", {"width": 40, "height": 28, "depth": 34, "vertical": 0.8, "horizontal": 0.6},
         lambda x, y, z: (abs(x / a) ** q + abs(z / c) ** q) ** (p / q) + abs(y / b) ** p - 1),
        ("ellipsoid", {"width": 40, "height": 28, "depth": 34}, lambda x, y, z: (x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2 - 1),
        ("torus", {"radius": 15, "tube_radius": 6}, lambda x, y, z: (np.hypot(x, y) - 15) ** 2 / 36 + z * z / 36 - 1),
    ]  # fmt: skip
    for name, values, f in equations:
        mesh = build(name, **values)
        points = mesh.vertices.T
        assert abs(f(*points)).max() < 1e-9
        steps = 1e-5 * np.eye(3)[:, :, None]
        gradient = np.stack([f(*(points + step)) - f(*(points - step)) for step in steps], axis=1)
        gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
        np.testing.assert_allclose(mesh.normals, gradient, atol=2e-3)


@pytest.mark.parametrize("name", SHAPES)
def test_samples_are_within_the_ranges_and_reproducible(name: str) -> None:
    known = parameters(name)
    rng = np.random.default_rng(7)
    drawn = [sample(name, rng) for _ in range(50)]
    for values in drawn:
        assert all(known[key].low <= value <= known[key].high for key, value in values.items())
    assert drawn[0] != drawn[1]
    assert sample(name, np.random.default_rng(7)) == drawn[0]


@pytest.mark.parametrize("name", SHAPES)
def test_parameters_are_read_from_the_signature(name: str) -> None:
    function = getattr(import_module(SHAPES[name]), name)
    assert {key: p.default for key, p in parameters(name).items()} == {
        key: argument.default for key, argument in inspect.signature(function).parameters.items()
    }
    assert describe()[name]


@pytest.mark.parametrize("name", SHAPES)
def test_bad_values_are_refused(name: str) -> None:
    for key, parameter in parameters(name).items():
        for value in (parameter.low - 1, parameter.high + 1, float("nan"), float("inf"), "3", None, True):
            with pytest.raises(ValueError, match=f"shape {name}: {key} must be a number from"):
                build(name, **{key: value})


def test_bad_names_are_refused() -> None:
    with pytest.raises(ValueError, match="shape teapot: unknown; there are capsule, cone, cylinder, "):
        build("teapot")
    with pytest.raises(ValueError, match="unknown parameter size; it has radius, segments"):
        build("sphere", size=3)
    with pytest.raises(ValueError, match="unknown parameter name"):
        build("sphere", name=3)
    with pytest.raises(ValueError, match="segments must be a whole number"):
        build("sphere", segments=64.5)


@pytest.mark.parametrize(
    ("vertices", "faces", "normals", "message"),
    [
        ([[0, 0]], [[0, 0, 0]], None, r"vertices must be \(V, 3\)"),
        ([[0, 0, np.nan]], [[0, 0, 0]], None, "not finite"),
        ([[0, 0, 0]], [[0, 0, 1]], None, "there are 1"),
        ([[0, 0, 0]], [[0, 0]], None, "faces must be whole numbers"),
        ([[0, 0, 0]], [[0.0, 0, 0]], None, "faces must be whole numbers"),
        ([[0, 0, 0]], [[0, 0, 0]], [[0, 0, 0]], "normal 0 has no length"),
        ([[0, 0, 0]], [[0, 0, 0]], [[0, 0, 1], [0, 0, 1]], "2 normals for 1 vertices"),
    ],
)
def test_bad_meshes_are_refused(vertices: object, faces: object, normals: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Mesh(np.array(vertices), np.array(faces), None if normals is None else np.array(normals))


def test_shapes_import_numpy_alone() -> None:
    code = "import sys, blender_scenes.shapes as s; [s.build(n) for n in s.SHAPES]; sys.exit('bpy' in sys.modules or 'gen' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0
