"""Every kind of capture folder: made here from one known scene, and the real sets where they are."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from gen.capture import Capture, Fault, grey, read_capture
from gen.errors import InputError
from gen.exr import write_exr
from gen.formats import READERS, detect, read
from gen.formats.render_folder import write_render
from gen.formats.tables import natural
from gen.formats.truth import NORMALS, read_truth
from gen.images import write_png

Synthetic = Callable[..., Capture]


def table(path: Path, rows: np.ndarray, head: str = "") -> None:
    path.write_text(head + "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in np.atleast_2d(rows)))


def sixteen(images: np.ndarray) -> np.ndarray:
    return np.round(np.clip(images, 0, 1) * 65535).astype(np.uint16)


def write_folder(kind: str, folder: Path, scene: Capture) -> Path:
    """The scene's pictures, lights, mask and normals in the layout `kind`; returns what a user names."""
    assert scene.truth.normals is not None
    normals = np.round((scene.truth.normals + 1) / 2 * 65535).astype(np.uint16)
    mask = scene.mask.astype(np.uint8) * 255
    if kind == "render":
        write_render(scene, folder)
        return folder
    folder.mkdir(parents=True)
    names = [f"shot{k + 1}.png" for k in range(scene.count)]
    for name, image in zip(names, scene.images, strict=True):
        write_png((folder / "thing" if kind == "psm" else folder) / name, sixteen(image))
    if kind == "diligent":
        (folder / "filenames.txt").write_text("\n".join(names) + "\n")
        table(folder / "light_directions.txt", scene.lights)
        table(folder / "light_intensities.txt", scene.intensities)
        write_png(folder / "Normal_gt.png", normals)
    elif kind == "rti":
        lines = [f"{folder.name}/{name} {x:.9f} {y:.9f} {z:.9f}" for name, (x, y, z) in zip(names, scene.lights, strict=True)]
        (folder / "dirs.lp").write_text(f"{len(lines)}\n" + "\n".join(lines))
        write_png(folder / "normals.png", normals)
    elif kind == "psm":
        write_png(folder / "thing" / "thing.mask.png", mask)
        write_png(folder / "thing" / "normals.png", normals)
        listed = [f"psmImages/thing/{name}" for name in [*names, "thing.mask.png"]]
        (folder / "thing.txt").write_text(f"{len(names)}\n" + "\n".join(listed) + "\n")
        table(folder / "lights.txt", scene.lights, f"{len(names)}\n")
        return folder / "thing"
    elif kind == "photos":
        says = {"images": "shot*.png", "lights": {"directions": scene.lights.tolist()}, "intensities": "equal"}
        (folder / "capture.yaml").write_text(json.dumps(says))
        write_png(folder / "normals.png", normals)
    else:
        table(folder / "lights.txt", scene.lights)
        write_png(folder / "normals.png", normals)
    write_png(folder / "mask.png", mask)
    return folder


@pytest.mark.parametrize("kind", list(READERS))
def test_every_format_gives_back_the_scene(tmp_path: Path, synthetic: Synthetic, kind: str) -> None:
    lights = np.random.default_rng(5).normal((0, 0, 4), 1, (12, 3))
    scene = synthetic(
        size=24, lights=lights / np.linalg.norm(lights, axis=1, keepdims=True), specular=np.full(3, 0.05), alpha=0.5
    )
    assert 0.3 < scene.images.max() < 1
    path = write_folder(kind, tmp_path / "capture", scene)
    assert detect(path) == kind
    found = read_capture(path)
    assert found.count == 12
    np.testing.assert_allclose(found.images, scene.images, atol=1e-5)
    np.testing.assert_allclose(found.lights, scene.lights, atol=1e-7)
    np.testing.assert_array_equal(found.mask, scene.mask)
    assert found.truth.normals is not None
    assert scene.truth.normals is not None
    np.testing.assert_allclose(found.truth.normals, scene.truth.normals, atol=1e-4)
    assert (found.truth.normals[~scene.mask] == 0).all()
    assert found.source == str(path)
    assert found.encoding == "linear"
    np.testing.assert_array_equal(read(path, format=kind).images, found.images)
    dark = (found.faults & Fault.DARK) > 0
    assert not dark[found.images.max(axis=3) > 0].any()


