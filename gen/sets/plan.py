"""The plan of a set: every capture with every value resolved, in one file of JSON lines, byte for byte the same for the same set.

Line 1 is a header, {"format": "degloss plan", "version": 1, "name", "seed", "set_sha256", "items": N}; then comes one item a line:
{"id", "group", "split", "single", "spec"}, the spec with its defaults. A plan needs neither the set's file nor a random generator.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gen.errors import InputError
from gen.files import must_exist, writing
from gen.sets.set_spec import MAX_ITEMS, expand, read_set
from gen.spec import Spec, spec_from

FORMAT = "degloss plan"
VERSION = 1
MAX_BYTES = 2_000_000_000
MAX_LINE = 2_000_000
SPLITS = ("train", "validation", "test")
HEADER_KEYS = {"format", "version", "name", "seed", "set_sha256", "items"}
ITEM_KEYS = {"id", "group", "split", "single", "spec"}

Progress = Callable[[int, int], None]
"""Called with (items done, items in all)."""


@dataclass(frozen=True)
class Item:
    """One capture of a set. split: train, validation, test, or None where nobody decided yet. spec: plain values, defaults filled in."""

    id: str
    group: str
    split: str | None
    single: bool
    spec: Mapping[str, Any]

    def capture_spec(self) -> Spec:
        """The spec, checked. Raises InputError, which names the item, where the plan's file was changed so that it is not valid."""
        spec = spec_from(self.spec, f"plan: item {self.id}")
        if self.single and len(spec.pictures()) != 1:
            raise InputError(f"plan: item {self.id}: is single, and has {len(spec.pictures())} pictures; make it false")
        return spec

    def line(self) -> str:
        """The item as its line of the file."""
        row = {"id": self.id, "group": self.group, "split": self.split, "single": self.single, "spec": self.spec}
        return json.dumps(row, sort_keys=True, ensure_ascii=True, allow_nan=False)


@dataclass(frozen=True)
class Plan:
    """A set with every value resolved. set_sha256: of the set spec's meaning (`gen.sets.SetSpec.digest`)."""

    name: str
    seed: int
    set_sha256: str
    items: tuple[Item, ...]

    def text(self) -> str:
        """The plan's file."""
        header = {"format": FORMAT, "version": VERSION, "name": self.name, "seed": self.seed, "set_sha256": self.set_sha256}
        first = json.dumps({**header, "items": len(self.items)}, sort_keys=True)
        return "".join(f"{line}\n" for line in (first, *(item.line() for item in self.items)))

    def digest(self) -> str:
        """SHA-256 of the text, in hexadecimal."""
        return hashlib.sha256(self.text().encode()).hexdigest()

    def chunk(self, index: int, count: int) -> tuple[Item, ...]:
        """Part `index` (from 0) of `count`: every count-th item from there, so that the parts of a sorted plan weigh alike.

        Raises InputError where there is no such part.
        """
        if count < 1 or not 0 <= index < count:
            raise InputError(f"chunk {index} of {count}: chunks are counted from 0, and the last is one less than their number")
        return self.items[index::count]


def plan_of(
    path_or_preset: str | Path, limit: int | None = None, progress: Progress | None = None, seed: int | None = None
) -> Plan:
    """The plan of a set spec, a YAML file or a preset's name: every draw made, every capture spec checked.

    limit: at most that many items, evenly spaced over the set; each is the one that the whole plan has. seed: takes the place of the
    spec's. Raises InputError, one line that names group, item and key, where anything in the set is wrong.
    """
    spec = read_set(path_or_preset)
    if seed is not None:
        if not 0 <= seed < 2**63:
            raise InputError(f"--seed {seed}: must be from 0 to 2**63 - 1")
        spec = spec.model_copy(update={"seed": seed})
    total = spec.total() if limit is None else min(limit, spec.total())
    items: list[Item] = []
    for name, group, capture in expand(spec, str(path_or_preset), limit):
        items.append(Item(name, group.name, group.split, group.single, capture.plain()))
        if progress is not None:
            progress(len(items), total)
    return Plan(spec.name, spec.seed, spec.digest(), tuple(items))


def write_plan(plan: Plan, path: Path) -> None:
    """Write a plan, by a temporary name. Raises InputError where the place cannot be written."""
    with writing(path) as temporary:
        temporary.write_text(plan.text(), encoding="utf-8", newline="\n")


