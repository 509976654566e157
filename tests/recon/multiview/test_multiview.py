"""Measurement from several views, against an ellipsoid in closed form, and on a small real render."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from gen.errors import InputError
from recon.multiview.compare import compare, nearest, true_surface
from recon.multiview.depth import Surface, matching_picture, photometric, refined
from recon.multiview.fuse import fuse, without_debris
from recon.multiview.measure import compare_rows, measure_views, rows_text
from recon.multiview.stereo import angle_between, confirmed, match, neighbours, rectify, stereo_depths
from recon.multiview.views import Ball, View, pose_of_render, read_views, views_of
from recon.reconstruct import Settings
from recon.registry import Normals
from tests.recon.multiview.ring import AXES, DISTANCE, MIDDLE, capture_at, distance_to_ellipsoid, paint, ring, turned, write_ring

Views = tuple[tuple[View, ...], Ball]
MATTE = Settings("none", "none")


@pytest.fixture(scope="module")
def four() -> Views:
    return ring((0, 14, 28, 42))


def true_depth(view: View) -> np.ndarray:
    assert view.capture.truth.depth is not None
    return 1000 * view.capture.truth.depth


def pictures(views: tuple[View, ...]) -> list[np.ndarray]:
    return [matching_picture(view, view.capture.truth.albedo) for view in views]


def test_points_and_projection_are_each_others_inverse(four: Views) -> None:
    for view in four[0]:
        depth = true_depth(view)
        points = view.points(depth)
        inside = np.isfinite(depth)
        assert distance_to_ellipsoid(points[inside]).max() < 1e-3
        x, y, z = view.project(points)
        rows, columns = np.indices(depth.shape)
        assert np.abs(x - columns)[inside].max() < 1e-8
        assert np.abs(y - rows)[inside].max() < 1e-8
        assert np.abs(z - depth)[inside].max() < 1e-8


def test_the_ball_holds_the_object(four: Views) -> None:
    views, ball = four
    assert np.linalg.norm(ball.centre - MIDDLE) < 1.5
    assert AXES.max() - 1 < ball.radius < 1.2 * AXES.max()
    for view in views:
        distance = view.capture.scale.distance_mm
        assert distance == pytest.approx(-(view.rotation @ ball.centre + view.pose[:3, 3])[2])


@pytest.mark.parametrize("swapped", [False, True])
def test_rectified_points_lie_in_one_row(four: Views, swapped: bool) -> None:
    """Points of both views land in the same row of the two rectified pictures, the left one farther right by f b (1/z - 1/middle)."""
    (a, b, *_), ball = four
    pair = rectify(b, a, ball) if swapped else rectify(a, b, ball)
    points = a.points(true_depth(a))[a.capture.mask]
    image, depth = [], []
    for view, R, P in zip((pair.left, pair.right), pair.rotations, pair.projections, strict=True):
        p = (points @ view.to_opencv[:, :3].T + view.to_opencv[:, 3]) @ R.T
        image.append((p / p[:, 2:]) @ P.T)
        depth.append(p[:, 2])
    assert np.abs(image[0][:, 1] - image[1][:, 1]).max() < 1e-8
    assert np.allclose(depth[0], depth[1])
    disparity = image[0][:, 0] - image[1][:, 0]
    assert np.abs(disparity).max() < pair.reach
    assert disparity.min() < 0 < disparity.max()
    assert np.corrcoef(disparity, 1 / depth[0])[0, 1] > 0.999999


def test_a_disparity_map_becomes_the_views_own_depth(four: Views) -> None:
    """The plane through the ball's middle that the rectified pair sees straight on has disparity 0."""
    (a, b, *_), ball = four
    pair = rectify(a, b, ball)
    for side, view in enumerate((pair.left, pair.right)):
        depth = pair.depth(np.zeros((pair.size, pair.size), np.float32), side)
        inside = np.isfinite(depth)
        assert inside.sum() > 0.95 * view.capture.mask.sum()
        common = pair.rotations[side] @ view.to_opencv[:, :3]
        off = (view.points(depth)[inside] - ball.centre) @ common[2]
        assert np.abs(off).max() < 1e-3


