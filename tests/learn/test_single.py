"""Methods (b) and (c): what their network's output means, and how it is judged."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from gen.errors import InputError
from gen.srgb import linear_to_srgb as reference_curve
from learn.method import create_method
from learn.models import create_model
from learn.models.blocks import as_recorded
from learn.models.lime_nets import LAYERS, encoded_diffuse
from learn.pictures import PictureBatch


def pictures(B: int = 4, side: int = 24) -> PictureBatch:
    """Shaded discs with a white highlight, black surroundings; some pixels of the highlight are over the sensor's top."""
    torch.manual_seed(3)
    y, x = torch.meshgrid(torch.linspace(-1, 1, side), torch.linspace(-1, 1, side), indexing="ij")
    mask = (x**2 + y**2 < 0.8)[None, None].expand(B, 1, -1, -1)
    centre = torch.rand(B, 2) * 0.8 - 0.4
    far = (x - centre[:, :1, None]) ** 2 + (y - centre[:, 1:, None]) ** 2
    diffuse = torch.rand(B, 3, 1, 1) * (1 - 0.5 * far[:, None]).clamp(min=0) * mask
    specular = 0.6 * torch.exp(-20 * far)[:, None].expand(-1, 3, -1, -1) * mask
    return PictureBatch(diffuse + specular, diffuse, specular, mask)


def lively(layer: str) -> nn.Module:
    """A network that says something, of any size and sign."""
    torch.manual_seed(0)
    model = create_model("specular", width=4, stem=2, layer=layer)
    for parameter in model.parameters():
        parameter.data += 0.1 * torch.randn_like(parameter)
    with torch.no_grad():
        for _ in range(5):  # averages for BatchNorm
            model(pictures().image)
    return model.eval()


def no_grad(model: nn.Module, image: Tensor, mask: Tensor | None) -> tuple[Tensor, Tensor]:
    with torch.no_grad():
        return model.remove(image, mask)


@pytest.mark.parametrize("layer", LAYERS)
@pytest.mark.parametrize("masked", [True, False])
def test_layers_are_not_negative_and_add_up_to_the_picture(layer: str, masked: bool) -> None:
    batch = pictures(side=27)
    image = batch.image * 2 + 0.01
    diffuse, specular = no_grad(lively(layer), image, batch.mask if masked else None)
    assert diffuse.min() >= 0
    assert specular.min() >= 0
    torch.testing.assert_close(diffuse + specular, image, rtol=1e-6, atol=1e-7)
    outside = ~batch.mask.expand_as(image)
    assert bool((specular[outside] == 0).all()) is masked
    assert (specular > 0).any()


@pytest.mark.parametrize("layer", LAYERS)
def test_surroundings_outside_the_mask_do_not_matter(layer: str) -> None:
    batch, model = pictures(), lively(layer)
    busy = torch.where(batch.mask, batch.image, torch.rand_like(batch.image))
    plain, other = no_grad(model, batch.image, batch.mask)[0], no_grad(model, busy, batch.mask)[0]
    assert torch.equal(plain * batch.mask, other * batch.mask)
    assert torch.equal(other * ~batch.mask, busy * ~batch.mask)


def test_an_untrained_network_of_b_sees_no_gloss() -> None:
    batch = pictures()
    image = batch.image.clamp(max=1)
    diffuse, specular = no_grad(create_model("specular", width=4).eval(), image, batch.mask)
    torch.testing.assert_close(diffuse, image, rtol=1e-5, atol=1e-6)
    assert specular.max() < 1e-5


@pytest.mark.parametrize("layer", LAYERS)
def test_the_true_output_gives_the_true_layer(layer: str) -> None:
    batch = pictures()
    truth = as_recorded(batch.diffuse)
    said = {"specular": as_recorded(batch.image) - truth, "diffuse": truth}[layer]
    torch.testing.assert_close(encoded_diffuse(layer, batch.image, said, batch.mask), truth)
    model = lively(layer)
    model.forward = lambda masked: said  # the reading of the output alone is under test
    diffuse, specular = no_grad(model, batch.image, batch.mask)
    torch.testing.assert_close(diffuse, batch.diffuse, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(specular, batch.specular, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("name", ["specular", "diffuse"])
def test_figures_are_the_papers_score(name: str) -> None:
    """Against numpy and the reference curve, with the layers of `remove`; what is minimised is no smaller than the score."""
    batch, method, model = pictures(), create_method(name), lively(name)
    loss, figures = method.loss(model, batch, 0.0)
    diffuse, _ = no_grad(model, batch.image, batch.mask)

    def score(layer: Tensor) -> float:
        encoded = [np.clip(reference_curve(part.numpy()) * 255, 0, 255) for part in (layer, batch.diffuse)]
        return float(np.mean((encoded[0] - encoded[1]) ** 2))

    assert figures["mse"].item() == pytest.approx(score(diffuse), rel=1e-4)
    assert figures["mse_input"].item() == pytest.approx(score(batch.image), rel=1e-4)
    assert loss.item() * 255**2 >= figures["mse"].item()


@pytest.mark.parametrize("name", ["specular", "diffuse"])
def test_learns_four_pictures_by_heart(name: str) -> None:
    torch.manual_seed(0)
    method, batch = create_method(name), pictures()
    model = method.build({"width": 8, "stem": 2})
    optimiser = torch.optim.Adam(model.parameters(), 1e-2)
    scores = []
    for _ in range(120):
        optimiser.zero_grad()
        loss, figures = method.loss(model, batch, 0.0)
        loss.backward()
        optimiser.step()
        scores.append(figures["mse"].item())
        if scores[-1] < scores[0] / 12:
            break
    assert scores[-1] < scores[0] / 10, scores[::10]


@pytest.mark.parametrize("name", ["specular", "diffuse"])
def test_samples_leave_the_network_in_its_mode(name: str) -> None:
    batch, method = pictures(6), create_method(name)
    model = lively(name).train()
    before = {key: value.clone() for key, value in model.state_dict().items()}
    sheet = method.samples(model, batch)
    assert sheet.shape == (4 * 24, 5 * 24, 3)
    assert sheet.dtype == np.uint8
    expected = np.round(np.clip(reference_curve(batch.image[1].permute(1, 2, 0).numpy()), 0, 1) * 255)
    np.testing.assert_allclose(sheet[24:48, :24], expected, atol=1)
    assert model.training
    assert all(torch.equal(before[key], value) for key, value in model.state_dict().items())


@pytest.mark.parametrize(
    ("options", "says"),
    [({"layer": "diffuse"}, "the method's own"), ({"levels": 3}, "unknown option"), ({"stem": 4}, "must be 1")],
)
def test_wrong_options(options: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        create_method("specular").build(options)
