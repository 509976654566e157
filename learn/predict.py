"""Gloss removal from pictures as they are: no capture folder, for the networks of single pictures no lights either."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gen.capture import Bools, Fault, Floats
from gen.errors import InputError
from gen.exr import unstack, write_exr
from gen.files import keep_apart, write_json, writing_folder
from gen.formats.tables import read_directions
from gen.images import read_frames, read_image, read_mask, write_png
from gen.srgb import linear_to_srgb
from learn.removers import separate
from recon.registry import Layers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from learn.weights import Loaded

FLOATS = 32
"""Bits from which on a file holds floats; its layers are written as EXR."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Predicted:
    """The files made of one picture. size: (H, W). encoding, bits: how the picture was read, which is how its layers were written."""

    source: Path
    files: dict[str, str]
    size: tuple[int, int]
    encoding: str
    bits: int
    clipped: float


def predict(
    loaded: Loaded,
    images: Sequence[Path],
    output: Path,
    mask: Path | None = None,
    lights: Path | None = None,
    encoding: str | None = None,
    progress: Progress | None = None,
) -> list[Predicted]:
    """Write the layers of each picture into the folder `output`, all or nothing; an earlier result of this kind there is replaced.

    images: PNG, JPEG, TIFF or EXR of any size from 8x8 pixels. Networks of single pictures take each alone and give `NAME-diffuse` and
    `NAME-specular`. The group network takes all of them as one view, each under another light, and gives `NAME-matte` and
    `NAME-confidence` (8-bit grey) besides. 8 and 16-bit pictures give PNG of as many bits, encoded as the picture was read; floats give
    linear EXR. The matte layer can be brighter than the picture: a PNG cuts it at its top value, an EXR does not. Of two pictures of one
    name the later one's files are numbered.
    mask: a picture, white on the object, for all. lights: rows of x y z, one a picture, for the group network alone. encoding: "srgb" or
    "linear" to say how the numbers are meant; None takes the default of the file's kind.
    Raises InputError, one line, where a file cannot be read, sizes do not agree, or an option does not suit the network.
    """
    if not images:
        raise InputError("there are no pictures to work on; name at least one")
    if lights is not None and loaded.method != "group":
        raise InputError(f"--lights {lights}: is for the group network, and {loaded.path} is of the method {loaded.method}")
    for image in images:
        keep_apart(image, output)
    names = distinct_names(images)
    made: list[Predicted] = []
    with writing_folder(output, "prediction") as folder:
        for k, (shown, layers, read) in enumerate(_separated(loaded, images, mask, lights, encoding)):
            files = _write(folder, names[k], layers, read.bits, read.encoding)
            size = (int(shown.shape[0]), int(shown.shape[1]))
            made.append(Predicted(images[k], files, size, read.encoding, read.bits, read.clipped))
            if progress is not None:
                progress(k + 1, len(images))
        write_json(
            folder / "prediction.json",
            {"method": loaded.method, "weights": loaded.path.name, "pictures": [_row(p) for p in made]},
        )
    return made


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """A name for each file, its own without the ending; where that is taken (in any case of letters), with a number behind it."""
    own = [path.stem for path in paths]
    taken: set[str] = set()
    names = []
    for name in own:
        number, found = 1, name
        while found.lower() in taken or (number > 1 and found.lower() in {other.lower() for other in own}):
            number += 1
            found = f"{name}-{number}"
        taken.add(found.lower())
        names.append(found)
    return names


@dataclass(frozen=True)
class _Read:
    encoding: str
    bits: int
    clipped: float


def _separated(
    loaded: Loaded, images: Sequence[Path], mask: Path | None, lights: Path | None, encoding: str | None
) -> Iterator[tuple[Floats, Layers, _Read]]:
    """(picture (H, W, 3), its layers as stacks of one, how it was read), one after another."""
    inside: Bools | None = None
    if loaded.method == "group":
        frames = read_frames(images, encoding)
        toward = None if lights is None else _unit(read_directions(lights, len(images)))
        if mask is not None:
            inside = read_mask(mask, (frames.images.shape[1], frames.images.shape[2]))
        layers = separate(loaded, frames.images, inside, frames.faults == 0, toward, str(images[0]))
        for k, picture in enumerate(frames.images):
            clipped = float(((frames.faults[k] & Fault.CLIPPED) > 0).mean())
            part = Layers(
                *(
                    None if stack is None else stack[k : k + 1]
                    for stack in (layers.diffuse, layers.specular, layers.matte, layers.confidence)
                )  # type: ignore[arg-type] # the first two are there
            )
            yield picture, part, _Read(frames.encoding, frames.bits, clipped)
        return
    for path in images:
        photo = read_image(path, encoding)
        if mask is not None:
            inside = read_mask(mask, (photo.linear.shape[0], photo.linear.shape[1]))
        layers = separate(loaded, photo.linear[None], inside, where=str(path))
        yield photo.linear, layers, _Read(photo.encoding, photo.bits, float(photo.clipped.mean()))


def _write(folder: Path, name: str, layers: Layers, bits: int, encoding: str) -> dict[str, str]:
    """The files of one picture's layers, by layer."""
    files = {}
    for layer, stack in (("diffuse", layers.diffuse), ("specular", layers.specular), ("matte", layers.matte)):
        if stack is None:
            continue
        ending = "exr" if bits >= FLOATS else "png"
        files[layer] = f"{name}-{layer}.{ending}"
        if ending == "exr":
            write_exr(folder / files[layer], unstack("", "RGB", stack[0]))
        else:
            write_png(folder / files[layer], as_stored(stack[0], bits, encoding))
    if layers.confidence is not None:
        files["confidence"] = f"{name}-confidence.png"
        write_png(folder / files["confidence"], np.rint(layers.confidence[0] * 255).astype(np.uint8))
    return files


def as_stored(linear: Floats, bits: int, encoding: str) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """A linear picture as whole numbers of 8 or 16 bits, "srgb" or "linear", rounded, cut at 0 and at the top value."""
    top = (1 << bits) - 1
    within = np.clip(linear.astype(np.float64), 0, 1)
    encoded = linear_to_srgb(within) if encoding == "srgb" else within
    return np.rint(top * encoded).astype(np.uint8 if bits == 8 else np.uint16)


def _unit(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths: NDArray[np.float64] = np.linalg.norm(directions, axis=1, keepdims=True)
    return directions / lengths


def _row(made: Predicted) -> dict[str, object]:
    return {
        "source": made.source.name,
        "files": made.files,
        "size": [made.size[1], made.size[0]],
        "encoding": made.encoding,
        "bits": made.bits,
        "clipped_percent": 100 * made.clipped,
    }
