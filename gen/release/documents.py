"""The files of a release that people and catalogues read: card, datasheet, licence, citation, Croissant, provenance, contact sheet."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from gen.files import dumps, sha256_of
from gen.images import write_png
from gen.release.about import About
from gen.release.card import card
from gen.release.croissant import croissant
from gen.release.datasheet import datasheet
from gen.release.facts import Facts
from gen.release.layout import CARD, CITATION, CROISSANT, DATA, DATASHEET, LICENCE, PROVENANCE, SHEET
from gen.release.provenance import provenance_of
from gen.release.yaml_text import yaml_text
from gen.sets.preview import contact_sheet
from gen.sets.set_folder import SetFolder


def write_documents(
    built: Path, folder: SetFolder, about: About, facts: Facts, sources: dict[str, str], hashes: Mapping[str, str]
) -> None:
    """Write all of them beside the folder `data`, which is complete. hashes: SHA-256 of its shards. sources: of the set's own files."""
    names = sorted(path.relative_to(built).as_posix() for path in (built / DATA).iterdir())
    every = {name: hashes.get(name) or sha256_of(built / name) for name in names}
    texts = {
        CARD: card(about, facts),
        DATASHEET: datasheet(about, facts),
        LICENCE: licence(about, facts),
        CITATION: citation(about),
        CROISSANT: dumps(croissant(built, about, facts, every), indent=1) + "\n",
        PROVENANCE: dumps(provenance_of(folder, about, facts, sources), indent=1) + "\n",
    }
    for name, text in texts.items():
        (built / name).write_text(text, encoding="utf-8", newline="\n")
    write_png(built / SHEET, contact_sheet(folder.path))


def licence(about: About, facts: Facts) -> str:
    """The text of LICENSE: the notice by which the data are licensed, and what it does not cover."""
    lines = [
        f"{about.title}, version {about.version}",
        f"Creator: {about.creator}",
        "",
        f"SPDX-License-Identifier: {about.licence}",
        "",
        f"These data are licensed under {about.terms.name} ({about.licence}).",
        f"The licence: {about.terms.url}legalcode",
        "",
        about.terms.terms,
        "The data come as they are, without any warranty.",
        "",
        "The data are pictures, tables and texts. The program degloss, which made them, is under GPL-3.0-or-later; that licence is",
        "about the program and not about what it renders. The same holds for Blender.",
    ]
    if facts.named_files:
        lines += [
            "",
            "Some captures show meshes or panoramas that the creator brought; the terms of their authors may ask for more.",
        ]
    return "\n".join(lines) + "\n"


def citation(about: About) -> str:
    """The text of CITATION.cff (Citation File Format 1.2.0)."""
    return yaml_text(
        {
            "cff-version": "1.2.0",
            "message": "If you use these data, please cite them as below.",
            "type": "dataset",
            "title": about.title,
            "abstract": about.description,
            "version": about.version,
            "authors": [{"name": about.creator}],
            "license": about.licence,
            **({"url": about.url} if about.url else {}),
            **({"date-released": about.date} if about.date else {}),
        }
    )
