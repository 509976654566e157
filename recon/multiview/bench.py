"""The mesh from several views with gloss, without, and of the matte twin: `python -m recon.multiview.bench [FOLDER] [--json]`.

FOLDER: views (see `recon.multiview.views`); where it is missing, the preset multiview-ring is rendered there, and without a name into a
folder that is removed again.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gen.errors import InputError
from gen.files import dumps
from gen.parts import PARTS
from recon.multiview.measure import compare_rows, rows_text
from recon.multiview.views import read_views
from recon.reconstruct import Settings

PRESET = "multiview-ring"


def figures(folder: Path) -> dict[str, Any]:
    """The rows of `compare_rows` of the views in a folder: chromaticity, group where torch is installed, with gloss, matte twin."""
    views, ball = read_views(folder)
    wanted = [Settings("chromaticity", "telea")]
    if PARTS["torch"].look().state == "ok":
        wanted.append(Settings("group", "none"))
    _, rows = compare_rows(views, ball, wanted, progress=lambda title: print(title, file=sys.stderr))
    return rows


def render_ring(folder: Path) -> None:
    """Render the preset into a folder. Raises InputError and MissingPart as rendering does."""
    from gen.sets.campaign import Engine, render_set
    from gen.sets.plan import plan_of

    render_set(plan_of(PRESET), folder, Engine(workers=2))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m recon.multiview.bench", description="Multi-view meshes with and without gloss."
    )
    parser.add_argument("folder", type=Path, nargs="?", help="views, or where to render the preset's")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="degloss-") as scratch:
        folder = options.folder or Path(scratch) / PRESET
        try:
            if not folder.exists():
                render_ring(folder)
            rows = figures(folder)
        except InputError as error:
            print(f"degloss: {error}", file=sys.stderr)
            raise SystemExit(2) from None
    print(dumps(rows) if options.json else rows_text(rows))


if __name__ == "__main__":
    main()
