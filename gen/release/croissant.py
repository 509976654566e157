"""croissant.json: the release for machines, in MLCommons' Croissant 1.1 with the fields of its RAI vocabulary 1.0."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gen.release.about import About
from gen.release.card import TAGS, bibtex
from gen.release.facts import Facts
from gen.release.layout import DATA, MEMBERS, PICTURES, PLAN, REJECTED, SPLITS
from gen.release.tables import MEMBERS as MEMBER_COLUMNS
from gen.release.tables import PICTURES as PICTURE_COLUMNS
from gen.release.tables import REJECTED as REJECTED_COLUMNS
from gen.release.tables import Columns

CONFORMS_TO = ["http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0"]

_CR = (
    "arrayShape", "citeAs", "column", "containedIn", "equivalentProperty", "extract", "field", "fileObject", "fileProperty", "fileSet",
    "format", "includes", "isArray", "isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet", "references", "regex",
    "repeated", "replace", "samplingRate", "separator", "source", "subField", "transform",
)  # fmt: skip
CONTEXT: Mapping[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "name": {"@container": "@language"},
    "description": {"@container": "@language"},
    **{name: f"cr:{name}" for name in _CR},
}
"""The JSON-LD context of Croissant 1.1."""

_TYPES = {"string": "sc:Text", "bool": "sc:Boolean", "int32": "sc:Integer", "int64": "sc:Integer", "float64": "sc:Float"}
_SPLIT_TYPES = {"train": "cr:TrainingSplit", "validation": "cr:ValidationSplit", "test": "cr:TestSplit"}
_PARQUET, _TAR, _JSON, _JSONL = "application/x-parquet", "application/x-tar", "application/json", "application/jsonlines"


def croissant(built: Path, about: About, facts: Facts, hashes: Mapping[str, str]) -> dict[str, Any]:
    """The content of croissant.json. hashes: SHA-256 of every file in `data`, by its name from the release's folder."""
    split_of = {f"{DATA}/{name}": split for name, split, _ in facts.shards}
    return {
        "@context": dict(CONTEXT),
        "@type": "sc:Dataset",
        "conformsTo": CONFORMS_TO,
        "name": about.name,
        "description": about.description,
        "alternateName": about.title,
        "version": about.version,
        "license": about.terms.url,
        "creator": {"@type": "sc:Organization", "name": about.creator},
        "citeAs": bibtex(about),
        "keywords": list(TAGS),
        "isLiveDataset": False,
        **({"url": about.url} if about.url else {}),
        **({"datePublished": about.date} if about.date else {}),
        **_responsible(about, facts),
        "distribution": [_file(built, name, digest, split_of.get(name)) for name, digest in sorted(hashes.items())],
        "recordSet": [
            _splits(facts),
            _records("pictures", "Every picture: where it stands in the shards, hash, gloss, light.", PICTURES, PICTURE_COLUMNS),
            _records("rejected", "Every picture that was left out, with the reason.", REJECTED, REJECTED_COLUMNS),
            _records("members", "Every file in every shard.", MEMBERS, MEMBER_COLUMNS),
        ],
    }


def _responsible(about: About, facts: Facts) -> dict[str, Any]:
    made = "; ".join(f"Blender {blender} (Cycles) on {device}" for blender, device, _ in facts.renderers)
    left_out = "; ".join(f"{n} {reason}" for reason, n in facts.rejected.items()) or "none"
    return {
        "rai:hasSyntheticData": True,
        "rai:dataCollection": f"All pictures were rendered by degloss with headless Blender from specs drawn by the seed {facts.seed}.",
        "rai:dataCollectionType": ["Software Collection", "Experiments"],
        "rai:dataCollectionMissingData": f"Pictures left out, each named with its reason in {REJECTED}: {left_out}.",
        "rai:dataCollectionRawData": f"The plan {PLAN} holds every value of every capture; the set can be rendered again from it.",
        "rai:dataPreprocessingProtocol": [
            "Single training pictures with pixels at 255 in R, G and B (8-bit sRGB) were left out.",
            f"Captures were divided so that splits do not share: {', '.join(facts.by)}.",
            "Files of pictures stand in the shards byte for byte as rendered; previews were added.",
        ],
        "rai:dataAnnotationProtocol": "The truth (layers, normals, depth, albedo, gloss, masks, shadows) comes from the renderer.",
        "rai:machineAnnotationTools": [made],
        "rai:dataUseCases": [
            "Training and judging gloss removal and the separation of pictures into layers.",
            "Judging photometric stereo against true normals and depth.",
        ],
        "rai:dataLimitations": [
            "Rendered, not photographed: ideal camera and lights, analytic materials, no background.",
            f"Families of shapes: {', '.join(facts.shapes)}. Families of materials: {', '.join(facts.materials)}.",
        ],
        "rai:dataBiases": "The ranges that shapes, colours, gloss and lights are drawn from are choices of the plan; what is tuned on them "
        "favours them.",
        "rai:dataSocialImpact": "Shows objects only. No effect on people is known.",
        "rai:personalSensitiveInformation": "The data hold no information about people.",
        "rai:dataReleaseMaintenancePlan": f"A version is never changed; corrections come as a new version. Kept up by {about.creator}.",
    }


def _file(built: Path, name: str, digest: str, split: str | None) -> dict[str, Any]:
    described = {
        PICTURES: "Table of all pictures.",
        REJECTED: "Table of the pictures that were left out.",
        MEMBERS: "Table of all files in the shards.",
        PLAN: "The plan: every value of every capture.",
        SPLITS: "The division into splits, and by what it was made.",
    }
    kind = {".parquet": _PARQUET, ".tar": _TAR, ".json": _JSON, ".jsonl": _JSONL}[Path(name).suffix]
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": Path(name).name,
        "description": described.get(name, f"Shard of the split {split}: one WebDataset sample a capture."),
        "contentUrl": name,
        "contentSize": f"{(built / name).stat().st_size} B",
        "encodingFormat": kind,
        "sha256": digest,
    }


def _records(name: str, description: str, file: str, columns: Columns) -> dict[str, Any]:
    key = {"pictures": ["item", "picture"], "rejected": ["item", "picture"], "members": ["item", "field"]}[name]
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": description,
        "key": [{"@id": f"{name}/{column}"} for column in key],
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"{name}/{column}",
                "name": column,
                "description": meaning,
                "dataType": _TYPES[kind],
                "source": {"fileObject": {"@id": file}, "extract": {"column": column}},
                **({"references": {"field": {"@id": "splits/name"}}} if (name, column) == ("pictures", "split") else {}),
            }
            for column, (kind, meaning) in columns.items()
        ],
    }


def _splits(facts: Facts) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": "splits",
        "name": "splits",
        "description": "The splits.",
        "dataType": "cr:Split",
        "key": {"@id": "splits/name"},
        "field": [
            {
                "@type": "cr:Field",
                "@id": "splits/name",
                "name": "name",
                "description": "Name of the split.",
                "dataType": "sc:Text",
            },
            {
                "@type": "cr:Field",
                "@id": "splits/url",
                "name": "url",
                "description": "Its meaning.",
                "dataType": ["sc:URL", "cr:Split"],
            },
        ],
        "data": [{"splits/name": name, "splits/url": _SPLIT_TYPES[name]} for name in facts.splits],
    }
