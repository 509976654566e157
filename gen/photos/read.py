"""A folder of photographs with capture.yaml becomes a Capture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gen.capture import Capture
from gen.formats.truth import read_truth
from gen.images import check_encoding
from gen.photos.darkroom import Photographs, develop_folder
from gen.photos.light_sources import Lights, lights_of, strengths_of
from gen.photos.spec import NAME, PhotoSpec, read_photo_spec


def is_photos(path: Path) -> bool:
    """Whether `path` is a folder that holds a capture.yaml."""
    return path.is_dir() and (path / NAME).is_file()


def read_photos(path: Path, encoding: str | None = None) -> Capture:
    """Read a folder of photographs by its capture.yaml (`gen.photos.spec.PhotoSpec`).

    Dark and ambient frames are subtracted, brackets merged, the flat field divided out, the lens undistorted; then the lights are taken
    as given or measured on balls, and their intensities taken as given, measured, or estimated. What was done is in the provenance.
    Radiance is in units of the sensor's full scale at the shortest exposure. encoding: "srgb" or "linear" in place of the file's colour.
    True normals and depth beside the photographs are read too (`gen.formats.truth`), unless the lens had to be undistorted.
    Raises InputError, one line, where something is missing, damaged or contradictory.
    """
    check_encoding(encoding)
    folder = Path(path)
    spec = read_photo_spec(folder)
    photographs = develop_folder(folder, spec, encoding)
    return assembled(folder, spec, photographs, lights_of(folder, spec, photographs))


def assembled(folder: Path, spec: PhotoSpec, photographs: Photographs, lights: Lights) -> Capture:
    """The Capture of developed photographs and their lights. Raises InputError as `strengths_of` does."""
    intensities, how, residual = strengths_of(folder, spec, photographs, lights)
    record = {"format": "photos", **photographs.record, **lights.record, "intensities": how}
    if residual is not None:
        record["intensities_residual"] = residual
    straight = photographs.development.distortion is None
    kinds = ("point",) * len(photographs.images) if lights.positions is not None else ()
    extra = {"truth": read_truth(folder, photographs.mask)} if straight else {}
    return Capture(
        images=photographs.images,
        lights=np.asarray(lights.directions),
        mask=photographs.mask,
        intensities=intensities,
        faults=photographs.faults,
        names=photographs.names,
        scale=photographs.scale,
        encoding=photographs.encoding,
        source=str(folder),
        provenance=record,
        light_kinds=kinds,
        positions=lights.positions,
        **extra,
    )
