"""Arrays as pictures to look at: photographs, normals, heights, errors, differences.

Every picture is (H, W, 3) uint8, sRGB. They are for looking; the files of measurement are float.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gen.errors import InputError
from gen.srgb import linear_to_srgb
from recon.metrics import normal_bytes

Picture = NDArray[np.uint8]
Bools = NDArray[np.bool_]

AT_ONCE = 1 << 23
"""Values of a picture that are worked out at a time."""

OUTSIDE = (30, 32, 36)
"""The neutral dark colour of pixels outside the mask, in every picture of a map."""


def encode_srgb(linear: ArrayLike) -> NDArray[np.float64]:
    """sRGB values in [0, 1] of linear ones (any shape), clipped to [0, 1]; NaN becomes 0. Source: IEC 61966-2-1."""
    return linear_to_srgb(np.clip(np.nan_to_num(np.asarray(linear, dtype=np.float64), nan=0.0), 0, 1))


def white_of(images: NDArray[Any], mask: Bools | None = None, percentile: float = 99.0) -> float:
    """The radiance to show as white, one for a whole capture, so that its pictures and layers compare.

    images: (..., H, W, 3) linear. mask: (H, W). The percentile is that of the brightest channel over all pictures inside the
    mask: highlights are clipped, the body is not dimmed for them. 1.0 where everything is black.
    """
    peak = np.asarray(images).max(axis=-1)
    values = peak if mask is None else peak[..., mask]
    values = values[np.isfinite(values)]
    white = float(np.percentile(values, percentile)) if values.size else 0.0
    return white if white > 0 else 1.0


def tone(radiance: NDArray[Any], white: float = 1.0) -> Picture:
    """A linear picture (..., H, W, 3) as 8-bit sRGB, with `white` at 255 and what is brighter clipped."""
    if not (np.isfinite(white) and white > 0):
        raise InputError(f"the white level must be a positive number, got {white!r}")
    picture = np.empty(np.shape(radiance), np.uint8)
    for rows in _strips(picture):
        picture[rows] = _bytes(encode_srgb(np.asarray(radiance[rows], dtype=np.float64) / white) * 255)
    return picture


def normal_picture(normal: NDArray[Any], mask: Bools | None = None) -> Picture:
    """Normals (H, W, 3) as colours, (n + 1) / 2 scaled to 8 bits: red to the right, green up, blue to the viewer.

    mask: (H, W); default: where the normal is finite and not zero. Outside it the picture is `OUTSIDE`.
    """
    picture = np.empty(normal.shape, np.uint8)
    for rows in _strips(picture):
        n = np.asarray(normal[rows], dtype=np.float64)
        inside = np.isfinite(n).all(axis=-1) & (n != 0).any(axis=-1)
        picture[rows] = _masked(normal_bytes(np.nan_to_num(n)), inside if mask is None else mask[rows] & inside)
    return picture


def sphere_legend(size: int = 96) -> Picture:
    """The key to `normal_picture`: the normals of a sphere seen from the front, of radius 0.48 size, (size, size, 3)."""
    centre = (size - 1) / 2
    y, x = np.mgrid[:size, :size]
    x, y = (x - centre) / (0.48 * size), (centre - y) / (0.48 * size)
    r2 = x**2 + y**2
    inside = r2 < 1
    n = np.stack([x, y, np.sqrt(np.clip(1 - r2, 0, None))], axis=-1)
    return normal_picture(n, inside)


def height_range(height: NDArray[Any], mask: Bools | None = None) -> tuple[float, float]:
    """The heights (H, W) between which the colours of a picture run; (0, 1) where none is finite.

    All but the lowest and the highest 0.2 %: a few steep pixels at the rim must not take the whole scale.
    """
    values = height[np.isfinite(height) if mask is None else mask & np.isfinite(height)]
    if not values.size:
        return 0.0, 1.0
    lo, hi = (float(v) for v in np.percentile(values, [0.2, 99.8]))
    return (lo, hi) if hi > lo else (lo - 0.5, lo + 0.5)


def relief_picture(height: NDArray[Any], lo: float, hi: float, metres_per_pixel: float = 1.0, strength: float = 1.0) -> Picture:
    """Shaded relief (H, W, 3) under the colours of height, so that small form is seen that a height map hides.

    height: (H, W), NaN outside. metres_per_pixel: of the pixel grid, in the height's unit (1 for heights in pixels).
    strength: exaggerates the slope. The light comes from the upper left at 45 degrees, the mapmaker's convention.
    Source: Horn, "Hill shading and the reflectance map", Proc. IEEE 69(1), 1981.
    """
    picture = np.empty((*height.shape, 3), np.uint8)
    for rows in _strips(picture):
        first = max(rows.start - 1, 0)  # slopes need the rows above and below
        picture[rows] = _relief(height[first : rows.stop + 1], lo, hi, metres_per_pixel, strength)[rows.start - first :][
            : rows.stop - rows.start
        ]
    return picture


def _relief(height: NDArray[Any], lo: float, hi: float, metres_per_pixel: float, strength: float) -> Picture:
    inside = np.isfinite(height)
    dx, dy = (strength * d / metres_per_pixel for d in _slopes(np.asarray(height, dtype=np.float64), inside))
    light = np.array([-0.5, 0.5, np.sqrt(0.5)])
    shade = (-dx * light[0] - dy * light[1] + light[2]) / np.sqrt(1 + dx**2 + dy**2)
    base = _table("height")[_index(height, inside, lo, hi)] / 255.0
    # Lambert's term on linear colour, over a floor so that no slope turns black and loses its height colour.
    lit = (base**2.2) * (0.25 + 1.05 * np.clip(shade, 0, None))[..., None]
    return _masked(_bytes(encode_srgb(lit) * 255), inside)


def error_picture(values: NDArray[Any], mask: Bools | None = None, top: float = 30.0, colours: str = "error") -> Picture:
    """Errors (H, W), in degrees say, from 0 (dark) to `top` (light; larger ones too). Outside the mask, or not finite: `OUTSIDE`.

    The colours rise evenly in lightness, so the map reads without colour vision and in grey print.
    """
    inside = np.isfinite(values)
    return _mapped(values, inside if mask is None else mask & inside, 0.0, top, colours)


def signed_picture(values: NDArray[Any], mask: Bools | None = None, top: float = 1.0) -> Picture:
    """Signed errors (H, W) from -top (blue) through 0 (near white) to +top (orange)."""
    inside = np.isfinite(values)
    return _mapped(values, inside if mask is None else mask & inside, -top, top, "signed")


def difference_picture(a: Picture, b: Picture, scale: float = 1.0) -> Picture:
    """|a - b| of two 8-bit pictures of one shape, times `scale`, clipped at 255. Source: the paper's Fig. 4.3 to 4.5."""
    if a.shape != b.shape:
        raise InputError(f"pictures of shapes {a.shape} and {b.shape} have no difference")
    return _bytes(np.abs(a.astype(np.float64) - b.astype(np.float64)) * scale)


