"""A rendered set in closed form (`tests.gen.sets.conftest`), and what a release makes of it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gen.capture import Capture
from gen.release.about import About
from gen.release.build import Released, release_set
from gen.sets.set_folder import SetFolder
from gen.sets.splits import write_splits
from tests.gen.sets.conftest import SET_SPEC, write_set

SHARD_BYTES = 30_000
"""So small that the set takes several shards."""

ABOUT = About("closed-form", "1.2.0", "Closed form", "Spheres and cylinders: a test.", "A. Tester")


def release(folder: SetFolder, output: Path, about: About = ABOUT, **options: Any) -> Released:
    """Make a release as the tests do."""
    return release_set(folder, output, about, SHARD_BYTES, **options)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder, hidden ones included."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory, synthetic: Callable[..., Capture]) -> SetFolder:
    """A set that is screened and divided, to be read only."""
    place = tmp_path_factory.mktemp("rendered")
    (place / "set.yaml").write_text(SET_SPEC)
    folder = write_set(place / "set.yaml", place / "set", synthetic)
    write_splits(folder, (0.6, 0.2, 0.2))
    return folder


@pytest.fixture(scope="session")
def released(tmp_path_factory: pytest.TempPathFactory, rendered: SetFolder) -> Path:
    """A release of it, to be read only."""
    output = tmp_path_factory.mktemp("released") / "closed-form"
    release(rendered, output)
    return output


@pytest.fixture
def rendered_copy(rendered: SetFolder, tmp_path: Path) -> SetFolder:
    """The set, to be changed."""
    shutil.copytree(rendered.path, tmp_path / "set")
    return SetFolder(tmp_path / "set")


@pytest.fixture
def released_copy(released: Path, tmp_path: Path) -> Path:
    """The release, to be changed."""
    shutil.copytree(released, tmp_path / "release")
    return tmp_path / "release"
