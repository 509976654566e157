"""Folders of photographs with capture.yaml: captures come back, bad ones are refused in one line, the check says what is wrong."""

from __future__ import annotations

import json
import struct
import textwrap
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.capture import Capture, Fault
from gen.errors import InputError
from gen.photos.read import is_photos, read_photos
from recon.normals.least_squares import least_squares
from recon.photo_check import check_photos
from tests.gen.photos.photo_scenes import LIGHTS, OURS, Balls, degrees, matte_folder, ring, save, say
from tests.gen.photos.test_develop import LENS, K, ideal_of

Synthetic = Callable[..., Capture]
STRENGTHS = np.array([1, 0.5, 0.8, 0.7, 0.9, 0.6])


@pytest.fixture
def folder(tmp_path: Path, synthetic: Synthetic) -> Path:
    return matte_folder(tmp_path / "photos", synthetic(lights=LIGHTS, layer="matte"))


def test_a_simple_folder_becomes_the_capture_it_is(folder: Path, synthetic: Synthetic) -> None:
    assert is_photos(folder)
    scene, found = synthetic(lights=LIGHTS, layer="matte"), read_photos(folder)
    np.testing.assert_allclose(found.images, scene.images, atol=1e-5)
    np.testing.assert_allclose(found.lights, scene.lights, atol=1e-12)
    np.testing.assert_array_equal(found.mask, scene.mask)
    assert found.names == tuple(f"p{k}.png" for k in range(1, 7))
    assert found.scale.metres_per_pixel == 1e-4
    assert found.provenance["intensities"] == "equal, as said"
    assert check_photos(folder) == []
    assert not is_photos(folder.parent)


def test_intensities_left_out_are_estimated(folder: Path, synthetic: Synthetic) -> None:
    for k, picture in enumerate(synthetic(lights=LIGHTS, layer="matte").images):
        save(folder / f"p{k + 1}.png", picture * STRENGTHS[k])
    say(folder, images="p*.png", lights={"directions": LIGHTS.tolist()})
    found = read_photos(folder)
    np.testing.assert_allclose(found.intensities[:, 0], STRENGTHS / STRENGTHS.mean(), rtol=0.002)
    assert found.provenance["intensities"] == "estimated from the object"
    assert [f.about for f in check_photos(folder)] == ["intensities", "scale"]
    say(folder, images="p*.png", lights={"directions": LIGHTS.tolist()}, intensities=(STRENGTHS * 7).tolist())
    np.testing.assert_allclose(read_photos(folder).intensities[:, 1], STRENGTHS * 7)


