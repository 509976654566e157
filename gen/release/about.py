"""What whoever releases says of a data set: its version, title, licence and creator; and the date, which nobody but they know."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from gen.errors import InputError

_SEMVER = re.compile(r"(0|[1-9]\d{0,8})\.(0|[1-9]\d{0,8})\.(0|[1-9]\d{0,8})")


@dataclass(frozen=True)
class Licence:
    """A licence for data. hub: its name in Hugging Face's cards. terms: what it asks, in plain words."""

    name: str
    url: str
    hub: str
    terms: str


LICENCES: Mapping[str, Licence] = {
    "CC-BY-4.0": Licence(
        "Creative Commons Attribution 4.0 International",
        "https://creativecommons.org/licenses/by/4.0/",
        "cc-by-4.0",
        "You may copy, change and share these data for any purpose, also commercially. You must name the data set and its creator, link to "
        "the licence, and say whether you changed anything.",
    ),
    "CC-BY-SA-4.0": Licence(
        "Creative Commons Attribution-ShareAlike 4.0 International",
        "https://creativecommons.org/licenses/by-sa/4.0/",
        "cc-by-sa-4.0",
        "You may copy, change and share these data for any purpose, also commercially. You must name the data set and its creator, link to "
        "the licence, say whether you changed anything, and share what you make of the data under the same licence.",
    ),
    "CC0-1.0": Licence(
        "Creative Commons Zero 1.0 Universal",
        "https://creativecommons.org/publicdomain/zero/1.0/",
        "cc0-1.0",
        "The creator gives up all rights to these data as far as the law allows. You may do with them what you like; naming the data set "
        "is a courtesy.",
    ),
}
"""By SPDX identifier."""


@dataclass(frozen=True)
class About:
    """name: of the set. description: a sentence or more. url: where it can be found, or None. date: ISO, or None where nobody said.

    Raises InputError where the version is not three numbers, the licence is unknown, or a text holds what would break a document.
    """

    name: str
    version: str
    title: str
    description: str
    creator: str
    licence: str = "CC-BY-4.0"
    url: str | None = None
    date: str | None = None

    def __post_init__(self) -> None:
        if not _SEMVER.fullmatch(self.version):
            raise InputError(f"--version {self.version}: must be three numbers such as 1.0.0 (semantic versioning)")
        if self.licence not in LICENCES:
            raise InputError(f"--license {self.licence}: must be one of {', '.join(LICENCES)}")
        for option in ("title", "description", "creator", "url"):
            text = getattr(self, option)
            if text is not None and (not text.strip() or len(text) > 2000 or any(map(_breaks, text))):
                raise InputError(f"--{option}: must be one line of text, at most 2,000 characters")
        if self.url is not None and not re.fullmatch(r"https?://\S+", self.url):
            raise InputError(f"--url {self.url}: must start with https://")

    @property
    def terms(self) -> Licence:
        """The licence."""
        return LICENCES[self.licence]

    @property
    def identifier(self) -> str:
        """Name and version in one word."""
        return f"{self.name}-{self.version}"


def _breaks(character: str) -> bool:
    """Whether it is a control character, or a byte of the command line that was no text (PEP 383), which no file takes."""
    return ord(character) < 32 or ord(character) == 127 or 0xD800 <= ord(character) <= 0xDFFF


def release_date() -> str | None:
    """The UTC date that SOURCE_DATE_EPOCH names (reproducible-builds.org), or None where it is not set. The clock is never asked."""
    said = os.environ.get("SOURCE_DATE_EPOCH", "").strip()
    if not said:
        return None
    try:
        return datetime.fromtimestamp(int(said), UTC).date().isoformat()
    except (ValueError, OverflowError, OSError):
        raise InputError(f"SOURCE_DATE_EPOCH={said[:40]}: must be seconds since 1970, a whole number") from None
