"""A campaign against one reader, guided by coverage: python -m tests.hostile.campaign NAME SECONDS FOLDER

Files that are a finding are left in FOLDER as crash-..., timeout-... or oom-...; the exit code is then not 0.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["gen", "recon", "learn"]):
    from tests.hostile.damage import NUMBERS, read_or_refused
    from tests.hostile.readers import READERS

MEGABYTES = 2000
"""Memory of the process, libraries included, from which on a file counts as a bomb."""

SECONDS = 20
"""Seconds that one file may take on a busy machine."""


def main() -> None:
    name, seconds, place = sys.argv[1], float(sys.argv[2]), Path(sys.argv[3])
    reader, folder, corpus = READERS[name], place / "folder", place / "corpus"
    folder.mkdir()
    corpus.mkdir()
    reader.lay(folder)
    sound = (folder / reader.file).read_bytes()
    (corpus / "sound").write_bytes(sound)
    words = place / "words.dict"
    pieces = (*NUMBERS, *reader.grammar)
    words.write_text("".join('"' + "".join(f"\\x{byte:02x}" for byte in piece[:60]) + '"\n' for piece in pieces))
    warnings.simplefilter("error")  # a warning would be a line on the terminal that nobody asked for
    options = [
        f"-max_total_time={int(seconds)}",
        f"-rss_limit_mb={MEGABYTES}",
        f"-timeout={SECONDS}",
        f"-max_len={max(4096, 2 * len(sound))}",
        f"-dict={words}",
        f"-artifact_prefix={place}/",
        "-seed=7",
        "-print_final_stats=1",
    ]
    atheris.Setup([sys.argv[0], *options, str(corpus)], lambda data: read_or_refused(reader, folder, data) and None)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
