"""What an inspection leaves on disk: maps, inspection.json and report.html, all or nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gen.exr import write_exr
from gen.files import write_json, writing_folder
from gen.images import write_png
from recon.inspection.inspection import Inspection
from recon.inspection.maps import deviation_map, look, uncertainty_map, verdict_map, with_bar, with_key
from recon.inspection.report import inspection_page
from recon.page import write_report


def write_inspection(inspection: Inspection, folder: Path) -> dict[str, Any]:
    """Write an inspection into `folder` (made whole under a temporary name, then renamed). Returns its figures.

    deviation.exr: raw.Z, form.Z, features.Z and their uncertainties raw_uncertainty.V, uncertainty.V, in the unit of the figures (which
    its header names), NaN where nothing is compared; verdict.V: 1 pass, 0 cannot be decided, -1 fail, NaN not judged. raw.png, form.png,
    features.png, uncertainty.png, verdict.png: to look at, with their legends. inspection.json; report.html (left out, with a line on
    stderr, where its package is missing). Raises InputError where the folder cannot be written.
    """
    with writing_folder(folder, "inspection") as temporary:
        return write_into(inspection, temporary)


def write_into(inspection: Inspection, folder: Path) -> dict[str, Any]:
    """`write_inspection` into a folder that is there already."""
    found, factor, figures = inspection.deviation, inspection.factor, inspection.figures()
    channels = {f"{name}.Z": getattr(found, name) * factor for name in ("raw", "form", "features")}
    channels |= {f"{name}.V": getattr(found, name) * factor for name in ("raw_uncertainty", "uncertainty")}
    channels["verdict.V"] = inspection.verdict.codes
    write_exr(folder / "deviation.exr", channels, header={"degloss.unit": figures["unit"]})
    titles = {"raw": "raw deviation (form not judged)", "form": "form (not measurable)", "features": "deviation, form removed"}
    for name, title in titles.items():
        picture, bar = deviation_map(inspection, name)
        write_png(folder / f"{name}.png", with_bar(look(inspection, picture), title, bar))
    spread = uncertainty_map(inspection, "uncertainty")
    if spread is not None:
        write_png(folder / "uncertainty.png", with_bar(look(inspection, spread[0]), "uncertainty u, form removed", spread[1]))
    write_png(folder / "verdict.png", with_key(look(inspection, verdict_map(inspection)), "verdict by pixel"))
    figures["report"] = write_report(folder, lambda: inspection_page(inspection))
    write_json(folder / "inspection.json", figures)
    return figures
