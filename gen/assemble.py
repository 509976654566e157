"""From the arrays of a spec's jobs to its capture: one exposure, the whole frame, shadows, and the capture's faults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Fault, Floats, Scale, Truth, grey
from gen.errors import InputError
from gen.exr import HALF_MAX
from gen.faults import rng_of, with_faults
from gen.parts import installed_version
from gen.spec import Spec
from gen.spec_faults import Faults
from gen.spec_parts import AutoExposure, Orthographic

PER_VIEW = ("coverage", "normal", "depth", "albedo", "gloss")


@dataclass(frozen=True, eq=False)
class Rendered:
    """A rendered capture, and the (H, W) share of each pixel that the object fills. seconds: the workers' time, all pictures."""

    capture: Capture
    coverage: Floats
    seconds: float


def layers_of(spec: Spec) -> list[str]:
    """The layers of each picture that a spec's jobs ask for: names of `blender_scenes.job.LAYERS`."""
    kinds = set(spec.light_kinds())
    layers = ["diffuse", "specular", "matte"]
    layers += ["lit"] if kinds & {"sun", "point"} else []
    layers += ["ks0"] if spec.ks0 else []
    return layers + (["mirror"] if spec.lime and not kinds & {"sun", "point"} else [])


def assemble(spec: Spec, shots: list[Mapping[str, NDArray[Any]]], made_by: Mapping[str, Any], seconds: float = 0.0) -> Rendered:
    """The capture of the workers' arrays, one mapping a job, at the spec's exposure.

    shots: of each job the `PER_VIEW` arrays, the layers asked for, and the box that they fill. The pictures are diffuse + specular;
    exposure multiplies pictures, layers and light intensities alike, so reflectance does not depend on it. Raises InputError where the
    object is not in view or unlit.
    """
    view = {name: shots[0][name] for name in PER_VIEW}
    mask = view["coverage"] >= 0.5
    if not mask.any():
        raise InputError(f"{spec.name}: the object is not in the picture; check pose.translation_mm, camera and the shape's size")
    layers = {name: np.concatenate([shot[name] for shot in shots]) for name in layers_of(spec)}
    shadow = _shadow(spec, layers.pop("lit"), view["normal"], view["depth"], shots[0]["box"], mask) if "lit" in layers else None
    exposure = exposure_of(spec, layers["diffuse"] + layers["specular"], mask)
    for name, layer in layers.items():
        layer *= np.float32(exposure)
        if spec.half:
            layers[name] = _halved(spec, name, layer)
    full = _Frame(spec.resolution, shots[0]["box"])
    layers = {name: full(layer, rows=1) for name, layer in layers.items()}
    images = layers["diffuse"] + layers["specular"]
    faults = np.where((images <= 0).all(axis=3), int(Fault.DARK), 0).astype(np.uint8)
    W, H = spec.resolution
    # Places of near lights are stated from where the camera looks, and so must the distance be; the fall-off tells where the object lies.
    positions = spec.light_positions()
    middle = spec.camera.distance_mm - (spec.pose.translation_mm[2] if positions is None else 0)
    if isinstance(spec.camera, Orthographic):
        scale = Scale(mm_per_pixel=spec.camera.width_mm / W, distance_mm=middle if middle > 0 else None)
    else:
        scale = Scale(camera=spec.camera.intrinsics(W, H), distance_mm=middle if middle > 0 else None)
    truth = Truth(
        normals=full(np.where(mask[..., None], view["normal"], 0).astype(np.float32)),
        depth=full(np.where(mask, view["depth"] / 1000, np.nan).astype(np.float32), np.nan),
        albedo=full(np.where(mask[..., None], view["albedo"], 0).astype(np.float32)),
        gloss=full(np.where(mask, view["gloss"], 0).astype(np.float32)),
        shadow=None if shadow is None else full(shadow, rows=1),
        specular_albedo=full(_specular_albedo(spec, mask)) if spec.lime else None,
        **layers,
    )
    capture = Capture(
        images=images,
        lights=spec.light_directions(),
        intensities=spec.light_intensities() * exposure,
        mask=full(mask),
        faults=faults,
        scale=scale,
        truth=truth,
        source=f"render of {spec.name}",
        provenance={
            "exposure": exposure,
            "spec": spec.plain(),
            "spec_sha256": spec.digest(),
            **made_by,
            "versions": {"degloss": installed_version("degloss") or "not installed", "numpy": np.__version__},
        },
        light_kinds=spec.light_kinds(),
        positions=positions,
    )
    capture = with_faults(capture, spec.faults or Faults(), rng_of(spec.seed), spec.clip)
    if spec.half and not np.array_equal(capture.images, images):  # no longer formed from halves, so stored as they are
        capture = replace(capture, images=_halved(spec, "pictures", capture.images))
    return Rendered(capture, full(view["coverage"].astype(np.float32)), seconds)