def read_plan(path: str | Path) -> Plan:
    """The plan in a file. Specs are checked when they are asked for (`Item.capture_spec`), everything else is here.

    Raises InputError, naming the line, where the file is missing, is no plan, or is damaged or cut short.
    """
    path = must_exist(Path(path), "a plan")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path}: is too large to be a plan (at most {MAX_BYTES // 10**6} MB)")
    items: list[Item] = []
    try:
        with path.open(encoding="utf-8") as file:
            header = _header(path, file.readline(MAX_LINE))
            for number, line in enumerate(iter(lambda: file.readline(MAX_LINE), ""), 2):
                if len(items) == header["items"]:
                    raise InputError(f"{path}: line {number}: the first line says {header['items']} items, more follow")
                items.append(_item(f"{path}: line {number}", line))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file (a plan)") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}; a plan)") from error
    if len(items) != header["items"]:
        raise InputError(f"{path}: holds {len(items)} items, its first line says {header['items']}; it was cut short, plan again")
    seen: set[str] = set()
    for item in items:
        if item.id in seen:
            raise InputError(f"{path}: the id {item.id} is there twice; plan again")
        seen.add(item.id)
    return Plan(header["name"], header["seed"], header["set_sha256"], tuple(items))


def is_plan(path: str | Path) -> bool:
    """Whether a file starts as a plan does. Never raises."""
    try:
        with must_exist(Path(path), "a plan").open(encoding="utf-8") as file:
            _header(Path(path), file.readline(MAX_LINE))
    except (OSError, ValueError):
        return False
    return True


def is_set(path_or_preset: str | Path) -> bool:
    """Whether a file or preset is a set spec: YAML that holds the key `set`. Never raises: what cannot be read is none."""
    from gen.presets import find_spec
    from gen.strict_yaml import read_yaml

    try:
        return "set" in read_yaml(find_spec(path_or_preset), "a set spec")
    except (InputError, OSError):
        return False


def identities(spec: Spec) -> dict[str, str]:
    """Keys (12 hex digits) of what a capture shows: `object` (shape, parameters, detail), `material_key` and `lights_key`.

    Two captures with the same key show the same object, material or set of lights, however their specs word it: defaults are filled
    in, gloss is alpha, and lights count as a set. Pose, camera, exposure and resolution are part of none.
    """
    from blender_scenes import shapes

    plain = spec.plain()
    shape = plain["shape"]
    if shape["name"] in shapes.SHAPES:
        shape = {**{key: parameter.default for key, parameter in shapes.parameters(shape["name"]).items()}, **shape}
    # Rounded: the last bit of a sine is not another light.
    lights = (_floats(light.job(), digits=7) for light in spec.pictures())
    return {
        "object": _key(shape),
        "material_key": _key(spec.material.job()),
        "lights_key": _key(sorted(lights, key=json.dumps)),
    }


def _key(value: Any) -> str:
    return hashlib.sha256(json.dumps(_floats(value), sort_keys=True).encode()).hexdigest()[:12]


def _floats(value: Any, digits: int = 12) -> Any:
    """Plain values with every number a float of so many digits after the point, and no -0.0: 20 and 20.0 are one radius."""
    if isinstance(value, dict):
        return {key: _floats(value[key], digits) for key in sorted(value)}
    if isinstance(value, list | tuple):
        return [_floats(part, digits) for part in value]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return round(float(value), digits) + 0.0
    return value


def _header(path: Path, line: str) -> dict[str, Any]:
    header = _json(line)
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise InputError(f"{path}: is not a plan; `degloss gen plan` makes one of a set spec")
    if header.get("version") != VERSION:
        raise InputError(
            f"{path}: is a plan of version {header.get('version')!r}, this program reads version {VERSION}; plan again"
        )
    good = (
        set(header) == HEADER_KEYS
        and isinstance(header["name"], str)
        and type(header["seed"]) is int
        and isinstance(header["set_sha256"], str)
        and re.fullmatch("[0-9a-f]{64}", header["set_sha256"])
        and type(header["items"]) is int
        and 0 <= header["items"] <= MAX_ITEMS
    )
    if not good:
        raise InputError(f"{path}: line 1: must hold {', '.join(sorted(HEADER_KEYS))}, each as a plan has it; plan again")
    return header


def _item(where: str, line: str) -> Item:
    row = _json(line)
    if not isinstance(row, dict) or set(row) != ITEM_KEYS:
        raise InputError(f"{where}: is not an item ({', '.join(sorted(ITEM_KEYS))}); it was cut short or changed, plan again")
    name, group, spec = row["id"], row["group"], row["spec"]
    if not isinstance(group, str) or not isinstance(name, str) or not re.fullmatch(re.escape(group) + r"-\d{6}", name):
        raise InputError(f"{where}: id must be the group's name, a dash and six digits, got {name!r:.80}")
    if not re.fullmatch(r"[a-z0-9][a-z0-9-]{0,59}", group):
        raise InputError(f"{where}: group must be lower-case letters, digits and dashes, got {group!r:.80}")
    if row["split"] not in (None, *SPLITS) or type(row["single"]) is not bool:
        raise InputError(f"{where}: split must be null or one of {', '.join(SPLITS)}, and single true or false")
    if not isinstance(spec, dict) or spec.get("name") != name:
        raise InputError(f"{where}: spec must be a capture spec whose name is the item's id")
    return Item(name, group, row["split"], row["single"], spec)


def _json(line: str) -> Any:
    """The value of a line, None where it is not JSON or holds a number that is not finite, which JSON has not."""
    try:
        value = json.loads(line)
        json.dumps(value, allow_nan=False)
        return value
    except (ValueError, RecursionError):
        return None