def test_what_is_not_known_is_said_in_one_line(tmp_path: Path) -> None:
    for name in ("render", "filenames.txt", ".lp", "psmImages", "lights.txt"):
        with pytest.raises(InputError, match="not a capture that is known") as error:
            detect(tmp_path)
        assert name in str(error.value)
    with pytest.raises(InputError, match="no such file or folder"):
        read_capture(tmp_path / "absent")
    with pytest.raises(InputError, match="no such file or folder"):
        read(tmp_path / "absent", format="plain")
    with pytest.raises(InputError, match=r"format 'exif' is unknown; there are render, photos, diligent"):
        read(tmp_path, format="exif")
    with pytest.raises(InputError, match="srgb or linear"):
        read_capture(tmp_path, "log")
    (tmp_path / "a.png").write_bytes(b"x")
    with pytest.raises(InputError, match="is a file"):
        read_capture(tmp_path / "a.png")


def test_a_render_folder_is_always_linear(tmp_path: Path, synthetic: Synthetic) -> None:
    path = write_folder("render", tmp_path / "r", synthetic(size=12, specular=np.full(3, 0.05)))
    assert read_capture(path, "linear").encoding == "linear"
    with pytest.raises(InputError, match="which is linear"):
        read_capture(path, "srgb")


# Plain folders


@pytest.fixture
def plain(tmp_path: Path, synthetic: Synthetic) -> Path:
    """Twelve 8-bit pictures 1.png to 12.png, each of one grey value equal to its number, with lights.txt."""
    for k in range(1, 13):
        write_png(tmp_path / f"{k}.png", np.full((4, 6, 3), k, np.uint8))
    table(tmp_path / "lights.txt", LIGHTS)
    return tmp_path


LIGHTS = np.stack([np.cos(np.arange(12)), np.sin(np.arange(12)), np.full(12, 1.5)], 1)


def numbers_of(capture: Capture) -> list[int]:
    """The grey value, 0 to 255, of each picture of the `plain` fixture that was read with encoding linear."""
    return [round(float(v) * 255) for v in capture.images[:, 0, 0, 0]]


def test_pictures_are_taken_as_people_count(plain: Path) -> None:
    assert numbers_of(read_capture(plain, "linear")) == list(range(1, 13))
    assert sorted(["b10", "b9", "B1", "a", "10", "9"], key=natural) == ["9", "10", "a", "B1", "b9", "b10"]


def test_without_a_mask_the_whole_frame_is_taken_and_the_record_says_so(plain: Path) -> None:
    capture = read_capture(plain)
    assert capture.mask.all()
    assert "whole frame" in capture.provenance["mask"]
    assert capture.provenance["encoding"] == "srgb (default of 8-bit files)"
    rgba = np.full((4, 6, 4), 255, np.uint8)
    rgba[:, 0, 3] = 0
    for k in range(1, 13):
        write_png(plain / f"{k}.png", rgba)
    assert read_capture(plain).mask.tolist() == [[False] + [True] * 5] * 4


def test_three_rows_of_k_numbers_are_the_same_lights(plain: Path) -> None:
    wanted = read_capture(plain).lights
    table(plain / "lights.txt", LIGHTS.T)
    np.testing.assert_allclose(read_capture(plain).lights, wanted, atol=1e-8)
    (plain / "lights.txt").rename(plain / "light_directions.txt")
    np.testing.assert_allclose(read_capture(plain).lights, wanted, atol=1e-8)
    (plain / "light_directions.txt").write_text("\n".join(",".join(map(str, row)) for row in LIGHTS.T))
    np.testing.assert_allclose(read_capture(plain).lights, wanted, atol=1e-8)


