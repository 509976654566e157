"""Captures that have everything a format may lose, and a small rendered set."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gen.capture import Capture, Fault, Scale
from gen.release.about import About
from gen.release.build import release_set
from gen.sets.set_folder import SetFolder
from gen.sets.splits import write_splits
from tests.gen.sets.conftest import SET_SPEC, write_set

Synthetic = Callable[..., Capture]

K = np.array([[800.0, 0, 15.25], [0, 805.5, 14.75], [0, 0, 1]])


@pytest.fixture(scope="session")
def glossy(synthetic: Synthetic) -> Capture:
    """A sphere under seven lights of differing strength and colour, highlights above 1, with all its truth and a scale."""
    rng = np.random.default_rng(3)
    lights = rng.normal((0, 0, 2.5), 1, (7, 3))
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    made = synthetic(size=32, lights=lights, specular=np.full(3, 0.3), alpha=0.2)
    strength = rng.uniform(0.5, 2, (7, 3))
    layers = {
        name: (getattr(made.truth, name) * strength[:, None, None]).astype(np.float32)
        for name in ("diffuse", "specular", "matte")
    }
    shadow = np.where(made.truth.matte.max(axis=-1) == 0, 1, 0).astype(np.uint8)  # type: ignore[union-attr]
    images = layers["diffuse"] + layers["specular"]
    assert images.max() > 1
    return replace(
        made,
        images=images,
        intensities=strength,
        truth=replace(made.truth, **layers, shadow=shadow),
        scale=Scale(mm_per_pixel=0.125),
        names=tuple(f"../{k}/shot.png" for k in range(7)),
        provenance={"spec": {"shape": {"file": "/home/someone/secret/part.glb"}}, "exposure": 0.5},
    )


@pytest.fixture(scope="session")
def faulty(glossy: Capture) -> Capture:
    """The same with clipped, dark and missing samples, noise below 0, and a perspective view."""
    images, faults = glossy.images.copy(), np.zeros(glossy.faults.shape, np.uint8)
    faults[0, 10, 10] = Fault.CLIPPED
    images[1, 12, 12], faults[1, 12, 12] = (0.001, 0.002, 0.0), Fault.DARK
    images[2, 14, 14], faults[2, 14, 14] = np.nan, Fault.MISSING
    images[3, 0, 0] = (-0.01, 0.1, 0.1)
    return replace(glossy, images=images, faults=faults, scale=Scale(camera=K, distance_mm=512.5))


@pytest.fixture(scope="session")
def small_set(tmp_path_factory: pytest.TempPathFactory, synthetic: Synthetic) -> SetFolder:
    """Eleven captures, one of them in quarantine; to be read only."""
    place = tmp_path_factory.mktemp("set")
    (place / "set.yaml").write_text(SET_SPEC)
    return write_set(place / "set.yaml", place / "set", synthetic)


@pytest.fixture(scope="session")
def released(tmp_path_factory: pytest.TempPathFactory, small_set: SetFolder) -> Path:
    """A release of a copy of that set."""
    place = tmp_path_factory.mktemp("release")
    folder = SetFolder(Path(shutil.copytree(small_set.path, place / "set")))
    write_splits(folder, (0.5, 0.25, 0.25), by=("object",))
    release_set(
        folder, place / "out", About("closed-form", "1.0.0", "Closed form", "Closed form.", "degloss", "CC0-1.0", None, None)
    )
    return place / "out"


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder by its name."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
