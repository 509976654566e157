"""Which files are the photographs of a capture: names and patterns of capture.yaml, none of which leads out of its folder."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from gen.errors import InputError
from gen.files import inside, real
from gen.formats.plain import NOT_PICTURES
from gen.formats.tables import natural
from gen.images import SUFFIXES
from gen.photos.spec import MOST, NAME, Bracket, Pattern, PhotoSpec, Shot


@dataclass(frozen=True)
class Taken:
    """A photograph on disk. exposure: seconds, None where it is not known."""

    path: Path
    exposure: float | None


def photographs_of(
    folder: Path, images: tuple[Shot | Bracket, ...] | Pattern, others: frozenset[Path], key: str = "images"
) -> list[list[Taken]]:
    """The photographs of each light, the exposures of a bracket together.

    images: as in the spec. others: files that a pattern leaves aside, since the spec names them as something else.
    Raises InputError where a file is not there, leads out of the folder or comes twice, a pattern finds nothing, or exposures are known of
    some photographs only.
    """
    if isinstance(images, Pattern):
        found = _matching(folder, images, others, key)
    else:
        shots = [entry.bracket if isinstance(entry, Bracket) else (entry,) for entry in images]
        found = [[Taken(existing(folder, shot.file, key), shot.exposure_s) for shot in group] for group in shots]
    seen: set[Path] = set()
    for taken in (one for group in found for one in group):
        if taken.path in seen:
            raise InputError(f"{folder / NAME}: {key} names {taken.path.name} twice; each picture has one light")
        seen.add(taken.path)
    known = {taken.exposure is not None for group in found for taken in group}
    if len(known) > 1:
        raise InputError(f"{folder / NAME}: {key}: exposure_s is given for some photographs only; give it for all, or for none")
    return found


def existing(folder: Path, name: str, key: str) -> Path:
    """The file `name` of the folder. Raises InputError where it leads out of it or is not there."""
    try:
        path = inside(folder, name)
    except InputError as error:
        raise InputError(f"{folder / NAME}: {key}: {str(error).removeprefix(f'{folder}: ')}") from None
    if not os.path.isfile(path):  # unlike Path.is_file, which raises for a name too long to be one
        raise InputError(f"{path}: there is no such file ({NAME} names it under {key})")
    return path


def named_files(folder: Path, spec: PhotoSpec) -> frozenset[Path]:
    """The files that the spec names as masks, frames or outlines, as far as they lie in the folder."""
    names: list[str | None] = [spec.mask]
    names += [shot.file for frames in (spec.dark, spec.ambient, spec.flat) for shot in frames or ()]
    for ball in (spec.lights.balls if spec.lights else None) or ():
        names += [ball.mask, ball.outline]
        if ball.images is not None and not isinstance(ball.images, Pattern):
            names += [shot.file for entry in ball.images for shot in (entry.bracket if isinstance(entry, Bracket) else (entry,))]
    return frozenset(_resolved(folder, (name for name in names if name is not None)))


def _resolved(folder: Path, names: Iterable[str]) -> Iterable[Path]:
    for name in names:
        try:
            yield real(inside(folder, name))
        except InputError:
            continue


def _matching(folder: Path, pattern: Pattern, others: frozenset[Path], key: str) -> list[list[Taken]]:
    where = f"{folder / NAME}: {key}"
    if "**" in pattern.glob:
        raise InputError(f"{where}: the pattern {pattern.glob!r} may not hold '**'; name the folder")
    inside_pattern = pattern.glob.replace("\\", "/")
    if inside_pattern.startswith("/") or ".." in inside_pattern.split("/") or ":" in inside_pattern:
        raise InputError(f"{where}: the pattern {pattern.glob!r} leads out of the folder")
    paths = []
    try:
        candidates = list(islice(folder.glob(inside_pattern), MOST * 100))
    except (OSError, ValueError) as error:
        raise InputError(f"{where}: the pattern {pattern.glob!r:.80} cannot be used ({error})") from None
    for path in candidates:
        if path.suffix.lower() not in SUFFIXES or path.name.startswith(".") or not path.is_file():
            continue
        if path.stem.casefold() in NOT_PICTURES or real(path) in others:
            continue
        paths.append(existing(folder, path.relative_to(folder).as_posix(), key))
        if len(paths) > MOST * 20:
            raise InputError(f"{where}: the pattern {pattern.glob!r} finds more than {MOST * 20} pictures")
    if not paths:
        raise InputError(f"{where}: the pattern {pattern.glob!r} finds no pictures; PNG, TIFF, JPEG and EXR are read")
    paths.sort(key=lambda p: natural(p.relative_to(folder).as_posix()))
    times = pattern.exposures_s
    if times is None:
        found = [[Taken(path, None)] for path in paths]
    else:
        if len(set(times)) != len(times):
            raise InputError(f"{where}.exposures_s: holds an exposure twice")
        if len(paths) % len(times):
            raise InputError(
                f"{where}: the pattern finds {len(paths)} pictures, which are no whole brackets of {len(times)} exposures"
            )
        found = [
            [Taken(p, t) for p, t in zip(paths[start : start + len(times)], times, strict=True)]
            for start in range(0, len(paths), len(times))
        ]
    if len(found) > MOST:
        raise InputError(f"{where}: the pattern finds {len(found)} pictures, more than the {MOST} that are read")
    return found