def difference_scale(*pairs: tuple[Picture, Picture]) -> float:
    """The largest of 1, 2, 4, 8, 16 that clips at most 1 % of any pair's differing values: one scale for all."""
    scales = [1.0]
    for a, b in pairs:
        d = np.abs(a.astype(np.float64) - b.astype(np.float64))
        d = d[d > 0]
        high = float(np.percentile(d, 99)) if d.size else 0.0
        scales.append(max((s for s in (1.0, 2.0, 4.0, 8.0, 16.0) if high * s <= 255), default=1.0))
    return min(scales[1:], default=1.0)


def overlay(picture: Picture, mask: Bools, colour: tuple[int, int, int] = (255, 64, 160), opacity: float = 0.65) -> Picture:
    """`picture` with the pixels of `mask` (H, W), such as the defects, tinted in `colour`."""
    tinted = picture.copy()
    tinted[mask] = _bytes(picture[mask] * (1 - opacity) + np.array(colour, dtype=np.float64) * opacity)
    return tinted


def colour_strip(colours: str = "error", width: int = 256, height: int = 1) -> Picture:
    """The colours from low (left) to high (right), (height, width, 3)."""
    index = np.round(np.linspace(0, 255, width)).astype(int)
    return np.repeat(_table(colours)[index][None], height, axis=0)


