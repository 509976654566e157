"""YAML that nobody trusts: bounded, without anchors, tags or repeated keys; and pydantic's complaints about it as one line."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gen.errors import InputError
from gen.files import must_exist

if TYPE_CHECKING:
    from pydantic import ValidationError

MAX_BYTES = 200_000
MAX_DEPTH = 20


def read_yaml(path: Path, what: str) -> dict[str, Any]:
    """The mapping that a YAML 1.2 file holds. Raises InputError, naming the line, for anything else.

    Anchors and aliases are refused: a few of them can stand for more data than memory holds. So are tags (!!set and the like) and
    repeated keys.
    """
    must_exist(path, what)
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path}: is too large to be {what} (at most {MAX_BYTES // 1000} kB)")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file ({what})") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}; {what})") from error
    return parse_yaml(text, str(path), what)


def parse_yaml(text: str, where: str, what: str) -> dict[str, Any]:
    """The mapping in YAML text; `where` is named in errors. See `read_yaml`."""
    from ruamel.yaml import YAML
    from ruamel.yaml.constructor import DuplicateKeyError
    from ruamel.yaml.error import MarkedYAMLError, YAMLError
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, NodeEvent

    yaml = YAML(typ="safe", pure=True)
    try:
        depth = 0
        for event in yaml.parse(text):
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise InputError(f"{where}: line {event.start_mark.line + 1}: is nested more than {MAX_DEPTH} deep")
            if isinstance(event, NodeEvent) and (isinstance(event, AliasEvent) or event.anchor is not None):
                raise InputError(
                    f"{where}: line {event.start_mark.line + 1}: anchors and aliases (& and *) are not read; write it out"
                )
            if getattr(event, "tag", None) is not None:
                raise InputError(f"{where}: line {event.start_mark.line + 1}: tags (!) of YAML are not read; leave it out")
        value = yaml.load(text)
    except DuplicateKeyError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise InputError(
            f"{where}: line {line}: {(error.problem or 'a key is there twice').split(' with value')[0]}; keep one"
        ) from None
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else "?"
        raise InputError(f"{where}: line {line}: is not valid YAML ({error.problem or error.context})") from None
    except InputError:
        raise
    except (YAMLError, RecursionError, ValueError, TypeError, LookupError, AttributeError) as error:
        # Keys that are lists, numbers and times that are cut short: the library's constructors fail in their own ways.
        raise InputError(f"{where}: is not valid YAML ({(str(error).splitlines() or [''])[0]})") from None
    if not isinstance(value, dict):
        raise InputError(f"{where}: must hold 'key: value' lines ({what})")
    return value


def first_complaint(
    error: ValidationError, data: Any, where: str, known: Mapping[str, tuple[str, ...]], synonyms: Mapping[str, str]
) -> InputError:
    """The first of pydantic's errors as one InputError line: file, key path, what is allowed.

    data: what was validated. known: allowed keys of each section, by its key path (list indices as []). synonyms: other people's
    names of a key, for the hint after an unknown one.
    """
    details = error.errors(include_url=False, include_context=True)
    # A misspelt key also shows as a missing one: name the misspelling, which is what the reader can see.
    first = next((d for d in details if d["type"] == "extra_forbidden"), details[0])
    path, section = _key_path(first["loc"], data, missing=first["type"] == "missing")
    last = str(first["loc"][-1]) if first["loc"] else ""
    if first["type"] == "extra_forbidden":
        allowed = known.get(section, ())
        near = [synonyms[last]] if synonyms.get(last) in allowed else difflib.get_close_matches(last, allowed, n=1, cutoff=0.5)
        hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(allowed)}" if allowed else "remove it"
        return InputError(f"{where}: {path}: unknown key; {hint}")
    if first["type"] == "missing":
        return InputError(f"{where}: {path}: is missing")
    return InputError(f"{where}: {path + ': ' if path else ''}{_phrase(first)}")


def _key_path(loc: tuple[int | str, ...], data: Any, missing: bool) -> tuple[str, str]:
    """(key path, section) as the file's author sees them: names of union branches, which pydantic adds, are left out."""
    path = section = ""
    node = data
    for i, part in enumerate(loc):
        last = i == len(loc) - 1
        if isinstance(node, dict) and part in node:
            node = node[part]
        elif isinstance(node, list) and isinstance(part, int) and part < len(node):
            node = node[part]
            path, section = f"{path}[{part}]", f"{section}[]" if not last else section
            continue
        elif not (missing and last):
            continue
        path = f"{path}.{part}" if path else str(part)
        section = section if last else f"{section}.{part}" if section else str(part)
    return path, section


_ALLOWED = {
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be a text",
    "finite_number": "must be a finite number",
    "literal_error": "must be {expected}",
    "string_pattern_mismatch": "must match {pattern}",
    "union_tag_invalid": "must be one of {expected_tags}",
    "model_type": "must hold 'key: value' pairs",
    "model_attributes_type": "must hold 'key: value' pairs",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
}


def _phrase(error: Any) -> str:
    context = error.get("ctx", {})
    kind, given = error["type"], error.get("input")
    if kind == "value_error":  # raised by our own validators, already phrased
        return str(context["error"])
    if kind == "union_tag_not_found":
        return f"needs a {context['discriminator']}"
    if kind in ("too_short", "too_long"):
        limit = f"at least {context['min_length']}" if kind == "too_short" else f"at most {context['max_length']}"
        return f"must have {limit} entries, has {context['actual_length']}"
    text = _ALLOWED.get(kind)
    said = text.format(**context) if text else str(error["msg"])
    shown = f", got {given!r}" if isinstance(given, str | int | float | bool) and len(str(given)) <= 60 else ""
    return said + shown
