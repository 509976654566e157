"""Unknown lights: exact up to a bas-relief transform, which an assumption then resolves; and the command that says so."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gen.capture import Capture, read_capture
from gen.errors import InputError
from gen.images import write_png
from recon.metrics import angular_error
from recon.normals.bas_relief import bas_relief, equally_strong
from recon.normals.uncalibrated import integrable, three_dimensions, uncalibrated
from recon.unknown_lights import SUSPECT, find_lights, read_pictures, remarks, write_lights

Doubles = NDArray[np.float64]
ROOT = Path(__file__).resolve().parent.parent.parent


def lights_under(tilt: float, count: int) -> Doubles:
    """Light directions (count, 3) spread over the cap up to a tilt in degrees, not evenly about the axis."""
    turn = np.arange(count) * 2.4
    r = np.sin(np.radians(tilt)) * np.sqrt((np.arange(count) + 0.5) / count)
    x, y = r * np.cos(turn) + 0.08, r * np.sin(turn) - 0.05
    L = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1)
    return L / np.linalg.norm(L, axis=1, keepdims=True)


def hills(lights: Doubles, size: int = 120, seed: int = 0) -> tuple[Capture, Doubles]:
    """Matte hills on a dome, three paints, lit by all lights: the capture, and its true normals (H, W, 3)."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[:size, :size].astype(float)
    x, y = column - (size - 1) / 2, (size - 1) / 2 - row
    mask = np.hypot(x, y) < 0.47 * size
    p, q = 0.6 * x / size, 0.6 * y / size
    for cx, cy in rng.uniform(-0.32, 0.32, (14, 2)) * size:
        bump = 0.55 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * 7.0**2))
        p, q = p + bump * (x - cx) / 7, q + bump * (y - cy) / 7
    n = np.stack([p, q, np.ones_like(p)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    albedo = np.select([x > 0.2 * size, y > 0.1 * size], [0.9, 0.4], 0.6)
    shading = np.einsum("hwi,ki->khw", n, lights)
    assert (shading[:, mask] > 0.05).all()
    images = (albedo * shading * mask)[..., None] * np.array([1, 0.8, 0.6])
    return Capture(images=images.astype(np.float32), lights=lights, mask=mask), n


def ones(capture: Capture) -> NDArray[np.float32]:
    return np.ones(capture.images.shape[:3], np.float32)


def angles(a: Doubles, b: Doubles) -> Doubles:
    return angular_error(a.astype(np.float32), b.astype(np.float32))


def test_lights_are_known_up_to_a_bas_relief() -> None:
    """Four numbers take what pictures and integrability alone give to the true lights: x and y by one factor, z by any row."""
    lights = lights_under(35, 12)
    strengths = np.random.default_rng(1).uniform(0.4, 2, 12)
    capture, _ = hills(lights)
    y = capture.images[:, capture.mask].sum(axis=-1) * strengths[:, None].astype(np.float32)
    U, b, used, misfit = three_dimensions(y, np.ones_like(y))
    assert misfit < 1e-5
    assert used.mean() > 0.99
    found, true = U @ np.linalg.inv(integrable(b, capture.mask)).T, lights * strengths[:, None]
    factor = (found[:, :2] * true[:, :2]).sum() / (found[:, :2] ** 2).sum()
    z = np.linalg.lstsq(found, true[:, 2], rcond=None)[0]
    after = np.column_stack([factor * found[:, :2], found @ z])
    assert np.abs(after - true).max() < 0.02
    anything = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    spoiled = U @ anything
    wrong = (spoiled[:, :2] * true[:, :2]).sum() / (spoiled[:, :2] ** 2).sum() * spoiled[:, :2]
    assert np.abs(wrong - true[:, :2]).max() > 0.2


def test_equal_strengths_resolve_it() -> None:
    """Lights and normals to a degree, albedo of three paints and all; and the transform itself, on lights that a known one spoiled."""
    lights = lights_under(40, 10)
    capture, n = hills(lights)
    result = uncalibrated(capture.images, capture.mask, ones(capture), "equal")
    assert angles(result.lights, lights).max() < 1
    assert np.nanmean(angular_error(result.normals.normal, n.astype(np.float32))[capture.mask]) < 0.7
    assert result.strengths == pytest.approx(np.ones(10), abs=0.02)
    assert result.against < 0.01
    G = bas_relief(0.4, -0.7, 1.8)
    back, spread = equally_strong(lights @ np.linalg.inv(G).T)
    assert back == pytest.approx(G, abs=1e-4)
    assert spread < 1e-6


def test_brightest_spots_resolve_unknown_strengths() -> None:
    lights = lights_under(30, 16)
    capture, n = hills(lights)
    strengths = np.random.default_rng(3).uniform(0.4, 2, 16)
    images = capture.images * strengths[:, None, None, None].astype(np.float32)
    result = uncalibrated(images, capture.mask, ones(capture), "unknown")
    assert angles(result.lights, lights).mean() < 3
    assert np.nanmean(angular_error(result.normals.normal, n.astype(np.float32))[capture.mask]) < 3
    assert result.strengths == pytest.approx(strengths / strengths.mean(), rel=0.1)
    wrong = uncalibrated(images, capture.mask, ones(capture), "equal")
    assert wrong.against > SUSPECT["equal"]
    assert "do not trust" in " ".join(remarks(wrong, "equal"))


def test_shadows_and_highlights_are_left_out() -> None:
    """A black half moon in each picture, and a glare in some: the lights stay what they were to a degree."""
    lights = lights_under(40, 12)
    capture, _ = hills(lights)
    images = capture.images.copy()
    row, column = np.mgrid[: images.shape[1], : images.shape[2]]
    for k, (x, y) in enumerate(np.random.default_rng(4).uniform(30, 90, (12, 2))):
        images[k][np.hypot(column - x, row - y) < 12] = 0
        if k % 3 == 0:
            images[k][np.hypot(column - y, row - x) < 5] += 1
    result = uncalibrated(images, capture.mask, ones(capture), "equal")
    assert angles(result.lights, lights).max() < 1.5


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda images: images[:4], "4 pictures; at least 5"),
        (lambda images: images[:1].repeat(8, 0), "differ too little"),
        (lambda images: images[:, 60:61, 60:61].repeat(120, 1).repeat(120, 2), "differ too little"),
        (lambda images: images * (np.arange(8) != 2)[:, None, None, None], "picture 3 is lit hardly anywhere"),
    ],
)
def test_what_pictures_do_not_say_is_refused(spoil: object, says: str) -> None:
    capture, _ = hills(lights_under(35, 8))
    images = np.asarray(spoil(capture.images), np.float32)  # type: ignore[operator]
    with pytest.raises(InputError, match=says):
        uncalibrated(images, capture.mask, np.ones(images.shape[:3], np.float32))


