"""Surface detail: closed forms of displaced cylinders and spheres, and on every shape a closed surface that its normals describe."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from blender_scenes.shapes import SHAPES, Mesh, build, detail_refinement, detail_roughness
from blender_scenes.shapes.detail import (
    DETAILS,
    add_detail,
    checked_details,
    describe_details,
    detail_parameters,
    sample_detail,
)

OPEN = {"relief"}
COARSE: dict[str, dict[str, Any]] = {
    "dents": {"radius": 4.0, "depth": 0.3, "count": 6},
    "grooves": {"pitch": 6.0, "depth": 0.2, "tilt_degrees": 20.0},
    "rings": {"pitch": 6.0, "depth": 0.2, "sharpness": 0.5},
    "roughness": {"wavelength": 9.0, "rms": 0.03},
    "scratches": {"length": 20.0, "width": 1.5, "depth": 0.1, "count": 5},
}
ALL: list[dict[str, Any]] = [
    {"kind": "dents", "radius": 4.0, "depth": 0.02, "count": 4},
    {"kind": "grooves", "pitch": 9.0, "depth": 0.01, "tilt_degrees": 20.0},
    {"kind": "rings", "pitch": 9.0, "depth": 0.01},
    {"kind": "roughness", "wavelength": 16.0, "rms": 0.001},
    {"kind": "scratches", "length": 20.0, "width": 2.0, "depth": 0.01, "count": 2},
]
FINE: dict[str, dict[str, Any]] = {
    "dents": {"radius": 5.0, "depth": 1.2, "count": 8},
    "grooves": {"pitch": 4.0, "depth": 0.9, "turn_degrees": 30.0, "tilt_degrees": 15.0, "sharpness": 0.8},
    "rings": {"pitch": 5.0, "depth": 0.9, "turn_degrees": 70.0, "tilt_degrees": 30.0},
    "roughness": {"wavelength": 5.0, "rms": 0.1},
    "scratches": {"length": 30.0, "width": 2.0, "depth": 0.4, "count": 9},
}


def facets(name: str) -> dict[str, int]:
    return {"segments": 48} if "segments" in build.__globals__["parameters"](name) else {}


@cache
def plain(name: str) -> Mesh:
    return build(name, **facets(name))


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees between rows."""
    unit = [rows / np.linalg.norm(rows, axis=1, keepdims=True) for rows in (a, b)]
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(unit[0] - unit[1], axis=1) / 2, 0, 1)))


def heights(kind: str, mesh: Mesh, values: dict[str, Any]) -> Any:
    return DETAILS[kind].field(mesh, **values).height


@pytest.mark.parametrize("kind", DETAILS)
def test_gradients_are_those_of_the_heights(kind: str) -> None:
    height = heights(kind, plain("sphere"), FINE[kind])
    points = plain("sphere").vertices[::3] * 1.01
    _, gradient = height(points)
    steps = 1e-5 * np.eye(3)
    numeric = np.stack([(height(points + step)[0] - height(points - step)[0]) / 2e-5 for step in steps], axis=1)
    assert abs(gradient).max() > 0.05
    np.testing.assert_allclose(gradient, numeric, atol=2e-5)


@pytest.mark.parametrize("kind", DETAILS)
def test_a_sphere_with_detail_has_the_normals_of_its_radius_function(kind: str) -> None:
    """The surface r(u) u over unit vectors u has the normal r u - grad r, the gradient on the unit sphere; it takes slopes to 40 degrees
    and heights to 5 % of the radius, where the curvature counts."""
    base = build("sphere", segments=192)
    height = heights(kind, base, FINE[kind])
    mesh = add_detail(base, [{"kind": kind, **FINE[kind]}])
    R = float(np.linalg.norm(base.vertices[0]))
    r = np.linalg.norm(mesh.vertices, axis=1)
    u = mesh.vertices / r[:, None]
    assert abs(r - (R + height(R * u)[0])).max() < 2e-4
    assert abs(r - R).max() > 0.5 * {"roughness": 0.1}.get(kind, FINE[kind].get("depth", 0))

    def radius(at: np.ndarray) -> np.ndarray:
        return R + height(R * at / np.linalg.norm(at, axis=1, keepdims=True))[0]

    gradient = np.stack([(radius(u + step) - radius(u - step)) / 2e-5 for step in 1e-5 * np.eye(3)], axis=1)
    error = angles(mesh.normals, r[:, None] * u - gradient)
    assert error.max() < 0.05  # measured: 0.011 at the most
    # Without the curvature, that is with n - grad h, it would be off.
    slope = height(R * u)[1]
    assert angles(mesh.normals, u - slope + (slope * u).sum(axis=1, keepdims=True) * u).max() > (
        0.05 if kind == "roughness" else 0.15
    )


