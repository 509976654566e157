"""The Capture: K linear pictures of one fixed view, each under one known light.

A render, a folder of photographs and a DiLiGenT folder all become a Capture; everything downstream takes nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntFlag
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture_lights import check_intensities, check_kinds, check_lights, check_positions, of_pictures
from gen.errors import InputError
from gen.files import printable

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

LUMA = np.array([0.2989, 0.5870, 0.1140])
"""Weights of linear R, G, B in the grey value that the solvers work on: those of DiLiGenT's published baselines."""


class Fault(IntFlag):
    """Why a sample is not a measurement. `Capture.faults` holds the sum of the reasons for every sample."""

    NONE = 0
    DARK = 1
    """At or below the black level: in shadow, or lost in the noise."""
    CLIPPED = 2
    """At the top of the sensor's or file's range in at least one channel."""
    MISSING = 4
    """No value at all (NaN, a hole)."""


@dataclass(frozen=True)
class Scale:
    """How pixels relate to the world. All fields None: unknown, and heights are in pixels.

    mm_per_pixel: orthographic views, millimetres between pixel centres.
    camera: (3, 3) OpenCV intrinsics (y down, pixel centres at integers): the view is perspective.
    distance_mm: distance along the optical axis from the camera to the object's middle, or where lights are near to the point that their
    places are stated from; with `camera` it fixes the scale.
    """

    mm_per_pixel: float | None = None
    camera: NDArray[np.float64] | None = None
    distance_mm: float | None = None

    def __post_init__(self) -> None:
        for name in ("mm_per_pixel", "distance_mm"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} must be a positive number, got {value!r}")
        if self.camera is not None:
            K = np.asarray(self.camera, dtype=np.float64)
            if K.shape != (3, 3) or not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
                raise InputError("camera K must be a finite 3x3 matrix with positive focal lengths")
            object.__setattr__(self, "camera", K)

    @property
    def metres_per_pixel(self) -> float | None:
        """Metres a pixel covers at the object, or None where the scale is unknown."""
        if self.camera is not None:
            return None if self.distance_mm is None else self.distance_mm / 1000 / float(self.camera[0, 0])
        return None if self.mm_per_pixel is None else self.mm_per_pixel / 1000

    @property
    def unit(self) -> str:
        """Unit of heights: "m" where the scale is known, else "px"."""
        return "px" if self.metres_per_pixel is None else "m"


@dataclass(frozen=True, eq=False)
class Truth:
    """What is known of the scene, each part None where it is not. Shapes as in `Capture`.

    normals: (H, W, 3) unit, zero outside the mask. depth: (H, W) metres along -z from the camera, NaN outside the mask.
    albedo: (H, W, 3). gloss: (H, W) alpha of the half-vector distribution, 0 where there is none.
    specular_albedo: (H, W, 3) specular reflectance: Ks of the substrate, m_s of Blinn-Phong.
    diffuse, specular, matte, ks0: (K, H, W, 3) layers of each picture. mirror: (K, H, W, 3) what the same surface shows as a mirror.
    shadow: (K, H, W) uint8, 1 attached, 2 cast.
    """

    normals: Floats | None = None
    depth: Floats | None = None
    albedo: Floats | None = None
    gloss: Floats | None = None
    specular_albedo: Floats | None = None
    diffuse: Floats | None = None
    specular: Floats | None = None
    matte: Floats | None = None
    ks0: Floats | None = None
    mirror: Floats | None = None
    shadow: NDArray[np.uint8] | None = None

    PER_VIEW = ("normals", "depth", "albedo", "gloss", "specular_albedo")
    PER_LIGHT = ("diffuse", "specular", "matte", "ks0", "mirror", "shadow")

    def names(self) -> list[str]:
        """The parts that are there."""
        return [name for name in (*self.PER_VIEW, *self.PER_LIGHT) if getattr(self, name) is not None]


