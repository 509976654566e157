"""Every network exports, and another runtime gives the same numbers, at sizes that no stride divides too."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from gen.errors import InputError
from learn import export
from learn.export import export_model, graph_of, inverse, pseudo_inverse
from learn.models import MODELS, create_model

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

SMALL = {"group": {"widths": [8, 8], "head": 8}}
SIZES = ((1, 37, 46), (2, 8, 9))


def network(name: str) -> torch.nn.Module:
    """A small network whose every parameter is moved from its start, so that no output is constant."""
    torch.manual_seed(1)
    model = create_model(name, **SMALL.get(name, {"width": 4})).eval()
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return model


@pytest.mark.parametrize(("name", "shrink"), [*((name, 1) for name in MODELS), ("group", 3)])
def test_onnxruntime_agrees(name: str, shrink: int, tmp_path: Path) -> None:
    """Run here by onnxruntime itself, beside the check that the exporter makes."""
    model, path = network(name), tmp_path / "net.onnx"
    done = export_model(model, path, "onnx", 4, {"degloss.method": name}, shrink)
    assert done["bytes"] == path.stat().st_size
    graph = graph_of(model, shrink)
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL  # the exporter's own check has them on
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    assert [entry.name for entry in session.get_outputs()] == list(graph.outputs) == done["outputs"]
    for seed, size in enumerate(SIZES, 10):
        inputs = graph.example(*size, pictures=4, seed=seed)
        given = {key: tensor.numpy() for key, tensor in zip(graph.inputs, inputs, strict=True)}
        found = session.run(None, {entry.name: given[entry.name] for entry in session.get_inputs()})
        with torch.no_grad():
            expected = graph.module(*inputs)
        for ours, theirs in zip(expected, found, strict=True):
            assert ours.shape == theirs.shape
            apart, top = np.abs(theirs - ours.numpy()), max(1, float(ours.abs().max()))
            assert np.percentile(apart, 99.9) < 5e-3 * top  # single samples of the group network may decide otherwise
            assert apart.mean() < 1e-4 * top
            assert name == "group" or apart.max() < 1e-4 * top
    held = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    assert held["degloss.method"] == name
    assert json.loads(held["inputs"]) == {key: list(axes) for key, axes in graph.inputs.items()}
    assert ("pictures" in held) == (name == "group")


def test_torchscript_agrees(tmp_path: Path) -> None:
    model, path = network("group"), tmp_path / "net.pt"
    export_model(model, path, "torch", 4)
    graph = graph_of(model)
    with export._quiet():
        read = torch.jit.load(path)
    inputs = graph.example(1, 50, 35, pictures=4, seed=5)
    with torch.no_grad():
        for ours, theirs in zip(graph.module(*inputs), read(*inputs), strict=True):
            torch.testing.assert_close(theirs, ours, rtol=1e-3, atol=1e-3)


def test_what_disagrees_is_not_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = network("specular")
    monkeypatch.setattr(export, "AGREES", (0.0, -1.0))
    with pytest.raises(InputError, match="departs"):
        export_model(model, tmp_path / "net.onnx")
    assert list(tmp_path.iterdir()) == []


def test_refusals(tmp_path: Path) -> None:
    for options, says in (({"format": "tflite"}, "onnx or torch"), ({"pictures": 2}, "from 3"), ({"pictures": 1000}, "to 96")):
        with pytest.raises(InputError, match=says):
            export_model(network("specular"), tmp_path / "net.onnx", **options)
    with pytest.raises(InputError, match="Linear"):
        export_model(torch.nn.Linear(2, 2), tmp_path / "net.onnx")
    assert list(tmp_path.iterdir()) == []


def test_small_matrices_against_lapack() -> None:
    """Inverse and pseudo-inverse by elementary operations, singular and nearly singular matrices among them."""
    torch.manual_seed(0)
    m = torch.randn(300, 3, 3)
    m[:50, 2] = m[:50, 0] + m[:50, 1]
    m[50:100, 2] = m[50:100, 0] + 1e-3
    m[100:150, 1:] = 2 * m[100:150, :1]
    torch.testing.assert_close(pseudo_inverse(m, 0.05), torch.linalg.pinv(m.double(), rtol=0.05).float(), rtol=1e-4, atol=1e-5)
    good = m[150:][torch.linalg.cond(m[150:]) < 50]
    torch.testing.assert_close(inverse(good), torch.linalg.inv(good), rtol=1e-3, atol=1e-4)
