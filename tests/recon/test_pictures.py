"""Pictures against closed forms and properties."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from PIL import Image

from gen.errors import InputError
from recon import pictures as p

# Linear values whose sRGB codes follow from IEC 61966-2-1 by hand: the two ends, both sides of the knee, middle grey.
SRGB = [(0.0, 0.0), (0.002, 0.02584), (0.0031308, 0.04045), (0.214041, 0.5), (0.5, 0.735357), (1.0, 1.0)]


@pytest.mark.parametrize(("linear", "encoded"), SRGB)
def test_encode_srgb_is_the_standard(linear: float, encoded: float) -> None:
    assert p.encode_srgb(linear) == pytest.approx(encoded, abs=2e-5)


def test_tone_puts_white_at_255_and_clips() -> None:
    radiance = np.array([[[0.0, 2.0, 4.0], [-1.0, np.nan, np.inf], [0.215 * 2, 1.0, 2e-9]]])
    assert p.tone(radiance, 2.0).tolist() == [[[0, 255, 255], [0, 0, 255], [128, 188, 0]]]


@pytest.mark.parametrize("white", [0.0, -1.0, np.nan])
def test_tone_refuses_a_bad_white(white: float) -> None:
    with pytest.raises(InputError, match="white level"):
        p.tone(np.zeros((1, 1, 3)), white)


def test_white_of_ignores_few_highlights_and_the_background() -> None:
    images = np.full((2, 100, 100, 3), 0.5)
    images[:, :5, :5] = 50.0  # a highlight on 0.25 % of the pixels
    images[:, 90:] = 9.0  # a bright background
    mask = np.ones((100, 100), bool)
    mask[90:] = False
    assert p.white_of(images, mask) == pytest.approx(0.5)
    assert p.white_of(np.zeros((1, 4, 4, 3))) == 1.0


def test_white_is_one_for_the_stack() -> None:
    images = np.stack([np.full((8, 8, 3), 0.2), np.full((8, 8, 3), 0.8)])
    white = p.white_of(images)
    assert white == pytest.approx(0.8)
    assert p.tone(images, white).shape == (2, 8, 8, 3)


def test_normal_picture_of_the_axes() -> None:
    normal = np.array([[[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 0]]], float)
    picture = p.normal_picture(normal)
    assert picture[0, :4].tolist() == [[128, 128, 255], [255, 128, 128], [128, 255, 128], [0, 128, 128]]
    assert tuple(picture[0, 4]) == p.OUTSIDE


def test_sphere_legend_holds_a_spheres_normals() -> None:
    size = 101
    legend = p.sphere_legend(size)
    assert tuple(legend[0, 0]) == p.OUTSIDE
    for dx, dy in [(0, 0), (30, 0), (0, 30), (-20, 25)]:  # right and up, pixels from the middle
        n = np.array([dx, dy, np.sqrt((0.48 * size) ** 2 - dx**2 - dy**2)]) / (0.48 * size)
        np.testing.assert_allclose(legend[50 - dy, 50 + dx], (n + 1) / 2 * 255, atol=0.5 + 1e-9)


@pytest.mark.parametrize(("lo", "hi"), [(1.0, 1.0), (2.0, 1.0), (0.0, np.nan)])
def test_a_scale_must_rise(lo: float, hi: float) -> None:
    with pytest.raises(InputError, match="must rise"):
        p.relief_picture(np.zeros((2, 2)), lo, hi)


def test_height_range_of_nothing_and_of_a_plane_can_be_shown() -> None:
    for height in (np.full((3, 3), np.nan), np.full((3, 3), 7.0)):
        lo, hi = p.height_range(height)
        p.relief_picture(height, lo, hi)


def test_relief_is_light_toward_the_upper_left() -> None:
    y, x = np.mgrid[:32, :32].astype(float)
    inside = np.hypot(x - 15.5, y - 15.5) < 15
    surfaces = {"to": x + y, "away": -x - y}
    facing = {name: p.relief_picture(np.where(inside, h, np.nan), -40, 40)[inside].mean() for name, h in surfaces.items()}
    # x + y rises to the lower right, so its surface faces the upper left, where the light is.
    assert facing["to"] > facing["away"] + 40


def test_relief_uses_the_scale() -> None:
    x = np.tile(np.arange(16.0), (16, 1))
    metres = p.relief_picture(x * 1e-4, 0, 16e-4, metres_per_pixel=1e-4)
    np.testing.assert_array_equal(metres, p.relief_picture(x, 0, 16))


def luminance(picture: np.ndarray) -> np.ndarray:
    """CIE lightness L* of 8-bit sRGB colours, by OpenCV."""
    return cv2.cvtColor((picture / 255).astype(np.float32), cv2.COLOR_RGB2LAB)[..., 0]


@pytest.mark.parametrize("colours", ["grey", "error", "height"])
def test_colours_rise_in_lightness(colours: str) -> None:
    lightness = luminance(p.colour_strip(colours, 256))[0]
    assert (np.diff(lightness) > -0.3).all()  # 8-bit rounding
    assert (np.diff(lightness[::8]) > 0).all()
    assert lightness[-1] - lightness[0] > 65


def test_signed_colours_are_even_on_both_sides_of_zero() -> None:
    lightness = luminance(p.colour_strip("signed", 256))[0]
    assert abs(lightness - lightness[::-1]).max() < 8
    assert lightness.argmax() in (127, 128)
    blue, orange = p.colour_strip("signed", 256)[0, [40, 215]].astype(int)
    assert blue[2] > blue[0] + 60
    assert orange[0] > orange[2] + 60


@pytest.mark.parametrize("colours", sorted(p.COLOURS))
def test_a_strip_has_its_size(colours: str) -> None:
    assert p.colour_strip(colours, 40, 3).shape == (3, 40, 3)


def test_unknown_colours_are_refused() -> None:
    with pytest.raises(InputError, match="no colours named 'jet'"):
        p.colour_strip("jet")


def test_error_picture_marks_what_is_outside() -> None:
    values = np.array([[0.0, 15.0, 30.0, 99.0, np.nan]])
    picture = p.error_picture(values, np.array([[True, True, True, True, True]]), top=30)
    strip = p.colour_strip("error", 256)[0]
    assert picture[0, :4].tolist() == strip[[0, 128, 255, 255]].tolist()
    assert tuple(picture[0, 4]) == p.OUTSIDE
    assert tuple(p.error_picture(values, np.zeros((1, 5), bool), 30)[0, 0]) == p.OUTSIDE


def test_difference_is_absolute_and_scaled() -> None:
    a = np.array([[[10, 200, 0]]], np.uint8)
    b = np.array([[[30, 190, 255]]], np.uint8)
    assert p.difference_picture(a, b).tolist() == [[[20, 10, 255]]]
    assert p.difference_picture(a, b, 4).tolist() == [[[80, 40, 255]]]
    with pytest.raises(InputError, match="no difference"):
        p.difference_picture(a, np.zeros((2, 1, 3), np.uint8))


def test_one_difference_scale_serves_the_largest() -> None:
    zero = np.zeros((4, 4, 3), np.uint8)
    assert p.difference_scale((zero, zero + np.uint8(30))) == 8
    assert p.difference_scale((zero, zero + np.uint8(30)), (zero, zero + np.uint8(100))) == 2
    assert p.difference_scale((zero, zero + np.uint8(200))) == 1


def test_overlay_changes_only_the_mask() -> None:
    picture = np.full((4, 4, 3), 100, np.uint8)
    mask = np.zeros((4, 4), bool)
    mask[1, 2] = True
    result = p.overlay(picture, mask, (200, 0, 100), 0.5)
    assert result[1, 2].tolist() == [150, 50, 100]
    assert (result[~mask] == 100).all()


def test_png_keeps_every_pixel(tmp_path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (9, 7, 3), dtype=np.uint8)
    (tmp_path / "a.png").write_bytes(p.png_bytes(picture))
    with Image.open(tmp_path / "a.png") as opened:
        np.testing.assert_array_equal(np.asarray(opened), picture)


def test_a_large_photo_becomes_a_jpeg_that_looks_the_same(tmp_path) -> None:
    y, x = np.mgrid[:256, :256]
    picture = np.stack([x, y, 127 + 120 * np.sin((x + 3 * y) / 9)], axis=-1).astype(np.uint8)
    data, kind = p.photo_bytes(picture, limit=1000)
    assert kind == "image/jpeg"
    (tmp_path / "a.jpg").write_bytes(data)
    with Image.open(tmp_path / "a.jpg") as opened:
        assert abs(np.asarray(opened, float) - picture).mean() < 1.5
    assert p.photo_bytes(np.zeros((8, 8, 3), np.uint8))[1] == "image/png"


def test_a_float_picture_is_not_written() -> None:
    with pytest.raises(InputError, match="8-bit"):
        p.png_bytes(np.zeros((2, 2, 3)))  # type: ignore[arg-type]


def test_crop_holds_the_mask_and_its_margin() -> None:
    mask = np.zeros((40, 50), bool)
    mask[10:20, 30:48] = True
    picture = np.dstack([mask * np.uint8(255)] * 3)
    cropped = p.crop_to_mask(picture, mask, margin=3)
    assert cropped.shape == (16, 23, 3)
    assert (cropped > 0).sum() == (picture > 0).sum()
    assert p.crop_to_mask(picture, np.zeros_like(mask)).shape == picture.shape


def test_fit_scales_down_by_area_and_never_up() -> None:
    picture = np.zeros((100, 200, 3), np.uint8)
    picture[:, ::2] = 200
    small = p.fit(picture, 100)
    assert small.shape == (50, 100, 3)
    assert (small == 100).all()
    assert p.fit(picture, 500) is picture