def test_everything_a_camera_adds_comes_off_again(folder: Path, synthetic: Synthetic) -> None:
    """Brackets in 8-bit sRGB with a dark frame for each exposure, room light, a vignette and a barrel lens: the normals come back."""
    rng = np.random.default_rng(0)
    scene = synthetic(lights=LIGHTS, layer="matte", size=120)
    height, width = 150, 200
    y, x = np.mgrid[:height, :width].astype(float)
    a, b = ideal_of(x, y)  # where the lens looks
    column, row = np.clip(np.round(a - 41).astype(int), 0, 119), np.clip(np.round(b - 13).astype(int), 0, 119)
    inside = (a >= 41) & (a <= 160) & (b >= 13) & (b <= 132)
    vignette = (1 - 1.5e-5 * ((x - 100) ** 2 + (y - 75) ** 2))[..., None]
    times = [0.1, 0.4, 1.6]

    def shoot(name: str, radiance: np.ndarray, t: float, bits: int = 8) -> dict[str, Any]:
        value = radiance * vignette * t * 8 + (0.01 + 0.004 * t) + rng.normal(0, 0.0005, radiance.shape)
        save(folder / name, value, bits, srgb=True)
        return {"file": name, "exposure_s": t}

    room, black = 0.05 * np.ones((height, width, 3)), np.zeros((height, width, 3))
    images = []
    for k, picture in enumerate(scene.images):
        seen = np.where(inside[..., None], picture[row, column], 0)
        images.append({"bracket": [shoot(f"b{k}_{t}.png", seen + room, t) for t in times]})
    mask = np.where(inside, scene.mask[row, column], False)
    save(folder / "object.png", np.repeat(mask[..., None], 3, -1).astype(float))
    spec: dict[str, Any] = {
        "images": images,
        "lights": {"directions": LIGHTS.tolist()},
        "intensities": "equal",
        "colour": "srgb",
        "dark": [shoot(f"dark_{t}.png", black, t) for t in times],
        "ambient": shoot("room.png", room, 0.4),
        "flat": shoot("card.png", 0.2 * np.ones((height, width, 3)), 0.4),
        "camera": {"K": K.tolist(), "distortion": LENS.tolist(), "distance_mm": 300},
        "mask": "object.png",
    }
    say(folder, **spec)
    found = read_photos(folder)
    assert found.provenance["brackets"]["exposures_s"] == times
    assert abs(found.provenance["brackets"]["slope"] - 1) < 0.02
    assert found.provenance["brackets"]["largest_shift_px"] < 0.3
    window = (slice(13, 133), slice(41, 161))
    good = scene.mask & found.valid[(slice(None), *window)].all(axis=0)
    ratio = found.images[(slice(None), *window)][:, good] / np.maximum(scene.images[:, good], 1e-9)
    lit = scene.images[:, good] > 0.05
    assert np.std(ratio[lit]) / np.mean(ratio[lit]) < 0.05  # the picture was bent by nearest pixels
    np.testing.assert_allclose(np.median(ratio[lit]), 0.8 * np.median(vignette), rtol=0.02)
    valid = found.valid.astype(np.float32)
    normals = []
    for capture, w, where in ((found, valid, window), (scene, valid[(slice(None), *window)], (slice(None), slice(None)))):
        normal = least_squares(capture.reflectance(), capture.lights, capture.mask, w).normal[where]
        normals.append(normal)
    good &= np.all([(normal != 0).any(-1) for normal in normals], axis=0)
    assert good.sum() > 0.3 * scene.mask.sum()
    assert scene.truth.normals is not None
    error = [degrees(normal[good], scene.truth.normals[good]) for normal in normals]
    assert error[0].mean() < error[1].mean() + 1.0
    assert [f.about for f in check_photos(folder) if f.level != "note"] == []

    spec["colour"] = "linear"
    spec["dark"] = spec["ambient"] = None
    say(folder, **spec)
    texts = [f.text for f in check_photos(folder) if f.about == "exposure"]
    assert len(texts) == 1
    assert "not linear as read" in texts[0]


def test_exposures_that_moved_are_told(folder: Path, synthetic: Synthetic) -> None:
    scene = synthetic(lights=LIGHTS, layer="matte")
    for k, picture in enumerate(scene.images):
        save(folder / f"q{k}_1.png", np.roll(picture, 2, axis=1) * 0.25 + 0.002)
        save(folder / f"q{k}_2.png", picture + 0.008)
    say(
        folder,
        images={"glob": "q*.png", "exposures_s": [0.25, 1]},
        lights={"directions": LIGHTS.tolist()},
        intensities="equal",
        mm_per_pixel=1,
    )
    assert [f.about for f in check_photos(folder)] == ["alignment"]
    assert read_photos(folder).count == 6


@pytest.mark.parametrize("kind", ["chrome", "matte"])
def test_lights_are_measured_on_balls_beside_the_object(tmp_path: Path, kind: str) -> None:
    """Two balls and a third that is the object, near lights: directions from one ball, places from two, intensities from the matte one."""
    balls = Balls((240, 320), np.array([[28, -16, 0], [-30, 17, 0], [-28, -16, 0]]), 16, None, 0.3)
    places = ring(35, 4) * 200
    strengths = np.array([1, 0.6, 0.8, 0.7, 0.9])
    for k, place in enumerate(places):
        matte = np.repeat((balls.matte(place=place * OURS) * 200**2 * 0.6 * strengths[k])[..., None], 3, -1)
        mirror = np.repeat(np.minimum(balls.mirror(place=place * OURS), 1)[..., None], 3, -1)
        measured = balls.masks[0] | balls.masks[1]
        save(tmp_path / f"{k}.png", np.where(measured[..., None] & (kind == "chrome"), mirror, matte))
    for n, mask in enumerate(balls.masks):
        save(tmp_path / f"ball{n}.png", np.repeat(mask[..., None], 3, -1).astype(float))
    both = [{"kind": kind, "mask": f"ball{n}.png", "diameter_mm": 32} for n in range(2)]
    say(tmp_path, images="[0-9].png", lights={"balls": both}, mm_per_pixel=0.3, mask="ball2.png")
    found = read_photos(tmp_path)
    assert found.light_kinds == ("point",) * 5
    assert found.positions is not None
    assert np.linalg.norm(found.positions - places, axis=1).max() < 6
    np.testing.assert_allclose(found.intensities[:, 0], strengths / strengths.mean(), rtol=0.06)
    assert [f for f in check_photos(tmp_path) if f.level == "missing"] == []
    say(tmp_path, images="[0-9].png", lights={"balls": both[:1]}, mm_per_pixel=0.3, mask="ball2.png")
    found = read_photos(tmp_path)
    assert found.positions is None
    from_the_ball = places - np.array([28, 16, 0.0])
    # Taken as distant: the highlight stands on the ball's front, and the fall-off over a matte ball looks like shading.
    assert degrees(found.lights, from_the_ball).max() < 6
    assert found.provenance["intensities"].startswith("measured on the matte" if kind == "matte" else "estimated")
    assert found.provenance["lights"] == f"measured on a {kind} ball"


