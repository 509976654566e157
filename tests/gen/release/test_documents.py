"""The documents of a release: the card's own code loads it, Croissant is valid and its record sets load, the rest says what it must."""

from __future__ import annotations

import json
import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from gen.capture import Capture, Truth
from gen.errors import InputError
from gen.exr import read_exr
from gen.release.about import LICENCES, About, release_date
from gen.release.card import bibtex
from gen.release.croissant import CONTEXT
from gen.release.yaml_text import yaml_text
from gen.sets.set_folder import SetFolder
from gen.strict_yaml import parse_yaml
from tests.gen.release.conftest import ABOUT, release
from tests.gen.sets.conftest import store_half_and_cropped

ROUTES = ("datasets", "webdataset", "OpenEXR", "reading")


def code_of(card: str, route: str) -> str:
    """The block of the card's code that imports something."""
    (found,) = [code for code in re.findall(r"```python\n(.*?)```", card, re.DOTALL) if re.search(rf"\b{route}\b", code)]
    return str(found)


@pytest.fixture
def run(released: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Any]:
    """A function that runs a block of the card as it stands, inside the release; the names that it leaves."""
    monkeypatch.chdir(released)
    for name in ("HF_HOME", "HF_DATASETS_CACHE"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("WDS_SECURE", "0")  # the card's own code has to set it
    before = {path: path.stat().st_mtime_ns for path in released.rglob("*")}

    def execute(route: str) -> dict[str, Any]:
        code = code_of((released / "README.md").read_text(), route)
        assert len([line for line in code.splitlines() if line.strip()]) <= 5
        for module in [module for module in sys.modules if module.split(".")[0] == "webdataset"]:
            monkeypatch.delitem(sys.modules, module)  # it reads WDS_SECURE once, when it is imported
        names: dict[str, Any] = {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of libraries that are imported here for the first time
            exec(compile(code, f"the card: {route}", "exec"), names)
        return names

    yield execute
    assert {path: path.stat().st_mtime_ns for path in released.rglob("*")} == before


def test_the_card_loads_by_datasets(run: Any, rendered: SetFolder) -> None:
    capture = run("datasets")["capture"]
    truth = rendered.capture(capture["__key__"])
    assert len([field for field in capture if re.fullmatch(r"\d+\.exr", field)]) == truth.count
    assert np.array(capture["json"]["directions"]) == pytest.approx(truth.lights)
    assert capture["001.exr"] == (rendered.item_folder(capture["__key__"]) / "frames/001.exr").read_bytes()
    assert (np.asarray(capture["mask.png"]) > 0).tolist() == truth.mask.tolist()
    assert capture["preview.png"].size == (24, 24)

    from datasets import get_dataset_config_names, load_dataset

    assert get_dataset_config_names(str(Path.cwd())) == ["1-picture", "5-pictures"]
    loaded = {
        (name, split): [row["__key__"] for row in rows]
        for name in ("1-picture", "5-pictures")
        for split, rows in load_dataset(str(Path.cwd()), name, streaming=True).items()
    }
    wanted = json.loads((rendered.path / "splits.json").read_text())["splits"]
    found = {split: sorted(key for (_, of), keys in loaded.items() if of == split for key in keys) for split in wanted}
    assert found == {split: sorted(items) for split, items in wanted.items()}


def test_the_card_loads_by_webdataset(run: Any, rendered: SetFolder) -> None:
    names = run("webdataset")
    assert sys.modules["webdataset"].utils.enforce_security
    capture = names["capture"]
    assert capture["001.exr"] == (rendered.item_folder(capture["__key__"]) / "frames/001.exr").read_bytes()
    assert capture["json"]["item"] == capture["__key__"]


def test_the_card_loads_by_plain_openexr(run: Any, rendered: SetFolder) -> None:
    names = run("OpenEXR")
    expected = read_exr(rendered.item_folder(names["row"]["item"]) / "frames" / names["row"]["field"])
    assert names["channels"].keys() == expected.keys()
    for name, channel in names["channels"].items():
        np.testing.assert_array_equal(channel.pixels, expected[name])


def test_the_card_loads_by_our_capture(run: Any, rendered: SetFolder) -> None:
    same_captures(run("reading")["capture"], rendered)


def same_captures(capture: Capture, folder: SetFolder) -> None:
    """That a capture which a release gave back is the set's, to the last bit."""
    wanted = folder.capture(capture.provenance["spec"]["name"])
    for name in ("images", "lights", "intensities", "mask", "faults"):
        np.testing.assert_array_equal(getattr(capture, name), getattr(wanted, name))
    for name in (*Truth.PER_VIEW, *Truth.PER_LIGHT):
        np.testing.assert_array_equal(getattr(capture.truth, name), getattr(wanted.truth, name))


def test_croissant_is_valid_and_loads(
    rendered: SetFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """By the reference implementation, without a network: no complaint, and every record set gives the rows of its table."""
    import socket

    monkeypatch.setattr(socket.socket, "connect", lambda *_: pytest.fail("the network was used"))
    output = tmp_path / "dated"
    release(rendered, output, About(**{**ABOUT.__dict__, "date": "2026-02-03", "url": "https://example.org/data"}))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rdflib's about its own classes
        import mlcroissant

        dataset = mlcroissant.Dataset(jsonld=output / "croissant.json")
        tables = {name: list(dataset.records(name)) for name in ("pictures", "rejected", "members", "splits")}
    assert dataset.metadata.ctx.issues.report() == ""
    assert dataset.metadata.ctx.conforms_to.value == "http://mlcommons.org/croissant/1.1"
    assert [record for record in caplog.records if record.levelname in ("WARNING", "ERROR")] == []
    for name in ("pictures", "rejected", "members"):
        rows = pq.read_table(output / f"data/{name}.parquet").to_pylist()
        records = tables[name]
        assert len(records) == len(rows)
        for record, row in zip(records, rows, strict=True):
            for key, value in row.items():
                found = record[f"{name}/{key}"]
                found = found.decode() if isinstance(found, bytes) else found
                assert found == value or (value is None and (found is None or found != found)), key
    assert [record["splits/name"] for record in tables["splits"]] == ["train", "validation", "test"]

    said = json.loads((output / "croissant.json").read_text())
    assert said["rai:hasSyntheticData"] is True
    assert said["datePublished"] == "2026-02-03"
    manifest = dict(reversed(line.split("  ")) for line in (output / "manifest-sha256.txt").read_text().splitlines())
    assert {entry["contentUrl"]: entry["sha256"] for entry in said["distribution"]} == manifest
    assert all(entry["contentSize"] == f"{(output / entry['contentUrl']).stat().st_size} B" for entry in said["distribution"])


def test_the_context_is_the_standards_own() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from mlcroissant._src.core.context import Context
        from mlcroissant._src.core.rdf import make_context
    assert dict(CONTEXT) == make_context(Context(conforms_to="http://mlcommons.org/croissant/1.1"))


def test_the_documents_say_what_they_must(released: Path) -> None:
    card = (released / "README.md").read_text()
    _, front, text = card.split("---\n", 2)
    head = parse_yaml(front, "README.md", "front matter")
    assert (head["license"], head["size_categories"]) == ("cc-by-4.0", ["n<1K"])
    assert [config["config_name"] for config in head["configs"]] == ["1-picture", "5-pictures"]
    named = {path for config in head["configs"] for entry in config["data_files"] for path in entry["path"]}
    assert named == {f"data/{path.name}" for path in (released / "data").glob("*.tar")}
    pictures = pq.read_table(released / "data/pictures.parquet").to_pylist()
    for split in ("train", "validation", "test"):
        rows = [row for row in pictures if row["split"] == split]
        assert f"| {split} | {sum(row['picture'] == 1 for row in rows)} | {len(rows)} |" in text
    assert "2 (overexposed)" in text
    citation = parse_yaml((released / "CITATION.cff").read_text(), "CITATION.cff", "a citation")
    wanted = {"cff-version": "1.2.0", "type": "dataset", "title": "Closed form", "version": "1.2.0", "license": "CC-BY-4.0"}
    assert wanted.items() <= citation.items()
    assert citation["authors"] == [{"name": "A. Tester"}]
    assert "SPDX-License-Identifier: CC-BY-4.0" in (released / "LICENSE").read_text()
    assert "8 captures, 20 pictures" in (released / "DATASHEET.md").read_text()
    said = json.loads((released / "provenance.json").read_text())
    assert said["set"]["items"] == 11
    assert len(said["released"]["code_sha256"]) == len(said["released"]["constraints_sha256"]) == 64
    for name in ("README.md", "DATASHEET.md", "LICENSE", "CITATION.cff", "croissant.json", "provenance.json"):
        assert not re.search(r"\b(None|nan|inf)\b|\{[a-z_.]+\}", (released / name).read_text()), name


def test_the_card_speaks_of_all_groups(rendered_copy: SetFolder, tmp_path: Path) -> None:
    """One group of the set is stored in half precision, cropped; the other two are not."""
    for row in rendered_copy.rows():
        if row["group"] == "stack":
            store_half_and_cropped(rendered_copy, row["id"])
    release(rendered_copy, tmp_path / "out")
    card = (tmp_path / "out/README.md").read_text()
    assert "`diffuse.{R,G,B}` (half or float)" in card
    assert "`normal.{X,Y,Z}` (float)" in card
    assert "`faults.V`" in card  # of the stacks alone
    assert "EXRs store the box around the object only" in card


def test_bibtex_reads_any_title_as_text() -> None:
    """Its braces balance, by which BibTeX finds the end of a field, and no character is a command of LaTeX."""
    said = About("x", "1.0.0", r"50% {of} A&B_c #1 \ $2 ~ ^", "d", "A } B", url="https://example.org/{a}_b")
    text = bibtex(said)
    depth = 0
    for character in text:
        depth += {"{": 1, "}": -1}.get(character, 0)
        assert depth >= 0
    assert depth == 0
    title, author = (line for line in text.splitlines() if line.startswith(("  title", "  author")))
    assert title == (
        r"  title = {50\% {\textbraceleft}of{\textbraceright} A\&B\_c \#1 {\textbackslash} \$2 {\textasciitilde} {\textasciicircum}},"
    )
    assert author == r"  author = {{A {\textbraceright} B}},"
    assert "  url = {https://example.org/%7Ba%7D_b}" in text


def test_a_date_is_only_what_the_environment_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    assert release_date() is None
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1770076800")
    monkeypatch.setenv("TZ", "America/Los_Angeles")
    assert release_date() == "2026-02-03"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(InputError, match="SOURCE_DATE_EPOCH=yesterday: must be seconds since 1970"):
        release_date()


WRONG: Mapping[str, tuple[dict[str, Any], str]] = {
    "version": ({"version": "1.0"}, "--version 1.0: must be three numbers"),
    "licence": ({"licence": "MIT"}, "--license MIT: must be one of CC-BY-4.0"),
    "lines": ({"title": "a\n---\nb"}, "--title: must be one line"),
    "bytes that are no text": ({"description": "caf\udce9"}, "--description: must be one line of text"),
    "empty": ({"creator": " "}, "--creator: must be one line"),
    "url": ({"url": "ftp://x"}, "--url ftp://x: must start with https://"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_stand_in_a_document_is_refused(name: str) -> None:
    values, message = WRONG[name]
    with pytest.raises(InputError, match=re.escape(message)):
        About(**{**ABOUT.__dict__, **values})


@pytest.mark.parametrize(
    "text", ["a: b # c", "- x", "'q'", '"', "yes", "1.0", "{a: 1}", "Ångström", "a: &b *c", "| pipe", "# no"]
)
def test_any_text_survives_yaml(text: str) -> None:
    assert parse_yaml(yaml_text({"title": text, "list": [text]}), "x", "a test") == {"title": text, "list": [text]}


def test_every_licence_has_its_terms() -> None:
    assert all(licence.url.startswith("https://creativecommons.org/") and licence.terms for licence in LICENCES.values())
