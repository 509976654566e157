"""What is missing or doubtful in a folder of photographs, in plain words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Fault, grey
from gen.capture_lights import NEAR
from gen.errors import InputError
from gen.photos.darkroom import develop_folder
from gen.photos.light_sources import lights_of
from gen.photos.read import assembled, is_photos
from gen.photos.spec import read_photo_spec
from gen.srgb import linear_to_srgb, srgb_to_linear
from recon.conditioning import MAX_CONDITION
from recon.suitability import NOTEWORTHY_CLIPPED, TOO_MANY_CLIPPED, clipped_share

DIM = 0.02
"""Share of full scale under which the 99th percentile of the object leaves 8 bits with five grey steps, and noise to look at."""

SLOPE = 0.1
"""How far d log(value) / d log(exposure) may be from 1: shutters are good to a few percent, a gamma taken for linear is off by 0.55."""

MOVED = 0.5
"""Pixels of shift between exposures from which edges of the merged picture are mixtures."""

BETTER = 0.7
"""A reading of the numbers (sRGB or linear) is suspected where another explains the shading with this share of the residual or less."""

FRONTAL = 12
"""Lights nearest to the camera whose pictures that is asked of: few pixels are lit by all of a hundred."""

ROUGH_BALL = 0.9
"""Share of the outline that should lie on the ball's: under it, something stands before the ball or belongs to the mask."""

BALLS_APART = 3.0
"""Degrees between the directions that distant-light balls say: more, and the light is near or a ball is wrong."""

ESTIMATE = 0.05
"""Residual over brightness above which estimated intensities are doubtful: of two real things, one that fits a matte one to 3.5 % gave
intensities good to 4 %, one that fits to 6 % gave them to 12 %."""

Level = Literal["missing", "doubtful", "note"]


@dataclass(frozen=True)
class Finding:
    """level: "missing" (cannot be measured so), "doubtful" (can, but look) or "note". about: one word. text: a sentence or two."""

    level: Level
    about: str
    text: str


def check_photos(folder: Path, encoding: str | None = None) -> list[Finding]:
    """What is missing or doubtful in a capture's folder, the worst first; empty where nothing is.

    For a folder with capture.yaml everything is said at once: what the pictures show is said even where the lights are missing. Any other
    capture that `gen.capture.read_capture` reads is checked as it comes. Raises InputError where the folder is not readable at all.
    """
    folder = Path(folder)
    if not is_photos(folder):
        from gen.capture import read_capture

        return _sorted(check_capture(read_capture(folder, encoding)))
    spec = read_photo_spec(folder)
    photographs = develop_folder(folder, spec, encoding)
    try:
        capture = assembled(folder, spec, photographs, lights_of(folder, spec, photographs))
    except InputError as error:
        about = "ball" if spec.lights is not None and spec.lights.balls is not None else "lights"
        bare = Capture(
            images=photographs.images,
            lights=np.tile((0.0, 0.0, 1.0), (len(photographs.images), 1)),
            mask=photographs.mask,
            faults=photographs.faults,
            names=photographs.names,
            scale=photographs.scale,
            encoding=photographs.encoding,
            source=str(folder),
            provenance=photographs.record,
        )
        text = str(error).removeprefix(f"{folder}/")
        return _sorted([Finding("missing", about, f"{text}."), *_of_pictures(bare)])
    return _sorted(check_capture(capture))


def check_capture(capture: Capture) -> list[Finding]:
    """The findings on a capture that was read. See `check_photos`."""
    return [*_of_lights(capture), *_of_pictures(capture), *_of_encoding(capture)]


def _sorted(findings: list[Finding]) -> list[Finding]:
    return sorted(findings, key=lambda finding: ("missing", "doubtful", "note").index(finding.level))


