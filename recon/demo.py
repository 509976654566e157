"""`degloss demo`: the paper's experiment, rendered and measured in one go."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

from gen.capture import read_capture
from gen.files import dumps, writing_folder
from recon.compare import planned_rows
from recon.output import write_into
from recon.pipeline import measure
from recon.progress import steps
from recon.reconstruct import Settings
from recon.registry import default_methods
from recon.tables import text_report

PRESET = "paper-cylinder"


def run_demo(output: Path, json: bool = False) -> None:
    """Render `PRESET` (a glossy substrate cylinder, five lights, 256x256, with the matte twin), measure it and print the table.

    The capture is written to output/capture and read back from there, like anybody's, so the demo walks the whole road.
    Raises InputError where the folder cannot be written, MissingPart where Blender is missing.
    """
    from gen.parts import require
    from gen.render import render_capture
    from gen.spec import read_spec

    require("bpy")
    require("report")
    start = time.perf_counter()
    with writing_folder(output, "demo") as folder, steps() as step:
        step("rendering with Blender")
        render_capture(read_spec(PRESET), folder / "capture")
        step("reading")
        capture = replace(read_capture(folder / "capture"), source=PRESET)
        gloss, repair = default_methods(capture.count)
        step.expect(5 + len(planned_rows(Settings(gloss, repair), capture.truth)))
        shape = measure(capture, gloss, repair, progress=step)
        metrics = write_into(shape, folder, step)
    if json:
        print(dumps(metrics))
        return
    print(text_report(metrics))
    print(f"\n{time.perf_counter() - start:.1f} s in all", file=sys.stderr)
    print(f"\nreport: {output / 'report.html'}")
