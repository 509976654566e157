"""Networks as files for other programs: ONNX, and TorchScript for libtorch. Nothing is left on disk that does not agree with the network.

Both are made by tracing at sides that no stride divides, so that padding and cutting are part of the graph and any size will do.
"""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.overrides import TorchFunctionMode

from gen.errors import InputError
from gen.files import writing
from gen.parts import require
from learn.models.group import MOST_SHRUNK

OPSET = 17
"""Of the ONNX standard: the newest that the exporter writes from a trace, read by onnxruntime from 1.12 on."""

TRACED = (2, 41, 53)
"""Batch, height and width of the trace."""

CHECKED = ((2, 41, 53), (1, 64, 96), (3, 70, 33))
"""Batch, height and width at which a file is compared with the network: the traced ones, whole multiples of every stride, others."""

MOST = 99.9
"""Percent of an output's values that `AGREES` holds for: where a network decides (a median, a threshold), the last bit of another library's
product can turn the decision in single samples."""

AGREES = (5e-3, 1e-4)
"""Differences from the network that are allowed, of `MOST` of the values and on average, over the output's largest value (at least 1)."""

FEWEST = 3
"""Pictures of an exported group network: with fewer, the normal that it looks at is a matter of rounding, and no two libraries agree."""

SWEEPS = 5
"""Of Jacobi's rotations over a symmetric 3x3 matrix; after four nothing is left off the diagonal in float32."""