def _of_lights(capture: Capture) -> list[Finding]:
    found: list[Finding] = []
    L, record = capture.lights, capture.provenance
    s = np.linalg.svd(L, compute_uv=False)
    if len(L) < 3:
        found.append(
            Finding("missing", "lights", f"There are {len(L)} lights; photometric stereo needs at least three, five are better.")
        )
    elif s[2] * 1e4 < s[0]:
        found.append(Finding("missing", "lights", "The light directions lie in one plane: move one light out of it."))
    elif s[2] * MAX_CONDITION < s[0]:
        text = f"The lights are too much alike (condition number {s[0] / s[2]:.0f}, at most {MAX_CONDITION:g}): spread them."
        found.append(Finding("missing", "lights", text))
    behind = int((L[:, 2] <= 0).sum())
    if behind:
        level: Level = "missing" if behind == len(L) else "doubtful"
        found.append(
            Finding(level, "lights", f"{behind} of {len(L)} lights come from behind the object (z <= 0): check their signs.")
        )
    if any(kind in NEAR for kind in capture.light_kinds) and capture.scale.metres_per_pixel is None:
        found.append(
            Finding(
                "doubtful",
                "scale",
                "The lights are near, but no scale is known, so where they stand over a pixel is not known either.",
            )
        )
    found += _of_balls(record)
    how = str(record.get("intensities", ""))
    if how.startswith("equal, because"):
        found.append(Finding("doubtful", "intensities", f"The lights' intensities were taken as {how}."))
    residual = record.get("intensities_residual")
    if residual is not None:
        text = f"The lights' intensities were estimated from the object, which fits a matte one to {100 * residual:.0f} %."
        found.append(
            Finding("doubtful", "intensities", f"{text} Measure them on a matte ball or a white card.")
            if residual > ESTIMATE
            else Finding("note", "intensities", text)
        )
    return found


def _of_balls(record: Any) -> list[Finding]:
    found = []
    for n, ball in enumerate(record.get("balls", []), 1):
        name = f"Ball {n} ({ball['kind']})"
        if ball["outline_share"] < ROUGH_BALL:
            text = f"{name}: only {100 * ball['outline_share']:.0f} % of its outline is a ball's; the rest was left aside."
            found.append(Finding("doubtful", "ball", text))
        worst = max(ball["off_the_mean_degrees"])
        if worst > BALLS_APART and "rays_miss_mm" not in record:
            text = f"{name} sees a light {worst:.1f} degrees off the mean of the balls: the lights are near, or a ball is wrong."
            found.append(Finding("doubtful", "ball", text))
    if "near" in record:
        found.append(Finding("doubtful", "ball", "The balls' rays to a light do not meet, so all lights were taken as distant."))
    return found


def _of_pictures(capture: Capture) -> list[Finding]:
    found: list[Finding] = []
    record, mask = capture.provenance, capture.mask
    share = clipped_share(capture)
    if share > TOO_MANY_CLIPPED:
        found.append(
            Finding("missing", "clipped", f"{100 * share:.0f} % of the object's samples are clipped: take less exposure.")
        )
    elif share > NOTEWORTHY_CLIPPED:
        text = f"{100 * share:.0f} % of the object's samples are clipped: less exposure, or a bracket, would measure more."
        found.append(Finding("doubtful", "clipped", text))
    brightness = np.percentile(grey(capture.images)[:, mask], 99, axis=1)
    times = (record.get("brackets") or {}).get("exposures_s") or [1.0]
    top = float(brightness.max()) * times[-1] / times[0]  # of full scale at the longest exposure
    if record.get("bits", 32) < 32 and top < DIM:
        text = f"The pictures are dark: the object's brightest parts reach {100 * top:.2g} % of full scale. Expose longer."
        found.append(Finding("doubtful", "dark", text))
    weak = brightness < 0.05 * np.median(brightness)
    if weak.any():
        name = capture.names[int(np.argmax(weak))]
        found.append(Finding("doubtful", "dark", f"Picture {name} is dark beside the others: was its light on?"))
    dark = float(((capture.faults & Fault.DARK) > 0)[:, mask].mean())
    if dark > 0.5:
        found.append(
            Finding("doubtful", "dark", f"{100 * dark:.0f} % of the object's samples do not stand out of the black level.")
        )
    missing = float(((capture.faults & Fault.MISSING) > 0)[:, mask].mean())
    if missing:
        found.append(Finding("doubtful", "missing", f"{100 * missing:.2g} % of the object's samples hold no value."))
    if str(record.get("mask", "")).startswith("none given"):
        found.append(Finding("doubtful", "mask", "There is no mask: the whole frame would be measured, background and all."))
    if capture.scale.metres_per_pixel is None:
        remedy = "camera.distance_mm" if capture.scale.camera is not None else "mm_per_pixel"
        found.append(Finding("note", "scale", f"No scale is known, so heights are in pixels: say {remedy}."))
    if record.get("bits") == 8:
        text = "The pictures have 8 bits: raw or 16-bit files keep more of the shadows, and nobody's tone curve."
        found.append(Finding("note", "8-bit", text))
    return found + _of_brackets(record)