def test_three_lights_are_read_as_rows(plain: Path) -> None:
    for k in range(4, 13):
        (plain / f"{k}.png").unlink()
    rows = np.array([[0.5, 0, 1], [0, 0.25, 1], [-0.75, 0.1, 1]])
    table(plain / "lights.txt", rows)
    np.testing.assert_allclose(read_capture(plain).lights, rows / np.linalg.norm(rows, axis=1, keepdims=True), atol=1e-8)


def test_a_table_with_names_says_which_pictures_and_in_which_order(plain: Path) -> None:
    write_png(plain / "with blanks.png", np.full((4, 6, 3), 99, np.uint8))
    (plain / "lights.txt").write_text("# name x y z\n7.png 0 0 2\nwith blanks.png 1, 0, 1\n2.png 0 1 1\n")
    capture = read_capture(plain, "linear")
    assert numbers_of(capture) == [7, 99, 2]
    assert capture.names == ("7.png", "with blanks.png", "2.png")
    np.testing.assert_allclose(capture.lights[1], np.array([1, 0, 1]) / np.sqrt(2))
    assert capture.provenance["not_in_the_table"] == ["1.png", *(f"{k}.png" for k in (3, 4, 5, 6, 8, 9, 10, 11, 12))]


@pytest.mark.parametrize("name", ["intensities.txt", "light_intensities.txt"])
def test_intensities(plain: Path, name: str) -> None:
    strength = 1 + np.arange(36).reshape(12, 3) / 7
    for rows in (strength, strength.T):
        table(plain / name, rows)
        np.testing.assert_allclose(read_capture(plain).intensities, strength, rtol=1e-8)
    table(plain / name, strength[:, :1])
    np.testing.assert_allclose(read_capture(plain).intensities, np.repeat(strength[:, :1], 3, 1), rtol=1e-8)


def test_scale_files(plain: Path) -> None:
    (plain / "scale.txt").write_text("# lens 2\nmm_per_pixel 0.05  # by ruler\n")
    assert read_capture(plain).scale.mm_per_pixel == 0.05
    K = np.array([[900, 0, 20.0], [0, 890, 30], [0, 0, 1]])
    table(plain / "K.txt", K)
    with pytest.raises(InputError, match=r"scale\.txt: mm_per_pixel is for orthographic"):
        read_capture(plain)
    (plain / "scale.txt").write_text("distance_mm = 450")
    (plain / "crop.txt").write_text("25 29 16 22 # rows, columns\n")
    scale = read_capture(plain).scale
    assert scale.distance_mm == 450
    np.testing.assert_array_equal(scale.camera, K - [[0, 0, 16], [0, 0, 25], [0, 0, 0]])
    (plain / "crop.txt").write_text("16 22 25 29\n")
    with pytest.raises(InputError, match=r"crop\.txt: .* must span the pictures, which are 6x4"):
        read_capture(plain)
    (plain / "K.txt").unlink()
    with pytest.raises(InputError, match=r"distance_mm needs the camera's K\.txt"):
        read_capture(plain)
    for text in ("mm_per_pixel 0", "mm_per_pixel nan", "mm_per_pixel", "0.05", "mm_per_pixel 1\nmm_per_pixel 2", "inches 3"):
        (plain / "scale.txt").write_text(text)
        with pytest.raises(InputError, match=r"scale\.txt: line [12]"):
            read_capture(plain)


def test_exr_pictures_and_their_holes(plain: Path) -> None:
    for k in range(1, 13):
        (plain / f"{k}.png").unlink()
        a = np.full((4, 6), k, np.float32)
        a[1, 2] = np.nan
        a[0, 0] = np.nan if k == 1 else 0
        write_exr(plain / f"{k}.exr", {"R": a, "G": a, "B": a})
    capture = read_capture(plain)
    assert capture.encoding == "linear"
    assert capture.images.max() == 12
    assert (capture.faults[:, 1, 2] == Fault.MISSING).all()
    assert not capture.mask[1, 2]
    assert capture.faults[:, 0, 0].tolist() == [Fault.MISSING] + [Fault.DARK] * 11
    assert capture.mask.sum() == 23


# RTI and lists


