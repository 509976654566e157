"""The measurement from end to end, over every registered name, on captures whose truth is known."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gen.capture import Capture, Fault, read_capture
from gen.errors import InputError
from gen.exr import read_exr, stack
from recon.compare import LABELS, compare
from recon.metrics import angular_error, eroded
from recon.pipeline import measure
from recon.reconstruct import Settings
from recon.registry import GLOSS, HEIGHT, NORMALS, REPAIR, Registry

Synthetic = Callable[..., Capture]


@pytest.mark.parametrize("registry", [GLOSS, REPAIR, NORMALS, HEIGHT], ids=lambda r: r.kind)
def test_every_name_loads_and_says_what_it_is(registry: Registry) -> None:
    for name, (line, _) in registry.describe().items():
        assert len(line) > 10, name
    for name in registry:
        if name not in ("none", "drop", "true-diffuse", "true-matte"):
            assert "Source" in (registry.load(name).__doc__ or ""), f"{name} names no source"
    with pytest.raises(InputError, match="there are"):
        registry["no such name"]


@pytest.mark.parametrize("gloss", [*GLOSS])
@pytest.mark.parametrize("repair", [*REPAIR])
def test_every_combination_measures(gloss: str, repair: str, synthetic: Synthetic) -> None:
    capture = synthetic("cylinder", 40, alpha=0.3, specular=0.3)
    shape = measure(capture, gloss, repair)
    error = angular_error(shape.normals.normal, capture.truth.normals)[capture.mask]
    assert np.isfinite(error).mean() > 0.99
    assert np.isfinite(shape.height.height[shape.normals.measurable]).all()
    assert shape.consumed == {"none": "pictures", "true-matte": "matte", "group": "matte", "explain": "matte"}.get(
        gloss, "diffuse"
    )
    assert ((shape.weights >= 0) & (shape.weights <= 1)).all()


def test_matte_pictures_give_the_true_shape(synthetic: Synthetic) -> None:
    """Lit by all, nothing removed: the normals and the height of the sphere, to rounding."""
    capture = synthetic("sphere", 64, layer="matte")
    shape = measure(capture, "none", "none")
    lit = capture.mask & (capture.truth.normals @ capture.lights.T > 0).all(-1)
    assert np.nanmax(angular_error(shape.normals.normal, capture.truth.normals)[lit]) < 0.01


def test_comparison_has_the_papers_rows_and_the_ceilings(synthetic: Synthetic) -> None:
    capture = synthetic("cylinder", 64, alpha=0.4618, specular=0.5)
    comparison = compare(measure(capture, repair="telea"))
    assert list(comparison.rows) == list(LABELS)
    figures = comparison.figures()
    mean = {name: row["normals"]["mask"]["mean"] for name, row in figures.items()}
    assert mean["true matte"] < mean["true diffuse"] < mean["glossy"]
    assert figures["glossy"]["gap closed"] == 0
    assert figures["true matte"]["gap closed"] == 1
    assert figures["true matte"]["non-glossy"]["normal MSE"] == 0
    assert figures["true matte"]["non-glossy"]["height MSE"] == 0
    assert figures["glossy"]["non-glossy"]["height MSE"] > figures["true diffuse"]["non-glossy"]["height MSE"] > 0
    # The figure by its definition, from scratch.
    a, b = (comparison.rows[name].normals.normal for name in ("glossy", "true matte"))
    pictures = [np.rint((n + 1) * 127.5)[capture.mask] for n in (a, b)]
    assert figures["glossy"]["non-glossy"]["normal MSE"] == pytest.approx(((pictures[0] - pictures[1]) ** 2).mean())


def test_no_truth_no_errors(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 40)
    bare = Capture(images=capture.images, lights=capture.lights, mask=capture.mask)
    metrics = measure(bare).metrics()
    assert "truth" not in metrics
    assert not any("normals" in row for row in compare(measure(bare)).figures().values())


def test_writes_everything_it_promises(tmp_path: Path, synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 40)
    shape = measure(capture, "chromaticity")
    metrics = shape.write(tmp_path / "out")
    found = {str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*") if p.is_file()}
    wanted = {f"{n}.{e}" for n in ("normal", "height") for e in ("exr", "png")}
    wanted |= {"albedo.exr", "mesh.ply", "mesh.glb", "metrics.json", "report.html", "overview.png", ".degloss"}
    wanted |= {f"{layer}/{k:03d}.{e}" for layer in ("diffuse", "specular") for k in range(1, 6) for e in ("exr", "png")}
    wanted |= {f"defects/{k:03d}.png" for k in range(1, 6)}
    assert found == wanted
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["consumed"] == metrics["consumed"]
    normal = stack(read_exr(tmp_path / "out" / "normal.exr"), "normal", "XYZ")
    assert (normal == shape.normals.normal).all()
    height = read_exr(tmp_path / "out" / "height.exr")["height.Z"]
    assert np.array_equal(height, shape.height.height, equal_nan=True)
    mesh = trimesh.load(tmp_path / "out" / "mesh.glb", force="mesh")
    assert mesh.extents[2] == pytest.approx(np.nanmax(height) - np.nanmin(height), rel=1e-4)
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    shape.write(tmp_path / "out")  # an earlier result is replaced
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_clipped_samples_are_left_out_where_the_lights_suffice(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 48, layer="matte")
    lit = capture.mask & (capture.truth.normals @ capture.lights.T > 0).all(-1)
    top = 0.85 * capture.images.max()
    faults = ((capture.images >= top).any(-1) * int(Fault.CLIPPED)).astype(np.uint8)
    clipped = Capture(
        images=np.minimum(capture.images, top), lights=capture.lights, mask=capture.mask, truth=capture.truth, faults=faults
    )
    errors = {}
    for saturated in ("keep", "drop"):
        shape = measure(clipped, "none", "none", saturated=saturated)
        errors[saturated] = angular_error(shape.normals.normal, capture.truth.normals)[lit & (faults > 0).any(0)]
    assert errors["drop"].mean() < 0.5 * errors["keep"].mean()


def test_missing_samples_never_count(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 48, layer="matte")
    images = capture.images.copy()
    images[2, 10:20] = np.nan
    shape = measure(Capture(images=images, lights=capture.lights, mask=capture.mask, truth=capture.truth), "none", "none")
    lit = capture.mask & (capture.truth.normals @ capture.lights.T > 0).all(-1)
    assert np.nanmax(angular_error(shape.normals.normal, capture.truth.normals)[lit]) < 0.01


@pytest.mark.parametrize("repair", [*REPAIR])
def test_clipped_samples_are_left_out_whatever_the_repair(repair: str, synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 48, layer="matte")
    faults = np.zeros(capture.faults.shape, np.uint8)
    faults[1, 20:24] = Fault.CLIPPED
    clipped = replace(capture, faults=faults)
    there = (faults > 0) & capture.mask
    dropped = measure(clipped, "none", repair)
    assert (dropped.weights[there] == 0).all()
    kept = measure(clipped, "none", repair, saturated="keep")
    assert (kept.weights[there] == 1).all()
    assert not kept.defects.mask.any()
    assert (kept.images == capture.images).all()


def test_shadows_can_be_left_out(synthetic: Synthetic) -> None:
    """Where a light does not reach, least squares errs; without those samples it is exact wherever three lights remain."""
    capture = synthetic("sphere", 64, layer="matte")
    facing = (capture.truth.normals @ capture.lights.T > 0).sum(-1)
    shadowed = capture.mask & (facing < 5)
    error = {
        shadows: angular_error(measure(capture, "none", "none", shadows=shadows).normals.normal, capture.truth.normals)
        for shadows in ("keep", "drop")
    }
    assert error["keep"][shadowed].mean() > 2
    assert np.median(error["drop"][shadowed]) < 0.1


def test_leaving_pixels_out_closes_no_gap(synthetic: Synthetic) -> None:
    """Rows are judged on the pixels that all of them measured."""
    capture = synthetic("cylinder", 48, alpha=0.2, specular=0.4)
    comparison = compare(measure(capture, repair="telea"))
    glossy = comparison.rows["glossy"]
    easy = angular_error(glossy.normals.normal, capture.truth.normals) < 5
    picky = replace(glossy, normals=replace(glossy.normals, measurable=easy, normal=glossy.normals.normal * easy[..., None]))
    rows = {name: picky if name in ("removed", "repaired") else shape for name, shape in comparison.rows.items()}
    figures = replace(comparison, rows=rows).figures()
    assert figures["removed"]["measured"] < 90
    assert figures["removed"].get("gap closed") in (None, 0)


def test_height_without_a_scale_is_judged_in_metres(synthetic: Synthetic) -> None:
    """Pixels have no length of their own: the true heights set the scale, and the error is theirs."""
    capture = synthetic("sphere", 64, layer="matte")
    figures = measure(capture, "none", "none").metrics()
    assert figures["height"]["unit"] == "px"
    true = -capture.truth.depth[capture.mask]
    assert 0 < figures["truth"]["height"]["rmse"] < np.ptp(true)
    assert figures["truth"]["height"]["percent"] == pytest.approx(
        100 * figures["truth"]["height"]["rmse"] / np.ptp(true), rel=1e-4
    )
    assert figures["truth"]["height"]["scale"] == pytest.approx(0.001, rel=0.1)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"gloss": "polish"}, "--gloss polish"),
        ({"repair": "tape"}, "--inpaint tape"),
        ({"normals": "guess"}, "--normals guess"),
        ({"height": "ruler"}, "--height ruler"),
        ({"threshold": "some"}, "--threshold some"),
        ({"threshold": -1.0}, "--threshold -1"),
        ({"threshold": float("nan")}, "--threshold nan"),
        ({"dilate": -1}, "--dilate -1"),
        ({"saturated": "perhaps"}, "--saturated perhaps"),
        ({"shadows": "perhaps"}, "--shadows perhaps"),
    ],
)
def test_wrong_settings_are_refused(wrong: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Settings(**wrong)  # type: ignore[arg-type]


def test_true_layers_need_truth(synthetic: Synthetic) -> None:
    capture = synthetic("sphere", 24)
    bare = Capture(images=capture.images, lights=capture.lights, mask=capture.mask)
    for name in ("true-diffuse", "true-matte"):
        with pytest.raises(InputError, match="needs a rendered capture"):
            measure(bare, name)


@pytest.mark.data
@pytest.mark.parametrize(("name", "published"), [("bear", 8.39), ("cat", 8.41)])
def test_diligent_baseline(data_folder: Path, name: str, published: float) -> None:
    """Least squares on all 96 lights is the published baseline (Shi et al. 2019, Table 3)."""
    capture = read_capture(data_folder / "diligent" / name)
    metrics = measure(capture, "none", "none", "least-squares").metrics()
    assert metrics["lights"] == 96
    assert metrics["truth"]["normals"]["mask"]["mean"] == pytest.approx(published, abs=0.02)


@pytest.mark.data
@pytest.mark.parametrize("name", ["uw_psm/cat.txt", "synthrti_tile/Dome"])
def test_real_pictures_run_through_to_mesh_and_report(data_folder: Path, tmp_path: Path, name: str) -> None:
    """The cat bulges toward the camera; the tile, where few lights are used to save time, has the true relief's orientation."""
    capture = read_capture(data_folder / name)
    capture = capture.select(range(0, capture.count, 4 if capture.count > 20 else 1))
    shape = measure(capture)
    metrics = shape.write(tmp_path / "out")
    assert ("truth" in metrics) == (name != "uw_psm/cat.txt")
    mesh = trimesh.load(tmp_path / "out" / "mesh.ply", force="mesh")
    assert len(mesh.faces) > 1.9 * metrics["pixels"] * 0.95
    assert (tmp_path / "out" / "report.html").stat().st_size < 12_000_000
    height, mask = shape.height.height, capture.mask
    if name == "uw_psm/cat.txt":
        inner = eroded(mask, 20)
        assert height[inner].mean() > np.nanmean(height[mask & ~eroded(mask, 3)])
    else:
        assert metrics["truth"]["normals"]["mask"]["mean"] < 25
