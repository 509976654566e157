"""The group network on pictures of any size: its trunk over the whole, made smaller, its head in tiles. What comes out is that of one look.

Of a whole picture nothing enters the network but its mean brightness, which is gathered first. The trunk looks far around, but at pictures
that are made smaller for it; the head looks at full size, but hardly beyond each pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from learn.models.evidence import evidence, level_of, roots
from learn.models.group import GroupLayers, GroupNet, Shrunk, enlarged, shrink_of, shrunk

Part = tuple[slice, slice]
"""Rows and columns."""

ROWS = 256
"""Rows of the full-size pictures, about, that are gathered at a time."""


@dataclass(frozen=True)
class Given:
    """What the network is given, by parts, on its device.

    images: part -> (1, K, 3, h, w) reflectance. valid: part -> (1, K, h, w) bool. mask: (H, W) bool. lights: (1, K, 3), or None where
    unknown.
    """

    images: Callable[[Part], Tensor]
    valid: Callable[[Part], Tensor]
    mask: Tensor
    lights: Tensor | None

    def inside(self, part: Part) -> Tensor:
        """The mask of a part, (1, h, w)."""
        return self.mask[part][None]


@dataclass(frozen=True)
class Gathered:
    """What is known of the whole: its brightness at full size, and the pictures that the trunk looks at, with theirs."""

    level: Tensor
    small: Shrunk
    small_level: Tensor


def layers_in_tiles(
    model: GroupNet, given: Given, tiles: Iterable[tuple[Part, Part]], most: int
) -> Iterator[tuple[Part, GroupLayers]]:
    """(where they belong, the layers there) for each tile that shows something of the object.

    tiles: (what is looked at, what is kept of it): more around what is kept than the head looks at, which is one pixel and one more in each
    refinement. most: samples that the trunk is given at once. Where the smaller pictures have more, as those of an object do that is thin
    and long, it is given the surroundings of each tile, as far as it looks.
    """
    shrink = shrink_of(given.mask)
    known = gathered(given, shrink)
    whole = (slice(0, given.mask.shape[0]), slice(0, given.mask.shape[1]))
    at_once = known.small.valid.numel() <= most
    coarse, start = trunk_at(model, given, known, whole, shrink)[0] if at_once else None, (0, 0)
    for seen, kept in tiles:
        if not given.mask[seen].any():
            continue
        if not at_once:
            coarse, start = trunk_at(model, given, known, seen, shrink)
        assert coarse is not None
        images, valid, mask = given.images(seen), given.valid(seen), given.inside(seen)
        found = evidence(images, given.lights, valid, mask, known.level)
        features = found.features.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        layers = model.head(images, given.lights, valid, mask, found, features, cut(coarse, start, seen, shrink))
        within = tuple(slice(a.start - b.start, a.stop - b.start) for a, b in zip(kept, seen, strict=True))
        yield (
            kept,
            GroupLayers(
                *(
                    maps[(..., *within)]
                    for maps in (layers.matte, layers.diffuse, layers.specular, layers.confidence, layers.normals)
                )
            ),
        )


def gathered(given: Given, shrink: int) -> Gathered:
    """What is known of the whole, from strips of rows."""
    height, width = given.mask.shape
    step = -(-ROWS // shrink) * shrink
    parts, sums, small_sums = [], [], []
    for top in range(0, height, step):
        rows = (slice(top, min(top + step, height)), slice(0, width))
        images, inside = given.images(rows), given.inside(rows)
        sums.append(roots(images, inside))
        parts.append(shrunk(images, given.valid(rows), inside, shrink))
        small_sums.append(roots(parts[-1].images, parts[-1].mask))
    small = Shrunk(
        torch.cat([p.images for p in parts], -2), torch.cat([p.valid for p in parts], -2), torch.cat([p.mask for p in parts], -2)
    )
    levels = [level_of(*(torch.stack(s).sum(0) for s in zip(*of, strict=True))) for of in (sums, small_sums)]
    return Gathered(levels[0], small, levels[1])


def trunk_at(model: GroupNet, given: Given, known: Gathered, part: Part, shrink: int) -> tuple[Tensor, tuple[int, int]]:
    """What the trunk sees of a part of the pictures and around it, (K, head, h, w), and its first row and column in what it sees of all.

    It begins where the strides of the whole fall.
    """
    step, reach = 1 << len(model.widths), model.reach
    small = known.small
    around = []
    for span, length in zip(part, small.mask.shape[1:], strict=True):
        first = max(span.start // shrink - reach, 0) // step * step
        around.append(slice(first, min(-(-span.stop // shrink) + reach, length)))
    here = (..., *around)
    seen = evidence(small.images[here], given.lights, small.valid[here], small.mask[here], known.small_level).features.flatten(
        0, 1
    )
    coarse = model.trunk(seen.contiguous(memory_format=torch.channels_last), small.images.shape[1])
    return coarse, (around[0].start // 2, around[1].start // 2)


def cut(coarse: Tensor, start: tuple[int, int], part: Part, shrink: int) -> Tensor:
    """Of what the trunk saw, enlarged to full size, a part. start: as `trunk_at` gives it."""
    factor = 2 * shrink
    near, within = [], []
    for span, first, length in zip(part, start, coarse.shape[2:], strict=True):
        low = max(span.start // factor - 1 - first, 0)  # one more on either side, for what lies between
        near.append(slice(low, min(-(-span.stop // factor) + 1 - first, length)))
        at = (first + low) * factor
        within.append(slice(span.start - at, span.stop - at))
    large: Tensor = enlarged(coarse[(..., *near)], shrink)[(..., *within)]
    return large
