"""What a Capture says of its lights: directions, strengths, kinds, places, and the true ones where what it states is known to be off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError

if TYPE_CHECKING:
    from gen.capture import Capture

Numbers = NDArray[np.float64]

NEAR = ("point", "area")
"""Kinds of light that stand at a place: the direction to them differs from pixel to pixel."""

WITHOUT_DIRECTION = ("environment", "ambient", "several")
"""Kinds of light that come from many directions: the one stated, toward the camera, only fills the array."""

KINDS = ("sun", *NEAR, *WITHOUT_DIRECTION)

TRUE_LIGHTS, TRUE_INTENSITIES, TRUE_POSITIONS = "true_lights", "true_intensities", "true_positions_mm"
"""Entries of a capture's provenance where the stated lights have errors: lists, one entry a picture, shaped as in the Capture."""


LONGEST = 1e100
"""The largest component of a light direction."""


def check_lights(lights: object, count: int, where: str) -> Numbers:
    """Unit light directions (K, 3) from anything like them; InputError unless they are finite, have a length, and are one a picture."""
    L = np.asarray(lights, dtype=np.float64)
    if L.ndim != 2 or L.shape[1] != 3:
        raise InputError(f"{where}: light directions must be rows of three numbers, got an array of shape {L.shape}")
    if len(L) == 0 or count == 0:
        raise InputError(f"{where}: there are no lights")
    if len(L) != count:
        raise InputError(f"{where}: {len(L)} light directions for {count} pictures; there must be one a picture")
    if not np.isfinite(L).all():
        raise InputError(f"{where}: light direction {int(np.argmin(np.isfinite(L).all(axis=1))) + 1} is not finite")
    check_not_endless(L, where)
    length = np.linalg.norm(L, axis=1)
    if (length < 1e-9).any():
        raise InputError(f"{where}: light direction {int(np.argmin(length)) + 1} has no length")
    # A unit vector stays as it is, so that a capture read back, or changed in another part, keeps its lights bit for bit.
    length[np.abs(length - 1) < 1e-12] = 1.0
    unit: Numbers = L / length[:, None]
    return unit


def check_not_endless(directions: Numbers, where: str) -> None:
    """InputError where a direction is so long that its square is beyond all numbers."""
    endless = (np.abs(directions) > LONGEST).any(axis=1)
    if endless.any():
        raise InputError(
            f"{where}: light direction {int(np.argmax(endless)) + 1} is longer than {LONGEST:g}; any shorter one points alike"
        )


def check_intensities(given: object, count: int, where: str) -> Numbers:
    """Light intensities (K, 3) from one or three numbers a picture, ones where None; InputError unless they are positive and finite."""
    if given is None:
        return np.ones((count, 3))
    E = np.asarray(given, dtype=np.float64)
    if E.shape == (count,) or E.shape == (count, 1):
        E = np.repeat(E.reshape(count, 1), 3, axis=1)
    if E.shape != (count, 3):
        raise InputError(
            f"{where}: light intensities of shape {E.shape} for {count} pictures; there must be one or three a picture"
        )
    if not np.isfinite(E).all() or (E <= 0).any():
        raise InputError(f"{where}: light intensities must be positive and finite")
    return E


def check_kinds(kinds: Sequence[str], count: int, where: str) -> tuple[str, ...]:
    """The kind of each picture's light, all "sun" where none is given; InputError unless they are names of `KINDS`, one a picture."""
    found = tuple(kinds) or ("sun",) * count
    if len(found) != count:
        raise InputError(f"{where}: {len(found)} kinds of light for {count} pictures; there must be one a picture")
    for k, kind in enumerate(found):
        if kind not in KINDS:
            raise InputError(f"{where}: light {k + 1} is of the unknown kind {kind!r:.40}; there are {', '.join(KINDS)}")
    return found


def check_positions(positions: object, kinds: tuple[str, ...], where: str) -> Numbers | None:
    """Places (K, 3) of the near lights, NaN rows for all others, None where no light is near.

    kinds: checked. Raises InputError where a near light has no place or one at the origin, or a light that is not near has one.
    """
    count = len(kinds)
    P = np.full((count, 3), np.nan) if positions is None else np.asarray(positions, dtype=np.float64)
    if P.shape != (count, 3):
        raise InputError(
            f"{where}: light positions of shape {P.shape} for {count} pictures; there must be three numbers a picture"
        )
    for k, kind in enumerate(kinds):
        if kind not in NEAR and not np.isnan(P[k]).all():
            raise InputError(f"{where}: light {k + 1} has a position, but is of the kind '{kind}', which has none")
        if kind in NEAR and not np.isfinite(P[k]).all():
            raise InputError(f"{where}: light {k + 1} is of the kind '{kind}', but has no position of three finite numbers")
        if kind in NEAR and not np.linalg.norm(P[k]) > 1e-9:
            raise InputError(f"{where}: light {k + 1} stands at the origin, where the object is")
    return P if any(kind in NEAR for kind in kinds) else None


def of_pictures(provenance: Mapping[str, Any], chosen: Sequence[int], count: int) -> Mapping[str, Any]:
    """The provenance of some pictures only: its entries on true lights keep theirs. count: pictures there were."""
    kept = {}
    for name in (TRUE_LIGHTS, TRUE_INTENSITIES, TRUE_POSITIONS):
        rows = provenance.get(name)
        if isinstance(rows, list) and len(rows) == count:
            kept[name] = [rows[k] for k in chosen]
    return {**provenance, **kept} if kept else provenance


def true_lights(capture: Capture) -> tuple[Numbers, Numbers]:
    """(directions, intensities), each (K, 3), that the pictures were taken under: the stated ones unless the provenance knows better.

    Raises InputError where the provenance holds something else.
    """
    where, record = capture.source, capture.provenance
    try:
        lights = check_lights(record[TRUE_LIGHTS], capture.count, where) if TRUE_LIGHTS in record else capture.lights
        if TRUE_INTENSITIES in record:
            return lights, check_intensities(record[TRUE_INTENSITIES], capture.count, where)
    except (TypeError, ValueError, OverflowError) as error:
        what = str(error).removeprefix(f"{where}: ")
        raise InputError(f"{where}: what its provenance says of the true lights cannot be used ({what})") from None
    return lights, capture.intensities
