"""DiLiGenT folders: 16-bit pictures under calibrated lights, with a mask and, where published, the truth.

Source: Shi, Mo, Wu, Duan, Yeung, Tan, "A Benchmark Dataset and Evaluation for Non-Lambertian and Uncalibrated Photometric
Stereo", TPAMI 2019.
"""

from __future__ import annotations

from pathlib import Path

from gen.capture import Capture
from gen.files import must_exist, read_lines
from gen.formats.tables import picture_paths, read_directions, read_intensities, read_scale
from gen.formats.truth import read_truth
from gen.images import read_frames, read_mask


def is_diligent(path: Path) -> bool:
    """Whether `path` is a folder with `filenames.txt`."""
    return (path / "filenames.txt").is_file()


def read_diligent(path: Path, encoding: str | None = None) -> Capture:
    """Read a folder of `filenames.txt`, `light_directions.txt`, `light_intensities.txt`, `mask.png` and the pictures they name.

    The pictures are not divided by anything: the intensities go into `Capture.intensities`. Optional: truth (see
    `gen.formats.truth.read_truth`) and `K.txt`, `crop.txt`, `scale.txt` (see `gen.formats.tables.read_scale`); where K is known
    and no distance is given, the median of the true depth serves. Raises InputError where a file is missing, damaged or
    contradicts another.
    """
    table = path / "filenames.txt"
    names = [line for _, line in read_lines(table, "picture names")]
    paths = picture_paths(path, names, table)
    lights = read_directions(path / "light_directions.txt", len(paths))
    intensities = read_intensities(path / "light_intensities.txt", len(paths))
    must_exist(path / "mask.png", "the mask")
    frames = read_frames(paths, encoding)
    size = frames.images.shape[1:3]
    mask = read_mask(path / "mask.png", (size[0], size[1]))
    return Capture(
        images=frames.images,
        lights=lights,
        mask=mask,
        intensities=intensities,
        faults=frames.faults,
        names=tuple(names),
        scale=read_scale(path, (size[0], size[1])),
        truth=read_truth(path, mask),
        encoding=frames.encoding,
        source=str(path),
        provenance={"format": "diligent", "encoding": frames.reading, "bits": frames.bits, "mask": "mask.png"},
    )