def _of_brackets(record: Any) -> list[Finding]:
    found = []
    bracket = record.get("brackets") or {}
    slope = bracket.get("slope")
    if slope is not None and abs(slope - 1) > SLOPE:
        text = (
            f"Twice the exposure gives {2**slope:.2f} times the value where it should give 2: "
            "the files are not linear as read (say colour), or an exposure_s is wrong."
        )
        found.append(Finding("doubtful", "exposure", text))
    shift = bracket.get("largest_shift_px", 0.0)
    if shift > MOVED:
        text = f"Exposures of one picture are shifted by {shift:.1f} pixels against each other: camera or object moved."
        found.append(Finding("doubtful", "alignment", text))
    return found


def _of_encoding(capture: Capture) -> list[Finding]:
    """Whether the other reading of the numbers would explain the shading much better."""
    if capture.encoding not in ("srgb", "linear") or capture.provenance.get("brackets") or capture.positions is not None:
        return []
    frames = capture.provenance.get("frames") or {}
    if "dark" in frames or "ambient" in frames or "flat" in frames or capture.provenance.get("format") == "render":
        return []  # the numbers are no longer the file's
    # Estimated intensities soak up part of what a wrong reading does, but not the bend within a picture.
    as_read, other = _fit(capture, None), _fit(capture, "decode" if capture.encoding == "linear" else "encode")
    if as_read is None or other is None or other > BETTER * as_read:
        return []
    wrong, right = ("linear", "srgb") if capture.encoding == "linear" else ("srgb", "linear")
    return [
        Finding(
            "doubtful",
            "encoding",
            f"The pictures were read as {wrong}, but as {right} they fit a shaded surface much better "
            f"(residual {100 * other:.1f} % against {100 * as_read:.1f} %): say how they were stored.",
        )
    ]


def _fit(capture: Capture, how: str | None) -> float | None:
    """Median over pixels of a Lambertian fit's residual over the brightness, None where hardly a pixel is lit by all lights.

    how: None, or "decode" or "encode": what is done to the numbers (sRGB) before the fit. The fit is brought back and compared with
    the numbers as they were: a residual among encoded numbers is smaller by itself, since encoding flattens all differences.
    """
    frontal = np.argsort(-capture.lights[:, 2])[:FRONTAL]
    L = capture.lights[frontal]
    if len(L) < 5 or np.linalg.cond(L) > MAX_CONDITION:
        return None
    rows, columns = np.nonzero(capture.mask & (capture.faults[frontal] == 0).all(axis=0))
    step = max(1, len(rows) // 4000)
    y: NDArray[np.float64] = grey(capture.images[frontal[:, None], rows[::step], columns[::step]]).astype(np.float64)
    y = y[:, y.min(axis=0) > 0.15 * y.max(axis=0)] if y.size else y
    if y.shape[1] < 100:
        return None
    there, back = {None: (_same, _same), "decode": (srgb_to_linear, linear_to_srgb), "encode": (linear_to_srgb, srgb_to_linear)}[
        how
    ]
    read = there(y)
    strength = np.ones(len(L))
    for _ in range(10):  # each light's strength is left free, so that neither reading profits from the stated ones
        shading = L @ np.linalg.lstsq(L, read / strength[:, None], rcond=None)[0]
        strength = (shading * read).sum(1) / np.maximum((shading**2).sum(1), 1e-30)
        strength = np.maximum(strength / strength.mean(), 1e-3)
    off = y - back(np.maximum(shading, 0) * strength[:, None])
    return float(np.median(np.sqrt((off**2).mean(axis=0)) / y.mean(axis=0)))


def _same(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values
