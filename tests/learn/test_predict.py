"""Pictures in, layers of the same kind out: every kind of file, any size, names kept apart, and nothing left behind by a refusal."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from gen.errors import InputError
from gen.exr import unstack, write_exr
from gen.images import read_image, read_raw, write_png
from learn.method import METHODS
from learn.predict import as_stored, distinct_names, predict
from learn.weights import Loaded


def blob(H: int, W: int, seed: int = 0) -> np.ndarray:
    """A smooth linear picture with a highlight, (H, W, 3) in 0..1, nowhere black."""
    y, x = np.mgrid[:H, :W] / max(H, W)
    base = (0.2 + 0.3 * x + 0.1 * np.sin(9 * y + seed))[..., None] * np.array([1, 0.6, 0.4])
    return np.clip(base + 0.6 * np.exp(-(((x - 0.4) ** 2 + (y - 0.3) ** 2) / 0.01))[..., None], 0, 1).astype(np.float32)


def written(path: Path, linear: np.ndarray) -> Path:
    """The picture as the kind of file that the name says: p8, p16, grey, jpg, tif16, tiff (float) or exr."""
    kind, path = path.stem.split("-")[0], path
    if kind == "exr":
        write_exr(path, unstack("", "RGB", linear))
    elif kind == "float":
        tifffile.imwrite(path, linear, photometric="rgb")
    elif kind in ("p16", "tif16"):
        cv2.imwrite(str(path), as_stored(linear, 16, "linear")[..., ::-1])
    elif kind == "grey":
        write_png(path, as_stored(linear, 8, "srgb")[..., 1])
    else:
        cv2.imwrite(str(path), as_stored(linear, 8, "srgb")[..., ::-1])
    return path


KINDS = {
    "p8.png": ("png", 8, "srgb"),
    "p16.png": ("png", 16, "linear"),
    "grey.png": ("png", 8, "srgb"),
    "jpg.jpg": ("png", 8, "srgb"),
    "tif16.tif": ("png", 16, "linear"),
    "float.tiff": ("exr", 32, "linear"),
    "exr.exr": ("exr", 32, "linear"),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", KINDS)
def test_layers_come_as_the_picture_came(networks: dict[str, Loaded], tmp_path: Path, method: str, name: str) -> None:
    source = written(tmp_path / name, blob(29, 34))
    (made,) = predict(networks[method], [source], tmp_path / "out")
    ending, bits, encoding = KINDS[name]
    assert (made.encoding, made.bits, made.size) == (encoding, bits, (29, 34))
    assert list(made.files)[:2] == ["diffuse", "specular"]
    before = read_image(source).linear
    layers = {layer: read_image(tmp_path / "out" / file) for layer, file in made.files.items()}
    for layer in ("diffuse", "specular"):
        assert made.files[layer] == f"{source.stem}-{layer}.{ending}"
        assert (layers[layer].bits, layers[layer].encoding) == (bits, encoding)
    # The sum is the input, but for the rounding of either file: half a step, where sRGB is steepest 1 / 12.92 the least of it.
    step = {8: 2.3 / 255, 16: 1 / 65535, 32: 1e-6}[bits]
    np.testing.assert_allclose(layers["diffuse"].linear + layers["specular"].linear, before, atol=step)
    kept = method == "group" and name == "grey.png"  # one grey picture alone tells it nothing
    assert (layers["specular"].linear.max() > 0) != kept
    assert ("matte" in made.files) == ("confidence" in made.files) == (method == "group")
    said = json.loads((tmp_path / "out" / "prediction.json").read_text())
    assert said["pictures"][0]["files"] == made.files
    assert said["pictures"][0]["size"] == [34, 29]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [(8, 8), (8, 61), (47, 9)])
def test_any_size_from_eight_pixels(networks: dict[str, Loaded], tmp_path: Path, method: str, size: tuple[int, int]) -> None:
    source = written(tmp_path / "p16.png", blob(*size))
    (made,) = predict(networks[method], [source], tmp_path / "out")
    assert read_raw(tmp_path / "out" / made.files["diffuse"]).shape == (*size, 3)


def test_one_pixel_too_small_leaves_nothing(networks: dict[str, Loaded], tmp_path: Path) -> None:
    good, small = written(tmp_path / "p8.png", blob(20, 20)), written(tmp_path / "p8-small.png", blob(7, 30))
    for method in METHODS:
        with pytest.raises(InputError, match=r"p8-small.png.*30x7") as refusal:
            predict(networks[method], [small] if method == "group" else [good, small], tmp_path / "out")
        assert "\n" not in str(refusal.value)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["p8-small.png", "p8.png"]


def test_names_are_kept_apart(networks: dict[str, Loaded], tmp_path: Path) -> None:
    assert distinct_names([Path(p) for p in ("a/x.png", "b/x.jpg", "X.exr", "x-2.png")]) == ["x", "x-3", "X-4", "x-2"]
    (tmp_path / "a").mkdir()
    sources = [written(tmp_path / "p8.png", blob(16, 16)), written(tmp_path / "a" / "p8.png", blob(16, 16, 2))]
    made = predict(networks["specular"], sources, tmp_path / "out")
    files = [file for one in made for file in one.files.values()]
    assert len(set(files)) == 4
    first, second = (read_raw(tmp_path / "out" / one.files["diffuse"]) for one in made)
    assert not np.array_equal(first, second)


def test_outside_the_mask_nothing_changes(networks: dict[str, Loaded], tmp_path: Path) -> None:
    source, mask = written(tmp_path / "p8.png", blob(30, 30)), np.zeros((30, 30), np.uint8)
    mask[8:22, 5:20] = 255
    write_png(tmp_path / "mask.png", mask)
    for method in METHODS:
        (made,) = predict(networks[method], [source], tmp_path / "out", tmp_path / "mask.png")
        diffuse, before = read_raw(tmp_path / "out" / made.files["diffuse"]), read_raw(source)
        np.testing.assert_array_equal(diffuse[mask == 0], before[mask == 0])
        assert (diffuse[mask > 0] != before[mask > 0]).any()


def test_group_takes_pictures_of_one_view(networks: dict[str, Loaded], tmp_path: Path) -> None:
    sources = [written(tmp_path / f"p8-{k}.png", blob(24, 32, k)) for k in range(4)]
    lights = tmp_path / "lights.txt"
    lights.write_text("0 0 2\n1 0 1\n-1 0 1\n0 1 1\n")
    without = predict(networks["group"], sources, tmp_path / "one")
    told = predict(networks["group"], sources, tmp_path / "two", lights=lights)
    assert [one.files["matte"] for one in told] == [f"p8-{k}-matte.png" for k in range(4)]
    a, b = (read_raw(tmp_path / place / told[0].files["matte"]) for place in ("one", "two"))
    assert not np.array_equal(a, b)
    alone = predict(networks["group"], sources[:1], tmp_path / "three")
    assert len(without) == 4
    assert list(alone[0].files) == ["diffuse", "specular", "matte", "confidence"]


def test_refusals(networks: dict[str, Loaded], tmp_path: Path) -> None:
    a, b = written(tmp_path / "p8.png", blob(20, 20)), written(tmp_path / "p8-b.png", blob(20, 24))
    lights, mask, text = tmp_path / "lights.txt", tmp_path / "mask.png", tmp_path / "no.png"
    lights.write_text("0 0 1\n")
    text.write_text("no picture")
    write_png(mask, np.full((5, 5), 255, np.uint8))
    before = sorted(tmp_path.iterdir())
    for method, sources, options, says in (
        ("specular", [], {}, "no pictures"),
        ("specular", [a], {"lights": lights}, "group network"),
        ("specular", [a, tmp_path / "missing.png"], {}, "missing.png"),
        ("specular", [a, text], {}, "no.png"),
        ("specular", [a], {"mask": mask}, "5x5"),
        ("group", [a, b], {}, "one size"),
        ("group", [a, a], {"lights": lights}, "light directions"),
        ("lime", [a], {"encoding": "gamma"}, "gamma"),
    ):
        with pytest.raises(InputError, match=says):
            predict(networks[method], sources, tmp_path / "out", **options)
    with pytest.raises(InputError, match="choose another place"):
        predict(networks["specular"], [a], tmp_path)
    assert sorted(tmp_path.iterdir()) == before
