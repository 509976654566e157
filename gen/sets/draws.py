"""Draws: values of a set's capture spec that are drawn anew for every item, resolved against a random generator.

A draw is a mapping with exactly one of these keys:

    {uniform: [a, b]}, {log_uniform: [a, b]}, {integer: [a, b]} (both ends may come), {normal: [mean, sd]},
    {choice: [value, ...]}, {weighted: [[weight, value], ...]} (a value may hold draws),
    {colour: {hue: [a, b], saturation: [a, b], value: [a, b]}} (hue in degrees; what is left out is drawn from its whole range),
    {rotation: uniform} (every rotation alike, as the angles of `gen.spec_parts.Pose`),

and a shape may say `sample: true` beside its name: the family's own sampler draws the parameters that are not given. Everything is
checked before anything is drawn, so an error never depends on chance. Drawn numbers have six significant digits: they read well, and
the last bit of another machine's exponential does not change a plan. Mappings are walked in the order of their sorted keys.
"""

from __future__ import annotations

import colorsys
import difflib
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from gen.errors import InputError

Generator = np.random.Generator
Resolver = Callable[[Generator], Any]

SAMPLE = "sample"
MAX_TRIES = 200
"""How often a shape is sampled again where it refuses what its sampler and the given parameters make together."""


def resolve(value: Any, rng: Generator, where: str = "draw") -> Any:
    """`value` with every draw in it replaced by what `rng` gives. See `resolver`."""
    return resolver(value, where)(rng)


def resolver(value: Any, where: str) -> Resolver:
    """Check the draws in `value`, mappings and lists of plain values, and return the function that resolves them.

    where: the dotted path of `value`, after the file. Raises InputError, one line that names the path of the draw, where a draw is
    not known, has company, or its range is reversed or impossible. The function is pure: it depends on the generator alone.
    """
    if isinstance(value, Mapping):
        return _mapping(value, where)
    if isinstance(value, list | tuple):
        parts = [resolver(part, f"{where}[{i}]") for i, part in enumerate(value)]
        return lambda rng: [part(rng) for part in parts]
    if not isinstance(value, str | int | float | None):
        raise InputError(f"{where}: must be a text, a number, a list or 'key: value' pairs, got {_short(value)}")
    return lambda rng: value


def rounded(number: float) -> float:
    """A drawn number to six significant digits."""
    return float(f"{number:.6g}")


def _mapping(value: Mapping[Any, Any], where: str) -> Resolver:
    for key in value:
        if not isinstance(key, str):
            raise InputError(f"{where}: the key {key!r} must be a text")
    if SAMPLE in value:
        return _sampled_shape(value, where)
    drawn = [key for key in value if key in DRAWS]
    if drawn:
        if len(value) > 1:
            others = ", ".join(repr(key) for key in value if key != drawn[0])
            raise InputError(f"{where}: a draw ({drawn[0]}) stands alone; take {others} out of it")
        return DRAWS[drawn[0]](value[drawn[0]], f"{where}.{drawn[0]}")
    if len(value) == 1:
        near = difflib.get_close_matches(next(iter(value)), DRAWS, n=1, cutoff=0.8)
        if near:
            raise InputError(f"{where}: there is no draw {next(iter(value))!r}; did you mean '{near[0]}'?")
    parts = {key: resolver(value[key], f"{where}.{key}") for key in sorted(value)}

    def draw(rng: Generator) -> dict[str, Any]:
        drawn = {key: part(rng) for key, part in parts.items()}
        return {key: drawn[key] for key in value}

    return draw


def _uniform(given: Any, where: str) -> Resolver:
    low, high = _range(given, where)
    return lambda rng: _within(rng.uniform(low, high), low, high)


def _log_uniform(given: Any, where: str) -> Resolver:
    low, high = _range(given, where)
    if low <= 0:
        raise InputError(f"{where}: both ends must be greater than 0, got [{low:g}, {high:g}]")
    return lambda rng: _within(math.exp(rng.uniform(math.log(low), math.log(high))), low, high)


def _integer(given: Any, where: str) -> Resolver:
    low, high = _range(given, where)
    if low != int(low) or high != int(high) or max(-low, high) > 2**53:
        raise InputError(f"{where}: both ends must be whole numbers, got [{low:g}, {high:g}]")
    first, last = int(low), int(high)
    return lambda rng: int(rng.integers(first, last, endpoint=True))


def _normal(given: Any, where: str) -> Resolver:
    mean, deviation = _pair(given, where, "[mean, standard deviation]")
    if deviation <= 0:
        raise InputError(f"{where}: the standard deviation must be greater than 0, got {deviation:g}")
    return lambda rng: rounded(rng.normal(mean, deviation))


def _choice(given: Any, where: str) -> Resolver:
    if not isinstance(given, list | tuple) or not given:
        raise InputError(f"{where}: must be a list of the values to choose from, got {_short(given)}")
    parts = [resolver(part, f"{where}[{i}]") for i, part in enumerate(given)]
    return lambda rng: parts[int(rng.integers(len(parts)))](rng)


