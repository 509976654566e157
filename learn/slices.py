"""The scenes that an evaluation runs over, one capture at a time from a pack, a set or a capture folder, and the slices they fall into."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import Capture, Fault, Truth, read_capture
from gen.errors import InputError
from gen.sets.pack import Pack, read_pack
from gen.sets.screening import kept_items, screening_of
from gen.sets.set_folder import SetFolder, is_set_folder
from gen.sets.set_spec import evenly
from gen.sets.splits import SPLITS, read_splits

GLOSS_LEVELS = (
    (0.05, "polished, alpha < .05"),
    (0.15, "glossy, .05 to .15"),
    (0.35, "satin, .15 to .35"),
    (np.inf, "sheen, > .35"),
)
"""Upper ends of alpha and what is below them."""

SATURATED = 0.25
"""(max - min) / max of the albedo's channels from which on a surface counts as coloured."""

WHITE = 0.7
"""Albedo of the strongest channel from which on a surface without colour counts as white."""

SLICES = ("gloss", "colour", "shape", "clipping", "material")


@dataclass(frozen=True, eq=False)
class Scene:
    """A capture with what is known of how it was made. alpha: width of the highlight, None where unknown or several."""

    name: str
    capture: Capture
    shape: str = "unknown"
    material: str = "unknown"
    alpha: float | None = None

    def slices(self, picture: int) -> dict[str, str]:
        """Where picture number `picture` belongs: a value for each of `SLICES`."""
        clipped = ((self.capture.faults[picture] & Fault.CLIPPED) > 0)[self.capture.mask].any()
        return {
            "gloss": gloss_level(self.alpha if self.alpha is not None else _width(self.capture)),
            "colour": colour_of(self.capture),
            "shape": self.shape,
            "clipping": "clipped" if clipped else "not clipped",
            "material": self.material,
        }


@dataclass(frozen=True, eq=False)
class Scenes:
    """How many there are, and a function that reads them one after another. split: which one was taken, None where all were."""

    name: str
    count: int
    read: Callable[[], Iterator[Scene]]
    split: str | None = None

    def __iter__(self) -> Iterator[Scene]:
        return self.read()


def scenes_of(data: Path, split: str | None = None, limit: int | None = None, kept_only: bool = False) -> Scenes:
    """The scenes of a pack, a set folder or any capture folder that carries the truth.

    split: "train", "validation", "test", or "all"; None takes the test items where the data is divided, and all of it where it is not.
    limit: at most so many, evenly spaced. kept_only: of a set without what screening leaves out (a pack is what was packed).
    Raises InputError, one line, where there is nothing to read, or nothing is left.
    """
    if data.is_file() and data.suffix == ".safetensors":
        return _of_pack(read_pack(data), split, limit)
    if data.is_dir() and is_set_folder(data):
        return _of_set(SetFolder(data), split, limit, kept_only)
    capture = read_capture(data)
    return Scenes(str(data), 1, lambda: iter([_from_render(data.name, capture)]))


def gloss_level(alpha: float | None) -> str:
    """The name of the level that a width of the highlight lies in (see `GLOSS_LEVELS`)."""
    if alpha is None:
        return "unknown"
    return next(name for top, name in GLOSS_LEVELS if alpha < top)


def colour_of(capture: Capture) -> str:
    """ "coloured", "white" or "grey", by the median of the true albedo over the object; "unknown" without it."""
    albedo = capture.truth.albedo
    if albedo is None:
        return "unknown"
    colour = np.median(albedo[capture.mask], axis=0)
    top, low = float(colour.max()), float(colour.min())
    if top > 0 and (top - low) / top >= SATURATED:
        return "coloured"
    return "white" if top >= WHITE else "grey"


def _width(capture: Capture) -> float | None:
    """The median width of the true highlight over the object, None where there is none."""
    gloss = capture.truth.gloss
    values = np.empty(0) if gloss is None else gloss[capture.mask & (gloss > 0)]
    return float(np.median(values)) if values.size else None