def png_bytes(picture: Picture) -> bytes:
    """The picture as a PNG file. (H, W, 3), or (H, W) for grey."""
    return _encoded(picture, ".png", [16, 6])  # cv2.IMWRITE_PNG_COMPRESSION; 9 takes ten times as long for 13 % less


def photo_bytes(picture: Picture, limit: int = 60_000) -> tuple[bytes, str]:
    """The picture as a PNG file where that takes at most `limit` bytes, else as a JPEG of quality 92; and its media type."""
    data = png_bytes(picture)
    if len(data) <= limit:
        return data, "image/png"
    # cv2.IMWRITE_JPEG_QUALITY = 1, _SAMPLING_FACTOR = 7: colour at full resolution (4:4:4), for small highlights keep their colour.
    return _encoded(picture, ".jpg", [1, 92, 7, 0x111111]), "image/jpeg"


def crop_box(mask: Bools, margin: int = 4) -> tuple[slice, slice]:
    """Rows and columns that hold the mask (H, W) and `margin` pixels around it; everything where the mask is empty."""
    H, W = mask.shape
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return slice(0, H), slice(0, W)
    return (
        slice(max(int(rows[0]) - margin, 0), min(int(rows[-1]) + 1 + margin, H)),
        slice(max(int(columns[0]) - margin, 0), min(int(columns[-1]) + 1 + margin, W)),
    )


def crop_to_mask(picture: Picture, mask: Bools, margin: int = 4) -> Picture:
    """`picture` (H, W, 3) cut to the box of `mask` (H, W) and `margin` pixels around it."""
    return picture[crop_box(mask, margin)]