def test_lights_from_a_file_by_order_or_by_name(folder: Path) -> None:
    rows = [" ".join(str(v) for v in row) for row in LIGHTS]
    say(folder, images="p*.png", lights={"file": "lights.txt"}, intensities="equal", mm_per_pixel=1)
    (folder / "lights.txt").write_text("6\n" + "\n".join(rows))
    np.testing.assert_allclose(read_photos(folder).lights, LIGHTS, atol=1e-12)
    (folder / "lights.txt").write_text("\n".join(f"p{k + 1}.png {rows[k]}" for k in (3, 1, 5, 0, 2, 4)))
    np.testing.assert_allclose(read_photos(folder).lights, LIGHTS, atol=1e-12)
    (folder / "lights.txt").write_text("\n".join(f"p{k + 1}.png {rows[k]}" for k in (3, 1, 5, 0, 2)))
    with pytest.raises(InputError, match=r"lights\.txt: has no light for p5\.png"):
        read_photos(folder)
    (folder / "lights.txt").write_text("\n".join(rows).replace("0.0", "nan", 1))
    with pytest.raises(InputError, match=r"lights\.txt: line 1 holds a value that is not finite"):
        read_photos(folder)


def test_a_ball_is_found_by_itself_through_a_bent_lens(folder: Path) -> None:
    """In the pictures where it is lit, or in another of its outline; a circle that is given is of the photograph as it is."""
    camera = {"K": [[90, 0, 32], [0, 90, 31], [0, 0, 1]], "distance_mm": 300, "distortion": [0, 0, 0, 0]}
    balls = Balls((64, 64), np.array([[6, -4, 300]]), 70, np.array(camera["K"]))
    lights = ring(25, 5)
    for k, light in enumerate(lights):
        save(folder / f"ball{k}.png", np.repeat(balls.matte(light * OURS)[..., None], 3, -1) * 0.9 + 0.01)
    save(folder / "room.png", np.where(balls.mask[..., None], 0.6, 0.05) * np.ones(3))
    ordinary = {"images": "p*.png", "camera": camera, "intensities": "equal"}
    for place, most in (({}, 3.0), ({"outline": "room.png"}, 1.5)):
        say(folder, **ordinary, lights={"balls": [{"kind": "matte", "diameter_mm": 140, "images": "ball*.png", **place}]})
        assert degrees(read_photos(folder).lights, lights).max() < most
    camera["distortion"] = [-0.4, 0, 0, 0]
    circle = {"circle_px": [10.0, 9.0, 6.0]}
    say(folder, **ordinary, lights={"balls": [{"kind": "matte", "images": "ball*.png", **circle}]})
    with pytest.raises(InputError, match="covers only"):
        read_photos(folder)


def test_a_ball_of_its_own_pictures(folder: Path) -> None:
    balls = Balls((64, 64), np.array([[2, -1, 0]]), 26, None)
    for k, light in enumerate(LIGHTS):
        save(folder / f"ball{k}.png", np.repeat(balls.matte(light * OURS)[..., None], 3, -1) * 0.9)
    ball = {"kind": "matte", "circle_px": [33.5, 30.5, 26], "images": "ball*.png"}
    say(folder, images="p*.png", lights={"balls": [ball]}, mm_per_pixel=1)
    assert degrees(read_photos(folder).lights, LIGHTS).max() < 0.5
    ball["kind"] = "chrome"
    say(folder, images="p*.png", lights={"balls": [ball]}, mm_per_pixel=1)
    worst = check_photos(folder)[0]
    assert worst.level == "missing"
    assert worst.about == "ball"
    assert "no highlight stands out" in worst.text