def _chosen(of: Sequence[str | None], split: str | None, limit: int | None, where: Path) -> tuple[list[int], str | None]:
    """The numbers of the items to take, and the split that was meant. of: the split of each item."""
    wanted = ("test" if "test" in of else None) if split is None else None if split == "all" else split
    numbers = [i for i, name in enumerate(of) if wanted is None or name == wanted]
    if not numbers:
        there = ", ".join(sorted({name for name in of if name is not None})) or "not divided"
        raise InputError(f"{where}: no item of the split {wanted!r} is there (the data is: {there})")
    if limit is not None and limit < 1:
        raise InputError(f"--limit {limit}: must be at least 1")
    return [numbers[i] for i in evenly(len(numbers), limit)], wanted


def _of_pack(pack: Pack, split: str | None, limit: int | None) -> Scenes:
    numbers, wanted = _chosen([item.get("split") for item in pack.items], split, limit, pack.path)

    def read() -> Iterator[Scene]:
        for number in numbers:
            yield scene_of_pack(pack, number)

    return Scenes(pack.path.name, len(numbers), read, wanted)


def scene_of_pack(pack: Pack, number: int) -> Scene:
    """Item `number` of a pack as a scene. Its scale is not known: a pack holds none."""
    facts, frames = pack.items[number], pack.frames(number)

    def layer(name: str) -> NDArray[Any] | None:
        if name not in pack.arrays:
            return None
        array = pack[name][number if name in Truth.PER_VIEW else frames]
        return np.array(array) if array.dtype == np.uint8 else np.asarray(array, np.float32)

    truth = Truth(**{name: layer(name) for name in (*Truth.PER_VIEW, *Truth.PER_LIGHT)})
    images = layer("combined")
    if images is None:
        if truth.diffuse is None or truth.specular is None:
            raise InputError(f"{pack.path}: holds neither combined nor diffuse and specular; pack it with --layers")
        images = truth.diffuse + truth.specular
    dark = (images <= 0).all(axis=-1)
    faults = np.where(pack["valid"][frames], 0, np.where(dark, int(Fault.DARK), int(Fault.CLIPPED))).astype(np.uint8)
    capture = Capture(
        images=images,
        lights=np.array(pack["lights"][frames], np.float64),
        intensities=np.array(pack["intensities"][frames], np.float64),
        mask=np.array(pack["mask"][number]),
        faults=faults,
        truth=truth,
        source=f"{pack.path.name}: {facts.get('id', number)}",
    )
    alpha = facts.get("alpha")
    known = isinstance(alpha, int | float) and not isinstance(alpha, bool)
    return Scene(
        str(facts.get("id", number)),
        capture,
        str(facts.get("shape") or "unknown"),
        str(facts.get("material") or "unknown"),
        float(alpha) if known else None,  # type: ignore[arg-type] # it is a number where known
    )


def _of_set(folder: SetFolder, split: str | None, limit: int | None, kept_only: bool) -> Scenes:
    rows = [row for row in folder.rows() if row["status"] == "rendered"]
    if kept_only:
        kept = kept_items(screening_of(folder))
        rows = [row for row in rows if row["id"] in kept]
    named: dict[str, str] = {}
    if (folder.path / SPLITS).is_file():
        named = {item: name for name, ids in read_splits(folder).items() for item in ids}
    numbers, wanted = _chosen([named.get(row["id"], row["split"]) for row in rows], split, limit, folder.path)

    def read() -> Iterator[Scene]:
        for number in numbers:
            row: Mapping[str, Any] = rows[number]
            yield _from_render(row["id"], folder.capture(row["id"]), row["shape"], row["material"])

    return Scenes(str(folder.path), len(numbers), read, wanted)


def _from_render(name: str, capture: Capture, shape: str | None = None, material: str | None = None) -> Scene:
    """A scene of a capture folder, with what its spec says of shape and material where it carries one."""
    spec = capture.provenance.get("spec")
    spec = spec if isinstance(spec, Mapping) else {}

    def said(part: str, key: str) -> str | None:
        table = spec.get(part)
        value = table.get(key) if isinstance(table, Mapping) else None
        return value if isinstance(value, str) else None

    return Scene(name, capture, shape or said("shape", "name") or "unknown", material or said("material", "kind") or "unknown")
