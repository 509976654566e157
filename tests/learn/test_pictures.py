"""Pictures from a pack: their order, crops and turns, their truth, and what is refused."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from gen.capture import Capture, Truth
from gen.errors import InputError
from gen.lime import lime_factors
from gen.sets.pack import FORMAT, VERSION, header_bytes
from learn.pictures import PictureBatch, Pictures, sheet

CPU = torch.device("cpu")
KINDS = {"bool": "BOOL", "float16": "F16", "float32": "F32", "int32": "I32"}
H, W = 24, 20


def write(path: Path, arrays: dict[str, NDArray[Any]], splits: list[str], frames: int = 1) -> Path:
    """A pack of items with so many frames each. arrays: layers; what every pack has is added where it is missing."""
    F = frames * len(splits)
    everything = {
        "valid": np.ones((F, H, W), np.bool_),
        "lights": np.tile(np.float32([0, 0, 1]), (F, 1)),
        "intensities": np.ones((F, 3), np.float32),
        "item": np.repeat(np.arange(len(splits), dtype=np.int32), frames),
        **arrays,
    }
    items = [{"id": f"train-{i:06d}", "split": split, "frames": [i * frames, (i + 1) * frames]} for i, split in enumerate(splits)]
    tensors = {name: (KINDS[array.dtype.name], array.shape) for name, array in everything.items()}
    opening, places = header_bytes(tensors, {"format": FORMAT, "version": VERSION, "facts": json.dumps({"items": items})})
    with path.open("wb") as stream:
        stream.write(opening)
        for name, array in sorted(everything.items(), key=lambda entry: places[entry[0]]):
            assert stream.tell() == places[name]
            stream.write(np.ascontiguousarray(array).tobytes())
    return path


def layers(items: int, frames: int = 1) -> dict[str, NDArray[Any]]:
    """Layers that say where they come from: red the frame, green the row, blue the column; a slim object elsewhere in each item."""
    F = items * frames
    frame, row, column = np.meshgrid(np.arange(F), np.arange(H), np.arange(W), indexing="ij")
    diffuse = np.stack([frame, row, column], axis=-1).astype(np.float16)
    mask = np.zeros((items, H, W), np.bool_)
    for i in range(items):
        mask[i, 2 + i % 9 : 12 + i % 9, 1 + i % 12 : 6 + i % 12] = True
    return {"diffuse": diffuse, "specular": 2 * diffuse, "mask": mask}


@pytest.fixture
def pack(tmp_path: Path) -> Path:
    return write(tmp_path / "paper.pack", layers(7), ["train"] * 7)


def source(path: Path, batch: int = 3, seed: int = 1, split: str = "train", **options: Any) -> Pictures:
    return Pictures({"pack": str(path), "validation_share": 0.0, **options}, batch, seed, CPU, split)


def shown(batch: PictureBatch) -> list[int]:
    """The frames of a batch."""
    return batch.diffuse[:, 0, 0, 0].int().tolist()


def same(a: PictureBatch, b: PictureBatch) -> bool:
    return all(torch.equal(getattr(a, name), getattr(b, name)) for name in ("image", "diffuse", "specular", "mask"))


def test_every_epoch_shows_every_picture_once(pack: Path) -> None:
    pictures = source(pack)
    row = [frame for step in range(14) for frame in shown(pictures.batch(step))]
    epochs = [row[7 * epoch : 7 * epoch + 7] for epoch in range(6)]
    assert all(sorted(epoch) == list(range(7)) for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) > 3
    assert pictures.steps_per_epoch == 3
    assert pictures.pictures == 3
    assert len(shown(source(pack, batch=10).batch(0))) == 10  # a batch larger than the pack goes on with the next epoch


def test_a_batch_depends_on_seed_and_number_alone(pack: Path) -> None:
    pictures, again = source(pack, crop=12), source(pack, crop=12)
    forwards = [pictures.batch(step) for step in range(5)]
    backwards = [again.batch(step) for step in reversed(range(5))][::-1]
    assert all(same(a, b) for a, b in zip(forwards, backwards, strict=True))
    other = source(pack, seed=2, crop=12)
    assert not all(same(a, other.batch(step)) for step, a in enumerate(forwards))


def test_layers_keep_together_and_the_picture_is_their_sum(pack: Path) -> None:
    batch = source(pack, batch=32, crop=12).batch(0)
    assert batch.image.shape == (32, 3, 12, 12)
    assert batch.image.dtype == torch.float32
    assert batch.mask.shape == (32, 1, 12, 12)
    assert batch.mask.dtype == torch.bool
    assert torch.equal(batch.specular, 2 * batch.diffuse)
    assert torch.equal(batch.image, batch.diffuse + batch.specular)
    masks = layers(7)["mask"]
    frame, row, column = batch.diffuse.int().unbind(1)
    assert torch.equal(batch.mask[:, 0], torch.from_numpy(masks)[frame, row, column])


def test_combined_is_the_picture_where_the_pack_has_it(tmp_path: Path) -> None:
    combined = np.full((7, H, W, 3), 0.25, np.float16)
    noisy = write(tmp_path / "noisy.pack", {**layers(7), "combined": combined}, ["train"] * 7)
    assert (source(noisy).batch(0).image == 0.25).all()


def test_crops_hold_the_object_where_it_fits_and_show_it_where_not(pack: Path) -> None:
    whole = source(pack, batch=64, crop=12).batch(0).mask
    assert (whole.sum(dim=(1, 2, 3)) == 50).all()  # 10x5 pixels
    assert len({tuple(mask.any(dim=1)[0].tolist()) for mask in whole}) > 3  # not always at the same place
    part = source(pack, batch=64, crop=8).batch(0).mask
    assert (part.sum(dim=(1, 2, 3)) == 40).all()  # as much as fits: 8x5


def test_a_crop_of_a_ragged_object_is_never_empty(tmp_path: Path) -> None:
    arrays = layers(7)
    arrays["mask"][:] = np.eye(H, W, dtype=bool)  # a diagonal: most windows within its extent miss it
    ragged = write(tmp_path / "ragged.pack", arrays, ["train"] * 7)
    assert source(ragged, batch=128, crop=8).batch(0).mask.any(dim=3).any(dim=2).all()
    assert source(ragged, batch=7, crop=8, split="train", flip=False).batch(1).mask.any(dim=3).any(dim=2).all()


def test_all_turns_and_mirrorings_come_and_none_where_they_are_off(pack: Path) -> None:
    def ways(batch: PictureBatch) -> set[tuple[int, ...]]:
        """Whether row and column grow (1), fall (-1) or stay (0) on the way down and on the way right: one word a symmetry."""
        corner, down, right = (batch.diffuse[:, 1:, y, x] for y, x in ((0, 0), (-1, 0), (0, -1)))
        steps = torch.cat([down - corner, right - corner], dim=1).sign().int()
        return {tuple(step) for step in steps.tolist()}

    assert len(ways(source(pack, batch=128, crop=12).batch(0))) == 8
    assert ways(source(pack, batch=32, crop=12, flip=False).batch(0)) == {(1, 0, 0, 1)}
    uncropped = source(pack, batch=64).batch(0)
    assert uncropped.image.shape == (64, 3, H, W)
    assert ways(uncropped) == {(a, 0, 0, b) for a in (1, -1) for b in (1, -1)}  # 24x20: no quarter turns


def test_colours_change_places_in_all_layers_alike(pack: Path, tmp_path: Path) -> None:
    plain, moved = (source(pack, batch=64, recolour=on).batch(0) for on in (False, True))
    assert torch.equal(plain.mask, moved.mask)
    assert torch.equal(moved.specular, 2 * moved.diffuse)
    assert torch.equal(moved.image, moved.diffuse + moved.specular)
    orders = set()
    for before, after in zip(plain.diffuse, moved.diffuse, strict=True):
        (order,) = [order for order in itertools.permutations(range(3)) if torch.equal(before[list(order)], after)]
        orders.add(order)
    assert len(orders) == 6
    held = source(pack, batch=2, split="validation", validation_share=0.3, recolour=True).batch(0)
    assert torch.equal(held.diffuse, source(pack, batch=2, split="validation", validation_share=0.3).batch(0).diffuse)
    lime = write(tmp_path / "lime.pack", glossy(), ["train"] * 2)
    factors = Pictures({"pack": str(lime), "validation_share": 0.0, "recolour": True}, 32, 1, CPU, "train", factors=True).batch(0)
    assert factors.D is not None
    assert factors.m_d is not None
    assert len({tuple(row) for row in factors.m_d.tolist()}) == 6
    torch.testing.assert_close(factors.D * factors.m_d[:, :, None, None], factors.diffuse)


def test_exposure_is_the_same_for_all_layers_of_a_picture(pack: Path) -> None:
    plain, exposed = (source(pack, batch=64, gain=gain).batch(0) for gain in (1.0, 2.0))
    factor = exposed.diffuse.amax((1, 2, 3)) / plain.diffuse.amax((1, 2, 3))
    assert 0.5 <= factor.min() < 0.6
    assert 1.7 < factor.max() <= 2.0
    assert abs(factor.log().mean()) < 0.2
    torch.testing.assert_close(exposed.diffuse, plain.diffuse * factor[:, None, None, None])
    torch.testing.assert_close(exposed.specular, plain.specular * factor[:, None, None, None])
    assert torch.equal(exposed.image, exposed.diffuse + exposed.specular)


def test_whole_pictures_are_enlarged_about_the_object(pack: Path) -> None:
    batch = source(pack, batch=64, zoom=1.6, flip=False).batch(0)
    assert batch.image.shape == (64, 3, H, W)
    torch.testing.assert_close(batch.specular, 2 * batch.diffuse)
    # Green is the row, blue the column: they grow by one over the factor, which is the same both ways to a pixel of the window.
    _, row, column = batch.diffuse.unbind(1)
    down, right = (row[:, 13] - row[:, 8])[:, 0] / 5, (column[:, :, 13] - column[:, :, 8])[:, 0] / 5
    torch.testing.assert_close(down, right, atol=0.06, rtol=0)
    assert down.min() < 0.68
    assert down.max() > 0.95
    assert down.min() >= 1 / 1.6 - 0.03
    # What is shown is the object, as large as it is now.
    areas = batch.mask.sum(dim=(1, 2, 3)) * down * right
    assert areas.min() > 5
    assert areas.max() < 65
    assert torch.equal(batch.mask, source(pack, batch=64, zoom=1.6, flip=False).batch(0).mask)
    held = source(pack, batch=2, split="validation", validation_share=0.3, zoom=1.6).batch(0)
    assert torch.equal(held.diffuse, source(pack, batch=2, split="validation", validation_share=0.3).batch(0).diffuse)


def test_validation_is_the_same_whole_way_round_every_time(tmp_path: Path) -> None:
    divided = write(tmp_path / "divided.pack", layers(7), ["train"] * 4 + ["validation"] * 2 + ["test"])
    held = source(divided, batch=2, split="validation", crop=12)
    first, second = held.batch(0), held.batch(1)
    assert sorted(shown(first)) == [4, 5]
    assert sorted(shown(second)) == [4, 5]
    by_frame = [batch.image[np.argsort(shown(batch))] for batch in (first, second)]
    assert torch.equal(by_frame[0], by_frame[1])
    assert (first.mask.sum(dim=(1, 2, 3)) == 50).all()
    assert sorted(shown(source(divided, batch=4).batch(0))) == [0, 1, 2, 3]


def test_held_out_pictures_are_never_trained_on_and_do_not_depend_on_the_seed(tmp_path: Path) -> None:
    frames = write(tmp_path / "stacks.pack", layers(10, 3), ["train"] * 10, 3)
    train, held = (
        {
            frame
            for step in range(10)
            for frame in shown(source(frames, 3, seed, split, validation_share=0.3, flip=False).batch(step))
        }
        for seed, split in ((1, "train"), (2, "validation"))
    )
    assert train.isdisjoint(held)
    assert train | held == set(range(30))
    assert len(held) == 9
    assert {frame // 3 for frame in train}.isdisjoint({frame // 3 for frame in held})  # a capture stays in one split


def test_pictures_held_on_a_device_are_those_of_the_file(pack: Path) -> None:
    mapped, held = source(pack, crop=12), source(pack, crop=12)
    held.layers = {name: torch.from_numpy(np.array(array)) for name, array in held.layers.items()}
    assert all(same(mapped.batch(step), held.batch(step)) for step in range(6))


def glossy(alpha: float = 0.2) -> dict[str, NDArray[Any]]:
    arrays = layers(2)
    inside = arrays["mask"]
    arrays["diffuse"] = (np.random.default_rng(0).random((2, H, W, 3)) * inside[..., None]).astype(np.float16)
    arrays["specular"] = arrays["mirror"] = arrays["diffuse"][:, ::-1].copy() * inside[..., None]
    arrays["albedo"] = (inside[..., None] * np.float16([0.5, 0.25, 0.75])).astype(np.float16)
    arrays["specular_albedo"] = (inside[..., None] * np.float16([0.125, 0, 0.25])).astype(np.float16)
    arrays["gloss"] = (inside * np.float16(alpha)).astype(np.float16)
    return arrays


def test_factors_are_those_of_gen_lime(tmp_path: Path) -> None:
    arrays = glossy()
    path = write(tmp_path / "lime.pack", arrays, ["train"] * 2)
    pictures = Pictures({"pack": str(path), "flip": False, "validation_share": 0.0}, 2, 1, CPU, "train", factors=True)
    batch = pictures.batch(0)
    order = np.argsort(pictures.item_of[pictures.frames[pictures._numbers(0)]])
    for item, b in enumerate(order):
        layer = {name: np.float32(arrays[name][item]) for name in ("albedo", "specular_albedo", "gloss")}
        layer |= {name: np.float32(arrays[name][item])[None] for name in ("diffuse", "specular", "mirror")}
        images = layer["diffuse"] + layer["specular"]
        expected = lime_factors(Capture(images, np.array([[0, 0, 1.0]]), arrays["mask"][item], truth=Truth(**layer)))
        assert batch.D is not None
        assert batch.S is not None
        assert batch.mirror is not None
        for found, wanted in ((batch.D, expected.D), (batch.S, expected.S), (batch.mirror, expected.mirror)):
            assert wanted is not None
            np.testing.assert_allclose(found[b].permute(1, 2, 0), wanted[0], rtol=1e-5)
        pixel = tuple(np.argwhere(arrays["mask"][item])[0])
        for number, maps in ((batch.m_d, expected.m_d), (batch.m_s, expected.m_s), (batch.exponent, expected.exponent)):
            assert number is not None
            np.testing.assert_allclose(number[b], maps[pixel], rtol=1e-5)
    plain = Pictures({"pack": str(path), "validation_share": 0.0}, 2, 1, CPU, "train").batch(0)
    assert plain.D is None
    assert plain.exponent is None


def test_two_materials_or_a_missing_layer_are_refused_for_lime(tmp_path: Path) -> None:
    arrays = glossy()
    arrays["albedo"][1, :, 3:] *= 0.5
    path = write(tmp_path / "two.pack", arrays, ["train"] * 2)
    with pytest.raises(InputError, match="train-000001 has more than one material"):
        Pictures({"pack": str(path), "validation_share": 0.0}, 2, 1, CPU, "train", factors=True)
    del arrays["mirror"]
    path = write(tmp_path / "less.pack", arrays, ["train"] * 2)
    with pytest.raises(InputError, match="lacks mirror"):
        Pictures({"pack": str(path), "validation_share": 0.0}, 2, 1, CPU, "train", factors=True)


@pytest.mark.parametrize(
    ("options", "split", "says"),
    [
        ({"crops": 12}, "train", "unknown option 'crops'"),
        ({"crop": 25}, "train", "crop = 25 must be 0"),
        ({"crop": 4}, "train", "crop = 4 must be 0"),
        ({"crop": True}, "train", "must be a int"),
        ({"flip": 1}, "train", "must be a bool"),
        ({"pack": ""}, "train", "pack is missing"),
        ({"pack": "/nowhere.pack"}, "train", "there is no such file"),
        ({"train_split": "learning"}, "train", "no item of train_split = 'learning'; the pack's splits are train"),
        ({"validation_share": 1.0}, "train", "less than 1"),
        ({"validation_share": 0.0}, "validation", "no item of validation_split"),
        ({"validation_split": "train"}, "validation", "are both 'train'"),
        ({"zoom": 0.5}, "train", "zoom = 0.5 must be from 1 to 4"),
        ({"zoom": 2.0, "crop": 12}, "train", "and 1 where pictures are cropped"),
        ({"gain": 0.5}, "train", "gain = 0.5 must be from 1 to 16"),
        ({"device_cache_gb": -1}, "train", "must not be negative"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(pack: Path, options: dict[str, Any], split: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        source(pack, split=split, **options)
    assert "\n" not in str(caught.value)


def test_sheet_lays_pictures_down_and_columns_across() -> None:
    grey = torch.arange(3).reshape(3, 1, 1, 1).expand(3, 3, 5, 4) * 0.5
    mask = torch.ones(3, 1, 5, 4)
    found = sheet([grey, mask], rows=2)
    assert found.shape == (10, 8, 3)
    assert (found[:5, :4] == 0).all()
    assert (found[5:, :4] == 188).all()  # sRGB of linear .5
    assert (found[:, 4:] == 255).all()