def fit(picture: Picture, max_side: int = 640) -> Picture:
    """`picture` scaled down (area filter), so that no side exceeds `max_side`; never up."""
    H, W = picture.shape[:2]
    if max(H, W) <= max_side:
        return picture
    import cv2

    factor = max_side / max(H, W)
    size = (max(1, round(W * factor)), max(1, round(H * factor)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


# Colour scales, as (lightness, chroma, hue in degrees) in OKLCh at even steps. Lightness is linear in the value or, in the
# signed scale, in its size: that is what makes them even to the eye and safe without colour vision.
COLOURS: Mapping[str, tuple[tuple[float, float, float], ...]] = {
    "grey": (),
    "error": ((0.22, 0.10, 282), (0.35, 0.15, 300), (0.49, 0.18, 345), (0.66, 0.19, 390), (0.82, 0.16, 430), (0.96, 0.09, 465)),
    "height": ((0.26, 0.10, 285), (0.38, 0.09, 260), (0.52, 0.09, 225), (0.66, 0.11, 170), (0.80, 0.15, 130), (0.94, 0.12, 105)),
    "signed": ((0.38, 0.15, 262), (0.67, 0.12, 245), (0.96, 0.005, 245), (0.67, 0.15, 52), (0.38, 0.10, 45)),
}
"""The colour scales by name."""


def _table(colours: str) -> Picture:
    if colours not in COLOURS:
        raise InputError(f"there are no colours named {colours!r}; there are {', '.join(COLOURS)}")
    return _tables(colours)


@cache
def _tables(colours: str) -> Picture:
    if colours == "grey":
        return np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    stops = np.array(COLOURS[colours])
    t, at = np.linspace(0, 1, 256), np.linspace(0, 1, len(stops))
    lightness = np.interp(t, at, stops[:, 0])
    angle = np.radians(stops[:, 2])
    a = np.interp(t, at, stops[:, 1] * np.cos(angle))
    b = np.interp(t, at, stops[:, 1] * np.sin(angle))
    # Too strong a colour for the screen is paled, never shifted in lightness.
    keep, drop = np.zeros(256), np.ones(256)
    for _ in range(20):
        middle = (keep + drop) / 2
        rgb = _oklab_to_linear(lightness, a * middle, b * middle)
        fits = ((rgb > -1e-6) & (rgb < 1 + 1e-6)).all(axis=1)
        keep, drop = np.where(fits, middle, keep), np.where(fits, drop, middle)
    return _bytes(encode_srgb(_oklab_to_linear(lightness, a * keep, b * keep)) * 255)


def _oklab_to_linear(lightness: NDArray[Any], a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    """Linear sRGB (N, 3) of OKLab. Source: Ottosson, "A perceptual color space for image processing", 2020."""
    lms = np.stack(
        [
            lightness + 0.3963377774 * a + 0.2158037573 * b,
            lightness - 0.1055613458 * a - 0.0638541728 * b,
            lightness - 0.0894841775 * a - 1.2914855480 * b,
        ]
    )
    to_rgb = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    rgb: NDArray[np.float64] = (to_rgb @ lms**3).T
    return rgb


def _strips(picture: Picture) -> Iterator[slice]:
    """Parts of a picture, along its first axis, that are worked out one after another: double precision takes eight times the room."""
    step = max(AT_ONCE * len(picture) // max(picture.size, 1), 1)
    for start in range(0, len(picture), step):
        yield slice(start, min(start + step, len(picture)))


def _index(values: NDArray[Any], inside: Bools, lo: float, hi: float) -> NDArray[np.intp]:
    if not (np.isfinite(lo) and np.isfinite(hi) and hi > lo):
        raise InputError(f"a colour scale must rise, got {lo} to {hi}")
    share = (np.where(inside, values, lo).astype(np.float64) - lo) / (hi - lo)
    return np.round(np.clip(share, 0, 1) * 255).astype(np.intp)


def _mapped(values: NDArray[Any], inside: Bools, lo: float, hi: float, colours: str) -> Picture:
    return _masked(_table(colours)[_index(values, inside, lo, hi)], inside)


def _masked(picture: Picture, inside: Bools) -> Picture:
    return np.where(inside[..., None], picture, np.array(OUTSIDE, np.uint8))


def _slopes(height: NDArray[np.float64], inside: Bools) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """dz/dx (right) and dz/dy (up), by central differences, one-sided at the rim, 0 where there is no neighbour."""

    def along(axis: int) -> NDArray[np.float64]:
        z, good = np.moveaxis(height, axis, 1), np.moveaxis(inside, axis, 1)
        step = np.where(good[:, 1:] & good[:, :-1], np.diff(np.where(good, z, 0), axis=1), np.nan)
        pair = np.full((2, *z.shape), np.nan)
        pair[0, :, :-1], pair[1, :, 1:] = step, step
        known = np.isfinite(pair)
        total = np.where(known, pair, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        return np.moveaxis(total, 1, axis)

    return along(1), -along(0)


def _bytes(values: NDArray[Any]) -> Picture:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _encoded(picture: Picture, kind: str, options: list[int]) -> bytes:
    import cv2

    if picture.dtype != np.uint8:
        raise InputError(f"a picture to write must be 8-bit, got {picture.dtype}")
    flipped = picture[..., ::-1] if picture.ndim == 3 else picture
    good, data = cv2.imencode(kind, np.ascontiguousarray(flipped), options)
    if not good:
        raise InputError(f"a picture of shape {picture.shape} cannot be encoded")
    return bytes(data.tobytes())
