"""The spec of a benchmark: which captures or views, which draws of their lights, which methods; a YAML file or a shipped preset."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from gen.errors import InputError
from gen.strict_yaml import first_complaint, parse_yaml, read_yaml
from recon.light_draws import CONDITION
from recon.reconstruct import Settings
from recon.registry import GLOSS, HEIGHT, NORMALS, REPAIR, Registry

Whole = Annotated[int, Field(strict=True)]
Names = Annotated[tuple[str, ...], Field(min_length=1, max_length=40)]

MAX_CELLS = 5000
"""The most combinations of methods."""

Combination = tuple[str, str, str, str]
"""Gloss remover, repair, solver, integrator."""

_NOT_OF_VIEWS = {
    "captures": "they are two benchmarks; write a file for each",
    "height": "their integrator is always quadratic; leave it out",
    "draws": "they are measured under all their lights; leave it out",
    "skip": "they are measured under all their lights; leave it out",
}
"""Keys of a benchmark of captures alone -> why."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Source(_Part):
    """Where captures, or objects seen from several sides, come from: exactly one of path, preset and set.

    path: a capture, a set folder, or a folder of captures; of views, a folder that `recon.multiview.views.read_views` takes, or a folder of
    those; relative to the spec's folder. preset: a shipped spec of one capture, or a spec file; set: a shipped set or a file; both are
    rendered into the benchmark's folder. limit: at most so many captures or objects, evenly spaced.
    """

    path: str | None = None
    preset: str | None = None
    set: str | None = None
    limit: Whole | None = Field(default=None, ge=1, le=100_000)

    @model_validator(mode="after")
    def _one_of_three(self) -> Source:
        if sum(value is not None for value in (self.path, self.preset, self.set)) != 1:
            raise ValueError("needs exactly one of path, preset and set")
        return self


class Draws(_Part):
    """Random subsets of each capture's lights. count: of subsets; lights: in each; max_condition: of their directions' condition number."""

    count: Whole = Field(ge=1, le=10_000)
    lights: Whole = Field(ge=3, le=1000)
    max_condition: float = Field(default=CONDITION, gt=1, le=1e6)


class Benchmark(_Part):
    """A whole benchmark, of captures or of views.

    captures: each is measured by itself. views: of objects, each measured from all its sides to one mesh (`recon.multiview`), always by the
    integrator "quadratic" and under all lights; None: a benchmark of captures. draws: None takes all lights of each capture. skip: capture
    name -> pictures (from 1) that are never used.
    """

    benchmark: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")
    seed: Whole = Field(default=0, ge=0, lt=2**63)
    captures: tuple[Source, ...] = Field(default=(), max_length=1000)
    views: tuple[Source, ...] | None = Field(default=None, max_length=1000)
    draws: Draws | None = None
    skip: dict[str, tuple[Whole, Whole]] = Field(default_factory=dict)
    gloss: Names = ("none",)
    repair: Names = ("none",)
    normals: Names = ("least-squares",)
    height: Names = (Settings.height,)

    @field_validator("gloss", "repair", "normals", "height")
    @classmethod
    def _are_known(cls, names: tuple[str, ...], info: Any) -> tuple[str, ...]:
        tables: dict[str, Registry[Any]] = {"gloss": GLOSS, "repair": REPAIR, "normals": NORMALS, "height": HEIGHT}
        registry = tables[info.field_name]
        for name in names:
            if name not in registry:
                raise ValueError(f"unknown {registry.kind} {name!r}; there are {', '.join(registry)}")
        if len(set(names)) != len(names):
            raise ValueError("names one method twice")
        return names

    @field_validator("views")
    @classmethod
    def _are_objects(cls, sources: tuple[Source, ...] | None) -> tuple[Source, ...] | None:
        for source in sources or ():
            if source.preset is not None:
                raise ValueError(f"the preset {source.preset} is one capture, not views of an object; name a path or a set")
            if source.set is not None and source.limit is not None:
                raise ValueError(f"the set {source.set} is one object, whose views all count; a limit is for a path of several")
        return sources

    @model_validator(mode="after")
    def _is_of_one_kind(self) -> Benchmark:
        for name, why in _NOT_OF_VIEWS.items():
            if self.views is not None and name in self.model_fields_set:
                raise ValueError(f"{name}: does not go with views: {why}")
        return self

    @model_validator(mode="after")
    def _is_bounded(self) -> Benchmark:
        if len(self.combinations()) > MAX_CELLS:
            raise ValueError(f"asks for {len(self.combinations())} combinations of methods, at most {MAX_CELLS} are done")
        return self

    @property
    def sources(self) -> tuple[Source, ...]:
        """Of the captures or the views."""
        return self.captures if self.views is None else self.views

    def of(self, paths: Iterable[Path]) -> Benchmark:
        """The same benchmark of other captures or views."""
        name = "captures" if self.views is None else "views"
        return self.model_copy(update={name: tuple(Source(path=str(path)) for path in paths)})

    def combinations(self) -> list[Combination]:
        """Every combination of methods, those of the glossy and the non-glossy pictures with each solver and integrator first.

        The true matte pictures are never repaired: there is nothing to repair in them.
        """
        height = self.height
        if self.views is not None:
            from recon.multiview.measure import INTEGRATOR

            height = (INTEGRATOR,)
        yardsticks = list(product(("none", "true-matte"), ("none",), self.normals, height))
        asked = product(self.gloss, self.repair, self.normals, height)
        return list(dict.fromkeys([*yardsticks, *(c for c in asked if not (c[0].startswith("true-") and c[1] != "none"))]))

    def plain(self) -> dict[str, Any]:
        """Everything that decides the figures, as JSON has it."""
        return self.model_dump(mode="json", exclude={"views"} if self.views is None else set(_NOT_OF_VIEWS))

    def digest(self) -> str:
        """Of `plain`."""
        return hashlib.sha256(json.dumps(self.plain(), sort_keys=True).encode()).hexdigest()


_KNOWN = {
    "": tuple(Benchmark.model_fields),
    "captures[]": tuple(Source.model_fields),
    "views[]": tuple(Source.model_fields),
    "draws": tuple(Draws.model_fields),
}
_SYNONYMS = {"name": "benchmark", "inpaint": "repair", "solver": "normals", "integrator": "height", "subsets": "draws"}


def preset_names() -> tuple[str, ...]:
    """The shipped benchmarks."""
    return tuple(sorted(p.name.removesuffix(".yaml") for p in _presets().iterdir() if p.name.endswith(".yaml")))


def read_benchmark(path_or_preset: str | Path) -> tuple[Benchmark, Path]:
    """The benchmark of a YAML file or of a shipped preset, and the folder that its relative paths start from.

    Raises InputError, one line, where there is no such file or preset, or a key is missing, unknown or out of range.
    """
    where = str(path_or_preset)
    if not Path(where).is_file() and where in preset_names():
        text = _presets().joinpath(f"{where}.yaml").read_text(encoding="utf-8")
        data, folder = parse_yaml(text, where, "a benchmark"), Path()
    elif Path(where).is_file():
        data, folder = read_yaml(Path(where), "a benchmark"), Path(where).parent
    else:
        raise InputError(f"{where}: is neither a file nor a shipped benchmark; those are {', '.join(preset_names())}")
    try:
        return Benchmark.model_validate(data), folder
    except ValidationError as error:
        raise first_complaint(error, data, where, _KNOWN, _SYNONYMS) from None


def _presets() -> Any:
    return files("recon.benchmark").joinpath("presets")
