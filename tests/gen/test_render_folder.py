"""Capture folders: any capture comes back bit for bit, and damage is one line."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from gen.capture import Capture, Scale, Truth, read_capture
from gen.capture_lights import KINDS, NEAR
from gen.errors import InputError
from gen.exr import read_exr, write_exr
from gen.formats.render_folder import is_render, read_render, write_render

H, W = 3, 5
any_float = st.floats(width=32)
ARRAYS = ("images", "lights", "intensities", "mask", "faults")


def same(a: Capture, b: Capture) -> None:
    """That two captures agree in every bit of every array, and in all else but their source."""
    for name in ARRAYS:
        left, right = getattr(a, name), getattr(b, name)
        assert left.dtype == right.dtype, name
        assert left.tobytes() == right.tobytes(), name
    assert a.light_kinds == b.light_kinds
    assert (a.positions is None) == (b.positions is None)
    assert a.positions is None or b.positions is None or a.positions.tobytes() == b.positions.tobytes()
    assert a.truth.names() == b.truth.names()
    for name in a.truth.names():
        left, right = getattr(a.truth, name), getattr(b.truth, name)
        assert left.dtype == right.dtype, name
        assert left.shape == right.shape, name
        assert np.array_equal(left, right, equal_nan=left.dtype.kind == "f"), name
    assert (a.names, a.encoding, dict(a.provenance)) == (b.names, b.encoding, dict(b.provenance))
    assert (a.scale.mm_per_pixel, a.scale.distance_mm) == (b.scale.mm_per_pixel, b.scale.distance_mm)
    assert np.array_equal(a.scale.camera, b.scale.camera) if a.scale.camera is not None else b.scale.camera is None


@st.composite
def captures(draw: st.DrawFn) -> Capture:
    K = draw(st.integers(1, 4))

    def floats(*shape: int, low: float = -(2.0**100), high: float = 2.0**100) -> Any:
        return draw(npst.arrays(np.float32, shape, elements=st.floats(low, high, width=32)))

    wild = {"elements": any_float}
    layers: dict[str, Any] = {}
    view = {"normals": (H, W, 3), "depth": (H, W), "albedo": (H, W, 3), "gloss": (H, W), "specular_albedo": (H, W, 3)}
    assert set(view) == set(Truth.PER_VIEW)
    for name, shape in view.items():
        if draw(st.booleans()):
            layers[name] = draw(npst.arrays(np.float32, shape, **wild))
    for name in ("diffuse", "specular", "matte", "ks0", "mirror"):
        if draw(st.booleans()):
            layers[name] = floats(K, H, W, 3)
    if draw(st.booleans()):
        layers["shadow"] = draw(npst.arrays(np.uint8, (K, H, W), elements=st.integers(0, 3)))
    images = draw(npst.arrays(np.float32, (K, H, W, 3), **wild))
    if "diffuse" in layers and "specular" in layers and draw(st.booleans()):
        images = layers["diffuse"] + layers["specular"]
    images[0, 0, 0] = 0.5
    faults = draw(st.one_of(st.none(), npst.arrays(np.uint8, (K, H, W), elements=st.integers(0, 7))))
    if faults is not None:
        faults[0, 0, 0] = 0
    mask = draw(npst.arrays(np.bool_, (H, W)))
    mask[0, 0] = True
    lights = draw(npst.arrays(np.float64, (K, 3), elements=st.floats(-1, 1))) + np.array([0, 0, 2])
    kinds = tuple(draw(st.lists(st.sampled_from(KINDS), min_size=K, max_size=K)))
    places = draw(npst.arrays(np.float64, (K, 3), elements=st.floats(-1e6, 1e6))) + np.array([0, 0, 2e6])
    places[[kind not in NEAR for kind in kinds]] = np.nan
    camera = np.array([[draw(st.floats(1, 1e4)), 0, 1.5], [0, 7.25, 2], [0, 0, 1]])
    number = st.one_of(st.none(), st.floats(1e-6, 1e6))
    return Capture(
        images=images,
        lights=lights,
        intensities=draw(npst.arrays(np.float64, (K, 3), elements=st.floats(1e-6, 1e6))),
        mask=mask,
        faults=faults,
        names=tuple(draw(st.lists(st.text(max_size=8), min_size=K, max_size=K))),
        scale=Scale(draw(number), draw(st.sampled_from([None, camera])), draw(number)),
        truth=Truth(**layers),
        light_kinds=kinds,
        positions=places,
        encoding=draw(st.sampled_from(["linear", "srgb"])),
        provenance=draw(
            st.dictionaries(st.text(max_size=5), st.one_of(st.integers(), st.floats(-1e9, 1e9), st.text(), st.none()), max_size=3)
        ),
    )


@settings(max_examples=60, deadline=None)
@given(captures())
def test_any_capture_comes_back_bit_for_bit(tmp_path_factory: pytest.TempPathFactory, capture: Capture) -> None:
    folder = tmp_path_factory.mktemp("capture") / "c"
    write_render(capture, folder)
    same(capture, read_render(folder))
    shutil.rmtree(folder.parent)


@pytest.fixture
def capture(synthetic: Callable[..., Capture]) -> Capture:
    """A small synthetic cylinder with its truth."""
    return synthetic("cylinder", size=16)


@pytest.fixture
def folder(capture: Capture, tmp_path: Path) -> Path:
    """Its folder."""
    write_render(capture, tmp_path / "c")
    return tmp_path / "c"


def test_a_folder_is_found_and_read_by_name(capture: Capture, folder: Path) -> None:
    assert is_render(folder)
    assert not is_render(folder.parent)
    found = read_capture(folder)
    same(capture, found)
    assert found.source == str(folder)
    with pytest.raises(InputError, match="linear; leave the encoding out"):
        read_capture(folder, "srgb")


def test_the_channels_are_the_documented_ones(capture: Capture, folder: Path) -> None:
    colours = [f"{layer}.{c}" for layer in ("diffuse", "specular", "matte") for c in "RGB"]
    frame = read_exr(folder / "frames" / "002.exr")
    assert set(frame) == {*"RGBA", *colours}
    assert set(read_exr(folder / "view.exr")) == {
        "normal.X",
        "normal.Y",
        "normal.Z",
        "depth.Z",
        *(f"albedo.{c}" for c in "RGB"),
        "gloss.A",
    }
    assert np.array_equal(frame["R"], frame["diffuse.R"] + frame["specular.R"])
    assert np.array_equal(frame["A"] > 0.5, capture.mask)
    assert json.loads((folder / "capture.json").read_text())["pictures"] == "diffuse + specular"


def test_pictures_are_formed_from_their_parts(folder: Path) -> None:
    """What stands in R, G, B does not matter where the index says that the parts sum up (half files round the sum once more)."""
    path = folder / "frames" / "001.exr"
    channels = read_exr(path)
    write_exr(path, {**channels, "R": channels["R"] * 2})
    assert np.array_equal(read_render(folder).images[0, ..., 0], channels["diffuse.R"] + channels["specular.R"])


def test_pictures_that_are_no_sum_are_stored(capture: Capture, tmp_path: Path) -> None:
    assert capture.truth.matte is not None
    twin = capture.with_images(capture.truth.matte)
    write_render(twin, tmp_path / "twin")
    same(twin, read_render(tmp_path / "twin"))


def test_the_same_capture_gives_the_same_bytes(capture: Capture, folder: Path, tmp_path: Path) -> None:
    write_render(capture, tmp_path / "again")
    names = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    assert len(names) == 9
    for name in names:
        assert (folder / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


def test_a_sun_is_stored_as_ever_and_other_lights_with_their_kind(capture: Capture, folder: Path, tmp_path: Path) -> None:
    frames = json.loads((folder / "capture.json").read_text())["frames"]
    assert all(list(frame) == ["name", "file", "direction", "intensity"] for frame in frames)
    kinds = ("sun", "point", "environment", "area", "several")
    places = np.full((5, 3), np.nan)
    places[1], places[3] = (0, 0.1, 200), (1 / 3, 0, 100)
    write_render(replace(capture, light_kinds=kinds, positions=places), tmp_path / "other")
    frames = json.loads((tmp_path / "other" / "capture.json").read_text())["frames"]
    assert [frame.get("kind") for frame in frames] == [None, "point", "environment", "area", "several"]
    assert [frame.get("position_mm") for frame in frames] == [None, [0, 0.1, 200], None, [1 / 3, 0, 100], None]


def test_a_capture_of_the_wrong_shape_leaves_nothing(capture: Capture, tmp_path: Path) -> None:
    wrong = replace(capture, truth=replace(capture.truth, albedo=capture.truth.albedo[..., :2]))  # type: ignore[index]
    with pytest.raises(InputError, match=r"truth 'albedo' has the shape \(16, 16, 2\)"):
        write_render(wrong, tmp_path / "new")
    assert list(tmp_path.iterdir()) == []


def set_in(folder: Path, *keys: Any, to: Any) -> None:
    index = json.loads((folder / "capture.json").read_text())
    part = index
    for key in keys[:-1]:
        part = part[key]
    if to is KeyError:
        del part[keys[-1]]
    else:
        part[keys[-1]] = to
    (folder / "capture.json").write_text(json.dumps(index))


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (("format",), "else", "is not the index of a capture folder of ours"),
        (("version",), 2, "has version 2, this program reads 1"),
        (("frames",), [], "frames must list 1 to 10000 pictures, it lists 0"),
        (("frames",), KeyError, "frames is missing or not a list"),
        (("frames", 1), 3, r"frames\[1\]: must be an object"),
        (("frames", 1, "file"), "../../secret.exr", "leads out of the folder"),
        (("frames", 1, "file"), "/etc/passwd", "leads out of the folder"),
        (("frames", 1, "file"), "frames/009.exr", "009.exr: there is no such file"),
        (("frames", 1, "file"), "mask.png", "mask.png: is not an OpenEXR file"),
        (("frames", 1, "direction"), [0, 0, 0], "light direction 2 has no length"),
        (("frames", 1, "direction"), [0, 0, None], r"frames\[1\]: direction must be three numbers"),
        (("frames", 1, "intensity"), [1, 1, -1], "light intensities must be positive"),
        (("frames", 1, "intensity"), KeyError, r"frames\[1\]: intensity is missing"),
        (("frames", 1, "direction"), [0, 0, 10**400], r"frames\[1\]: direction must be three numbers"),
        (("frames", 1, "kind"), 3, r"frames\[1\]: kind is missing or not a text"),
        (("frames", 1, "kind"), "lamp", "light 2 is of the unknown kind 'lamp'"),
        (("frames", 1, "kind"), "point", "light 2 is of the kind 'point', but has no position"),
        (("frames", 1, "position_mm"), [1, 2, 3], "light 2 has a position, but is of the kind 'sun'"),
        (("frames", 1, "position_mm"), [1, 2], r"frames\[1\]: position_mm must be three numbers"),
        (("mask",), "../m.png", "leads out of the folder"),
        (("mask",), KeyError, "mask is missing or not a text"),
        (("view",), "frames/../../v.exr", "leads out of the folder"),
        (("scale", "mm_per_pixel"), -1, "mm_per_pixel must be a positive number"),
        (("scale", "mm_per_pixel"), "x", "scale.mm_per_pixel must be a number or null"),
        (("scale", "camera"), [[1, 2], [3]], "scale.camera must be a 3x3 matrix"),
        (("scale", "camera"), [[1, 2], [3, 4]], "camera K must be"),
        (("faults",), True, "001.exr: lacks the channels faults.V"),
        (("provenance",), 3, "provenance is missing or not an object"),
    ],
)  # fmt: skip
def test_a_wrong_index_is_one_line(folder: Path, keys: tuple[Any, ...], value: Any, message: str) -> None:
    set_in(folder, *keys, to=value)
    with pytest.raises(InputError, match=message) as error:
        read_render(folder)
    assert str(folder) in str(error.value)


def test_a_symbolic_link_out_of_the_folder_is_refused(folder: Path, tmp_path: Path) -> None:
    shutil.move(folder / "view.exr", tmp_path / "view.exr")
    (folder / "view.exr").symlink_to(tmp_path / "view.exr")
    with pytest.raises(InputError, match="leads out of the folder"):
        read_render(folder)


@pytest.mark.parametrize("name", ["capture.json", "frames/003.exr", "view.exr", "mask.png"])
@pytest.mark.parametrize("keep", [0, 40, 0.5])
def test_a_truncated_file_is_named(folder: Path, name: str, keep: float) -> None:
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data[: int(keep * len(data)) if keep < 1 else int(keep)])
    with pytest.raises(InputError, match=name):
        read_render(folder)


def test_sizes_and_layers_must_agree(folder: Path) -> None:
    path = folder / "frames" / "002.exr"
    channels = read_exr(path)
    write_exr(path, {key: value[:8] for key, value in channels.items()})
    with pytest.raises(InputError, match=r"002.exr: is 16x8 pixels, the first picture is 16x16"):
        read_render(folder)
    write_exr(path, {key: value for key, value in channels.items() if not key.startswith("matte")})
    with pytest.raises(InputError, match=r"002.exr: has the layers \['diffuse', 'specular'\], the first picture has"):
        read_render(folder)