def test_lp_names_with_prefixes_and_blanks(plain: Path) -> None:
    (plain / "1.png").rename(plain / "shot 1.png")
    (plain / "lights.txt").unlink()
    (plain / "a.lp").write_text(f"3\n{plain.name}/shot 1.png 0 0 1\nsome\\where\\2.png\t1 0 1\n./3.png 0 1 1\n")
    for path in (plain, plain / "a.lp"):
        assert read_capture(path, "linear").names == ("shot 1.png", "2.png", "3.png")
    (plain / "b.LP").write_text("3\n1.png 0 0 1\n2.png 1 0 1\n3.png 0 1 1\n")
    with pytest.raises(InputError, match=r"holds 2 \.lp files"):
        read_capture(plain)
    assert detect(plain / "a.lp") == "rti"


def test_a_psm_list_is_found_from_the_list_and_from_the_folder(tmp_path: Path, synthetic: Synthetic) -> None:
    scene = synthetic(size=12)
    folder = write_folder("psm", tmp_path / "set", scene)
    np.testing.assert_array_equal(read_capture(folder).images, read_capture(tmp_path / "set" / "thing.txt").images)
    listed = (tmp_path / "set" / "thing.txt").read_text().splitlines()
    (tmp_path / "set" / "thing.txt").write_text("\n".join(listed[:-1]))
    (folder / "thing.mask.png").unlink()
    assert read_capture(folder).mask.all()
    (tmp_path / "set" / "thing.txt").write_text("\n".join(listed[:-2]))
    with pytest.raises(InputError, match=r"thing\.txt: says 5 pictures and then names 4 files"):
        read_capture(folder)


# Truth


def some_normals() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    n = rng.normal((0, 0, 3), 1, (7, 9, 3))
    mask = np.ones((7, 9), bool)
    mask[0] = mask[:, :2] = False
    return n / np.linalg.norm(n, axis=2, keepdims=True), mask


@pytest.mark.parametrize("name", NORMALS)
def test_true_normals_in_every_file(tmp_path: Path, name: str) -> None:
    n, mask = some_normals()
    path = tmp_path / name
    if name.endswith(".mat"):
        scipy.io.savemat(path, {"Normal_gt": n, "other": 3}, do_compression=True)
    elif name.endswith(".npy"):
        np.save(path, np.asfortranarray(n))
    elif name.endswith(".npz"):
        np.savez_compressed(path, normal=n.astype(np.float32))
    elif name.endswith(".txt"):
        table(path, n.reshape(-1, 3))
    else:
        write_png(path, np.round((n + 1) / 2 * 65535).astype(np.uint16))
    found = read_truth(tmp_path, mask).normals
    assert found is not None
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[mask], n[mask], atol=5e-5)
    assert (found[~mask] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(found[mask], axis=1), 1, atol=1e-6)


def test_true_normals_of_8_bits_and_with_holes(tmp_path: Path) -> None:
    n, mask = some_normals()
    write_png(tmp_path / "normals.png", np.round((n + 1) / 2 * 255).astype(np.uint8))
    found = read_truth(tmp_path, mask).normals
    assert found is not None
    assert np.degrees(np.arccos(np.clip((found * n).sum(2)[mask], -1, 1))).max() < 0.6
    n[3, 4], n[4, 5] = np.nan, 0
    np.save(tmp_path / "Normal_gt.npy", n)
    found = read_truth(tmp_path, mask).normals
    assert found is not None
    assert (found[3, 4] == 0).all()
    assert (found[4, 5] == 0).all()


@pytest.mark.parametrize("key", ["depth", "depth_gt"])
def test_true_depth_is_in_metres_and_fixes_the_distance_of_a_known_camera(plain: Path, key: str) -> None:
    depth = np.full((4, 6), 700.0)
    depth[0, 0] = np.nan
    depth[0, 1] = 0
    np.savez(plain / "depth_gt.npz", **{key: depth})
    found = read_capture(plain)
    assert found.truth.depth is not None
    np.testing.assert_array_equal(np.isnan(found.truth.depth), ~(depth > 0))
    assert np.nanmax(found.truth.depth) == pytest.approx(0.7)
    assert found.scale.distance_mm is None
    table(plain / "K.txt", np.array([[900, 0, 2.0], [0, 890, 3], [0, 0, 1]]))
    found = read_capture(plain)
    assert found.scale.distance_mm == pytest.approx(700)
    assert found.provenance["distance"] == "median of the true depth"


