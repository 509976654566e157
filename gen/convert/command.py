"""The command `degloss gen convert`. Nothing heavy is imported before it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

Format = Literal["diligent", "webdataset", "exr", "png16"]


def convert(
    source: Path,
    output: Path,
    /,
    *,
    format: Format,
    encoding: Literal["srgb", "linear"] | None = None,
    white: float | None = None,
    json: Annotated[bool, Parameter(negative=(), show_default=False)] = False,
) -> None:
    """Write a capture, or every capture of a rendered set or a release, in a layout that other programs read.

    diligent: DiLiGenT's folders, 16-bit PNGs with light_directions.txt, light_intensities.txt and Normal_gt.mat, for published code.

    png16: 16-bit linear PNGs of pictures and layers; exr: plain EXRs, one RGB file a picture and layer. Both have a capture.yaml, by
    which degloss reads them back.

    webdataset: tar shards with a sample a capture, for training that streams; as in our releases (see degloss gen release), but without
    the preview and with fewer facts.

    What a format does not hold is said in one line on stderr.

    Parameters
    ----------
    source
        A capture's folder of any kind (a render, photographs, DiLiGenT, RTI, psmImages), a set folder, or a release.
    output
        The folder to write; of many captures it holds a folder each, or shards. An earlier conversion there is replaced.
    format
        The layout to write.
    encoding
        How the source files' numbers are meant. Default: 8-bit is sRGB, 16-bit and EXR are linear.
    white
        The radiance that is stored as 65535 in diligent and png16; what is brighter is cut and marked as clipped. Default: the smallest
        power of two that nothing exceeds. The lights' intensities are divided by it.
    json
        Print one JSON object on stdout in place of a sentence.
    """
    import sys
    import time

    from gen.convert.conversion import convert as run
    from gen.files import dumps
    from gen.sets.set_commands import progress_bar

    started = time.monotonic()
    with progress_bar(f"{source}: converting", "captures") as bar:
        done = run(source, output, format, encoding, white, bar)
    took = time.monotonic() - started
    note = done.note(format)
    if note:
        print(note, file=sys.stderr)
    if json:
        facts = {"folder": str(output), "format": format, "captures": done.captures, "pictures": done.pictures}
        print(dumps({**facts, "not_held": dict(done.lost), "seconds": round(took, 3)}))
        return
    many = f"{done.captures} captures, " if done.captures != 1 else ""
    print(f"{output}: {many}{done.pictures} pictures as {format} in {took:.1f} s")