def test_a_vertical_pair_is_matched_like_a_horizontal_one() -> None:
    """Cameras one above the other: the same errors as side by side."""
    for other in (turned(12, 15), turned(0, 27)):
        poses = [turned(0, 15), other]
        views, ball = views_of([capture_at(pose, 96) for pose in poses], poses, ["a", "b"])
        for view, depth in zip(views, stereo_depths(views, ball, pictures(views)), strict=True):
            error = np.abs(depth - true_depth(view))[np.isfinite(depth)]
            assert len(error) > 0.6 * view.capture.mask.sum()
            assert np.median(error) < 0.25


def test_stereo_finds_the_depth(four: Views) -> None:
    views, ball = four
    pixel = DISTANCE / views[0].K[0, 0]
    for view, depth in zip(views, stereo_depths(views, ball, pictures(views)), strict=True):
        error = np.abs(depth - true_depth(view))[np.isfinite(depth)]
        assert len(error) > 0.7 * view.capture.mask.sum()
        assert np.median(error) < 0.35 * pixel
        assert np.percentile(error, 95) < 2 * pixel


def test_other_pictures_give_no_depth(four: Views) -> None:
    """Noise in place of one picture: hardly a pixel survives the look from both sides."""
    (a, b, *_), ball = four
    rng = np.random.default_rng(0)
    noise = np.where(b.capture.mask, rng.integers(0, 255, b.capture.mask.shape), 0).astype(np.uint8)
    pair = rectify(a, b, ball)
    by_view = {a.name: pictures((a,))[0], b.name: noise}
    left, right = match(pair, (by_view[pair.left.name], by_view[pair.right.name]))
    assert np.isfinite(left).sum() + np.isfinite(right).sum() < 0.1 * (a.capture.mask.sum() + b.capture.mask.sum())


def test_a_depth_that_no_one_confirms_goes(four: Views) -> None:
    (a, b, *_), _ = four
    depth, other = true_depth(a), true_depth(b)
    spoilt = depth.copy()
    spoilt[40:50, 40:50] -= 3
    kept = confirmed(a, spoilt, [(b, other)], tolerance=1.0)
    assert np.isnan(kept[40:50, 40:50]).all()
    assert np.isfinite(kept[a.capture.mask]).mean() > 0.8


def test_neighbours_are_the_nearest_within_the_angles(four: Views) -> None:
    views, ball = four
    assert angle_between(views[0], views[1], ball) == pytest.approx(14 * np.cos(np.radians(15)), abs=0.6)
    assert neighbours(views, ball) == [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]
    apart, around = ring((0, 90, 104), size=48)
    with pytest.raises(InputError, match=r"view 0: no other view is from 2 to 40 degrees away, the nearest is"):
        neighbours(apart, around)


def test_normals_refine_and_outliers_do_not_stay(four: Views) -> None:
    """True depth with steps, noise and a gross blob, true normals: what comes back is nearer than what went in."""
    view = four[0][0]
    depth = true_depth(view)
    rng = np.random.default_rng(1)
    coarse = (depth + 0.3 * rng.normal(size=depth.shape)).astype(np.float32)
    coarse[44:52, 44:52] += 5
    coarse[rng.random(depth.shape) < 0.3] = np.nan
    normal = view.capture.truth.normals
    assert normal is not None
    flat = np.zeros(depth.shape, np.float32)
    fine = refined(view, coarse, Normals(normal, np.zeros_like(normal), flat, view.capture.mask))
    inside = np.isfinite(fine)
    error = np.abs(fine - depth)[inside]
    assert inside.sum() > 0.85 * view.capture.mask.sum()
    assert np.median(error) < 0.05
    assert np.percentile(error, 95) < 0.3