@dataclass(frozen=True)
class Graph:
    """What is exported. module: tensors in, a tuple of tensors out. inputs: name -> its axes, from "B", "K", "H", "W" and numbers.

    outputs: names. booleans: the inputs that are true or false.
    """

    module: nn.Module
    inputs: Mapping[str, tuple[str | int, ...]]
    outputs: tuple[str, ...]
    booleans: tuple[str, ...] = ("mask", "valid")

    def example(self, batch: int, height: int, width: int, pictures: int, seed: int = 0) -> tuple[Tensor, ...]:
        """Inputs of that size: random radiance to 1.5, lights about the view, most samples valid, an object in the middle."""
        rng = np.random.default_rng(seed)
        sides = {"B": batch, "K": pictures, "H": height, "W": width}
        made: list[Tensor] = []
        for name, axes in self.inputs.items():
            shape = tuple(sides[axis] if isinstance(axis, str) else axis for axis in axes)
            if name == "mask":
                inside = np.zeros(shape, bool)
                inside[..., height // 8 : height - height // 8, width // 8 : width - width // 8] = True
                made.append(torch.from_numpy(inside))
            elif name == "valid":
                made.append(torch.from_numpy(rng.random(shape) < 0.95))
            elif name == "lights":
                toward = rng.normal(0, 0.5, shape) + np.array([0, 0, 1.2])
                made.append(torch.from_numpy((toward / np.linalg.norm(toward, axis=-1, keepdims=True)).astype(np.float32)))
            else:
                made.append(torch.from_numpy(rng.uniform(0, 1.5, shape).astype(np.float32)))
        return tuple(made)


def graph_of(model: nn.Module, shrink: int = 1) -> Graph:
    """What is exported of a network of `learn.models`. Raises InputError where it is of a kind that is not known.

    shrink: of the group network, see `learn.models.group.shrink_of`.
    """
    picture = {"image": ("B", 3, "H", "W")}
    masked = {**picture, "mask": ("B", 1, "H", "W")}
    match type(model).__name__:
        case "GroupNet":
            inputs: dict[str, tuple[str | int, ...]] = {
                "images": ("B", "K", 3, "H", "W"),
                "lights": ("B", "K", 3),
                "valid": ("B", "K", "H", "W"),
                "mask": ("B", "H", "W"),
            }
            return Graph(_Group(model, shrink), inputs, ("matte", "diffuse", "specular", "confidence", "normals"))
        case "LimeNet" | "SpecularNet":
            return Graph(_Remover(model), masked, ("diffuse", "specular"))
        case "SegmentationNet":
            return Graph(_Plain(model), picture, ("mask_logit",))
        case "MirrorNet":
            return Graph(_Plain(model), {"S": ("B", 3, "H", "W")}, ("mirror_encoded",))
        case "AlbedoNet":
            return Graph(_Plain(model), {**picture, "S": ("B", 3, "H", "W"), "mask": ("B", 1, "H", "W")}, ("m_d", "m_s"))
        case "ExponentNet":
            inputs = {"S": ("B", 3, "H", "W"), "mirror": ("B", 3, "H", "W"), "mask": ("B", 1, "H", "W")}
            return Graph(_Plain(model), inputs, ("exponent_logits",))
        case kind:
            raise InputError(f"a network of the kind {kind} cannot be exported")


def export_model(
    model: nn.Module,
    path: Path,
    format: str = "onnx",
    pictures: int = 5,
    facts: Mapping[str, str] | None = None,
    shrink: int = 1,
) -> dict[str, Any]:
    """Write a network in evaluation mode to `path`, compare the file with the network at the sizes of `CHECKED`, and only then keep it.

    format: "onnx" (opset `OPSET`; batch, height and width are free) or "torch" (TorchScript, for torch.jit.load and libtorch; the same are
    free). pictures: K, which is part of the graph of the group network and of no other, as is shrink (see `learn.models.group.shrink_of`).
    facts: what the file says of itself.
    Returns format, inputs, outputs, bytes, and the relative differences that were found (see `AGREES`). Raises InputError where the
    file would not agree with the network or cannot be written, MissingPart without onnx and onnxruntime.
    """
    if format not in ("onnx", "torch"):
        raise InputError(f"--format {format}: must be onnx or torch")
    if not FEWEST <= pictures <= 96:
        raise InputError(f"--pictures {pictures}: must be from {FEWEST} to 96")
    if not 1 <= shrink <= MOST_SHRUNK:
        raise InputError(f"--shrink {shrink}: must be from 1 to {MOST_SHRUNK}")
    if format == "onnx":
        require("export")
    graph = graph_of(model.to("cpu").eval(), shrink)
    said = {**(facts or {}), "inputs": json.dumps({name: list(axes) for name, axes in graph.inputs.items()})}
    if "images" in graph.inputs:
        said |= {"pictures": str(pictures), "shrink": str(shrink)}
    with torch.no_grad(), _Elementary(), _quiet():
        traced = torch.jit.trace(graph.module, graph.example(*TRACED, pictures), check_trace=False)
        data = _onnx_bytes(traced, graph, pictures, said) if format == "onnx" else _script_bytes(traced, said)
    with writing(path) as temporary:
        temporary.write_bytes(data)
        run = _onnx_session(temporary, graph) if format == "onnx" else _script_session(temporary)
        found = [_difference(graph, run, size, pictures, seed) for seed, size in enumerate(CHECKED, 1)]
        worst, mean = (max(values) for values in zip(*found, strict=True))
        if not (worst <= AGREES[0] and mean <= AGREES[1]):
            raise InputError(
                f"{path}: not written: the exported network departs from the original by {worst:.2g} of its range ({mean:.2g} on average)"
            )
    inputs = {name: [pictures if axis == "K" else axis for axis in axes] for name, axes in graph.inputs.items()}
    return {
        "format": format,
        "inputs": inputs,
        "outputs": list(graph.outputs),
        "bytes": len(data),
        "difference": {"most": worst, "mean": mean},
    }


class _Remover(nn.Module):
    """remove(image, mask) of a network of single pictures."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, image: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        layers: tuple[Tensor, Tensor] = self.model.remove(image, mask)
        return layers


class _Group(nn.Module):
    """The group network's layers as a tuple."""

    def __init__(self, model: nn.Module, shrink: int) -> None:
        super().__init__()
        self.model, self.shrink = model, shrink

    def forward(self, images: Tensor, lights: Tensor, valid: Tensor, mask: Tensor) -> tuple[Tensor, ...]:
        layers = self.model(images, lights, valid, mask, shrink=self.shrink)
        return layers.matte, layers.diffuse, layers.specular, layers.confidence, layers.normals


class _Plain(nn.Module):
    """A network's own forward, its result as a tuple."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        result = self.model(*inputs)
        return result if isinstance(result, tuple) else (result,)


def _onnx_bytes(traced: Any, graph: Graph, pictures: int, facts: Mapping[str, str]) -> bytes:
    """The ONNX file of a trace, checked by the library, its facts in the metadata."""
    import onnx

    free = {"B": "batch", "H": "height", "W": "width"}
    axes = {name: {i: free[axis] for i, axis in enumerate(of) if axis in free} for name, of in graph.inputs.items()}
    sides = dict(zip("BHW", TRACED, strict=True)) | {"K": pictures}
    outputs = traced(*graph.example(*TRACED, pictures))
    for name, output in zip(graph.outputs, outputs, strict=True):
        axes[name] = {i: free[axis] for i, side in enumerate(output.shape) for axis in free if side == sides[axis]}
    stream = io.BytesIO()
    torch.onnx.export(
        traced,
        graph.example(*TRACED, pictures),
        stream,
        dynamo=False,
        opset_version=OPSET,
        input_names=list(graph.inputs),
        output_names=list(graph.outputs),
        dynamic_axes=axes,
    )
    model = onnx.load_model_from_string(stream.getvalue())
    onnx.helper.set_model_props(model, dict(facts))
    model.doc_string = "degloss: a network that removes gloss; linear radiance in, linear radiance out"
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def _script_bytes(traced: Any, facts: Mapping[str, str]) -> bytes:
    """The TorchScript archive of a trace, its facts in the extra file facts.json."""
    stream = io.BytesIO()
    torch.jit.save(traced, stream, _extra_files={"facts.json": json.dumps(facts)})
    return stream.getvalue()


def _onnx_session(path: Path, graph: Graph) -> Callable[[tuple[Tensor, ...]], list[Any]]:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])

    def run(inputs: tuple[Tensor, ...]) -> list[Any]:
        given = {name: tensor.numpy() for name, tensor in zip(graph.inputs, inputs, strict=True)}
        return list(session.run(None, {name: given[name] for name in (entry.name for entry in session.get_inputs())}))

    return run


def _script_session(path: Path) -> Callable[[tuple[Tensor, ...]], list[Any]]:
    with _quiet():
        loaded = torch.jit.load(io.BytesIO(path.read_bytes()))

    def run(inputs: tuple[Tensor, ...]) -> list[Any]:
        with torch.no_grad():
            return [output.numpy() for output in loaded(*inputs)]

    return run


def _difference(
    graph: Graph, run: Callable[[tuple[Tensor, ...]], list[Any]], size: tuple[int, int, int], pictures: int, seed: int
) -> tuple[float, float]:
    """The differences of `AGREES` between file and network at one size; infinite where shapes differ or a value is not finite."""
    inputs = graph.example(*size, pictures, seed)
    with torch.no_grad():
        expected = [output.numpy() for output in graph.module(*inputs)]
    try:
        found = run(inputs)
    except Exception as error:  # each library has its own
        raise InputError(f"the exported network fails at {size[2]}x{size[1]} pixels: {str(error)[:200]}") from error
    worst = mean = 0.0
    for ours, theirs in zip(expected, found, strict=True):
        if ours.shape != theirs.shape or not np.isfinite(theirs).all():
            return float("inf"), float("inf")
        apart, top = np.abs(ours - theirs), max(1.0, float(np.abs(ours).max()))
        worst, mean = max(worst, float(np.percentile(apart, MOST)) / top), max(mean, float(apart.mean()) / top)
    return worst, mean


class _Elementary(TorchFunctionMode):
    """What ONNX lacks, by operations that every runtime has: inverses of 3x3 matrices, pooling to a size that is not constant,
    repeating, joining axes.

    The networks pool to a whole fraction of the size, and repeat each entry of the first axis: only so much is put in the place of either.
    """

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if func is torch.linalg.inv:
            return inverse(args[0])
        if func is torch.linalg.det:
            return determinant(args[0])
        if func is torch.linalg.pinv:
            return pseudo_inverse(args[0], float(kwargs["rtol"]))
        if func is F.adaptive_avg_pool2d:
            return F.avg_pool2d(args[0], round(int(args[0].shape[-1]) / int(args[1][-1])))
        if func is Tensor.flatten and args[1:] == (0, 1):
            return args[0].reshape(-1, *args[0].shape[2:])
        if func is Tensor.repeat_interleave:
            return repeated(args[0], args[1])
        return func(*args, **kwargs)


def repeated(x: Tensor, times: int) -> Tensor:
    """Each entry of the first axis `times` times, one after the other."""
    spread: Tensor = x.unsqueeze(1).expand(-1, times, *(-1 for _ in x.shape[1:])).reshape(-1, *x.shape[1:])
    return spread


def determinant(m: Tensor) -> Tensor:
    """Determinants (...) of 3x3 matrices (..., 3, 3)."""
    a, b, c = (m[..., i, :] for i in range(3))
    return (a * _cross(b, c)).sum(-1)


def inverse(m: Tensor) -> Tensor:
    """Inverses (..., 3, 3) of 3x3 matrices, by the adjugate."""
    a, b, c = (m[..., i, :] for i in range(3))
    adjugate = torch.stack([_cross(b, c), _cross(c, a), _cross(a, b)], -1)
    return adjugate / (a * _cross(b, c)).sum(-1)[..., None, None]


def pseudo_inverse(m: Tensor, rtol: float) -> Tensor:
    """Pseudo-inverses (..., 3, 3) of 3x3 matrices; singular values of at most `rtol` of the largest count as 0, as in torch.linalg.pinv.

    From the eigenvectors of m^T m, found by Jacobi's cyclic rotations.
    Source: G. Golub and C. Van Loan, "Matrix Computations", section 8.5.
    """
    wide = m.double()
    square = wide.transpose(-1, -2) @ wide
    vectors = torch.eye(3, dtype=wide.dtype).expand_as(square)
    for _ in range(SWEEPS):
        for p, q in ((0, 1), (0, 2), (1, 2)):
            rotation = _rotation(square, p, q)
            square = rotation.transpose(-1, -2) @ square @ rotation
            vectors = vectors @ rotation
    values = torch.stack([square[..., i, i] for i in range(3)], -1).clamp(min=0)
    kept = values.sqrt() > rtol * values.amax(-1, keepdim=True).sqrt()
    inverted = torch.where(kept, 1 / torch.where(kept, values, torch.ones_like(values)), torch.zeros_like(values))
    return (((vectors * inverted[..., None, :]) @ vectors.transpose(-1, -2)) @ wide.transpose(-1, -2)).to(m.dtype)


def _rotation(square: Tensor, p: int, q: int) -> Tensor:
    """The rotation of axes p and q that brings the element (p, q) of symmetric matrices to 0."""
    off = square[..., p, q]
    there = off.abs() > 1e-30
    theta = (square[..., q, q] - square[..., p, p]) / (2 * torch.where(there, off, torch.ones_like(off)))
    sign = torch.where(theta >= 0, torch.ones_like(theta), -torch.ones_like(theta))
    t = torch.where(there, sign / (theta.abs() + (theta * theta + 1).sqrt()), torch.zeros_like(theta))
    c = 1 / (t * t + 1).sqrt()
    s, one, zero = t * c, torch.ones_like(c), torch.zeros_like(c)
    entries = {(p, p): c, (q, q): c, (p, q): s, (q, p): -s}
    rows = [torch.stack([entries.get((i, j), one if i == j else zero) for j in range(3)], -1) for i in range(3)]
    return torch.stack(rows, -2)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    (ax, ay, az), (bx, by, bz) = a.unbind(-1), b.unbind(-1)
    return torch.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the tracer's warnings (what it would freeze is meant, and `_difference` tests it) and those of its coming retirement."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=torch.jit.TracerWarning)
        warnings.filterwarnings(
            "ignore", category=DeprecationWarning, message=r"(?s).*(torch\.jit|TorchScript|dynamo|The feature will be removed).*"
        )
        warnings.filterwarnings("ignore", category=UserWarning, module=r"torch\.onnx.*")
        yield
