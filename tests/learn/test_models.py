"""The networks of single pictures: shapes, gradients, sizes, and that each can learn; and the blocks that they are made of."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gen.errors import InputError
from gen.srgb import linear_to_srgb as reference_curve
from learn.models import MODELS, create_model
from learn.models.blocks import as_recorded, linear_to_srgb, masked_mean, pad_to_multiple, srgb_to_linear
from learn.models.lime_nets import EXPONENTS, expected_exponent, exponent_shares

NAMES = [name for name in MODELS if name != "group"]
"""The group network sees captures, not pictures; it has tests of its own."""

LIMITS = {"segmentation": 1.7, "specular": 1.7, "mirror": 1.7, "albedo": 0.4, "exponent": 0.4, "lime": 3.3}
"""Millions of parameters at the paper's width. Weight files stay under 16 MB: 4 M of float32."""


@pytest.fixture(autouse=True)
def _repeatable() -> None:
    torch.manual_seed(1)


def disc(B: int, H: int, W: int) -> Tensor:
    """Masks (B, 1, H, W): a disc of another radius and place in each picture."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, H), torch.linspace(-1, 1, W), indexing="ij")
    return torch.stack([((x - 0.1 * b) ** 2 + y**2 < (0.9 - 0.12 * b) ** 2)[None] for b in range(B)])


def arguments(name: str, B: int = 4, H: int = 24, W: int = 24) -> tuple[Tensor, ...]:
    """What the network of that name takes."""
    mask = disc(B, H, W)
    image, other = torch.rand(B, 3, H, W) * mask, torch.rand(B, 3, H, W) * mask
    return {"albedo": (image, other, mask), "exponent": (image, other, mask), "lime": (image, mask)}.get(name, (image,))


def tensors(output: object) -> list[Tensor]:
    return [output] if isinstance(output, Tensor) else [part for part in output if part.is_floating_point()]  # type: ignore[attr-defined]


def awake(model: nn.Module, name: str) -> nn.Module:
    """The network with no layer at 0 and with averages of its own, in the mode of use."""
    for parameter in model.parameters():
        parameter.data += 0.1 * torch.randn_like(parameter)
    with torch.no_grad():
        for _ in range(5):
            model(*arguments(name))
    return model.eval()


@pytest.mark.parametrize("stem", [1, 2])
@pytest.mark.parametrize("name", NAMES)
def test_gradients_reach_every_parameter(name: str, stem: int) -> None:
    model = create_model(name, width=4, stem=stem)
    for parameter in model.parameters():
        parameter.data += 0.1 * torch.randn_like(parameter)
    outputs = tensors(model(*arguments(name)))
    sum((output.float() * torch.randn_like(output)).sum() for output in outputs).backward()
    for key, parameter in model.named_parameters():
        assert parameter.grad is not None, key
        assert torch.isfinite(parameter.grad).all(), key
        assert parameter.grad.abs().max() > 0, key


@pytest.mark.parametrize("name", NAMES)
def test_size_of_the_papers_networks(name: str) -> None:
    count = sum(parameter.numel() for parameter in create_model(name).parameters())
    print(f"{name}: {count} parameters")
    assert 0.5 * LIMITS[name] < count / 1e6 < LIMITS[name]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("H", "W", "stem"), [(8, 8, 2), (9, 31, 1), (33, 18, 2)])
def test_any_size(name: str, H: int, W: int, stem: int) -> None:
    given = arguments(name, 2, H, W)
    model = create_model(name, width=4, stem=stem).eval()
    with torch.no_grad():
        for output in tensors(model(*given)):
            assert output.shape[0] == 2
            assert output.ndim == 2 or output.shape[2:] == (H, W)
            assert torch.isfinite(output).all()


@pytest.mark.parametrize("name", ["segmentation", "specular", "mirror"])
def test_padding_is_by_the_last_row_and_column(name: str) -> None:
    model = awake(create_model(name, width=4, stem=2), name)
    (image,) = arguments(name, 2, 21, 27)
    with torch.no_grad():
        assert torch.equal(model(image), model(pad_to_multiple(image, 32))[..., :21, :27])


@pytest.mark.parametrize("name", NAMES)
def test_pictures_of_a_batch_do_not_see_each_other(name: str) -> None:
    model = awake(create_model(name, width=4, stem=2), name)
    given = arguments(name)
    order = torch.tensor([2, 0, 3, 1])
    with torch.no_grad():
        straight, mixed = tensors(model(*given)), tensors(model(*(part[order] for part in given)))
    for a, b in zip(straight, mixed, strict=True):
        torch.testing.assert_close(a[order], b, rtol=1e-4, atol=1e-5)
        assert (a[0] - a[1]).abs().max() > 1e-4  # it says something of each


def targets(name: str, given: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    y = torch.linspace(0, 1, given[0].shape[2])[:, None]
    if name == "segmentation":
        return (disc(4, 24, 24).float(),)
    if name == "albedo":
        return torch.rand(4, 3) * 0.8 + 0.1, torch.rand(4, 3) * 0.8 + 0.1
    if name == "exponent":
        return (torch.tensor([EXPONENTS[k] for k in (1, 5, 9, 14)]),)
    return (linear_to_srgb(given[0]) * y,)


def error(name: str, output: object, wanted: tuple[Tensor, ...]) -> Tensor:
    if name == "segmentation":
        return F.binary_cross_entropy_with_logits(output, wanted[0])
    if name == "exponent":
        return F.cross_entropy(output, exponent_shares(wanted[0]))
    return torch.stack([(a - b).square().mean() for a, b in zip(tensors(output), wanted, strict=True)]).mean()


@pytest.mark.parametrize("name", [name for name in NAMES if name != "lime"])  # LIME's own loss: test_lime
def test_learns_four_pictures_by_heart(name: str) -> None:
    model = create_model(name, width=8, stem=1 if name in ("albedo", "exponent") else 2)
    optimiser = torch.optim.Adam(model.parameters(), 1e-2)
    given = arguments(name)
    wanted = targets(name, given)
    losses = []
    for _ in range(120):
        optimiser.zero_grad()
        loss = error(name, model(*given), wanted)
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
        if losses[-1] < losses[0] / 12:
            break
    assert losses[-1] < losses[0] / 10, losses[::10]


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("resnet", {}, "unknown; there are segmentation"),
        ("specular", {"depth": 3}, "unknown option 'depth'"),
        ("specular", {"width": "wide"}, "must be a int"),
        ("mirror", {"width": 2}, "from 4 to 128"),
        ("albedo", {"stem": 3}, "must be 1"),
        ("specular", {"layer": "matte"}, "one of specular, diffuse"),
        ("lime", {"width": 1000}, "from 4 to 128"),
    ],
)
def test_a_wrong_name_or_option_is_one_line(name: str, options: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        create_model(name, **options)
    assert "\n" not in str(caught.value)


def test_curve_is_the_reference_curve() -> None:
    linear = np.concatenate([np.linspace(0, 0.01, 101), np.linspace(0.01, 8, 500)]).astype(np.float32)
    encoded = linear_to_srgb(torch.from_numpy(linear))
    np.testing.assert_allclose(encoded.numpy(), reference_curve(linear), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(srgb_to_linear(encoded).numpy(), linear, rtol=1e-5, atol=1e-6)
    assert float(as_recorded(torch.tensor(3.0))) == pytest.approx(1)


@pytest.mark.parametrize("curve", [linear_to_srgb, srgb_to_linear])
def test_curve_has_a_finite_gradient_everywhere(curve: object) -> None:
    at = torch.tensor([-1.0, 0.0, 1e-30, 0.0031308, 0.04045, 0.5, 100.0], requires_grad=True)
    curve(at).sum().backward()  # type: ignore[operator]
    assert at.grad is not None
    assert torch.isfinite(at.grad).all()
    assert at.grad[0] == 0
    assert (at.grad[2:] > 0).all()


def test_mean_over_the_object_ignores_its_surroundings() -> None:
    features = torch.rand(2, 5, 8, 8)
    mask = torch.zeros(2, 1, 16, 16, dtype=torch.bool)
    mask[0, :, 4:8, 2:10] = True
    mean = masked_mean(features, mask)
    torch.testing.assert_close(mean[0], features[0, :, 2:4, 1:5].mean(dim=(1, 2)))
    torch.testing.assert_close(mean[1], features[1].mean(dim=(1, 2)))  # no object: the picture


def test_exponent_survives_its_classes() -> None:
    exponents = torch.tensor([4.0, 5.0, 33.3, 700.0, 1024.0])
    shares = exponent_shares(exponents)
    torch.testing.assert_close(shares.sum(dim=1), torch.ones(5))
    torch.testing.assert_close(expected_exponent(torch.log(shares + 1e-12)), exponents, rtol=1e-4, atol=0)
    torch.testing.assert_close(exponent_shares(torch.tensor([1.0, 1e6])), exponent_shares(torch.tensor([4.0, 1024.0])))