def test_strengths_are_one_of_two() -> None:
    capture, _ = hills(lights_under(35, 8))
    with pytest.raises(InputError, match="must be equal or unknown"):
        uncalibrated(capture.images, capture.mask, ones(capture), "guess")  # type: ignore[arg-type]


def folder_without_lights(folder: Path, lights: Doubles) -> Path:
    """Sixteen-bit pictures and a mask, and nothing else."""
    capture, _ = hills(lights)
    folder.mkdir(exist_ok=True)
    for k, picture in enumerate(capture.images):
        write_png(folder / f"{k + 1}.png", np.rint(picture * 60000).astype(np.uint16))
    write_png(folder / "mask.png", capture.mask.astype(np.uint8) * 255)
    return folder


def degloss(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "degloss", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=120)


def test_the_command_makes_a_capture_of_bare_pictures(tmp_path: Path) -> None:
    lights = lights_under(40, 11)
    folder = folder_without_lights(tmp_path / "hills", lights)
    said = json.loads(degloss("recon", "lights", folder, "--json").stdout)
    assert angles(np.array(said["lights"]), lights).max() < 1
    assert said["written"] == []
    assert not (folder / "lights.txt").exists()
    written = degloss("recon", "lights", folder, "--write")
    assert written.returncode == 0, written.stderr
    assert "equally strong" in written.stdout
    assert "convex or concave cannot be told" in written.stdout
    capture = read_capture(folder)
    assert capture.names == tuple(f"{k + 1}.png" for k in range(11))
    assert angles(capture.lights, lights).max() < 1
    again = degloss("recon", "lights", folder, "--write")
    assert again.returncode == 2
    assert again.stderr.count("\n") == 1
    assert "is there already" in again.stderr


def test_unknown_strengths_are_written_too(tmp_path: Path) -> None:
    folder = folder_without_lights(tmp_path / "hills", lights_under(30, 16))
    pictures = read_pictures(folder)
    found = find_lights(pictures, "unknown", str(folder))
    write_lights(folder, found, pictures.names, remarks(found, "unknown"), "unknown")
    assert read_capture(folder).intensities.std() < 0.1
    assert sorted(p.name for p in folder.iterdir() if p.suffix == ".txt") == ["light_intensities.txt", "lights.txt"]


def test_pictures_of_a_capture_yaml_without_lights(tmp_path: Path) -> None:
    lights = lights_under(40, 9)
    folder = folder_without_lights(tmp_path / "hills", lights)
    (folder / "capture.yaml").write_text('images: "[0-9].png"\nmask: mask.png\n')
    pictures = read_pictures(folder)
    assert pictures.names == tuple(f"{k + 1}.png" for k in range(9))
    assert angles(find_lights(pictures, "equal", "here").lights, lights).max() < 1
    with pytest.raises(InputError, match="here: lights cannot be told from 3 pictures"):
        find_lights(type(pictures)(pictures.images[:3], pictures.mask, pictures.weights[:3], pictures.names[:3]), "equal", "here")


@pytest.mark.data
def test_a_real_object_whose_lights_are_ignored(data_folder: Path) -> None:
    """DiLiGenT's cat, every fifth light, with and without its known strengths, and doubt where unequal lights are taken for equal."""
    capture = read_capture(data_folder / "diligent" / "cat")
    capture = capture.select(range(0, capture.count, 5))
    for strengths, images, off, limit in (("equal", capture.reflectance(), 4, 11), ("unknown", capture.images, 6, 14)):
        result = uncalibrated(images, capture.mask, ones(capture), strengths)  # type: ignore[arg-type]
        assert result.against < SUSPECT[strengths]
        assert angles(result.lights, capture.lights).mean() < off
        assert np.nanmean(angular_error(result.normals.normal, capture.truth.normals)[capture.mask]) < limit
    assert uncalibrated(capture.images, capture.mask, ones(capture), "equal").against > SUSPECT["equal"]
