"""Lights of a folder that says nothing of them, from its pictures: the way to `lights.txt`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gen.capture import Fault, read_capture
from gen.errors import InputError
from gen.files import writing
from gen.formats import detect
from gen.formats.plain import INTENSITIES, LIGHTS, NOT_PICTURES
from gen.formats.tables import mask_or_frame, pictures_in, read_intensities
from gen.images import read_frames
from gen.photos.darkroom import develop_folder
from gen.photos.spec import NAME, read_photo_spec
from recon.normals.uncalibrated import AMBIGUOUS, Strengths, Uncalibrated, uncalibrated

SUSPECT = {"equal": 0.05, "unknown": 0.85}
"""`Uncalibrated.against` from which the assumption is doubted. On DiLiGenT's bear and cat it is .01 where the lights are equal, .07 to .17
where they differ by a sixth and are taken for equal, and .5 to .8 with unknown ones; spots at random would come to .97."""


@dataclass(frozen=True, eq=False)
class Pictures:
    """The pictures of a folder, whatever it says of their lights.

    images: (K, H, W, 3) linear radiance, over the lights' strengths where the folder states them. mask: (H, W). weights: (K, H, W), 0
    where a sample is no measurement. names: (K,).
    """

    images: NDArray[np.float32]
    mask: NDArray[np.bool_]
    weights: NDArray[np.float32]
    names: tuple[str, ...]


def read_pictures(folder: Path, encoding: str | None = None) -> Pictures:
    """The pictures of a folder with or without lights: a plain one, one with capture.yaml, or any other capture.

    Raises InputError where there are none, or they cannot be read.
    """
    kind = detect(folder)
    if kind == "photos":
        developed = develop_folder(folder, read_photo_spec(folder), encoding)
        return Pictures(developed.images, developed.mask, _usable(developed.faults), developed.names)
    if kind == "plain" and not any((folder / name).exists() for name in LIGHTS):
        names = [name for name in pictures_in(folder) if Path(name).stem.casefold() not in NOT_PICTURES]
        frames = read_frames([folder / name for name in names], encoding)
        mask, _ = mask_or_frame(folder / "mask.png", frames)
        stated = next((folder / name for name in INTENSITIES if (folder / name).exists()), None)
        strength = np.ones((len(names), 3)) if stated is None else read_intensities(stated, len(names))
        images = frames.images / strength[:, None, None].astype(np.float32)
        return Pictures(images, mask, _usable(frames.faults), tuple(names))
    capture = read_capture(folder, encoding)
    return Pictures(capture.reflectance(), capture.mask, _usable(capture.faults), capture.names)


def find_lights(pictures: Pictures, strengths: Strengths, where: str) -> Uncalibrated:
    """`uncalibrated` of the pictures, its refusals with the folder's name before them."""
    try:
        return uncalibrated(pictures.images, pictures.mask, pictures.weights, strengths)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def remarks(found: Uncalibrated, strengths: Strengths) -> list[str]:
    """What is certain, assumed and ambiguous about lights that were found, in sentences."""
    said = {
        "equal": f"The lights were assumed to be equally strong; they come out so within {100 * found.against:.1f} %.",
        "unknown": "Each picture's brightest spots were assumed to face its light; "
        f"{100 * (1 - found.against):.0f} % of them do.",
    }
    doubt = ["That speaks against the assumption: do not trust these lights."] if found.against > SUSPECT[strengths] else []
    matte = f"A matte surface under such lights explains the pictures to {100 * found.misfit:.1f} %; gloss bends what is found."
    return [said[strengths], *doubt, matte, *AMBIGUOUS]


def table(found: Uncalibrated, names: tuple[str, ...], notes: list[str]) -> str:
    """The content of lights.txt: the notes as comments, then a row `name x y z` a picture."""
    rows = [f"{name} {x:.6f} {y:.6f} {z:.6f}" for name, (x, y, z) in zip(names, found.lights.tolist(), strict=True)]
    return "".join(f"{line}\n" for line in [*(f"# {note}" for note in notes), *rows])


def write_lights(folder: Path, found: Uncalibrated, names: tuple[str, ...], notes: list[str], strengths: Strengths) -> list[Path]:
    """Write lights.txt beside the pictures, and light_intensities.txt where strengths were found too. Returns what was written.

    Raises InputError where one of them is there already.
    """
    content = {"lights.txt": table(found, names, notes)}
    if strengths == "unknown":
        content["light_intensities.txt"] = "".join(f"{value:.6f}\n" for value in found.strengths)
    for name in [*LIGHTS, *(INTENSITIES if strengths == "unknown" else ())]:
        if (folder / name).exists():
            raise InputError(f"{folder / name}: is there already; take it away before lights are written")
    for name, text in content.items():
        with writing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return [folder / name for name in content]


def next_step(folder: Path, written: list[Path]) -> str:
    """What to do with the files that were written."""
    if (folder / NAME).is_file():
        return f"say `lights: {{file: {written[0].name}}}` in {folder / NAME}"
    return f"degloss recon run {folder} -o OUT"


def _usable(faults: NDArray[np.uint8]) -> NDArray[np.float32]:
    return ((faults & (Fault.CLIPPED | Fault.MISSING)) == 0).astype(np.float32)
