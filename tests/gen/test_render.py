"""From spec to capture: real renders against the reference BRDF and closed-form geometry; exposure and clipping on plain arrays."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.assemble import PER_VIEW, assemble
from gen.capture import Capture, Fault, grey, read_capture
from gen.errors import InputError
from gen.farm import Farm
from gen.render import RenderFailed, jobs_of, load_shot, render, render_capture
from gen.spec import Spec, read_spec, spec_from
from gen.substrate import shade

SMALL: dict[str, Any] = {
    "name": "small",
    "resolution": [48, 40],
    "shape": {"name": "sphere", "radius": 14},
    "material": {"albedo": [0.2, 0.35, 0.5], "specular": 0.3, "alpha": 0.25},
    "lights": [[0, 0, 1], {"direction": [3, 0, 4], "intensity": [1, 2, 0.5]}, [0, 3, 4]],
    "camera": {"kind": "orthographic", "width_mm": 36},
    "exposure": 1.0,
}


def spec_with(**changes: Any) -> Spec:
    return spec_from({**SMALL, **changes}, "test")


@pytest.fixture(scope="module")
def farm() -> Any:
    """One worker for all tests of this module."""
    with Farm() as opened:
        yield opened


def digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


def mean_angle(capture: Capture, images: np.ndarray) -> float:
    """Mean error in degrees of plain least squares on all pictures (Woodham 1980)."""
    assert capture.truth.normals is not None
    y = grey(capture.reflectance(images))[:, capture.mask]
    b = np.linalg.lstsq(capture.lights, y, rcond=None)[0].T
    cosine = (b * capture.truth.normals[capture.mask]).sum(axis=1) / np.linalg.norm(b, axis=1)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


@pytest.mark.render
def test_the_layers_are_the_reference_brdf(farm: Farm) -> None:
    capture = render(spec_with(exposure=0.7), farm=farm).capture
    truth, mask = capture.truth, capture.mask
    assert truth.normals is not None
    n = truth.normals[mask].astype(np.float64)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    rd, rs = np.array(SMALL["material"]["albedo"]), np.full(3, SMALL["material"]["specular"])
    for k in range(capture.count):
        expected = shade(n, capture.lights[k], np.array([0.0, 0.0, 1.0]), rd, rs, SMALL["material"]["alpha"])
        for name, layer in zip(("diffuse", "specular", "matte"), expected, strict=True):
            found = getattr(truth, name)[k][mask]
            assert found == pytest.approx(layer * capture.intensities[k], abs=2e-5 * max(1.0, float(layer.max()))), (name, k)
    assert capture.intensities == pytest.approx(0.7 * np.array([[1, 1, 1], [1, 2, 0.5], [1, 1, 1]]))


@pytest.mark.render
def test_the_view_is_a_sphere(farm: Farm) -> None:
    capture = render(spec_with(pose={"translation_mm": [2, -3, 5]}), farm=farm).capture
    truth = capture.truth
    assert capture.scale.mm_per_pixel == 0.75
    assert capture.scale.distance_mm == 995
    y, x = np.mgrid[:40, :48]
    X, Y = (x - 23.5) * 0.75 - 2, (19.5 - y) * 0.75 + 3
    inside = X**2 + Y**2 < 13.8**2
    assert capture.mask[inside].all()
    assert not capture.mask[X**2 + Y**2 > 14.2**2].any()
    Z = np.sqrt(14**2 - X[inside] ** 2 - Y[inside] ** 2)
    assert truth.normals is not None
    assert truth.depth is not None
    assert truth.albedo is not None
    assert truth.gloss is not None
    assert truth.normals[inside] == pytest.approx(np.stack([X[inside], Y[inside], Z], axis=1) / 14, abs=2e-3)
    # The mesh's facets lie up to radius (pi / segments)^2 within the sphere, more along the line of sight near the rim.
    middle = inside & (X**2 + Y**2 < 10**2)
    assert truth.depth[middle] == pytest.approx((995 - np.sqrt(14**2 - X[middle] ** 2 - Y[middle] ** 2)) / 1000, abs=2e-6)
    assert np.isnan(truth.depth[~capture.mask]).all()
    assert not truth.normals[~capture.mask].any()
    assert truth.albedo[capture.mask] == pytest.approx(np.tile(SMALL["material"]["albedo"], (capture.mask.sum(), 1)), abs=1e-6)
    assert np.unique(truth.gloss[capture.mask]) == pytest.approx(0.25)


@pytest.mark.render
def test_a_perspective_view_obeys_k(farm: Farm) -> None:
    K = [[70, 0, 22], [0, 70, 21], [0, 0, 1]]
    rendered = render(spec_with(camera={"kind": "perspective", "distance_mm": 80, "K": K}, supersampling=4), farm=farm)
    capture = rendered.capture
    assert capture.scale.camera is not None
    assert capture.scale.camera.tolist() == K
    assert capture.scale.distance_mm == 80
    # A sphere on the axis is seen as a disc of tangent radius f R / sqrt(d^2 - R^2) about the principal point.
    y, x = np.nonzero(capture.mask)
    assert (x.mean(), y.mean()) == pytest.approx((22, 21), abs=0.1)
    assert np.sqrt(rendered.coverage.sum() / np.pi) == pytest.approx(70 * 14 / np.sqrt(80**2 - 14**2), rel=0.005)
    assert capture.truth.depth is not None
    assert capture.truth.depth[21, 22] == pytest.approx(0.066, abs=5e-5)


@pytest.mark.render
def test_light_comes_from_where_it_is_said(farm: Farm) -> None:
    capture = render(spec_with(), farm=farm).capture
    picture = grey(capture.images)
    assert picture[1, :, 24:].sum() > 1.5 * picture[1, :, :24].sum()  # from +x: the right side
    assert picture[2, :20].sum() > 1.5 * picture[2, 20:].sum()  # from +y: the upper side


@pytest.mark.render
def test_the_same_spec_gives_the_same_bytes_with_any_workers(farm: Farm, tmp_path: Path) -> None:
    spec = spec_with(supersampling=2, exposure="auto")
    first = render_capture(spec, tmp_path / "a", farm=farm)
    render_capture(spec, tmp_path / "b", workers=3)
    assert digests(tmp_path / "a") == digests(tmp_path / "b")
    found = read_capture(tmp_path / "a")
    for name in ("images", "lights", "intensities", "mask", "faults"):
        assert np.array_equal(getattr(found, name), getattr(first.capture, name)), name
    for name in first.capture.truth.names():
        assert np.array_equal(getattr(found.truth, name), getattr(first.capture.truth, name), equal_nan=True), name
    assert found.provenance == first.capture.provenance
    assert read_spec(tmp_path / "a" / "spec.yaml") == spec
    assert spec_from(found.provenance["spec"], "x") == spec


@pytest.mark.render
def test_progress_counts_pictures(farm: Farm) -> None:
    seen: list[tuple[int, int]] = []
    render(spec_with(), farm=farm, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (3, 3)
    assert seen == sorted(seen)


@pytest.mark.render
def test_nothing_in_view_is_one_line_and_no_folder(farm: Farm, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"small: the object is not in the picture; check pose.translation_mm"):
        render_capture(spec_with(pose={"translation_mm": [500, 0, 0]}), tmp_path / "a", farm=farm)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.render
def test_a_light_from_behind_leaves_the_object_black(farm: Farm) -> None:
    with pytest.raises(InputError, match="small: exposure: the object is black"):
        render(spec_with(lights=[[0, 0, -1]], exposure="auto"), farm=farm)


@pytest.mark.render
def test_a_folder_of_someone_else_is_not_replaced(farm: Farm, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="is not an earlier capture"):
        render_capture(spec_with(), tmp_path, farm=farm)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.render
def test_the_papers_cylinder(farm: Farm) -> None:
    """What least squares gives on the three layers, as an independent renderer of the same scene found."""
    capture = render(spec_from({**read_spec("paper-cylinder").plain(), "resolution": [128, 128]}, "x"), farm=farm).capture
    assert capture.truth.matte is not None
    assert capture.truth.diffuse is not None
    assert mean_angle(capture, capture.truth.matte) == pytest.approx(1.25, abs=0.1)
    assert mean_angle(capture, capture.truth.diffuse) == pytest.approx(4.5, abs=0.1)
    assert mean_angle(capture, capture.images) == pytest.approx(15.1, abs=0.4)
    assert not (capture.faults & Fault.CLIPPED).any()
    dark = (capture.faults & Fault.DARK) > 0
    assert (dark == (capture.images == 0).all(axis=3)).all()


# Exposure and clipping need no renderer: `assemble` takes a worker's arrays.


def shots(count: int = 3, seed: int = 0) -> list[dict[str, np.ndarray]]:
    rng = np.random.default_rng(seed)
    H, W = 40, 48
    diffuse, specular = rng.random((2, count, H, W, 3), dtype=np.float32)
    view = {
        "coverage": (rng.random((H, W)) > 0.3).astype(np.float32),
        "normal": np.tile(np.float32([0, 0, 1]), (H, W, 1)),
        "depth": np.full((H, W), 1000, np.float32),
        "albedo": np.ones((H, W, 3), np.float32),
        "gloss": np.ones((H, W), np.float32),
    }
    lit = np.ones((count, H, W), np.float32)
    box = np.array([0, 0, W, H])
    return [{**view, "diffuse": diffuse, "specular": specular, "matte": diffuse * np.float32(1.2), "lit": lit, "box": box}]


@pytest.mark.parametrize(("percentile", "level"), [(90, 0.6), (100, 1.0), (50, 0.1)])
def test_automatic_exposure_is_one_for_the_capture(percentile: float, level: float) -> None:
    spec = spec_with(exposure={"percentile": percentile, "level": level})
    capture = assemble(spec, shots(), {}).capture
    bright = np.percentile(grey(capture.images)[:, capture.mask], percentile)
    assert bright == pytest.approx(level, rel=0.006)  # three digits
    plain = assemble(spec_with(exposure=1.0), shots(), {}).capture
    for name in ("diffuse", "specular", "matte"):
        ratio = getattr(capture.truth, name)[0, 5, 5] / getattr(plain.truth, name)[0, 5, 5]
        assert ratio == pytest.approx(capture.provenance["exposure"], rel=1e-6)
    assert capture.reflectance() == pytest.approx(plain.reflectance(), rel=1e-6)
    assert np.array_equal(capture.images, capture.truth.diffuse + capture.truth.specular)  # type: ignore[operator]


def test_nothing_is_clipped_unless_asked_for() -> None:
    loud = assemble(spec_with(exposure=5.0), shots(), {}).capture
    assert loud.images.max() > 1
    assert loud.valid.all()
    cut = assemble(spec_with(exposure=5.0, clip=True), shots(), {}).capture
    assert cut.images.max() == 1
    assert np.array_equal(cut.faults == Fault.CLIPPED, (loud.images >= 1).any(axis=3))
    assert np.array_equal(cut.truth.specular, loud.truth.specular)  # type: ignore[arg-type]


@pytest.mark.parametrize("workers", [1, 2, 3, 7])
@pytest.mark.parametrize("resolution", [[16, 16], [256, 256], [1000, 1000]])
def test_jobs_hold_every_light_once_and_in_order(workers: int, resolution: list[int], tmp_path: Path) -> None:
    spec = spec_with(resolution=resolution, lights={"pattern": "hemisphere", "count": 10})
    jobs = jobs_of(spec, tmp_path, workers)
    directions = [light["direction"] for job in jobs for light in job["lights"]]
    assert np.array_equal(directions, spec.light_directions())
    assert max(len(job["lights"]) for job in jobs) <= -(-10 // workers)
    assert len({job["id"] for job in jobs}) == len({job["out"] for job in jobs}) == len(jobs)


@pytest.mark.parametrize(("samples", "off", "fits"), [(1, 9e-7, True), (1, 1.1e-6, False), (32, 1.1e-6, True), (32, 4e-6, False)])
def test_a_picture_of_many_samples_may_round_more_often(samples: int, off: float, fits: bool, tmp_path: Path) -> None:
    path = tmp_path / "shot.npz"
    np.savez(path, sum_error=np.array([off]), box=np.array([0, 0, 2, 2]), **dict.fromkeys(PER_VIEW, np.zeros((2, 2))))
    spec = spec_with(resolution=[2, 2])
    job = {"id": "1", "out": str(path), "lights": [], "layers": [], "crop": True, "samples": samples}
    if fits:
        assert load_shot(spec, job)["sum_error"] == off
    else:
        with pytest.raises(RenderFailed, match="differs from diffuse"):
            load_shot(spec, job)
