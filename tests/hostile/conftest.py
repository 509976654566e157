"""What the hostile tests share: libraries are loaded beforehand, so that the memory of a refusal is the refusal's own."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

import pytest

LIBRARIES = ("cv2", "OpenEXR", "trimesh", "scipy.io", "scipy.sparse", "pydantic", "torch", "safetensors")


@pytest.fixture(scope="session", autouse=True)
def _loaded() -> None:
    for name in LIBRARIES:
        if find_spec(name.split(".")[0]) is not None:
            import_module(name)
    for name in ("gen.cli", "recon.cli", "learn.cli", "gen.spec", "recon.pipeline", "recon.inspection.inspection"):
        import_module(name)
    if find_spec("torch") is not None:
        import torch

        torch.set_num_threads(1)
        import_module("learn.train")  # it takes the standard error of the moment for its progress