@dataclass(frozen=True, eq=False)
class Capture:
    """K linear pictures of one fixed view, each under one known light.

    images: (K, H, W, 3) float32 linear radiance. lights: (K, 3) unit vectors from the surface to the light, camera frame
    (x right, y up, z to the viewer). intensities: (K, 3) radiance of a white Lambertian surface facing the light.
    light_kinds: one of `gen.capture_lights.KINDS` a picture, by default "sun". Light from many directions ("environment", "ambient",
    "several") states the direction to the camera. positions: (K, 3) mm of near lights ("point", "area"), along the camera frame's axes
    from where the camera looks, NaN rows where the light is distant; None where all are. Their intensity is that at the origin.
    mask: (H, W) bool. faults: (K, H, W) uint8 of `Fault` flags. names: one a picture.
    encoding: how the file's numbers became linear ("linear", "srgb"), as it was said or defaulted.
    source: where it came from, for reports. provenance: whatever else the source says of itself.

    Raises InputError where shapes disagree, lights have no length, near ones no place, or the mask is empty. Whether the lights suffice
    for photometric stereo is for the measurement to say (`recon.suitability`): a capture of one light is a capture too.
    """

    images: Floats
    lights: NDArray[np.float64]
    mask: Bools
    intensities: NDArray[np.float64] = None  # type: ignore[assignment] # filled in: ones
    faults: NDArray[np.uint8] = None  # type: ignore[assignment] # filled in: no fault
    names: tuple[str, ...] = ()
    scale: Scale = field(default_factory=Scale)
    truth: Truth = field(default_factory=Truth)
    encoding: str = "linear"
    source: str = "memory"
    provenance: Mapping[str, Any] = field(default_factory=dict)
    light_kinds: tuple[str, ...] = ()
    positions: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        where = printable(self.source)
        put("source", where)
        images = np.asarray(self.images, dtype=np.float32)
        if images.ndim != 4 or images.shape[3] != 3 or 0 in images.shape:
            raise InputError(f"{where}: images must be (K, H, W, 3), got {images.shape}")
        K, H, W, _ = images.shape
        mask = np.asarray(self.mask, dtype=bool)
        if mask.shape != (H, W):
            raise InputError(f"{where}: the mask is {_size(mask.shape)}, the pictures are {_size((H, W))}")
        if not mask.any():
            raise InputError(f"{where}: the mask is empty; white pixels must mark the object")
        put("mask", mask)
        put("lights", check_lights(self.lights, K, where))
        put("intensities", check_intensities(self.intensities, K, where))
        put("light_kinds", check_kinds(self.light_kinds, K, where))
        put("positions", check_positions(self.positions, self.light_kinds, where))
        faults = np.zeros((K, H, W), np.uint8) if self.faults is None else np.asarray(self.faults, dtype=np.uint8)
        if faults.shape != (K, H, W):
            raise InputError(f"{where}: faults must be {(K, H, W)}, got {faults.shape}")
        red, green, blue = np.moveaxis(np.isfinite(images), 3, 0)
        finite = red & green & blue
        if not finite.all():
            faults = faults | np.where(finite, 0, int(Fault.MISSING)).astype(np.uint8)
            images = np.where(finite[..., None], images, 0).astype(np.float32)
        if not ((faults & Fault.MISSING) == 0)[:, mask].any():
            raise InputError(f"{where}: not one finite value inside the mask")
        put("images", images)
        put("faults", faults)
        names = tuple(map(printable, self.names)) or tuple(f"{k + 1:03d}" for k in range(K))
        if len(names) != K:
            raise InputError(f"{where}: {len(names)} names for {K} pictures")
        put("names", names)
        for name in Truth.PER_VIEW:
            _check_truth(getattr(self.truth, name), name, (H, W), where)
        for name in Truth.PER_LIGHT:
            _check_truth(getattr(self.truth, name), name, (K, H, W), where)

    @property
    def valid(self) -> Bools:
        """(K, H, W) bool: false where the sample is clipped, dark or missing."""
        return self.faults == 0

    @property
    def count(self) -> int:
        """K, the number of pictures."""
        return int(self.images.shape[0])

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)."""
        return int(self.images.shape[1]), int(self.images.shape[2])

    def reflectance(self, images: Floats | None = None) -> Floats:
        """`images` (K, H, W, 3), by default the capture's own, over each light's intensity: albedo * max(n.l, 0) where matte."""
        chosen = self.images if images is None else images
        return chosen / self.intensities[:, None, None, :].astype(np.float32)

    def with_images(self, images: Floats, faults: NDArray[np.uint8] | None = None) -> Capture:
        """The same view and lights with other pictures (K, H, W, 3), such as the matte truth; faults as they are unless given."""
        return replace(self, images=images, faults=self.faults if faults is None else faults)

    def select(self, frames: Sequence[int]) -> Capture:
        """The capture of some pictures only. frames: 0-based indices, in the order wanted.

        Raises InputError where an index is out of range or comes twice.
        """
        chosen = list(frames)
        wrong = [k + 1 for k in chosen if not 0 <= k < self.count]
        if wrong:
            raise InputError(f"{self.source}: there is no picture {wrong[0]}; it has pictures 1 to {self.count}")
        if len(set(chosen)) != len(chosen):
            raise InputError(f"{self.source}: a picture is named twice in the selection")
        truth = replace(
            self.truth,
            **{name: part[chosen] for name in Truth.PER_LIGHT if (part := getattr(self.truth, name)) is not None},
        )
        return replace(
            self,
            images=self.images[chosen],
            lights=self.lights[chosen],
            intensities=self.intensities[chosen],
            faults=self.faults[chosen],
            names=tuple(self.names[k] for k in chosen),
            truth=truth,
            provenance=of_pictures(self.provenance, chosen, self.count),
            light_kinds=tuple(self.light_kinds[k] for k in chosen),
            positions=None if self.positions is None else self.positions[chosen],
        )


def read_capture(path: str | Path, encoding: str | None = None) -> Capture:
    """Read any capture folder: our renders, DiLiGenT, RTI `.lp`, psmImages lists, or pictures with `lights.txt`.

    path: the folder, or the list file (`.txt`, `.lp`). encoding: "srgb" or "linear" to say how the numbers are meant; None takes
    the default of the file type (8-bit is sRGB, 16-bit and EXR are linear), which the capture records in `encoding`.
    Raises InputError with one line where something is missing, damaged or contradictory.
    """
    from gen.formats import read

    return read(Path(path), encoding)


def grey(images: NDArray[Any]) -> NDArray[Any]:
    """Luma (..., H, W) of linear pictures (..., H, W, 3): the one grey value that the solvers use."""
    result: NDArray[Any] = images @ LUMA.astype(images.dtype)
    return result


def _check_truth(part: NDArray[Any] | None, name: str, lead: tuple[int, ...], where: str) -> None:
    if part is not None and part.shape[: len(lead)] != lead:
        raise InputError(f"{where}: truth '{name}' is {part.shape}, the pictures ask for {lead}")


def _size(shape: tuple[int, ...]) -> str:
    return "x".join(str(n) for n in reversed(shape))