def test_a_view_without_a_stereo_depth_adds_nothing(four: Views) -> None:
    view = four[0][0]
    nothing = np.full(view.capture.size, np.nan, np.float32)
    assert np.isnan(refined(view, nothing, photometric(view, MATTE))).all()


def test_fused_true_depths_are_the_ellipsoid() -> None:
    """From all around the mesh is right to a thirtieth of a pixel, turned outward, in one piece, and painted as the object is."""
    views, ball = ring(range(0, 360, 30), size=64)
    surfaces = [Surface(true_depth(v), v.capture.truth.normals, v.capture.truth.albedo) for v in views]
    mesh = fuse(views, surfaces, ball)
    pixel = DISTANCE / views[0].K[0, 0]
    distance = distance_to_ellipsoid(np.asarray(mesh.vertices))
    assert distance.mean() < 0.03 * pixel
    assert np.percentile(distance, 99) < 0.4 * pixel
    outward = np.einsum("nk,nk->n", mesh.face_normals, (mesh.triangles_center - MIDDLE) / AXES**2)
    assert (outward > 0).mean() > 0.999
    assert mesh.body_count == 1
    colour = np.asarray(mesh.visual.vertex_colors)[:, 0].astype(float)
    assert np.corrcoef(colour, paint(np.asarray(mesh.vertices) - MIDDLE))[0, 1] > 0.95


def test_a_view_that_sees_past_it_removes_a_ghost(four: Views) -> None:
    """A second sheet behind one view's outline is carved away by the others' background."""
    views, ball = four
    surfaces = [Surface(true_depth(v), v.capture.truth.normals, v.capture.truth.albedo) for v in views]
    ghost = surfaces[0].depth.copy()
    ghost[:, :48] -= 12  # half of the view comes off and floats before the object
    mesh = fuse(views, [Surface(ghost, surfaces[0].normal, surfaces[0].albedo), *surfaces[1:]], ball)
    clean = fuse(views, surfaces, ball)
    far = distance_to_ellipsoid(np.asarray(mesh.vertices)) > 3
    assert distance_to_ellipsoid(np.asarray(clean.vertices)).max() < 1
    assert far.mean() < 0.4


def test_debris_goes() -> None:
    large, small = trimesh.creation.icosphere(4), trimesh.creation.icosphere(1, radius=0.1)
    small.apply_translation([3, 0, 0])
    kept = without_debris(trimesh.util.concatenate([large, small]))
    assert len(kept.faces) == len(large.faces)
    assert np.abs(kept.extents - 2).max() < 0.01


def test_distances_are_those_of_concentric_spheres() -> None:
    inner, outer = trimesh.creation.icosphere(4, radius=10), trimesh.creation.icosphere(4, radius=10.2)
    found = compare(outer, inner, tolerance=0.25)
    assert found["accuracy"]["mean"] == pytest.approx(0.2, abs=0.01)
    assert found["completeness"]["median"] == pytest.approx(0.2, abs=0.01)
    assert found["f score"] > 99.9
    assert found["normals"]["mean"] < 4
    half = trimesh.Trimesh(outer.vertices, outer.faces[outer.triangles_center[:, 2] > 0][:, ::-1])  # and inside out
    found = compare(half, inner, tolerance=0.25)
    assert found["accuracy"]["within"] == 100
    assert found["completeness"]["within"] == pytest.approx(50, abs=2)
    assert found["normals"]["mean"] > 177


def test_the_nearest_triangle_is_found_exactly() -> None:
    box = trimesh.creation.box((2, 2, 2))
    points = np.array([[0, 0, 1.5], [2, 0, 0], [0.3, -1.25, 0.2], [0, 0, 0.9]])
    distance, face = nearest(points, box)
    assert distance == pytest.approx([0.5, 1, 0.25, 0.1])
    assert box.face_normals[face].round().tolist() == [[0, 0, 1], [1, 0, 0], [0, -1, 0], [0, 0, 1]]


