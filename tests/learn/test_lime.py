"""Method (a): how LIME's five networks hang together, and what their losses say of the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from learn.method import create_method
from learn.methods.lime import WEIGHTS, loss_parts
from learn.models import create_model
from learn.models.blocks import linear_to_srgb
from learn.models.lime import LimeFactors, perceptual_loss
from learn.models.lime_nets import EXPONENTS, exponent_shares
from learn.pictures import PictureBatch


def pictures(B: int = 4, side: int = 24) -> PictureBatch:
    """Discs of one material each, image = m_d D + m_s S exactly; the surroundings are grey."""
    torch.manual_seed(5)
    y, x = torch.meshgrid(torch.linspace(-1, 1, side), torch.linspace(-1, 1, side), indexing="ij")
    radius = torch.linspace(0.9, 0.5, B)[:, None, None, None]
    mask = (x**2 + y**2)[None, None] < radius
    centre = torch.rand(B, 2, 1, 1) - 0.5
    far = ((x - centre[:, :1]) ** 2 + (y - centre[:, 1:]) ** 2).expand(B, 3, -1, -1)
    D, S = (1 - 0.6 * far).clamp(min=0.05) * mask, torch.exp(-10 * far) * mask
    m_d, m_s = torch.rand(B, 3) * 0.5 + 0.2, torch.rand(B, 1).expand(-1, 3) * 0.3 + 0.1
    diffuse, specular = m_d[:, :, None, None] * D, m_s[:, :, None, None] * S
    exponent = torch.tensor([EXPONENTS[k] for k in (1, 5, 9, 14)])[:B]
    image = diffuse + specular + 0.2 * ~mask
    return PictureBatch(image, diffuse + 0.2 * ~mask, specular, mask, D, S, 2 * S, m_d, m_s, exponent)


def lively() -> nn.Module:
    """Five networks that say something."""
    torch.manual_seed(0)
    model = create_model("lime", width=4, stem=2)
    for parameter in model.parameters():
        parameter.data += 0.1 * torch.randn_like(parameter)
    batch = pictures()
    with torch.no_grad():
        for _ in range(5):  # averages for BatchNorm
            model(batch.image, batch.mask)
    return model.eval()


def truth_of(batch: PictureBatch) -> LimeFactors:
    """What networks without error would say."""
    assert batch.S is not None
    assert batch.mirror is not None
    assert batch.exponent is not None
    certain = (batch.mask.float() * 2 - 1) * 50
    shares = torch.log(exponent_shares(batch.exponent) + 1e-12)
    return LimeFactors(certain, batch.mask, linear_to_srgb(batch.S), linear_to_srgb(batch.mirror), batch.m_d, batch.m_s, shares)


@pytest.mark.parametrize("given", [True, False])
def test_diffuse_is_the_picture_less_m_s_times_s(given: bool) -> None:
    batch, model = pictures(side=27), lively()
    with torch.no_grad():
        said = model(batch.image, batch.mask if given else None)
        diffuse, specular = model.remove(batch.image, batch.mask if given else None)
    expected = torch.minimum(said.m_s[:, :, None, None] * said.S, batch.image)
    assert torch.equal(specular, expected)
    assert specular.max() > 0
    assert diffuse.min() >= 0
    torch.testing.assert_close(diffuse + specular, batch.image, rtol=1e-6, atol=1e-7)
    assert (specular * ~said.mask == 0).all()


def test_networks_are_wired_as_lime_says() -> None:
    """Each is called by hand with what the one before it gave."""
    batch, model = pictures(), lively()
    with torch.no_grad():
        said = model(batch.image)
        inside = model.segmentation(batch.image) > 0
        assert 0 < inside.float().mean() < 1
        masked = batch.image * inside
        assert torch.equal(said.mask, inside)
        assert torch.equal(said.S_encoded, model.specular(masked))
        assert torch.equal(said.mirror_encoded, model.mirror(said.S))
        m_d, m_s = model.albedo(masked, said.S, inside)
        assert torch.equal(said.m_d, m_d)
        assert torch.equal(said.m_s, m_s)
        assert torch.equal(said.exponent_logits, model.exponent(said.S, said.mirror, inside))
    assert ((said.m_s > 0) & (said.m_s < 1)).all()
    assert (said.exponent >= EXPONENTS[0] - 1e-3).all()
    assert (said.exponent <= EXPONENTS[-1] + 1).all()


def test_a_users_mask_takes_the_place_of_the_segmentation() -> None:
    batch, model = pictures(), lively()
    busy = torch.where(batch.mask, batch.image, torch.rand_like(batch.image))
    with torch.no_grad():
        a, b, own = model(batch.image, batch.mask), model(busy, batch.mask), model(batch.image)
    assert torch.equal(a.mask, batch.mask)
    assert torch.equal(a.S, b.S)  # the surroundings do not matter any more
    assert torch.equal(a.m_s, b.m_s)
    assert not torch.equal(a.mask, own.mask)
    assert not torch.equal(a.S, own.S)
    assert torch.equal(a.mask_logit, own.mask_logit)


def test_untrained_networks_see_no_gloss() -> None:
    batch = pictures()
    with torch.no_grad():
        diffuse, specular = create_model("lime", width=4, stem=2).eval().remove(batch.image, batch.mask)
    assert torch.equal(diffuse, batch.image)
    assert specular.max() == 0


def test_perceptual_loss_is_zero_on_truth_and_counts_what_is_not_explained() -> None:
    batch = pictures()
    parts = (batch.image, batch.mask, batch.D, batch.S, batch.m_d)
    assert perceptual_loss(*parts, batch.m_s).item() < 1e-7
    too_much = perceptual_loss(*parts, batch.m_s + 0.1)
    inside = batch.mask.expand_as(batch.image)
    assert too_much.item() == pytest.approx(0.1 * batch.S[inside].mean().item(), rel=1e-4)


def test_every_part_of_the_loss_is_zero_on_truth_and_only_its_own_feels_an_error() -> None:
    batch = pictures()
    truth = truth_of(batch)
    assert set(loss_parts(truth, batch)) == set(WEIGHTS)
    for name, value in loss_parts(truth, batch).items():
        assert value.item() < 1e-5, name
    worse: dict[str, tuple[dict[str, Tensor], set[str]]] = {
        "mask": ({"mask_logit": -truth.mask_logit}, {"mask"}),
        "S": ({"S_encoded": truth.S_encoded + 0.1}, {"S", "perceptual"}),
        "mirror": ({"mirror_encoded": truth.mirror_encoded - 0.1}, {"mirror"}),
        "m_d": ({"m_d": truth.m_d + 0.1}, {"albedo", "perceptual"}),
        "m_s": ({"m_s": truth.m_s + 0.1}, {"albedo", "perceptual"}),
        "exponent": ({"exponent_logits": -truth.exponent_logits}, {"exponent"}),
    }
    for what, (change, felt) in worse.items():
        parts = loss_parts(truth._replace(**change), batch)
        assert {name for name, value in parts.items() if value.item() > 1e-3} == felt, what


def test_what_is_undefined_does_not_count() -> None:
    """No highlight, so no S and no exponent: neither is asked for."""
    batch = pictures()
    assert batch.m_s is not None
    assert batch.exponent is not None
    dull = torch.tensor([1.0, 0.0, 1.0, 0.0])
    batch = replace(batch, m_s=batch.m_s * dull[:, None], exponent=batch.exponent * dull)
    truth = truth_of(batch)
    wrong = dull[:, None] == 0
    lying = truth._replace(
        S_encoded=truth.S_encoded + wrong[:, :, None, None], exponent_logits=torch.where(wrong, -1, 1) * truth.exponent_logits
    )
    parts = loss_parts(lying, batch)
    assert parts["S"].item() < 1e-5
    assert parts["exponent"].item() < 1e-5


def test_learns_four_pictures_by_heart() -> None:
    torch.manual_seed(0)
    method, batch = create_method("lime"), pictures()
    model = method.build({"width": 8, "stem": 2})
    optimiser = torch.optim.Adam(model.parameters(), 1e-2)
    losses = []
    for _ in range(150):
        optimiser.zero_grad()
        loss, figures = method.loss(model, batch, 0.0)
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
        if losses[-1] < losses[0] / 12:
            break
    assert losses[-1] < losses[0] / 10, losses[::10]
    assert figures["mse"] < figures["mse_input"]


def test_samples_leave_the_networks_in_their_mode() -> None:
    batch, method, model = pictures(), create_method("lime"), lively().train()
    before = {key: value.clone() for key, value in model.state_dict().items()}
    sheet = method.samples(model, batch)
    assert sheet.shape == (4 * 24, 9 * 24, 3)
    assert sheet.dtype == np.uint8
    assert np.array_equal(sheet[:, 8 * 24 :, 0] > 0, batch.mask.reshape(4 * 24, 24).numpy())
    assert model.training
    assert all(torch.equal(before[key], value) for key, value in model.state_dict().items())
