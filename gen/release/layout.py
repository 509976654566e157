"""The release: names of its files, and the one way in which a capture stands in a shard.

    README.md              the card: what it is, how to load it (front matter for Hugging Face)
    DATASHEET.md LICENSE CITATION.cff croissant.json contact-sheet.png
    provenance.json        what it was made from and by what
    data/SPLIT-NNNNN.tar   shards; where captures differ in their number of pictures K, data/SPLIT-Kx-NNNNN.tar
    data/pictures.parquet  every picture: where it stands, hash, gloss, light
    data/rejected.parquet  every picture that was left out, and why
    data/members.parquet   every file in every shard: offset, size, SHA-256
    data/plan.jsonl        the plan: every value of every capture, also of those left out
    data/splits.json       the division, and by what it was made
    bagit.txt bag-info.txt manifest-sha256.txt tagmanifest-sha256.txt     BagIt (RFC 8493)

A capture is one WebDataset sample: its key is the item's id, its fields

    json                   facts that every sample words alike: split, lights, intensities, gloss, ...
    capture                capture.json of the capture folder
    001.exr 002.exr ...    the pictures with their layers, frames/001.exr ... of the capture folder, byte for byte
    view.exr mask.png      byte for byte too
    preview.png            a small sRGB picture for people

The field `capture` has no ending that loaders decode: what it says differs from item to item, and Arrow wants columns of one type.
Nothing holds a time, a user's name or a path outside: the same rendered set gives the same bytes.
"""

from __future__ import annotations

import re

from gen.errors import InputError
from gen.sets.thumbnail import THUMBNAIL

FORMAT = "degloss release"
VERSION = 1

CARD, DATASHEET, LICENCE, CITATION = "README.md", "DATASHEET.md", "LICENSE", "CITATION.cff"
CROISSANT, SHEET, PROVENANCE = "croissant.json", "contact-sheet.png", "provenance.json"
DATA = "data"
PICTURES, REJECTED, MEMBERS = f"{DATA}/pictures.parquet", f"{DATA}/rejected.parquet", f"{DATA}/members.parquet"
PLAN, SPLITS = f"{DATA}/plan.jsonl", f"{DATA}/splits.json"
BAGIT, BAG_INFO, MANIFEST, TAG_MANIFEST = "bagit.txt", "bag-info.txt", "manifest-sha256.txt", "tagmanifest-sha256.txt"

FACTS, CAPTURE, PREVIEW = "json", "capture", THUMBNAIL
SHARD_BYTES = 500_000_000
"""Size of a shard, about, where nobody says another."""

MAX_FILE = 2_000_000_000
"""The largest file of a capture in bytes."""

KEY = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,79}")
SHARD = re.compile(r"(train|validation|test)(-\d+x)?-\d{5}\.tar")
_FRAME = re.compile(r"frames/(\d{3,5}\.exr)")
_FIELD = re.compile(r"\d{3,5}\.exr")
_SAME = ("view.exr", "mask.png")
_NOT_RELEASED = ("spec.yaml", ".degloss")
"""Files of an item whose content stands elsewhere: the spec in capture.json, the folder's own list of files in members.parquet."""


def field_of(file: str) -> str | None:
    """The field that a file of a capture folder becomes; None where it is not released. Raises InputError where it is unknown."""
    if file == "capture.json":
        return CAPTURE
    if frame := _FRAME.fullmatch(file):
        return frame[1]
    if file in (*_SAME, PREVIEW):
        return file
    if file in _NOT_RELEASED:
        return None
    raise InputError(f"the file {file!r:.80} has no place in a release")


def file_of(field: str) -> str | None:
    """The reverse: the file of the capture folder that a field is, None where it is none of it (facts, preview, anything unknown)."""
    if field == CAPTURE:
        return "capture.json"
    if _FIELD.fullmatch(field):
        return f"frames/{field}"
    return field if field in _SAME else None


def key_of(item: str) -> str:
    """An item's id as the key of its sample. Raises InputError where it holds a dot, at which loaders would cut it."""
    if not KEY.fullmatch(item):
        raise InputError(f"{item!r:.100}: cannot be the key of a sample, which is letters, digits, dashes and underscores")
    return item
