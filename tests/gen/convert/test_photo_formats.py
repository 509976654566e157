"""The two formats with a capture.yaml: pictures that other libraries open, and that come back as the same capture."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest

from gen.capture import Capture, Fault, Scale, read_capture
from gen.convert.exr import write_exr_files
from gen.convert.png16 import write_png16
from gen.convert.sixteen_bit import TOP
from gen.errors import InputError
from gen.formats import detect
from tests.gen.convert.conftest import contents

WRITERS = {"png16": write_png16, "exr": write_exr_files}


@pytest.fixture(params=WRITERS)
def format(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def white_of(folder: Path) -> float:
    return float(json.loads((folder / "conversion.json").read_text())["white"])


def test_a_capture_comes_back(tmp_path: Path, glossy: Capture, format: str) -> None:
    lost = WRITERS[format](glossy, tmp_path)
    assert set(lost) == ({"gloss", "shadows"} if format == "png16" else set())
    assert detect(tmp_path) == "photos"
    found, white = read_capture(tmp_path), white_of(tmp_path)
    np.testing.assert_allclose(found.images * white, glossy.images, atol=0.51 * white / TOP if format == "png16" else 0)
    np.testing.assert_array_equal(found.lights, glossy.lights)
    np.testing.assert_array_equal(found.intensities * white, glossy.intensities)
    np.testing.assert_array_equal(found.mask, glossy.mask)
    np.testing.assert_allclose(found.truth.normals, glossy.truth.normals, atol=3e-5)  # type: ignore[arg-type]
    np.testing.assert_array_equal(found.truth.depth, glossy.truth.depth)  # type: ignore[arg-type]
    assert found.scale == glossy.scale
    assert found.encoding == "linear"


def test_a_camera_faults_and_near_lights_come_back(tmp_path: Path, faulty: Capture, format: str) -> None:
    places = faulty.lights * np.linspace(1e-3, 900, 7)[:, None]
    near = replace(faulty, light_kinds=("point",) * 7, positions=places, lights=places)
    lost = "; ".join(WRITERS[format](near, tmp_path))
    found = read_capture(tmp_path)
    np.testing.assert_array_equal(found.scale.camera, faulty.scale.camera)  # type: ignore[arg-type]
    assert found.scale.distance_mm == 512.5
    assert found.light_kinds == near.light_kinds
    np.testing.assert_array_equal(found.positions, near.positions)  # type: ignore[arg-type]
    missing, clipped = ((found.faults & flag) > 0 for flag in (Fault.MISSING, Fault.CLIPPED))
    np.testing.assert_array_equal(np.argwhere(missing), [[2, 14, 14]])
    np.testing.assert_array_equal(np.argwhere(clipped), [[0, 10, 10]] if format == "png16" else np.empty((0, 3)))
    assert "lost in the noise" in lost
    assert ("clipped" in lost) == (format == "exr")
    assert "missing" not in lost
    assert "near" not in lost


@pytest.mark.parametrize(
    ("kinds", "words"),
    [
        (("area",) * 7, "that near lights are discs"),
        (("point",) + ("sun",) * 6, "that lights are near, and where they stand"),
        (("environment",) + ("sun",) * 6, "that light comes from many directions"),
    ],
)
def test_what_capture_yaml_cannot_say_of_lights_is_told_and_kept(
    tmp_path: Path, glossy: Capture, kinds: tuple[str, ...], words: str
) -> None:
    places = np.where(np.isin(kinds, ("area", "point"))[:, None], glossy.lights * 300, np.nan)
    assert words in write_exr_files(replace(glossy, light_kinds=kinds, positions=places), tmp_path)
    frames = json.loads((tmp_path / "conversion.json").read_text())["frames"]
    assert tuple(frame["kind"] for frame in frames) == kinds
    assert [k for k, frame in enumerate(frames) if "position_mm" in frame] == [k for k, p in enumerate(places) if p[0] == p[0]]
    np.testing.assert_allclose(read_capture(tmp_path).lights, glossy.lights, atol=1e-12)


def test_layers_lie_beside_the_pictures_on_one_scale(tmp_path: Path, glossy: Capture) -> None:
    write_png16(glossy, tmp_path)
    white = white_of(tmp_path)
    for name in ("diffuse", "specular", "matte"):
        picture = cv2.imread(str(tmp_path / name / "003.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
        assert picture.dtype == np.uint16
        np.testing.assert_allclose(picture / TOP * white, getattr(glossy.truth, name)[2], atol=0.51 * white / TOP)
    albedo = cv2.imread(str(tmp_path / "albedo.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    np.testing.assert_allclose(albedo / TOP, glossy.truth.albedo, atol=1e-5)


def test_exrs_are_read_by_opencv_and_openexr(tmp_path: Path, glossy: Capture) -> None:
    write_exr_files(glossy, tmp_path)
    layers = {"001.exr": glossy.images[0], **{f"{n}.exr": getattr(glossy.truth, n) for n in ("normals", "albedo", "gloss")}}
    layers |= {f"{n}/004.exr": getattr(glossy.truth, n)[3] for n in ("diffuse", "specular", "matte", "shadow")}
    depth = np.nan_to_num(glossy.truth.depth)
    names = [*layers, "depth.exr"]
    # OpenCV is built with EXR and reads it only where the environment says so.
    code = "import sys, cv2, numpy as np; np.savez(sys.argv[1], **{n: cv2.imread(n, cv2.IMREAD_UNCHANGED) for n in sys.argv[2:]})"
    environment = {**os.environ, "OPENCV_IO_ENABLE_OPENEXR": "1"}
    subprocess.run([sys.executable, "-c", code, "read.npz", *names], cwd=tmp_path, env=environment, check=True)
    with np.load(tmp_path / "read.npz") as read:
        for name, layer in {**layers, "depth.exr": depth}.items():
            pixels = read[name]
            np.testing.assert_array_equal(pixels[..., ::-1] if pixels.ndim == 3 else pixels, layer, err_msg=name)
    with OpenEXR.File(str(tmp_path / "matte" / "004.exr"), separate_channels=True) as file:
        assert set(file.channels()) == {"R", "G", "B"}
        assert len(file.parts) == 1


def test_nothing_of_this_machine_stands_in_it(tmp_path: Path, glossy: Capture, format: str) -> None:
    """No path of the source, no name of a picture that leads elsewhere is used as a name; what they said is kept as text."""
    (tmp_path / "a").mkdir()
    WRITERS[format](replace(glossy, source="/home/someone/captures/x"), tmp_path / "a")
    assert not [name for name, data in contents(tmp_path).items() if b"/home/someone" in data]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    about = json.loads((tmp_path / "a" / "conversion.json").read_text())
    assert [frame["name"] for frame in about["frames"]] == list(glossy.names)
    assert about["provenance"]["spec"]["shape"]["file"] == "part.glb"


def test_the_same_capture_gives_the_same_bytes(tmp_path: Path, glossy: Capture, format: str) -> None:
    for place in (tmp_path / "a", tmp_path / "b"):
        place.mkdir()
        WRITERS[format](glossy, place)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_what_capture_yaml_refuses_is_one_line(tmp_path: Path, glossy: Capture, format: str) -> None:
    strong = replace(glossy, intensities=np.full((7, 3), 1e12))
    with pytest.raises(InputError, match=r"cannot be said in capture.yaml: intensities.*must lie within 1e\+09"):
        WRITERS[format](strong, tmp_path)


def test_the_distance_of_an_orthographic_camera_is_told(tmp_path: Path, glossy: Capture, format: str) -> None:
    assert "the camera's distance" in WRITERS[format](replace(glossy, scale=Scale(0.125, distance_mm=300)), tmp_path)
    assert read_capture(tmp_path).scale == Scale(0.125)
    assert json.loads((tmp_path / "conversion.json").read_text())["scale"]["distance_mm"] == 300


def test_a_skewed_camera_is_told(tmp_path: Path, glossy: Capture) -> None:
    skewed = replace(glossy, scale=Scale(camera=np.array([[800.0, 2, 15], [0, 800, 15], [0, 0, 1]]), distance_mm=300))
    assert "the camera's K, which has a skew" in write_exr_files(skewed, tmp_path)
    assert read_capture(tmp_path).scale == Scale()


def test_white_is_not_for_floats(tmp_path: Path, glossy: Capture) -> None:
    with pytest.raises(InputError, match="--white 2: is for 16-bit formats"):
        write_exr_files(glossy, tmp_path, 2)
    write_png16(glossy, tmp_path, 0.5)
    assert white_of(tmp_path) == 0.5
    found = read_capture(tmp_path)
    clipped = (found.faults & Fault.CLIPPED) > 0
    np.testing.assert_array_equal(clipped, (glossy.images > 0.5).any(axis=-1))
    np.testing.assert_allclose(found.images[~clipped] * 0.5, glossy.images[~clipped], atol=1e-5)
