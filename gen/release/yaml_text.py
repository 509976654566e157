"""Plain values as YAML 1.2 text that is the same on every run, for the card's front matter and CITATION.cff."""

from __future__ import annotations

import io
from typing import Any


def yaml_text(value: Any) -> str:
    """Block-style YAML in the order of the keys."""
    from ruamel.yaml import YAML

    writer = YAML(typ="rt", pure=True)
    writer.width, writer.allow_unicode = 4096, True
    stream = io.StringIO()
    writer.dump(value, stream)
    return stream.getvalue()