def test_the_nearest_triangle_is_found_among_many_small_ones() -> None:
    """More triangles than points are drawn, in two layers: the upper one is the nearer."""
    fine = trimesh.creation.icosphere(6, radius=10)
    shell = fine.copy()
    shell.apply_scale(1.01)
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distance, _ = nearest(10.5 * directions, trimesh.util.concatenate([fine, shell]))
    assert distance == pytest.approx(np.full(500, 0.4), abs=0.003)


def test_the_true_surface_is_that_of_the_views(four: Views) -> None:
    truth = true_surface(four[0])
    assert truth is not None
    assert distance_to_ellipsoid(np.asarray(truth.triangles_center)).max() < 0.1
    assert (np.einsum("nk,nk->n", truth.face_normals, (truth.triangles_center - MIDDLE) / AXES**2) > 0).all()


def test_gloss_costs_accuracy_and_the_twin_does_not() -> None:
    views, ball = ring((0, 14, 28, 42), gloss=1.5)
    models, rows = compare_rows(views, ball, [Settings("true-matte", "none")])
    assert list(rows) == ["true-matte", "none"]
    assert rows["none"]["label"] == "with gloss"
    matte, glossy = rows["true-matte"], rows["none"]
    pixel = models["true-matte"].voxel
    assert matte["accuracy"]["mean"] < 0.25 * pixel
    assert glossy["chamfer"] > 1.5 * matte["chamfer"]
    assert glossy["normals"]["mean"] > 1.5 * matte["normals"]["mean"]


def test_two_views_are_binocular_stereo() -> None:
    views, ball = ring((0, 15))
    model = measure_views(views, ball, MATTE)
    assert np.median(distance_to_ellipsoid(np.asarray(model.mesh.vertices))) < 0.25 * model.voxel


def command(*arguments: object) -> None:
    from recon.cli import app

    app([str(argument) for argument in arguments], result_action="return_value", exit_on_error=False)


def test_the_command_writes_meshes_depths_and_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ring(tmp_path / "views", (0, 14, 28), gloss=0.3)
    command("multiview", tmp_path / "views", "-o", tmp_path / "out", "--gloss", "low-rank", "--voxel", "0.8", "--json")
    metrics = json.loads(capsys.readouterr().out)
    assert metrics == json.loads((tmp_path / "out/metrics.json").read_text())
    assert set(metrics["rows"]) == {"low-rank", "none", "true-matte"}
    assert metrics["voxel_mm"] == 0.8
    mesh = trimesh.load(tmp_path / "out/mesh.ply", force="mesh")
    assert len(mesh.faces) == metrics["mesh"]["triangles"]
    assert np.median(distance_to_ellipsoid(1000 * np.asarray(mesh.vertices))) < 0.5
    assert trimesh.load(tmp_path / "out/mesh.glb", force="mesh").extents == pytest.approx(mesh.extents, rel=1e-4)
    assert {p.name for p in (tmp_path / "out/compared").iterdir()} == {"none.ply", "true-matte.ply"}
    from gen.exr import read_exr

    depth = read_exr(tmp_path / "out/depth/002.exr")["depth.Z"]
    view = read_views(tmp_path / "views")[0][1]
    assert np.nanmedian(np.abs(1000 * depth - true_depth(view))) < 0.3
    assert (tmp_path / "out/depth/003.png").is_file()


def test_the_table_has_a_line_for_every_row_and_says_what_failed() -> None:
    ball = trimesh.creation.icosphere(3)
    rows = {"none": {"label": "with gloss", "error": "no two views agree"}, "x": {"label": "x", **compare(ball, ball, 0.1)}}
    text = rows_text(rows).splitlines()
    assert len(text) == 5
    assert text[2].split() == ["with", "gloss", "no", "two", "views", "agree"]
    assert text[3].split()[:9] == ["x", "0.000", "0.000", "100.0", "0.000", "0.000", "100.0", "0.000", "100.0"]


