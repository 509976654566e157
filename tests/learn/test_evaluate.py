"""Figures against hand computations and skimage; a perfect remover closes the gap, doing nothing closes none; packs and sets read alike."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio, structural_similarity

from gen.capture import Capture, Fault, Truth
from gen.errors import InputError
from gen.formats.render_folder import write_render
from gen.sets.pack import ALWAYS, DTYPES, FORMAT, VERSION, header_bytes
from learn.end_to_end import DIFFUSE, GLOSSY, MATTE, measured, pooled
from learn.evaluate import ALL, CLASSICAL, HIGHLIGHT, NOTHING, evaluate, figures_of, sums_of
from learn.evaluation_table import text_of
from learn.slices import Scene, Scenes, colour_of, gloss_level, scenes_of
from learn.table1 import METHODS, PRINTED, table1
from recon.metrics import angular_error
from recon.reconstruct import Settings
from recon.registry import GLOSS, Layers

Synthetic = Callable[..., Capture]
LUMA = np.array([0.2989, 0.5870, 0.1140])


def perfect(capture: Capture) -> Layers:
    return GLOSS.load("true-matte")(capture)


def lazy(capture: Capture) -> Layers:
    return GLOSS.load("none")(capture)


def srgb8(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB by the standard's own formula."""
    x = np.clip(linear.astype(np.float64), 0, 1)
    return np.round(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(np.uint8)


@pytest.fixture(scope="module")
def captures(synthetic: Synthetic) -> list[Capture]:
    """Stacks that differ in shape, gloss and colour; the last has clipped samples."""
    made = [
        synthetic("cylinder", 40, alpha=0.4, specular=0.5),
        synthetic("sphere", 40, alpha=0.2, albedo=(0.5, 0.5, 0.5)),
        synthetic("sphere", 40, alpha=0.1, specular=0.4, albedo=(0.9, 0.85, 0.88)),
    ]
    last = made[2]
    clipped = (last.images >= 1).any(axis=-1)
    made[2] = replace(last, images=np.minimum(last.images, 1), faults=np.where(clipped, int(Fault.CLIPPED), 0).astype(np.uint8))
    return made


def scenes(captures: list[Capture]) -> Scenes:
    def read() -> Iterator[Scene]:
        for i, capture in enumerate(captures):
            yield Scene(f"item-{i}", capture, capture.source.split()[-1], "substrate")

    return Scenes("made here", len(captures), read)


def pack_file(path: Path, captures: list[Capture], splits: list[str], alpha: float | None = 0.25) -> Path:
    """A pack written by hand: the captures' layers as float32, one item each."""
    stacks = {
        "combined": np.concatenate([c.images for c in captures]),
        "valid": np.concatenate([c.valid for c in captures]),
        "lights": np.concatenate([c.lights for c in captures]),
        "intensities": np.concatenate([c.intensities for c in captures]),
        "item": np.concatenate([np.full(c.count, i) for i, c in enumerate(captures)]),
        "mask": np.stack([c.mask for c in captures]),
    }
    for name in ("diffuse", "specular", "matte"):
        stacks[name] = np.concatenate([getattr(c.truth, name) for c in captures])
    for name in ("normals", "depth", "albedo", "gloss"):
        stacks[name] = np.stack([getattr(c.truth, name) for c in captures])
    kinds = {name: {"b": "BOOL", "i": "I32"}.get(array.dtype.kind, "F32") for name, array in stacks.items()}
    ends = np.cumsum([c.count for c in captures]).tolist()
    items = [
        {
            "id": f"i{n}",
            "split": split,
            "shape": "sphere",
            "material": "substrate",
            "alpha": alpha,
            "frames": [end - c.count, end],
        }
        for n, (split, c, end) in enumerate(zip(splits, captures, ends, strict=True))
    ]
    facts = json.dumps({"set": "hand-made", "items": items})
    opening, places = header_bytes(
        {name: (kinds[name], array.shape) for name, array in stacks.items()},
        {"format": FORMAT, "version": VERSION, "facts": facts},
    )
    with path.open("wb") as stream:
        stream.write(opening)
        for name, place in places.items():
            stream.seek(place)
            stream.write(np.ascontiguousarray(stacks[name], DTYPES[kinds[name]]).tobytes())
    assert set(ALWAYS) <= set(stacks)
    return path


def test_doing_nothing_equals_a_hand_computation(captures: list[Capture]) -> None:
    done = evaluate({}, scenes(captures), measure=False)
    row = done.pictures[ALL][ALL][NOTHING]["diffuse"]
    squared, inside, bright, similar = [], [], [], []
    for capture in captures:
        assert capture.truth.diffuse is not None
        assert capture.truth.specular is not None
        for k in range(capture.count):
            a, b = srgb8(capture.images[k]), srgb8(capture.truth.diffuse[k])
            error = (a.astype(float) - b.astype(float)) ** 2
            squared.append(error.ravel())
            inside.append(error[capture.mask].ravel())
            bright.append(error[capture.mask & (capture.truth.specular[k] @ LUMA > HIGHLIGHT)].ravel())
            similar.append(structural_similarity(a, b, channel_axis=2, data_range=255))
    full, mask, light = (float(np.concatenate(part).mean()) for part in (squared, inside, bright))
    assert row["mse"] == pytest.approx(full)
    assert row["mse mask"] == pytest.approx(mask)
    assert row["psnr"] == pytest.approx(10 * np.log10(255**2 / full))
    assert row["psnr highlight"] == pytest.approx(10 * np.log10(255**2 / light))
    assert row["ssim"] == pytest.approx(np.mean(similar))
    assert row["pictures"] == 15
    assert light > mask > full > 0


def test_figures_are_those_of_skimage() -> None:
    rng = np.random.default_rng(0)
    a, b = (rng.uniform(0, 1.2, (30, 40, 3)).astype(np.float32) for _ in range(2))
    mask = rng.random((30, 40)) < 0.4
    figures = figures_of(sums_of(a, b, mask, ~mask))
    x, y = srgb8(a), srgb8(b)
    assert figures["mse"] == pytest.approx(mean_squared_error(x, y))
    assert figures["psnr"] == pytest.approx(peak_signal_noise_ratio(y, x, data_range=255))
    assert figures["ssim"] == pytest.approx(structural_similarity(x, y, channel_axis=2, data_range=255))
    assert figures["mse mask"] == pytest.approx(mean_squared_error(x[mask], y[mask]))
    same = figures_of(sums_of(a, a, mask, np.zeros_like(mask)))
    assert (same["mse"], same["psnr"], same["psnr highlight"], same["ssim"]) == (0, None, None, pytest.approx(1))


def test_a_perfect_remover_closes_the_gap(captures: list[Capture]) -> None:
    done = evaluate({"perfect": perfect, "lazy": lazy}, scenes(captures), Settings(gloss="none", repair="none"))
    rows = done.measurement
    assert rows["perfect"]["gap closed"] == 1
    assert rows["perfect"]["height MSE"] == 0
    assert rows["perfect"]["times smaller"] is None
    assert rows["perfect"]["interval"] == [1, 1]
    assert rows[GLOSSY]["gap closed"] == rows["lazy"]["gap closed"] == 0
    assert rows[GLOSSY]["times smaller"] == 1
    assert 0 < rows[DIFFUSE]["gap closed"] < 1
    assert done.counts == {"captures": 3, "pictures": 15, "captures measured": 3}
    assert done.by_material
    assert all(part["perfect"]["gap closed"] == 1 for part in done.by_material.values())
    pictures = done.pictures[ALL][ALL]
    assert pictures["perfect"]["diffuse"]["mse"] == pictures["perfect"]["matte"]["mse"] == 0
    assert "matte" in pictures[NOTHING]
    assert "matte" not in pictures["bilateral"]
    assert set(pictures) == {NOTHING, *CLASSICAL, "perfect", "lazy"}


def test_the_pooled_gap_and_its_interval_by_hand(captures: list[Capture]) -> None:
    settings = Settings(gloss="none", repair="telea")
    layers = [{"bilateral": GLOSS.load("bilateral")(c)} for c in captures]
    rows = [measured(c, found, settings) for c, found in zip(captures, layers, strict=True)]
    assert set(rows[0]) == {GLOSSY, "bilateral", "bilateral, repaired", DIFFUSE, MATTE}
    by_hand = []
    for capture in captures:  # least squares on the matte layer, from scratch
        y = (capture.truth.matte @ LUMA)[:, capture.mask]
        b = np.linalg.lstsq(capture.lights, y, rcond=None)[0].T
        normal = np.zeros((*capture.size, 3), np.float32)
        normal[capture.mask] = b / np.linalg.norm(b, axis=1, keepdims=True)
        by_hand.append(float(np.nanmean(angular_error(normal, capture.truth.normals)[capture.mask])))
    assert [row[MATTE]["normals"] for row in rows[:2]] == pytest.approx(by_hand[:2], abs=1e-3)  # the third drops clipped samples
    table = pooled(rows, seed=4)
    g, m, t = (np.array([row[name]["normals"] for row in rows]) for name in (GLOSSY, "bilateral", MATTE))
    assert table["bilateral"]["gap closed"] == pytest.approx((g - m).sum() / (g - t).sum())
    low, high = table["bilateral"]["interval"]
    gaps = (g - m) / (g - t)
    assert gaps.min() - 1e-9 <= low <= table["bilateral"]["gap closed"] <= high <= gaps.max() + 1e-9
    assert pooled(rows, seed=4) == table
    assert pooled(rows[:1])["bilateral"]["interval"] is None


def test_slices(captures: list[Capture]) -> None:
    done = evaluate({"perfect": perfect}, scenes(captures), measure=False)
    assert set(done.pictures["colour"]) == {"coloured", "grey", "white"}
    assert set(done.pictures["shape"]) == {"cylinder", "sphere"}
    assert set(done.pictures["clipping"]) == {"clipped", "not clipped"}
    assert set(done.pictures["gloss"]) == {"sheen, > .35", "satin, .15 to .35", "glossy, .05 to .15"}
    assert set(done.pictures["material"]) == {"substrate"}
    for values in done.pictures.values():  # every picture is in one value of each slice
        assert sum(rows[NOTHING]["diffuse"]["pictures"] for rows in values.values()) == 15
    assert [gloss_level(a) for a in (None, 0.01, 0.05, 0.5)] == [
        "unknown",
        "polished, alpha < .05",
        "glossy, .05 to .15",
        "sheen, > .35",
    ]
    assert colour_of(replace(captures[0], truth=Truth())) == "unknown"
    text = text_of(done)
    assert "perfect" in text
    assert "diffuse by colour" in text


def test_what_does_not_apply_is_said(captures: list[Capture]) -> None:
    singles = [captures[0].select([1]), captures[1].select([2])]
    done = evaluate({"lazy": lazy}, scenes(singles))
    assert set(done.pictures[ALL][ALL]) == {NOTHING, "bilateral", "lazy"}
    assert done.measurement == {}
    assert any("low-rank does not apply" in note and "2 of 2" in note for note in done.notes)
    bare = [replace(c, truth=Truth()) for c in captures]
    with pytest.raises(InputError, match="no truth"):
        evaluate({"lazy": lazy}, scenes(bare))
    coplanar = replace(captures[0], lights=np.tile([0, 0, 1.0], (5, 1)))
    assert any("not measured" in note for note in evaluate({}, scenes([coplanar])).notes)


def test_packs_and_captures_read_alike(captures: list[Capture], tmp_path: Path) -> None:
    path = pack_file(tmp_path / "p.safetensors", captures, ["train", "test", "test"])
    read = scenes_of(path)
    assert (read.count, read.split) == (2, "test")
    for scene, capture in zip(scenes_of(path, "all"), captures, strict=True):
        np.testing.assert_array_equal(scene.capture.images, capture.images)
        np.testing.assert_array_equal(scene.capture.valid, capture.valid)
        np.testing.assert_array_equal(scene.capture.truth.matte, capture.truth.matte)
        np.testing.assert_allclose(scene.capture.lights, capture.lights, atol=1e-6)
        assert scene.alpha == 0.25
    assert [scene.name for scene in scenes_of(path, "all", limit=2)] == ["i0", "i2"]
    with pytest.raises(InputError, match=r"'validation'.*test, train"):
        scenes_of(path, "validation")
    with pytest.raises(InputError, match="--limit 0"):
        scenes_of(path, limit=0)
    with pytest.raises(InputError, match="no such file"):
        scenes_of(tmp_path / "nothing")
    write_render(captures[0], tmp_path / "capture")
    (one,) = scenes_of(tmp_path / "capture")
    whole = evaluate({"lazy": lazy}, scenes_of(tmp_path / "capture"), measure=False).pictures[ALL][ALL]["lazy"]["diffuse"]
    direct = evaluate({"lazy": lazy}, scenes(captures[:1]), measure=False).pictures[ALL][ALL]["lazy"]["diffuse"]
    assert one.name == "capture"
    assert whole["mse"] == pytest.approx(direct["mse"])


def test_table1_has_the_papers_rows(captures: list[Capture], tmp_path: Path) -> None:
    singles = [c.select([k]) for c in captures for k in (0, 1)]
    path = pack_file(tmp_path / "p.safetensors", singles, ["train", "test"] * 3)
    removers = {name: perfect if name == "group" else lazy for name in METHODS}
    done = table1(removers, path, path, limit=2)
    rows = done.rows()
    assert list(rows) == [NOTHING, *CLASSICAL, "lime", "specular", "diffuse", "group"]
    assert done.plain()["pictures"] == {"learning": 2, "test": 3}
    for data in ("learning", "test"):
        assert rows["group"][data]["mse"] == 0
        assert rows["lime"][data]["mse"] == rows[NOTHING][data]["mse"] > 0
        assert rows["low-rank"][data]["mse"] is None
    assert {name: tuple(rows[name]["paper"].values()) for name in PRINTED} == dict(PRINTED)
    assert "134.20" in done.text()
    assert "(d) group" in done.text()
    by_hand = np.mean(
        [((srgb8(c.images[0]).astype(float) - srgb8(c.truth.diffuse[0]).astype(float)) ** 2).mean() for c in singles[1::2]]
    )
    assert rows[NOTHING]["test"]["mse"] == pytest.approx(by_hand)
    figure = done.figure()
    assert figure.dtype == np.uint8
    assert figure.shape[1] == 6 + 6 * 182
    assert len({tuple(colour) for colour in figure.reshape(-1, 3)}) > 100
    alone = table1(removers, None, path)
    assert list(alone.data) == ["test"]