@pytest.mark.parametrize("turn_degrees", [90.0, 0.0])
@pytest.mark.parametrize("sharpness", [0.0, 0.9])
def test_a_grooved_cylinder_is_its_closed_form(turn_degrees: float, sharpness: float) -> None:
    """Around the axis: the surface of revolution of R + h(y). Along it: (R + h(R sin a)) (sin a, cos a)."""
    pitch, depth, R = 3.0, 0.4, 20.0
    given = {"kind": "grooves", "pitch": pitch, "depth": depth, "sharpness": sharpness, "turn_degrees": turn_degrees}
    mesh = add_detail(build("cylinder", segments=256), [given])
    x, y, z = mesh.vertices.T
    side = (abs(y) < 22) & (np.hypot(x, z) > 15)
    x, y, z = x[side], y[side], z[side]
    a = np.arctan2(x, z)
    t = y if turn_degrees == 90 else R * np.sin(a)
    k, s = 2 * np.pi / pitch, max(sharpness, 1e-6)
    h = depth / 2 * (np.arcsin(s * np.cos(k * t)) / np.arcsin(s) - 1)
    slope = -depth / 2 * k * s * np.sin(k * t) / np.arcsin(s) / np.sqrt(1 - (s * np.cos(k * t)) ** 2)
    np.testing.assert_allclose(np.hypot(x, z), R + h, atol=1e-6)
    radial, around = np.stack([np.sin(a), 0 * a, np.cos(a)], axis=1), np.stack([np.cos(a), 0 * a, -np.sin(a)], axis=1)
    if turn_degrees == 90:
        expected = radial - slope[:, None] * np.array([0.0, 1, 0])
    else:
        expected = (R + h)[:, None] * radial - (slope * R * np.cos(a))[:, None] * around
    assert abs(slope).max() > 0.3
    assert angles(mesh.normals[side], expected).max() < 0.01


def test_detail_fades_toward_sharp_edges_and_leaves_them_where_they_were() -> None:
    mesh = add_detail(build("cylinder"), [{"kind": "grooves", "pitch": 2.3, "depth": 0.1}])
    radius, y = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 2]), abs(mesh.vertices[:, 1])
    rim = (abs(radius - 20) < 1e-6) & (abs(y - 25) < 1e-6)
    assert rim.sum() >= 2 * 2 * 512
    straight = np.isclose(abs(mesh.normals[rim]).max(axis=1), 1) | np.isclose(mesh.normals[rim][:, 1], 0)
    assert straight.all()
    side = mesh.vertices[(radius > 19) & (y < 24)]
    assert np.ptp(np.hypot(side[:, 0], side[:, 2])) == pytest.approx(0.1, rel=0.02)


def check_surface(name: str, details: list[dict[str, Any]]) -> None:
    """Closed where it was, finite, unit normals, and faces that stand as their normals say."""
    import trimesh

    base = plain(name)
    mesh = add_detail(base, details)
    assert len(mesh.vertices) < 400_000
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-9)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    solid.merge_vertices(merge_norm=True, merge_tex=True)
    assert solid.is_winding_consistent
    assert solid.is_watertight == (name not in OPEN)
    p = mesh.vertices[mesh.faces]
    cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    area = np.linalg.norm(cross, axis=1)
    assert area.min() > 0
    mean = angles(mesh.normals[mesh.faces].sum(axis=1), cross)
    assert (mean * area).sum() / area.sum() < 2.5
    moved = abs(np.ptp(mesh.vertices, axis=0) - np.ptp(base.vertices, axis=0)).max()
    assert moved < 1.3


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_takes_detail(name: str) -> None:
    """One kind of detail each, in turn; all at once under `make soak`."""
    kind = ("grooves", "dents")[list(SHAPES).index(name) % 2]
    check_surface(name, [{"kind": kind, **COARSE[kind]}])


@pytest.mark.soak
@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_takes_all_details_at_once(name: str) -> None:
    check_surface(name, ALL)


@pytest.mark.parametrize("name", ["cylinder", "rounded_box"])
@pytest.mark.parametrize("kind", DETAILS)
def test_shapes_take_every_detail_alone(name: str, kind: str) -> None:
    check_surface(name, [{"kind": kind, **COARSE[kind]}])


@pytest.mark.parametrize("name", ["cylinder", "rounded_box"])
def test_details_add_up_and_are_the_same_twice(name: str) -> None:
    details = [{"kind": kind, **COARSE[kind]} for kind in ("grooves", "dents")]
    one, two = add_detail(plain(name), details), add_detail(plain(name), details)
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.normals.tobytes() == two.normals.tobytes()
    assert one.faces.tobytes() == two.faces.tobytes()
    assert add_detail(plain(name), []) is plain(name)


