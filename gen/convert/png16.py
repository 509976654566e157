"""16-bit linear PNGs, which any program opens, with capture.yaml, by which our reader of photographs reads them back.

001.png, 002.png, ...   the pictures, RGB; with an alpha channel, 0 where a sample is missing, if any is
capture.yaml            lights, intensities, scale
mask.png                white on the object
diffuse/001.png, ...    the layers that there are, on the pictures' scale; so specular/, matte/, ks0/, mirror/
normals.png             true normals, (n + 1) / 2
depth_gt.npz            true depth, millimetres
albedo.png              true albedo; 65535 is 1
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gen.capture import Capture, Fault
from gen.convert.about import truth_left_out, write_about
from gen.convert.capture_yaml import write_capture_yaml
from gen.convert.sixteen_bit import TOP, quantised, to_sixteen_bits
from gen.convert.truth_files import write_depth, write_normal_map
from gen.formats.render_folder import COLOUR_LAYERS
from gen.images import write_png


def write_png16(capture: Capture, folder: Path, white: float | None = None) -> tuple[str, ...]:
    """Write a capture as 16-bit linear PNGs into an empty folder; returns what that does not hold.

    white: the radiance that is stored as 65535 (`gen.convert.sixteen_bit`); the intensities are divided by it. Raises InputError where
    the folder cannot be written, or capture.yaml cannot say what there is.
    """
    truth = capture.truth
    layers = {name: layer for name in COLOUR_LAYERS if (layer := getattr(truth, name)) is not None}
    stored = to_sixteen_bits(capture, white, layers.values(), holes=True)
    names = [f"{k + 1:03d}.png" for k in range(capture.count)]
    missing = (capture.faults & Fault.MISSING) > 0
    for k, name in enumerate(names):
        picture = stored.words[k]
        if missing.any():
            alpha = np.where(missing[k], 0, TOP).astype(np.uint16)
            picture = np.concatenate([picture, alpha[..., None]], axis=-1)
        write_png(folder / name, picture)
    for layer, stack in layers.items():
        (folder / layer).mkdir()
        for name, picture in zip(names, stack, strict=True):
            write_png(folder / layer / name, quantised(picture, stored.white))
    write_png(folder / "mask.png", np.where(capture.mask, 255, 0).astype(np.uint8))
    held = (*layers, *write_depth(capture, folder))
    if truth.normals is not None:
        write_normal_map(truth.normals, folder / "normals.png")
        held += ("normals",)
    if truth.albedo is not None:
        write_png(folder / "albedo.png", quantised(truth.albedo, 1.0))
        held += ("albedo",)
    comments = ["16-bit linear pictures. Folders beside them hold their layers on the same scale."]
    lost = write_capture_yaml(capture, folder, names, comments, stored.white)
    write_about(capture, folder, "png16", names, stored.white)
    return (*stored.lost, *truth_left_out(capture, held), *lost)
