"""Developing a photograph: what the camera added is taken off, and what it bent is straightened, in linear numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gen.capture import Bools, Fault, Floats
from gen.errors import InputError
from gen.images import Picture, read_image

Doubles = NDArray[np.float64]

LOST = 3.0
"""A sample is dark where no channel stands out of the dark frame by more than so many standard deviations of the dark frame's noise."""

LEAST_FLAT = 0.02
"""Share of the flat field's median below which it says nothing: there the lens or the card ends, and samples are missing."""


@dataclass(frozen=True)
class Colour:
    """How the numbers of a file became what they are. encoding: "srgb" or "linear", None for the default of the file's kind.

    gamma: where it is not 1, linear numbers are the file's to this power.
    """

    encoding: str | None = None
    gamma: float = 1.0

    def read(self, path: Path) -> Picture:
        """A picture, linear. Raises InputError as `gen.images.read_image` does."""
        if self.gamma == 1.0:
            return read_image(path, self.encoding)
        picture = read_image(path, "linear")
        powered = np.copysign(np.abs(picture.linear) ** np.float32(self.gamma), picture.linear)
        return replace(picture, linear=powered, encoding=f"gamma {self.gamma:g}")


@dataclass(frozen=True, eq=False)
class Frames:
    """The mean of several pictures of the same thing. mean: (H, W, 3). noise: standard deviation of one picture's samples."""

    mean: Floats
    noise: float

    @staticmethod
    def of(pictures: Sequence[Picture], paths: Sequence[Path]) -> Frames:
        """Raises InputError where they differ in size."""
        first = pictures[0].linear
        for picture, path in zip(pictures, paths, strict=True):
            if picture.linear.shape != first.shape:
                raise InputError(f"{path}: is another size than {paths[0].name}; the frames of one kind must have one size")
        stack = np.stack([p.linear for p in pictures])
        mean = stack.mean(axis=0)
        if len(stack) > 1:
            noise = float(np.sqrt(stack.var(axis=0, ddof=1).mean()))
        else:  # what differs between neighbours: fixed patterns count as noise then
            noise = float(1.4826 * np.median(np.abs(np.diff(mean, axis=1))) / np.sqrt(2)) if mean.shape[1] > 1 else 0.0
        return Frames(mean.astype(np.float32), noise)


@dataclass(frozen=True, eq=False)
class Development:
    """All that is done to every photograph of a capture, in this order; each part is left out where it is None.

    dark: by exposure in seconds (None: any), subtracted. ambient: radiance per unit of exposure (H, W, 3), subtracted.
    flat: (H, W, 3), median 1 in each channel, divided. camera, distortion: OpenCV's, undistorted onto the same K.
    """

    dark: dict[float | None, Frames] = field(default_factory=dict)
    ambient: Floats | None = None
    flat: Floats | None = None
    camera: Doubles | None = None
    distortion: Doubles | None = None

    def without_dark(self, picture: Picture, exposure: float | None, path: Path) -> tuple[Floats, NDArray[np.uint8]]:
        """(linear values (H, W, 3) over the black level, faults (H, W)) of a picture. Values may fall under 0: noise has two sides."""
        faults = picture.faults
        if not self.dark:
            return picture.linear, faults
        frame = self.dark.get(exposure, self.dark.get(None))
        if frame is None:
            known = ", ".join(f"{t:g}" for t in self.dark if t is not None)
            raise InputError(
                f"{path}: there is no dark frame of its exposure {exposure} s, only of {known} s; take one, or leave them out"
            )
        same_size(frame.mean, picture.linear, path, "dark frame")
        values = picture.linear - frame.mean
        hidden = (values <= LOST * frame.noise).all(axis=-1) & ((faults & Fault.MISSING) == 0)
        faults = faults | np.where(hidden, int(Fault.DARK), 0).astype(np.uint8)
        return values, faults

    def finish(self, radiance: Floats, faults: NDArray[np.uint8], path: Path) -> tuple[Floats, NDArray[np.uint8]]:
        """(radiance, faults) with the ambient light off, the flat field divided out and the lens' distortion undone."""
        if self.ambient is not None:
            same_size(self.ambient, radiance, path, "ambient frame")
            radiance = radiance - self.ambient
        if self.flat is not None:
            same_size(self.flat, radiance, path, "flat field")
            blind = (self.flat < LEAST_FLAT).any(axis=-1)
            radiance = radiance / np.where(blind[..., None], 1, self.flat)
            faults = np.where(blind, np.uint8(Fault.MISSING), faults)
        if self.camera is not None and self.distortion is not None:
            return undistorted(radiance, faults, self.camera, self.distortion)
        return radiance.astype(np.float32), faults

    def mask(self, mask: Bools) -> Bools:
        """A mask drawn on the photographs (H, W), undistorted like them."""
        if self.camera is None or self.distortion is None:
            return mask
        values, _ = undistorted(
            np.repeat(mask[..., None], 3, 2).astype(np.float32), np.zeros(mask.shape, np.uint8), self.camera, self.distortion
        )
        straight: Bools = values[..., 0] > 0.5
        return straight


def flat_field(frame: Floats, path: Path) -> Floats:
    """A picture of an even card (H, W, 3), the dark subtracted, divided by its median in each channel, so that colours stay.

    Raises InputError where it is black.
    """
    middle = np.median(frame, axis=(0, 1))
    if not (middle > 0).all():
        raise InputError(f"{path}: the flat field is black in a channel; photograph an evenly lit grey card")
    flat: Floats = (frame / middle).astype(np.float32)
    return flat


def undistorted(
    radiance: Floats, faults: NDArray[np.uint8], camera: Doubles, distortion: Doubles
) -> tuple[Floats, NDArray[np.uint8]]:
    """The picture that a lens without distortion would have given, for the same K.

    radiance: (H, W, 3) linear. faults: (H, W). camera: (3, 3). distortion: OpenCV's coefficients (4, 5, 8, 12 or 14 of them).
    Bilinear, in linear radiance: nothing overshoots at a highlight's edge. A sample has every fault of the four that it is made of,
    and is MISSING where the lens saw nothing. Source: OpenCV's camera model (Brown, Conrady).
    """
    import cv2

    height, width = faults.shape
    x, y = cv2.initUndistortRectifyMap(camera, distortion, np.eye(3), camera, (width, height), cv2.CV_32FC1)
    straight: Floats = cv2.remap(
        np.ascontiguousarray(radiance, np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    found = np.zeros((height, width), np.uint8)
    for flag in (Fault.DARK, Fault.CLIPPED, Fault.MISSING):
        here = ((faults & flag) > 0).astype(np.float32)
        outside = 1.0 if flag == Fault.MISSING else 0.0
        touched = cv2.remap(here, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside) > 1e-3
        found[touched] |= np.uint8(flag)
    return straight, found


def same_size(frame: Floats, picture: Floats, path: Path, what: str) -> None:
    """InputError unless a frame fits the pictures."""
    if frame.shape != picture.shape:
        raise InputError(
            f"{path}: is {picture.shape[1]}x{picture.shape[0]} pixels, but the {what} is {frame.shape[1]}x{frame.shape[0]}; "
            "all must have one size"
        )
