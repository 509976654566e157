"""DiLiGenT's layout, read by other libraries as published code does, and by ourselves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import imageio.v3 as imageio
import numpy as np
import pytest
from scipy.io import loadmat

from gen.capture import LUMA, Capture, Fault, Scale, read_capture
from gen.convert.diligent import write_diligent
from gen.convert.sixteen_bit import TOP
from gen.formats import detect
from recon.normals.least_squares import least_squares
from tests.gen.convert.conftest import contents


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, glossy: Capture) -> Path:
    place = tmp_path_factory.mktemp("diligent")
    write_diligent(glossy, place)
    return place


def test_published_code_measures_what_we_measure(folder: Path, glossy: Capture) -> None:
    """Files by numpy, cv2 and scipy, divided, made grey and solved as the benchmark's own baseline does, against our solver on floats."""
    names = np.genfromtxt(folder / "filenames.txt", dtype=str)
    L, E = np.loadtxt(folder / "light_directions.txt"), np.loadtxt(folder / "light_intensities.txt")
    mask = cv2.imread(str(folder / "mask.png"), cv2.IMREAD_GRAYSCALE) > 0
    stack = np.stack([cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)[..., ::-1] / 65535 for name in names])
    b = np.linalg.lstsq(L, (stack / E[:, None, None] @ LUMA)[:, mask], rcond=None)[0].T
    found = b / np.linalg.norm(b, axis=1, keepdims=True)

    ours = least_squares(glossy.reflectance(), glossy.lights, glossy.mask, np.ones(glossy.faults.shape, np.float32)).normal[mask]
    assert np.degrees(np.arccos(np.clip((found * ours).sum(1), -1, 1))).max() < 0.05
    truth = loadmat(folder / "Normal_gt.mat")["Normal_gt"]
    assert truth.shape == (32, 32, 3)
    assert truth.dtype == np.float64
    np.testing.assert_array_equal(truth, glossy.truth.normals)
    error = np.degrees(np.arccos(np.clip((found * truth[mask]).sum(1), -1, 1))).mean()
    assert 1 < error < 25  # glossy, but not mirrored, turned, or with its channels swapped


def test_the_files_are_as_programs_that_split_text_want_them(folder: Path, glossy: Capture) -> None:
    assert (folder / "filenames.txt").read_bytes() == b"".join(b"%03d.png\n" % k for k in range(1, 8))
    for name in ("light_directions.txt", "light_intensities.txt"):
        *lines, last = (folder / name).read_text().split("\n")
        assert last == ""
        assert [len(line.split(" ")) for line in lines] == [3] * 7
    rows = np.loadtxt(folder / "normal.txt").reshape(32, 32, 3)
    np.testing.assert_allclose(rows, glossy.truth.normals, atol=1e-7)
    picture = cv2.imread(str(folder / "Normal_gt.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    assert picture.dtype == np.uint16
    np.testing.assert_allclose(picture / TOP * 2 - 1, glossy.truth.normals, atol=2e-5)
    first = cv2.imread(str(folder / "001.png"), cv2.IMREAD_UNCHANGED)
    assert (first.dtype, first.shape) == (np.uint16, (32, 32, 3))
    assert set(np.unique(imageio.imread(folder / "mask.png")).tolist()) == {0, 255}


def test_we_read_it_back(folder: Path, glossy: Capture) -> None:
    assert detect(folder) == "diligent"
    found = read_capture(folder)
    white = 2 ** np.ceil(np.log2(glossy.images.max()))
    np.testing.assert_allclose(found.images * white, glossy.images, atol=0.51 * white / TOP)
    np.testing.assert_array_equal(found.lights, glossy.lights)
    np.testing.assert_array_equal(found.intensities * white, glossy.intensities)
    np.testing.assert_array_equal(found.mask, glossy.mask)
    np.testing.assert_allclose(found.truth.normals, glossy.truth.normals, atol=1e-6)  # type: ignore[arg-type]
    np.testing.assert_array_equal(found.truth.depth, glossy.truth.depth)  # type: ignore[arg-type]
    assert found.scale == glossy.scale
    assert found.encoding == "linear"


def test_faults_and_a_perspective_view_come_back_as_far_as_they_can(tmp_path: Path, faulty: Capture) -> None:
    lost = "; ".join(write_diligent(faulty, tmp_path))
    found = read_capture(tmp_path)
    np.testing.assert_array_equal(found.scale.camera, faulty.scale.camera)  # type: ignore[arg-type]
    assert found.scale.distance_mm == faulty.scale.distance_mm
    clipped, dark = ((found.faults & flag) > 0 for flag in (Fault.CLIPPED, Fault.DARK))
    np.testing.assert_array_equal(np.argwhere(clipped), [[0, 10, 10]])
    assert dark[2, 14, 14]
    assert not dark[1, 12, 12]
    for words in ("lost in the noise", "missing", "below 0", "matte layers", "gloss", "true albedo", "shadows"):
        assert words in lost
    skewed = replace(faulty, scale=Scale(camera=np.array([[800.0, 0, 15], [1, 800, 15], [0, 0, 1]])))
    (tmp_path / "skewed").mkdir()
    assert "the camera's K, which is not of OpenCV's form" in write_diligent(skewed, tmp_path / "skewed")
    assert read_capture(tmp_path / "skewed").scale == Scale()
    (tmp_path / "afar").mkdir()
    assert "the camera's distance" in write_diligent(replace(faulty, scale=Scale(0.125, distance_mm=300)), tmp_path / "afar")


def test_the_same_capture_gives_the_same_bytes(folder: Path, glossy: Capture, tmp_path: Path) -> None:
    write_diligent(glossy, tmp_path)
    assert contents(tmp_path) == contents(folder)
    assert len(contents(folder)) == 17


def test_real_photographs_pass_through_unchanged(data_folder: Path, tmp_path: Path) -> None:
    """Three pictures of DiLiGenT's cat: every number comes back, and the truth."""
    cat, few = data_folder / "diligent" / "cat", tmp_path / "cat"
    few.mkdir()
    for name in ("filenames.txt", "light_directions.txt", "light_intensities.txt"):
        (few / name).write_text("".join((cat / name).read_text().splitlines(keepends=True)[:3]))
    for name in ("mask.png", "normal_gt.npz", "K.txt", "crop.txt", *(few / "filenames.txt").read_text().split()):
        (few / name).write_bytes((cat / name).read_bytes())
    capture = read_capture(few)
    (tmp_path / "again").mkdir()
    assert write_diligent(capture, tmp_path / "again") == ()
    found = read_capture(tmp_path / "again")
    white = capture.intensities[0, 0] / found.intensities[0, 0]
    np.testing.assert_array_equal(found.images * np.float32(white), capture.images)
    np.testing.assert_array_equal(found.faults, capture.faults)
    np.testing.assert_array_equal(found.lights, capture.lights)
    np.testing.assert_array_equal(found.intensities * white, capture.intensities)
    np.testing.assert_array_equal(found.scale.camera, capture.scale.camera)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.truth.normals, capture.truth.normals, atol=1e-6)  # type: ignore[arg-type]