def _weighted(given: Any, where: str) -> Resolver:
    if not isinstance(given, list | tuple) or not given:
        raise InputError(f"{where}: must be a list of [weight, value], got {_short(given)}")
    weights, parts = [], []
    for i, pair in enumerate(given):
        if not isinstance(pair, list | tuple) or len(pair) != 2 or not _is_number(pair[0]) or pair[0] < 0:
            raise InputError(f"{where}[{i}]: must be [weight, value] with a weight of 0 or more, got {_short(pair)}")
        weights.append(float(pair[0]))
        parts.append(resolver(pair[1], f"{where}[{i}][1]"))
    total = sum(weights)
    if not 0 < total < math.inf:
        raise InputError(f"{where}: the weights must have a finite sum greater than 0, it is {total:g}")
    edges = np.cumsum(weights)
    last = max(i for i, weight in enumerate(weights) if weight > 0)
    # The first part whose edge lies beyond the point: one of weight 0 has an edge of no width and is never met.
    return lambda rng: parts[min(int(np.searchsorted(edges, rng.uniform(0, total), side="right")), last)](rng)


def _colour(given: Any, where: str) -> Resolver:
    limits = {"hue": (-360.0, 720.0), "saturation": (0.0, 1.0), "value": (0.0, 1.0)}
    if not isinstance(given, Mapping):
        raise InputError(f"{where}: must hold {', '.join(limits)}, each [lowest, highest], got {_short(given)}")
    for key in given:
        if key not in limits:
            near = difflib.get_close_matches(str(key), limits, n=1, cutoff=0.5)
            hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(limits)}"
            raise InputError(f"{where}.{key}: unknown key; {hint}")
    ranges = {"hue": (0.0, 360.0), "saturation": (0.0, 1.0), "value": (0.0, 1.0)}
    for key, span in given.items():
        low, high = ranges[key] = _range(span, f"{where}.{key}")
        least, most = limits[key]
        if low < least or high > most:
            raise InputError(f"{where}.{key}: must lie from {least:g} to {most:g}, got [{low:g}, {high:g}]")

    def draw(rng: Generator) -> list[float]:
        hue, saturation, value = (rng.uniform(*ranges[key]) for key in ("hue", "saturation", "value"))
        return [rounded(channel) for channel in colorsys.hsv_to_rgb(hue / 360 % 1, saturation, value)]

    return draw


def _rotation(given: Any, where: str) -> Resolver:
    if given != "uniform":
        raise InputError(f"{where}: must be uniform, got {_short(given)}; for angles of your own, rotation_degrees takes a list")

    def draw(rng: Generator) -> list[float]:
        # Evenly over all rotations: the volume element of the angles of Rz Ry Rx is cos(y) dx dy dz.
        x, z = rng.uniform(-180, 180, 2)
        return [rounded(x), rounded(math.degrees(math.asin(rng.uniform(-1, 1)))), rounded(z)]

    return draw


DRAWS: dict[str, Callable[[Any, str], Resolver]] = {
    "uniform": _uniform,
    "log_uniform": _log_uniform,
    "integer": _integer,
    "normal": _normal,
    "choice": _choice,
    "weighted": _weighted,
    "colour": _colour,
    "rotation": _rotation,
}
"""Each draw's key and the function from its argument and path to its resolver."""


def _sampled_shape(value: Mapping[str, Any], where: str) -> Resolver:
    from blender_scenes import shapes
    from gen.shape_extent import box

    if value[SAMPLE] is not True:
        raise InputError(f"{where}.{SAMPLE}: must be true, or left out, got {_short(value[SAMPLE])}")
    if "name" not in value:
        raise InputError(f"{where}.{SAMPLE}: belongs in a shape, beside its name")
    parts = {key: resolver(value[key], f"{where}.{key}") for key in sorted(value) if key != SAMPLE}

    def draw(rng: Generator) -> dict[str, Any]:
        refusal = ""
        for _ in range(MAX_TRIES):
            given = {key: part(rng) for key, part in parts.items()}
            name = given.pop("name")
            if name not in shapes.SHAPES:
                raise InputError(f"{where}.name: unknown shape {_short(name)}; there are {', '.join(shapes.SHAPES)}")
            known = shapes.parameters(name)
            for key in given:
                if key not in known:
                    raise InputError(f"{where}.{key}: unknown parameter of {name}; there are {', '.join(known)}")
            sampled = {key: v if isinstance(v, int) else rounded(v) for key, v in shapes.sample(name, rng).items()}
            parameters = {**sampled, **given}
            try:
                box(name, parameters)
            except ValueError as error:
                refusal = str(error).removeprefix(f"shape {name}: ")
                continue
            return {"name": name, **parameters}
        raise InputError(f"{where}: {MAX_TRIES} samples were refused; the last: {refusal}; give fewer parameters beside {SAMPLE}")

    return draw


def _within(number: float, low: float, high: float) -> float:
    return min(max(rounded(number), low), high)


def _range(given: Any, where: str) -> tuple[float, float]:
    low, high = _pair(given, where, "[lowest, highest]")
    if low > high:
        raise InputError(f"{where}: is reversed; write [{high:g}, {low:g}]")
    return low, high


def _pair(given: Any, where: str, what: str) -> tuple[float, float]:
    if not isinstance(given, list | tuple) or len(given) != 2 or not all(_is_number(number) for number in given):
        raise InputError(f"{where}: must be two finite numbers {what}, got {_short(given)}")
    return float(given[0]), float(given[1])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= 1e300  # false for NaN too


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