Spoil = Callable[[dict[str, Any]], object]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda said: said.update(format="x"), "does not hold the cameras"),
        (lambda said: said.update(version=2), "has version 2"),
        (lambda said: said.update(unit="m"), "unit must be mm"),
        (lambda said: said.update(views=[]), "from 2 to 1000 views, there are 0"),
        (lambda said: said["views"][0].update(capture="../14"), "leads out of the folder"),
        (lambda said: said["views"][1].update(capture="0"), "is there twice"),
        (lambda said: said["views"][1].update(object_to_camera=[[1, 2], [3, 4]]), "14: object_to_camera must be a 4x4 matrix"),
        (lambda said: said["views"][1].update(object_to_camera=(2 * np.eye(4)).tolist()), "not a rotation and a shift"),
        (lambda said: said["views"][1].update(object_to_camera=said["views"][0]["object_to_camera"]), None),
        (lambda said: said["views"][1].update(object_to_camera=turned(180).tolist()), None),
    ],
)
def test_wrong_cameras_are_one_line(tmp_path: Path, spoil: Spoil, message: str | None) -> None:
    """A half turn, or none, in place of 14 degrees cannot be told from the file alone: it is refused where no neighbour is near."""
    write_ring(tmp_path / "views", (0, 14), size=48)
    where = tmp_path / "views/cameras.json"
    said = json.loads(where.read_text())
    spoil(said)
    where.write_text(json.dumps(said))
    with pytest.raises(InputError, match=message or "no other view is from 2 to 40 degrees") as refused:
        command("multiview", tmp_path / "views", "-o", tmp_path / "out", "--gloss", "none")
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "out").exists()
    assert {p.name for p in tmp_path.iterdir()} == {"views"}


def test_what_is_no_folder_of_views_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no cameras.json and is no rendered set"):
        read_views(tmp_path)
    with pytest.raises(InputError, match="unknown gloss remover"):
        command("multiview", tmp_path, "-o", tmp_path / "out", "--gloss", "nothing")


def test_a_voxel_must_be_possible(four: Views) -> None:
    views, ball = four
    surfaces = [Surface(true_depth(v), v.capture.truth.normals, v.capture.truth.albedo) for v in views]
    for voxel, message in ((0.0, "must be a positive number"), (0.001, "more than 200; take larger")):
        with pytest.raises(InputError, match=message):
            fuse(views, surfaces, ball, voxel)


@pytest.mark.render
def test_the_records_of_a_render_say_where_its_camera_stood(tmp_path: Path) -> None:
    """The true depths of the preset's first views, put together by the poses that are read, lie on the superquadric that was built."""
    from blender_scenes import shapes
    from gen.presets import preset_file
    from gen.sets.campaign import Engine, render_set
    from gen.sets.plan import plan_of

    text = preset_file("multiview-ring").read_text().replace("[224, 224]", "[56, 56]").replace("focal_px: 1000", "focal_px: 250")
    spec = tmp_path / "ring.yaml"
    spec.write_text(text)
    render_set(plan_of(spec, limit=3), tmp_path / "ring", Engine())
    views, ball = read_views(tmp_path / "ring")
    assert len(views) == 3
    assert ball.radius < 26
    half, exponent = np.array([20, 17, 14]), 2 / 0.6
    for view in views:
        points = view.points(true_depth(view))[view.capture.mask]
        value = (np.abs(points / half) ** exponent).sum(axis=1)
        assert (
            np.percentile(np.abs(value - 1), 80) < 0.01
        )  # 0.04 mm; toward the rim a pixel's mean depth lies beside its middle's
        assert np.allclose(pose_of_render(view.capture), view.pose)
    vertices = shapes.build("superquadric", width=40, height=34, depth=28, vertical=0.6, horizontal=0.6).vertices
    assert np.abs((np.abs(vertices / half) ** exponent).sum(axis=1) - 1).max() < 1e-6