def test_normals_are_those_of_a_finer_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """One surface on finer and finer meshes: the mean angle between a face and its vertices' mean normal falls with the facets' size."""
    base = build("sphere", radius=6, segments=96)
    found = []
    for parts in (10, 20, 40):
        monkeypatch.setattr(detail_roughness, "PARTS", parts)
        mesh = add_detail(base, [{"kind": "roughness", "wavelength": 4.0, "rms": 0.08}])
        p = mesh.vertices[mesh.faces]
        cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        area = np.linalg.norm(cross, axis=1)
        found.append((angles(mesh.normals[mesh.faces].sum(axis=1), cross) * area).sum() / area.sum())
    assert found[1] < 0.65 * found[0]
    assert found[2] < 0.65 * found[1]


def test_new_points_lie_on_the_smooth_surface() -> None:
    """Of chords 1.6 mm long the middles lie 15 um under a sphere of 20 mm, and 15 um inside a cylinder's rim."""
    invisible = [{"kind": "roughness", "wavelength": 4.0, "rms": 1e-6}]
    ball = add_detail(build("sphere", radius=20, segments=80), invisible)
    assert len(ball.vertices) > 6_000
    assert abs(np.linalg.norm(ball.vertices, axis=1) - 20).max() < 1e-4
    tube = add_detail(build("cylinder", segments=80), invisible).vertices
    rim = tube[abs(abs(tube[:, 1]) - 25) < 1e-5]
    radius = np.hypot(rim[:, 0], rim[:, 2])
    outer = np.sort(radius)[-320:]
    assert abs(outer - 20).max() < 1e-4


def test_a_dent_within_one_large_face_is_found() -> None:
    square = np.array([[-20.0, -20, 0], [20, -20, 0], [20, 20, 0], [-20, 20, 0]])
    for normals in (np.tile([0.0, 0, 1], (4, 1)), None):
        mesh = add_detail(
            Mesh(square, np.array([[0, 1, 2, 3]]), normals), [{"kind": "dents", "radius": 1.5, "depth": 0.2, "count": 9}]
        )
        low = mesh.vertices[mesh.vertices[:, 2] < -0.08]
        assert len(np.unique(np.round(low[:, :2] / 3), axis=0)) >= 6


BAD = [
    ([{"kind": "rust"}], "detail rust: unknown; there are dents, grooves"),
    ([{"pitch": 1}], "detail: needs a kind"),
    ({"kind": "grooves"}, "detail: must be a list"),
    (["grooves"], "detail: must be a list"),
    ([{"kind": "grooves"}] * 9, "detail: must be a list of at most 8"),
    ([{"kind": "grooves", "picth": 1}], "detail grooves: unknown parameter picth; it has pitch"),
    ([{"kind": "grooves", "pitch": 0}], "detail grooves: pitch must be a number from 0.001"),
    ([{"kind": "grooves", "pitch": "1"}], "detail grooves: pitch must be a number"),
    ([{"kind": "grooves", "pitch": 1, "depth": 0.3}], "detail grooves: depth 0.3 mm must be 0.25 mm"),
    ([{"kind": "rings", "pitch": 1, "depth": 0.3}], "detail rings: depth 0.3 mm must be 0.25 mm"),
    ([{"kind": "dents", "radius": 1, "depth": 0.3}], "detail dents: depth"),
    ([{"kind": "dents", "count": 2.5}], "detail dents: count must be a whole number"),
    ([{"kind": "scratches", "width": 1, "depth": 0.3}], "detail scratches: depth"),
    ([{"kind": "scratches", "width": 13}], "detail scratches: width 13 mm must be the length"),
    ([{"kind": "roughness", "rms": 0.1}], "detail roughness: rms"),
    ([{"kind": "roughness", "seed": float("nan")}], "detail roughness: seed must be a number"),
]


@pytest.mark.parametrize(("details", "message"), BAD)
def test_bad_details_are_refused_in_one_line(details: Any, message: str) -> None:
    with pytest.raises(ValueError, match="^" + message) as caught:
        checked_details(details)
    assert "\n" not in str(caught.value)


def test_too_fine_a_detail_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detail_refinement, "MAX_VERTICES", 20_000)
    with pytest.raises(ValueError, match=r"^detail grooves: pitch 0.1 mm is too fine for this shape: [^\n]+ coarser detail"):
        add_detail(build("cylinder"), [{"kind": "dents"}, {"kind": "grooves", "pitch": 0.1, "depth": 0.01}])


@pytest.mark.parametrize("kind", DETAILS)
def test_samples_are_within_the_ranges_and_reproducible(kind: str) -> None:
    known, rng = detail_parameters(kind), np.random.default_rng(5)
    drawn = [sample_detail(kind, rng) for _ in range(50)]
    checked_details(drawn[:8])
    for values in drawn:
        checked_details([values])
        assert set(values) - {"kind"} <= set(known)
    assert drawn[0] != drawn[1]
    assert sample_detail(kind, np.random.default_rng(5)) == drawn[0]
    assert describe_details()[kind]
