"""Captures and rendered sets in the layouts that other programs read. To add one: write its module and enter it in `FORMATS`.

`write_x(capture, folder, white) -> tuple[str, ...]` writes a capture's files into an existing, empty folder and returns, in plain words,
what the layout cannot hold of it. white: the radiance that is stored as the largest number; None where it is to be chosen, or there is
no such.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

FOLDERS: Mapping[str, str] = MappingProxyType(
    {
        "diligent": "gen.convert.diligent:write_diligent",
        "exr": "gen.convert.exr:write_exr_files",
        "png16": "gen.convert.png16:write_png16",
    }
)
"""Name of a format that gives every capture a folder -> "module:function", imported when used."""

SHARDS: Mapping[str, str] = MappingProxyType({"webdataset": "gen.convert.webdataset:write_shards"})
"""Name of a format that puts many captures into one file -> "module:function", which writes all of them; see `gen.convert.webdataset`."""

FORMATS = (*FOLDERS, *SHARDS)
