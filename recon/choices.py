"""From the words of a command line to the settings of a measurement."""

from __future__ import annotations

from gen.errors import InputError
from recon.defects import require_threshold
from recon.reconstruct import Settings


def settings_from(
    gloss: str | None,
    inpaint: str | None,
    normals: str | None,
    height: str | None,
    threshold: str,
    dilate: str,
    saturated: str,
    shadows: str,
) -> Settings:
    """`Settings` of option values, None taking the default. Raises InputError for an unknown name or an impossible value."""
    given = {"gloss": gloss, "repair": inpaint, "normals": normals, "height": height}
    names = {key: value for key, value in given.items() if value is not None}
    return Settings(
        **names, threshold=threshold_value(threshold), dilate=dilate_value(dilate), saturated=saturated, shadows=shadows
    )


def threshold_value(text: str) -> float | str:
    """ "auto", "otsu", or the number that the text says. Raises InputError for anything else."""
    try:
        return float(text)
    except ValueError:
        require_threshold(text)
        return text


def dilate_value(text: str) -> int:
    """The whole number that the text says. Raises InputError for anything else."""
    try:
        return whole_number(text)
    except ValueError:
        raise InputError(f"--dilate {text}: must be a whole number of pixels, 0 or more") from None


def whole_number(text: str) -> int:
    """A number of plain digits, blanks around them allowed. Raises ValueError for anything else."""
    if not (text.strip().isascii() and text.strip().isdecimal() and len(text) < 20):
        raise ValueError(text)
    return int(text)


def frame_numbers(text: str | None) -> list[int] | None:
    """0-based indices of a list such as "1,3,5" of numbers from 1; None for None. Raises InputError for anything else."""
    if text is None:
        return None
    try:
        numbers = [whole_number(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"--lights {text}: must be numbers from 1 with commas between them, such as 1,3,5") from None
    if any(number < 1 for number in numbers):
        raise InputError(f"--lights {text}: pictures are numbered from 1")
    return [number - 1 for number in numbers]