def _specular_albedo(spec: Spec, mask: NDArray[np.bool_]) -> Floats:
    """(h, w, 3): Ks, LIME's m_s, of each pixel of the object; such materials have one for all."""
    specular: Floats = (mask[..., None] * np.array(spec.material.job()["specular"])).astype(np.float32)
    return specular


class _Frame:
    """Puts arrays of a box of pixels into the whole frame. rows: the axis of theirs that holds the rows; the columns' follows."""

    def __init__(self, resolution: tuple[int, int], box: NDArray[Any]) -> None:
        self.size, self.box = resolution, tuple(int(v) for v in box)

    def __call__(self, array: NDArray[Any], outside: float = 0.0, rows: int = 0) -> NDArray[Any]:
        (W, H), (x0, y0, x1, y1) = self.size, self.box
        if (x0, y0, x1, y1) == (0, 0, W, H):
            return array
        whole = np.full((*array.shape[:rows], H, W, *array.shape[rows + 2 :]), outside, array.dtype)
        whole[(slice(None),) * rows + (slice(y0, y1), slice(x0, x1))] = array
        return whole


def _halved(spec: Spec, name: str, layer: Floats) -> Floats:
    """The layer's values as half precision keeps them."""
    if float(layer.max()) > HALF_MAX:
        raise InputError(
            f"{spec.name}: half: {name} reaches {float(layer.max()):g}, more than half precision holds; leave half out"
        )
    rounded: Floats = layer.astype(np.float16).astype(np.float32)
    return rounded


def _shadow(
    spec: Spec, lit: Floats, normal: Floats, depth: Floats, box: NDArray[Any], mask: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """(K, h, w) uint8: 1 where the surface turns away from the light, 2 where something stands between, 0 where lit or off the object.

    A pixel counts as dark where less than half of its samples are lit. Pictures without a single sun or point light have no shadows here.
    """
    shadow = np.zeros(lit.shape, np.uint8)
    for k, light in enumerate(spec.pictures()):
        if light.kind not in ("sun", "point"):
            continue
        toward = light.toward() if light.kind == "sun" else np.array(light.position_mm) - _points(spec, depth, box)
        away = (normal * toward).sum(axis=-1) <= 0
        shadow[k] = np.where(mask & (lit[k] < 0.5), np.where(away, 1, 2), 0)
    return shadow


def _points(spec: Spec, depth: Floats, box: NDArray[Any]) -> NDArray[np.float64]:
    """(h, w, 3) mm: the surface points that the pixels of a box show. depth: (h, w) mm."""
    W, H = spec.resolution
    x0, y0, x1, y1 = (int(v) for v in box)
    y, x = np.mgrid[y0:y1, x0:x1].astype(np.float64)
    if isinstance(spec.camera, Orthographic):
        mm = spec.camera.width_mm / W
        X, Y = (x + 0.5 - W / 2) * mm, (H / 2 - y - 0.5) * mm
    else:
        K = spec.camera.intrinsics(W, H)
        X, Y = (x - K[0, 2]) / K[0, 0] * depth, (K[1, 2] - y) / K[1, 1] * depth
    return np.stack([X, Y, spec.camera.distance_mm - depth], axis=-1)


def exposure_of(spec: Spec, images: Floats, mask: NDArray[np.bool_]) -> float:
    """The factor on radiance and light alike. images: (K, H, W, 3) before exposure; mask: (H, W).

    An automatic one is rounded to three digits, so that another machine's last bit does not change every pixel. Raises InputError
    where the percentile is black.
    """
    if not isinstance(spec.exposure, AutoExposure):
        return float(spec.exposure)
    bright = float(np.percentile(grey(images)[:, mask], spec.exposure.percentile))
    if not bright > 0:
        raise InputError(
            f"{spec.name}: exposure: the object is black at the {spec.exposure.percentile:g}th percentile; move the lights, "
            "or give exposure as a number"
        )
    return float(f"{spec.exposure.level / bright:.3g}")
