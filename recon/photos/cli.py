"""`degloss recon capture`: check a folder of photographs. Nothing heavy is imported until it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def capture(
    folder: Path,
    /,
    *,
    encoding: Literal["srgb", "linear"] | None = None,
    json: Annotated[bool, Parameter(negative=(), show_default=False)] = False,
) -> None:
    """Check a folder of photographs and say in plain words what is missing or doubtful.

    Reads the folder as `run` would, by its capture.yaml or in any other known layout, and looks at the lights, the balls they
    were measured on, exposure, brackets, colour, mask and scale. Where it cannot be measured as it is, the exit code is 2.

    Parameters
    ----------
    folder
        The folder of a capture.
    encoding
        How the files' numbers are meant, in place of what capture.yaml says.
    json
        Print one JSON object on stdout.
    """
    import textwrap

    from gen.errors import InputError
    from gen.files import dumps
    from recon.photos.check import check_photos

    findings = check_photos(folder, encoding)
    missing = [finding for finding in findings if finding.level == "missing"]
    if json:
        print(dumps({"folder": folder, "measurable": not missing, "findings": [vars(finding) for finding in findings]}))
    else:
        for finding in findings:
            print(textwrap.fill(finding.text, 110, initial_indent=f"{finding.level:<9} ", subsequent_indent=" " * 10))
        if not findings:
            print("nothing is missing or doubtful")
    if missing:
        what = "1 thing is" if len(missing) == 1 else f"{len(missing)} things are"
        raise InputError(f"{folder}: cannot be measured yet: {what} missing or wrong (see above); put it right and check again")