def bad_truth(tmp_path: Path, name: str) -> None:
    n, _ = some_normals()
    match name:
        case "objects.npz":
            np.savez(tmp_path / "normal_gt.npz", normal=np.array([{"a": 1}], dtype=object))
        case "objects.npy":
            np.save(tmp_path / "Normal_gt.npy", np.full((7, 9, 3), None), allow_pickle=True)
        case "no key":
            np.savez(tmp_path / "normal_gt.npz", other=n)
        case "size":
            np.savez(tmp_path / "normal_gt.npz", normal=n[:-1])
        case "truncated.npz":
            np.savez(tmp_path / "normal_gt.npz", normal=n)
            (tmp_path / "normal_gt.npz").write_bytes((tmp_path / "normal_gt.npz").read_bytes()[:400])
        case "truncated.npy":
            np.save(tmp_path / "Normal_gt.npy", n)
            (tmp_path / "Normal_gt.npy").write_bytes((tmp_path / "Normal_gt.npy").read_bytes()[:-9])
        case "huge.npy":
            with (tmp_path / "Normal_gt.npy").open("wb") as stream:
                np.lib.format.write_array_header_1_0(stream, {"shape": (10**7, 10**5, 3), "fortran_order": False, "descr": "<f8"})
        case "text.mat":
            (tmp_path / "Normal_gt.mat").write_text("hello" * 100)
        case "size.mat":
            scipy.io.savemat(tmp_path / "Normal_gt.mat", {"Normal_gt": n[:, :-1]})
        case "cells.mat":
            scipy.io.savemat(tmp_path / "Normal_gt.mat", {"Normal_gt": np.full((7, 9, 3), "a", object)})
        case "not unit":
            np.save(tmp_path / "Normal_gt.npy", n * 7)
        case "rows":
            table(tmp_path / "normal.txt", n.reshape(-1, 3)[:-1])
        case "picture size":
            write_png(tmp_path / "normals.png", np.full((7, 8, 3), 60000, np.uint16))
        case "depth":
            np.savez(tmp_path / "depth_gt.npz", depth=np.full((7, 9), np.nan))


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("objects.npz", "Python objects"),
        ("objects.npy", "Python objects"),
        ("no key", "has no array named normal"),
        ("size", r"shape \(6, 9, 3\)"),
        ("truncated.npz", "damaged"),
        ("truncated.npy", "damaged"),
        ("huge.npy", "shape"),
        ("text.mat", "damaged"),
        ("size.mat", "must hold Normal_gt"),
        ("cells.mat", "must hold Normal_gt"),
        ("not unit", "does not hold unit normals"),
        ("rows", "62 normals for 63 pixels"),
        ("picture size", "must be an 8 or 16-bit picture of 9x7"),
        ("depth", "no positive depth"),
    ],
)
def test_bad_truth_is_refused_in_one_line(tmp_path: Path, name: str, why: str) -> None:
    bad_truth(tmp_path, name)
    with pytest.raises(InputError, match=why) as error:
        read_truth(tmp_path, some_normals()[1])
    assert "\n" not in str(error.value)
    assert str(error.value).startswith(str(next(tmp_path.iterdir())))


# The real sets


def least_squares_error(capture: Capture) -> float:
    """Mean angular error in degrees of plain least squares on the grey reflectance (clipped at 1) of all pictures, over the mask."""
    g = np.minimum(grey(capture.reflectance())[:, capture.mask], 1)
    n, *_ = np.linalg.lstsq(capture.lights, g, rcond=None)
    n /= np.linalg.norm(n, axis=0)
    assert capture.truth.normals is not None
    t = capture.truth.normals[capture.mask].T
    known = np.linalg.norm(t, axis=0) > 0
    return float(np.degrees(np.arccos(np.clip((n * t).sum(0)[known], -1, 1))).mean())


