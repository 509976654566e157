"""Tests of the networks need torch: where it is missing they skip and say so."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from learn.weights import Loaded

if find_spec("torch") is None:
    collect_ignore_glob = ["test_*.py"]


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> None:
    """Small tensors are slower on several threads, and far slower where other work runs beside."""
    import torch

    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def networks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Loaded]:
    """A small network of each method with random weights, loaded from its file."""
    from learn.method import METHODS
    from tests.learn.small_weights import loaded

    folder = tmp_path_factory.mktemp("weights")
    return {method: loaded(folder, method) for method in METHODS}
