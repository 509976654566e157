"""Small networks with random weights, saved and loaded as trained ones are: what the tests of their use share."""

from __future__ import annotations

from pathlib import Path

import torch

from learn.method import create_method
from learn.weights import Loaded, load_weights, save_weights

OPTIONS = {"lime": {"width": 4}, "specular": {"width": 4}, "diffuse": {"width": 4}, "group": {"widths": [8, 8], "head": 8}}


def weights_file(folder: Path, method: str, seed: int = 0) -> Path:
    """A file of weights that do something: every parameter and buffer moved from its start."""
    options = OPTIONS[method]
    torch.manual_seed(seed)
    model = create_method(method).build(options)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    path = folder / f"{method}.safetensors"
    save_weights(path, model, method, options, {"data": "none", "seed": seed})
    return path


def loaded(folder: Path, method: str, seed: int = 0) -> Loaded:
    """The same, loaded."""
    return load_weights(weights_file(folder, method, seed))