@pytest.mark.data
@pytest.mark.parametrize(("name", "degrees"), [("bear", 8.39), ("cat", 8.41)])
def test_diligent_gives_the_published_error(data_folder: Path, name: str, degrees: float) -> None:
    capture = read_capture(data_folder / "diligent" / name)
    assert capture.count == 96
    assert capture.provenance["encoding"] == "linear (default of 16-bit files)"
    assert least_squares_error(capture) == pytest.approx(degrees, abs=0.02)
    assert capture.truth.depth is not None
    assert capture.scale.distance_mm == pytest.approx(1490, abs=30)
    K = capture.scale.camera
    assert K is not None
    assert 0 < K[0, 2] < capture.size[1]
    assert 0 < K[1, 2] < capture.size[0]


@pytest.mark.data
def test_the_lights_of_the_psm_set_fit_its_chrome_ball(data_folder: Path) -> None:
    """The highlight on a mirror sphere gives the light: l = 2 (n.v) n - v. The set's own lights.txt agrees to some degrees."""
    capture = read_capture(data_folder / "uw_psm" / "chrome.txt")
    rows, columns = np.nonzero(capture.mask)
    radius = np.sqrt(capture.mask.sum() / np.pi)
    errors = []
    for image, light in zip(grey(capture.images), capture.lights, strict=True):
        y, x = np.nonzero(np.where(capture.mask, image, 0) > 0.9 * image[capture.mask].max())
        nx, ny = (x.mean() - columns.mean()) / radius, (rows.mean() - y.mean()) / radius
        n = np.array([nx, ny, np.sqrt(1 - nx**2 - ny**2)])
        errors.append(np.degrees(np.arccos(np.clip((2 * n[2] * n - [0, 0, 1]) @ light, -1, 1))))
    assert np.median(errors) < 4
    assert max(errors) < 12


@pytest.mark.data
@pytest.mark.parametrize("name", ["buddha", "cat", "gray", "horse", "owl", "rock"])
def test_the_psm_set_is_read_from_its_folders(data_folder: Path, name: str) -> None:
    capture = read_capture(data_folder / "uw_psm" / name)
    assert (capture.count, capture.size, capture.encoding) == (12, (340, 512), "srgb")
    assert 0.1 < capture.mask.mean() < 0.5
    g = grey(capture.images)
    assert g[:, capture.mask].mean() > 5 * g[:, ~capture.mask].mean(), "the mask lies on the object"


@pytest.mark.data
@pytest.mark.parametrize(("name", "count"), [("Dome", 49), ("Test", 20)])
def test_the_rti_tile(data_folder: Path, name: str, count: int) -> None:
    capture = read_capture(data_folder / "synthrti_tile" / name, "linear")
    assert (capture.count, capture.size) == (count, (320, 320))
    assert 15 < least_squares_error(capture) < 22, "glossy, but the frames of normals and lights agree"


@pytest.mark.data
def test_a_transposed_table_of_a_real_set(data_folder: Path, tmp_path: Path) -> None:
    source = data_folder / "harvard_xiong" / "frog"
    for picture in (source / "Objects").iterdir():
        (tmp_path / picture.name).write_bytes(picture.read_bytes())
    (tmp_path / "lights.txt").write_bytes((source / "refined_light.txt").read_bytes())
    capture = read_capture(tmp_path)
    assert capture.count == 20
    np.testing.assert_array_equal(capture.images[..., 0], capture.images[..., 2])
    given: Any = (
        np.loadtxt(source / "refined_light.txt", delimiter=",") if "," in (source / "refined_light.txt").read_text() else None
    )
    rows = np.loadtxt(source / "refined_light.txt") if given is None else given
    np.testing.assert_allclose(capture.lights, (rows / np.linalg.norm(rows, axis=0)).T, atol=1e-9)