def huge(path: Path) -> None:
    body = b"".join(
        struct.pack(">I", len(b)) + t + b + struct.pack(">I", zlib.crc32(t + b))
        for t, b in (
            (b"IHDR", struct.pack(">IIBBBBB", 100_000, 100_000, 16, 2, 0, 0, 0)),
            (b"IDAT", zlib.compress(b"\0" * 99)),
            (b"IEND", b""),
        )
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def out_by_a_link(path: Path) -> None:
    path.rename(path.parent.parent / "secret.png")
    path.symlink_to(path.parent.parent / "secret.png")


def nothing(path: Path) -> None:
    pass


DIRECTIONS = {"directions": LIGHTS.tolist()}
BAD: dict[str, tuple[dict[str, Any], Callable[[Path], object], str]] = {
    # what is wrong: (what capture.yaml says beside the ordinary, what is done to p3.png, what the line must say)
    "an unknown key": ({"imagez": 1}, nothing, r"imagez: unknown key; did you mean 'images'\?"),
    "an unknown key of a ball": ({"lights": {"balls": [{"kind": "chrome", "radius": 3}]}}, nothing, "did you mean 'circle_px'"),
    "no lights at all": ({"lights": None}, nothing, "lights: is missing; give directions"),
    "two sources of light": ({"lights": {**DIRECTIONS, "file": "x"}}, nothing, "exactly one of directions"),
    "NaN in the lights": (
        {"lights": {"directions": [[0, 0, float("nan")]] * 6}},
        nothing,
        r"directions\[0\]: must be three numbers",
    ),
    "a light of no length": ({"lights": {"directions": [[0, 0, 0]] * 6}}, nothing, "needs a length"),
    "a light too few": ({"lights": {"directions": LIGHTS[:5].tolist()}}, nothing, "5 for 6 pictures"),
    "an intensity too few": ({"intensities": [1, 1]}, nothing, "intensities: 2 for 6 pictures"),
    "a negative intensity": ({"intensities": [1, 1, -1, 1, 1, 1]}, nothing, r"intensities\[2\]: must be greater than 0"),
    "a file that is not there": ({"images": ["p1.png", "p9.png"]}, nothing, "p9.png: there is no such file"),
    "a file named twice": ({"images": ["p1.png", "./p1.png"]}, nothing, "names p1.png twice"),
    "a path that leads up": ({"images": ["../p1.png"]}, nothing, "leads out of the folder"),
    "an absolute path": ({"mask": "/etc/hosts"}, nothing, "mask: .*leads out of the folder"),
    "a pattern that leads up": ({"images": "../*.png"}, nothing, "leads out of the folder"),
    "an absolute pattern": ({"images": "/etc/*"}, nothing, "leads out of the folder"),
    "a pattern of all folders": ({"images": "**/*.png"}, nothing, "may not hold"),
    "a pattern of nothing": ({"images": "z*.png"}, nothing, "finds no pictures"),
    "a pattern that is too long": ({"images": "p" * 400}, nothing, "cannot be used"),
    "a name that is too long": ({"images": ["p" * 400 + ".png"]}, nothing, "no such file"),
    "an exposure of no time": (
        {"images": {"glob": "p*.png", "exposures_s": [1e-300, 1]}},
        nothing,
        r"exposures_s\[0\]: must be at least",
    ),
    "a light out of all bounds": ({"lights": {"directions": [[0, 1e308, 1]] * 6}}, nothing, "must lie within"),
    "a link that leads out": ({}, out_by_a_link, "leads out of the folder"),
    "a huge picture": ({}, huge, "megapixels"),
    "a truncated picture": ({}, cut, "p3.png: is damaged or truncated"),
    "a picture of another size": ({}, lambda p: save(p, np.ones((5, 6, 3))), "all pictures must have one size"),
    "an 8-bit picture among others": ({}, lambda p: save(p, np.ones((64, 64, 3)), 8), "say which holds for all, srgb or linear"),
    "a dark frame of another size": ({"dark": "p3.png"}, lambda p: save(p, np.zeros((5, 6, 3))), "one size"),
    "a black flat field": ({"flat": "p3.png"}, lambda p: save(p, np.zeros((64, 64, 3))), "flat field is black"),
    "an incomplete bracket": ({"images": {"glob": "p*.png", "exposures_s": [1, 2, 3, 4]}}, nothing, "no whole brackets of 4"),
    "an exposure twice": ({"images": {"glob": "p*.png", "exposures_s": [1, 1]}}, nothing, "holds an exposure twice"),
    "an exposure of some": ({"images": ["p1.png", {"file": "p2.png", "exposure_s": 1}]}, nothing, "for some photographs only"),
    "a bracket without exposures": ({"images": [{"bracket": ["p1.png", "p2.png"]}]}, nothing, "needs its exposure_s"),
    "K upside down": ({"camera": {"K": [[1, 0, 0], [0, -1, 0], [0, 0, 1]]}, "mm_per_pixel": None}, nothing, "fx and fy positive"),
    "three numbers of distortion": (
        {"camera": {"K": [[9, 0, 0], [0, 9, 0], [0, 0, 1]], "distortion": [1, 2, 3]}, "mm_per_pixel": None},
        nothing,
        "4, 5, 8, 12 or 14",
    ),
    "two scales": ({"camera": {"K": [[9, 0, 0], [0, 9, 0], [0, 0, 1]]}}, nothing, "distance_mm: 0.9, which means the same"),
    "near lights from one ball": ({"lights": {"balls": [{"kind": "matte"}], "near": True}}, nothing, "needs two balls"),
    "an unknown colour": ({"colour": "rec2020"}, nothing, "'srgb' or 'linear'"),
    "an empty mask": ({"mask": "p3.png"}, lambda p: save(p, np.zeros((64, 64, 3))), "mask is empty"),
    "an ambient frame without its exposure": (
        {"images": {"glob": "p[12].png", "exposures_s": [1]}, "ambient": "p3.png"},
        nothing,
        "need their exposure_s",
    ),
}


@pytest.mark.parametrize("case", list(BAD))
def test_bad_folders_are_refused_in_one_line(folder: Path, case: str) -> None:
    values, harm, says = BAD[case]
    ordinary = {"images": "p*.png", "lights": DIRECTIONS, "intensities": "equal", "mm_per_pixel": 0.1}
    text = json.dumps({k: v for k, v in {**ordinary, **values}.items() if v is not None}).replace("NaN", ".nan")
    (folder / "capture.yaml").write_text(text)
    harm(folder / "p3.png")
    with pytest.raises(InputError, match=says) as error:
        read_photos(folder)
    assert "\n" not in str(error.value)
    assert str(folder) in str(error.value)


def test_yaml_that_is_none(folder: Path) -> None:
    for text, says in (
        ("a: &x 1\nb: *x", "anchors"),
        ("images: [", "not valid YAML"),
        ("- a", "key: value"),
        ("!!python/none x", r"YAML|key"),
    ):
        (folder / "capture.yaml").write_text(text)
        with pytest.raises(InputError, match=says):
            read_photos(folder)
    with pytest.raises(InputError, match=r"has no capture\.yaml"):
        read_photos(folder.parent)
    with pytest.raises(InputError, match="no such folder"):
        read_photos(folder / "absent")


def test_clipped_samples_of_a_bracket_are_masked(folder: Path) -> None:
    ramp = np.broadcast_to(np.linspace(0, 2, 64)[None, :, None], (64, 64, 3))
    for k in range(3):
        save(folder / f"r{k}_a.png", ramp)
        save(folder / f"r{k}_b.png", ramp * 4)
    say(
        folder,
        images={"glob": "r*.png", "exposures_s": [0.5, 2]},
        lights={"directions": LIGHTS[:3].tolist()},
        intensities="equal",
    )
    found = read_photos(folder)
    clipped = (found.faults & Fault.CLIPPED) > 0
    np.testing.assert_array_equal(clipped[0], ramp[..., 0] >= 1)
    good = ~clipped & (found.faults == 0)
    np.testing.assert_allclose(found.images[good], np.broadcast_to(ramp, (3, 64, 64, 3))[good], atol=2e-5)


def test_the_example_of_the_package_is_a_spec_that_uses_every_key() -> None:
    import gen.photos
    from gen.photos.spec import BallSpec, Bracket, PhotoSpec, photo_spec
    from gen.strict_yaml import parse_yaml

    text = textwrap.dedent("\n".join(line for line in str(gen.photos.__doc__).splitlines() if line.startswith("    ")))
    spec = photo_spec(parse_yaml(text, "the docstring", "an example"), "the docstring")
    assert spec.model_fields_set == set(PhotoSpec.model_fields) - {"mm_per_pixel"}
    assert isinstance(spec.images[0], Bracket)  # type: ignore[index]
    assert spec.lights is not None
    assert all(isinstance(ball, BallSpec) for ball in spec.lights.balls or [])
