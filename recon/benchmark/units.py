"""The units of a benchmark: one capture under one draw of its lights. Captures are found, or rendered into the benchmark's folder."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gen.capture import Capture, read_capture
from gen.errors import InputError
from gen.files import real
from gen.sets.set_folder import RENDERED, SetFolder, is_set_folder
from gen.sets.set_spec import evenly
from recon.benchmark.spec import Benchmark, Source
from recon.light_draws import draws


@dataclass(frozen=True)
class Unit:
    """One measurement's pictures. name: the capture's. group: what captures of one kind have in common, for the tables.

    path: where it lies. draw: its number; lights: indices of the pictures used.
    """

    name: str
    group: str
    path: str
    draw: int
    lights: tuple[int, ...]

    @property
    def key(self) -> str:
        """A file name of its own."""
        text = f"{self.name}\n{self.path}"
        return f"{hashlib.sha256(text.encode()).hexdigest()[:12]}-{self.draw:04d}"

    def capture(self) -> Capture:
        """The pictures, read from their files. Raises InputError where they cannot be."""
        whole = read_capture(Path(self.path))
        return whole if list(self.lights) == list(range(whole.count)) else whole.select(list(self.lights))


def places(sources: Iterable[Source], folder: Path, rendered: Path, workers: int = 1) -> list[tuple[str, str, Path]]:
    """(name, group, path) of every capture of the sources, in order, each once.

    folder: where relative paths start. rendered: where captures of presets and sets are rendered, or were by an earlier run. workers: that
    render at the same time. Raises InputError where a path holds no capture, and as rendering does.
    """
    found: dict[Path, tuple[str, str, Path]] = {}
    for source in sources:
        if source.path is not None:
            here = list(_under(folder / source.path))
        elif source.preset is not None:
            here = [_render_one(source.preset, rendered)]
        else:
            here = list(_under(rendered_set(str(source.set), rendered, workers, source.limit)))
        for i in evenly(len(here), source.limit):
            found.setdefault(real(here[i][2]), here[i])
    names = [name for name, _, _ in found.values()]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"captures: two are named {twice}; the tables could not tell them apart")
    return list(found.values())


def units(benchmark: Benchmark, where: Iterable[tuple[str, str, Path]]) -> list[Unit]:
    """Every capture under every draw. Raises InputError where a capture cannot be read or has too few lights for a draw."""
    found: list[Unit] = []
    for name, group, path in where:
        capture = read_capture(path)
        if capture.truth.normals is None:
            raise InputError(f"{path}: has no true normals to measure against")
        first, last = benchmark.skip.get(name, (0, 0))
        usable = [i for i in range(capture.count) if not first <= i + 1 <= last]
        if benchmark.draws is None:
            found.append(Unit(name, group, str(path), 0, tuple(usable)))
            continue
        asked = benchmark.draws
        try:
            every = draws(capture.lights[usable], asked.count, asked.lights, asked.max_condition, benchmark.seed)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        for number, chosen in enumerate(every):
            found.append(Unit(name, group, str(path), number, tuple(usable[i] for i in chosen)))
    return found


def _under(path: Path) -> Iterator[tuple[str, str, Path]]:
    """A capture, the captures of a set, or of each folder in a folder."""
    if not path.exists():
        raise InputError(f"{path}: does not exist")
    if path.is_dir() and is_set_folder(path):
        folder = SetFolder(path)
        for row in folder.rows():
            if row["status"] == RENDERED:
                yield str(row["id"]), str(row["group"]), folder.item_folder(str(row["id"]))
        return
    if path.is_dir() and not any(entry.is_file() and not entry.name.startswith(".") for entry in path.iterdir()):
        inside = sorted(entry for entry in path.iterdir() if entry.is_dir() and not entry.name.startswith("."))
        if inside:
            for entry in inside:
                yield entry.name, entry.name, entry
            return
    yield path.stem if path.is_file() else real(path).name, real(path).name, path


def _render_one(preset: str, rendered: Path) -> tuple[str, str, Path]:
    from gen.render import render_capture
    from gen.spec import read_spec

    spec = read_spec(preset)
    place = rendered / f"{spec.name}-{spec.digest()[:8]}"
    if not place.is_dir():
        rendered.mkdir(parents=True, exist_ok=True)
        render_capture(spec, place)
    return spec.name, spec.name, place


def rendered_set(preset: str, rendered: Path, workers: int = 1, limit: int | None = None) -> Path:
    """The folder in `rendered` of a shipped set or a set's file; all of it, or at most `limit` items, is rendered unless it was before."""
    from gen.sets.campaign import Engine, render_set
    from gen.sets.plan import plan_of

    place = rendered / (Path(preset).stem if limit is None else f"{Path(preset).stem}-{limit}")
    plan = plan_of(preset, limit)
    rendered.mkdir(parents=True, exist_ok=True)
    render_set(plan, place, Engine(workers), resume=place.exists())
    return place
