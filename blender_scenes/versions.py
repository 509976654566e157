"""Which Blender will do. It is asked first, by any Python that a Blender may hold: the standard library alone, and no new syntax."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.util import find_spec

from blender_scenes.errors import MissingBlender

OLDEST = (4, 5)
"""The first Blender that takes a mesh's normals as they are given (the attribute `custom_normal` at its points). 4.2 to 4.4 pass them over
without a word and shade by their own; earlier ones lack more."""

TESTED = "4.5 LTS, 5.0 and 5.2 LTS"
"""The versions that passed the tests. 5.2 rounds the normals that it is given: they, and the light with them, are off by up to 3e-5."""


def check_version(version: Sequence[int]) -> None:
    """Raise MissingBlender, one line, where a Blender of this version (`bpy.app.version`) is too old. Newer ones than tested may try."""
    if tuple(version[:2]) < OLDEST:
        raise MissingBlender(
            f"Blender {'.'.join(map(str, version))} is too old: {'.'.join(map(str, OLDEST))} or newer is needed (tested: {TESTED})"
        )


def check_host() -> None:
    """Check the Blender that this Python was started by, if one was, and that it has numpy. Raises MissingBlender."""
    if "bpy" in sys.modules:
        check_version(sys.modules["bpy"].app.version)
    if find_spec("numpy") is None:
        raise MissingBlender(
            f"the Python of this Blender has no numpy: install it for Python {sys.version_info[0]}.{sys.version_info[1]}"
            " (on Debian or Ubuntu: apt-get install -y python3-numpy)"
        )
