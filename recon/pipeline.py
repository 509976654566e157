"""The measurement from end to end: remove the gloss, find and repair the defects, solve for normals, integrate, all by name.

capture = read_capture("photos/bolt")
shape = measure(capture, gloss="group", repair="none", normals="least-squares", height="adaptive")
print(shape.report())
shape.write("out/bolt")
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gen.capture import Capture
from recon.compare import shape_metrics
from recon.output import write_shape
from recon.reconstruct import Progress, Settings, Shape, reconstruct
from recon.registry import GLOSS, default_methods
from recon.suitability import require_suitable
from recon.tables import text_report


@dataclass(frozen=True, eq=False)
class Measurement(Shape):
    """A measured shape that speaks for itself: its figures, a table, and everything on disk."""

    def metrics(self) -> dict[str, Any]:
        """Settings, counts and times, and the errors against the capture's truth where there is truth (see `recon.compare`)."""
        return shape_metrics(self)

    def report(self) -> str:
        """A short table for the terminal."""
        return text_report(self.metrics())

    def write(self, folder: str | Path) -> dict[str, Any]:
        """Maps, layers, mesh, metrics.json and report.html into a folder, all or nothing. Returns the metrics."""
        return write_shape(self, Path(folder))


def measure(
    capture: Capture,
    gloss: str | None = None,
    repair: str | None = None,
    normals: str = Settings.normals,
    height: str = Settings.height,
    *,
    threshold: float | str = Settings.threshold,
    dilate: int = Settings.dilate,
    saturated: str = Settings.saturated,
    shadows: str = Settings.shadows,
    progress: Progress | None = None,
) -> Measurement:
    """Measure the shape of a capture. The choices are those of `Settings`; gloss and repair None are those of `default_methods`.

    Raises InputError where a name is unknown, the capture does not suit (see `recon.suitability`), or nothing can be measured.
    """
    gloss, repair = default_methods(capture.count, gloss, repair)
    settings = Settings(gloss, repair, normals, height, threshold, dilate, saturated, shadows)
    require_suitable(capture)
    if progress is not None:
        progress("removing the gloss")
    start = time.perf_counter()
    layers = GLOSS.load(settings.gloss)(capture)
    seconds = {"gloss": time.perf_counter() - start}
    return Measurement(**vars(reconstruct(capture, layers, settings, progress, seconds)))
